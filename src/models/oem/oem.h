// SPDX-License-Identifier: Apache-2.0
// CCSDS Orbit Ephemeris Messages (CCSDS 502.0-B-3, chapter 5), KVN form, read and written, with covariance.
//
// Edges in km and km/s; here metres. Frames "ICRF", "GCRF", "EME2000" and "J2000" are all taken as ICRF axes: no bias
// is applied. Covariances may also stand on the orbit's axes RTN, RSW or TNW. Reading is strict: unknown or misplaced
// keywords, a wrong number of fields, epochs out of order or outside START_TIME..STOP_TIME are errors at
// "name:line:column". Segments of one object, frame, centre and time system are joined where one begins with the state
// with which the last ended; anything else between segments is an error.
#pragma once

#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "foundation/base/error.h"
#include "foundation/time/epoch.h"
#include "models/ephemeris/bodies.h"
#include "models/ephemeris/ephemeris.h"

namespace astronav {

struct OemCovariance {
  Epoch epoch;
  Mat6 covariance;  // position, velocity; m, m/s
};

struct Oem {
  std::string object_name = "ASTRONAV";
  std::string object_id = "2026-000A";
  std::string originator = "ASTRONAV";
  // ISO 8601 UTC. Where empty, the first state's epoch is written: the same states always give the same bytes.
  std::string creation_date;
  std::vector<std::string> comments;  // of the header, one line each
  BodyId center = body::solar_system_barycenter;
  TimeScale scale = TimeScale::tdb;
  std::vector<Epoch> epochs;               // strictly ascending
  std::vector<State> states;               // N, relative to the centre
  std::vector<OemCovariance> covariances;  // epochs ascending
  // The part of the span where interpolation is meant to be used (USEABLE_START_TIME, USEABLE_STOP_TIME).
  std::optional<Epoch> useable_begin;
  std::optional<Epoch> useable_end;
};

// corrupt_data (breaks the format), unsupported (a frame, time system or jump between segments that is not handled).
Result<Oem> parse_oem(std::string_view text, std::string_view name_for_errors);
// As CCSDS_OEM_VERS 3.0, one segment, frame ICRF, rounded to um and nm/s. Needs at least one state.
std::string to_text(const Oem& oem);

}  // namespace astronav
