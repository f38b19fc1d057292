// SPDX-License-Identifier: Apache-2.0
#include "simulator/transfer/ballistic.h"

#include <string>

#include <Eigen/Geometry>
#include <gtest/gtest.h>

#include "support/shipped_ephemeris.h"

namespace astronav::transfer {
namespace {

const Ephemeris& ephemeris() {
  return testing::shipped_ephemeris();
}
Epoch date(const char* text) {
  return Epoch::parse(text, TimeScale::tdb).value();
}
State of(BodyId id, Epoch e) {
  return ephemeris().state(id, body::solar_system_barycenter, e).value();
}

class EarthMars : public ::testing::TestWithParam<std::pair<const char*, double>> {};

TEST_P(EarthMars, StandsAtTheAimPoint) {
  const auto [departure, days] = GetParam();
  const auto design = design_ballistic(ephemeris(), body::earth, body::mars, date(departure), Duration::days(days));
  ASSERT_TRUE(design) << describe(design.error());
  RecordProperty("iterations", design->iterations);
  EXPECT_LT(design->aim_error_m, 1e3);
  EXPECT_LE(design->iterations, 12);
  EXPECT_EQ(design->begin, date(departure) + Duration::days(3.0));
  EXPECT_EQ(design->end, date(departure) + Duration::days(days - 3.0));
  EXPECT_EQ(design->arc.begin(), design->begin);
  EXPECT_EQ(design->arc.end(), design->arrival);

  // Flown again from the one state that it hands on, under its own force model: beside Mars.
  const auto forces = dynamics::ForceModel::create(ephemeris());
  ASSERT_TRUE(forces);
  const auto flown = dynamics::propagate(*forces, design->initial, design->begin, design->arrival);
  ASSERT_TRUE(flown);
  EXPECT_NEAR((flown->nodes().back().state.p_m - of(body::mars, design->arrival).p_m).norm(), design->miss_distance_m,
              2e3);
  EXPECT_GT(design->miss_distance_m, 1.0e8);
  EXPECT_LT(design->miss_distance_m, 1.35e8);

  // Backwards in time it comes from a pericentre 300 km above the Earth, at the departure epoch.
  const auto back = dynamics::propagate(*forces, design->initial, design->begin, design->departure);
  ASSERT_TRUE(back) << describe(back.error());
  const State start = back->nodes().front().state;
  const State earth = of(body::earth, design->departure);
  EXPECT_NEAR((start.p_m - earth.p_m).norm(), 6378.137e3 + 300e3, 1e3);
  EXPECT_NEAR((start.p_m - earth.p_m).normalized().dot((start.v_m_s - earth.v_m_s).normalized()), 0.0, 1e-3);

  // The conics patched together are right to a few per cent.
  const double v_departure = design->lambert.v_infinity_departure_m_s.norm();
  const double v_arrival = design->lambert.v_infinity_arrival_m_s.norm();
  EXPECT_NEAR(design->v_infinity_departure_m_s.norm() / v_departure, 1.0, 0.03);
  EXPECT_NEAR(design->v_infinity_arrival_m_s.norm() / v_arrival, 1.0, 0.03);
  EXPECT_GT(design->closest_approach_m, 5e7);
  EXPECT_LE(design->closest_approach_m, 1.001 * design->miss_distance_m);

  // Nowhere in the cruise is it near a planet.
  for (Epoch e = design->begin; e < design->end; e = e + Duration::days(1.0)) {
    const State s = design->arc.at(e).value();
    EXPECT_GT((s.p_m - of(body::mars, e).p_m).norm(), 5e8);
    EXPECT_GT((s.p_m - of(body::earth, e).p_m).norm(), 7e8);
  }
}

INSTANTIATE_TEST_SUITE_P(Windows, EarthMars,
                         ::testing::Values(std::pair{"2026-11-09T00:00:00", 300.0},
                                           std::pair{"2024-10-06T00:00:00", 320.0},
                                           std::pair{"2028-12-05T00:00:00", 300.0},
                                           std::pair{"2031-02-10T00:00:00", 300.0}),
                         [](const auto& test) { return "From" + std::string(test.param.first, 4); });

TEST(Ballistic, EarthToVenus) {
  // Venus Express: launched 2005-11-09, in orbit on 2006-04-11, with a C3 of about 7.8 km^2/s^2.
  const auto design = design_ballistic(ephemeris(), body::earth, body::venus, date("2005-11-09T04:00:00"),
                                       date("2006-04-11T07:00:00") - date("2005-11-09T04:00:00"));
  ASSERT_TRUE(design) << describe(design.error());
  EXPECT_LT(design->aim_error_m, 1e3);
  EXPECT_NEAR(design->c3_m2_s2 * 1e-6, 7.8, 1.0);
}

// Heavy planets bend what the conics patched together take for straight.
TEST(Ballistic, EarthToJupiter) {
  // Close to the launch of New Horizons: C3 of 157.75 km^2/s^2 on 2006-01-19, at Jupiter on 2007-02-28.
  const auto design =
      design_ballistic(ephemeris(), body::earth, body::jupiter, date("2006-01-19T19:00:00"),
                       date("2007-02-28T05:43:00") - date("2006-01-19T19:00:00"), {.miss_distance_m = 2.3e9});
  ASSERT_TRUE(design) << describe(design.error());
  EXPECT_LT(design->aim_error_m, 1e3);
  EXPECT_NEAR(design->c3_m2_s2 * 1e-6, 157.75, 3.0);
  EXPECT_TRUE(
      design_ballistic(ephemeris(), body::earth, body::jupiter, date("2026-11-09T00:00:00"), Duration::days(900.0)));
}

TEST(Ballistic, RefusesNonsense) {
  const auto refused = [](Duration duration, BallisticSettings settings) {
    const auto d =
        design_ballistic(ephemeris(), body::earth, body::mars, date("2026-11-09T00:00:00"), duration, settings);
    return !d && d.error().code == ErrorCode::invalid_argument;
  };
  EXPECT_TRUE(refused(Duration::days(5.0), {})) << "no cruise left";
  EXPECT_TRUE(refused(Duration::days(-300.0), {}));
  EXPECT_TRUE(refused(Duration::days(300.0), {.departure_altitude_m = -1.0}));
  EXPECT_TRUE(refused(Duration::days(300.0), {.miss_distance_m = 1e6})) << "inside Mars";
  EXPECT_TRUE(refused(Duration::days(300.0), {.coast_in = Duration::days(-1.0)}));
  const auto late =
      design_ballistic(ephemeris(), body::earth, body::mars, date("2060-11-09T00:00:00"), Duration::days(300.0));
  ASSERT_FALSE(late);
  EXPECT_EQ(late.error().code, ErrorCode::out_of_range);
}

}  // namespace
}  // namespace astronav::transfer
