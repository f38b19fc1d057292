// SPDX-License-Identifier: Apache-2.0
#include "simulator/trajectory/flown.h"

#include <gtest/gtest.h>

#include "support/shipped_ephemeris.h"

namespace astronav::trajectory {
namespace {

Epoch day(double d) {
  return Epoch::parse("2027-01-01T00:00:00 TDB").value() + Duration::days(d);
}
FlightPlan plan() {
  FlightPlan p{.begin = day(0), .end = day(40), .initial = {}};
  p.initial = testing::shipped_ephemeris().state(body::earth, body::solar_system_barycenter, day(0)).value();
  p.initial.p_m += 3e9 * p.initial.v_m_s.normalized();
  p.thrust = {.mass_kg = 22.0, .arcs = {{day(5), day(25), 1.9e-3, 3000.0, Vec3::UnitX()}}};
  return p;
}
Disturbances all() {
  return {.unmodelled = {.sigma_m_s2 = 1e-8},
          .thrust = {.magnitude_sigma = 0.005, .pointing_sigma_rad = 0.3 * kDegree},
          .unloading = true};
}
Vec3 end_of(const Disturbances& d, std::uint64_t seed = 1, std::uint64_t sample = 0) {
  const auto flight = fly(testing::shipped_ephemeris(), {}, plan(), d, seed, sample);
  EXPECT_TRUE(flight) << (flight ? "" : describe(flight.error()));
  return flight->arc.at(day(40)).value().p_m;
}

TEST(Flown, IsTheSameForTheSameSeedAndSample) {
  EXPECT_EQ(end_of(all()), end_of(all()));
  EXPECT_GT((end_of(all(), 2) - end_of(all())).norm(), 1e5);
  EXPECT_GT((end_of(all(), 1, 1) - end_of(all())).norm(), 1e5);
}

// Each disturbance has its own dice. What they do is small enough to add up.
TEST(Flown, DisturbancesAreDrawnApart) {
  const Vec3 none = end_of({});
  Disturbances a = all(), b = {}, c = all();
  a.unloading = false;
  b.unloading = true;
  const Vec3 without_kicks = end_of(a) - none, kicks = end_of(b) - none, together = end_of(c) - none;
  EXPECT_LT((together - without_kicks - kicks).norm(), 0.01 * kicks.norm());
  // About 13 kicks of 7.5 mm/s, each for 20 days in the mean: tens of kilometres.
  EXPECT_GT(kicks.norm(), 5e3);
  EXPECT_LT(kicks.norm(), 3e5);
  // 0.5 % and 0.3 degree of 9e-5 m/s^2, correlated over a day: hundreds of kilometres.
  EXPECT_GT(without_kicks.norm(), 3e4);
  EXPECT_LT(without_kicks.norm(), 3e6);
}

TEST(Flown, HandsErrorsOn) {
  Disturbances d = all();
  d.thrust.magnitude_sigma = -1.0;
  EXPECT_FALSE(fly(testing::shipped_ephemeris(), {}, plan(), d, 1, 0));
  d = all();
  d.kicks.largest_m_s = -1.0;
  EXPECT_FALSE(fly(testing::shipped_ephemeris(), {}, plan(), d, 1, 0));
  FlightPlan late = plan();
  late.end = day(90000);
  EXPECT_FALSE(fly(testing::shipped_ephemeris(), {}, late, {}, 1, 0));
}

}  // namespace
}  // namespace astronav::trajectory
