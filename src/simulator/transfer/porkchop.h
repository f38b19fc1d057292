// SPDX-License-Identifier: Apache-2.0
// Pork-chop plots: what a ballistic transfer costs, by the day of departure and the time of flight.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "foundation/base/error.h"
#include "foundation/time/epoch.h"
#include "models/ephemeris/ephemeris.h"
#include "simulator/transfer/lambert.h"

namespace astronav::transfer {

struct PorkchopSettings {
  Epoch departure_begin, departure_end;
  Duration departure_step = Duration::days(2.0);
  Duration shortest = Duration::days(100.0);  // time of flight
  Duration longest = Duration::days(450.0);
  Duration flight_step = Duration::days(2.0);
};

// Lambert legs on the grid of both; empty where the two places lie in line with the Sun.
struct Porkchop {
  BodyId from, to;
  std::vector<Epoch> departures;
  std::vector<Duration> flights;
  std::vector<std::optional<LambertLeg>> legs;  // departures.size() rows of flights.size()
  const std::optional<LambertLeg>& at(std::size_t departure, std::size_t flight) const {
    return legs[departure * flights.size() + flight];
  }
  // The leg with the least C3.
  LambertLeg least_c3() const;
};

// invalid_argument: ends before begins, steps not above zero, more than a million legs; errors of the ephemeris.
Result<Porkchop> porkchop(const Ephemeris& ephemeris, BodyId from, BodyId to, const PorkchopSettings& settings);

// One line a leg: departure_tdb,arrival_tdb,days,c3_km2_s2,v_infinity_departure_km_s,v_infinity_arrival_km_s.
std::string to_csv(const Porkchop& porkchop);
// Colours and lines of C3, dashed lines of the v-infinity at arrival; `title` above.
std::string to_svg(const Porkchop& porkchop, const std::string& title);

}  // namespace astronav::transfer
