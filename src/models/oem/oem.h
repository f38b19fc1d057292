// SPDX-License-Identifier: Apache-2.0
// CCSDS Orbit Ephemeris Messages (CCSDS 502.0-B-3, chapter 5), KVN form, read and written, with covariance.
//
// Edges in km and km/s; here metres. The frame "ICRF" (or "EME2000", taken as ICRF axes: no bias is applied).
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
  Eigen::Matrix<double, 6, 6> covariance;  // m, m/s
};

struct Oem {
  std::string object_name = "ASTRONAV";
  std::string object_id = "2026-000A";
  std::string originator = "ASTRONAV";
  BodyId center = body::solar_system_barycenter;
  TimeScale scale = TimeScale::tdb;
  std::vector<Epoch> epochs;
  std::vector<State> states;  // N, relative to the centre
  std::vector<OemCovariance> covariances;
};

Result<Oem> parse_oem(std::string_view text, std::string_view name_for_errors);
std::string to_text(const Oem& oem);

}  // namespace astronav
