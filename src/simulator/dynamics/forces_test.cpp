// SPDX-License-Identifier: Apache-2.0
#include "simulator/dynamics/forces.h"

#include <cmath>
#include <vector>

#include <gtest/gtest.h>

#include "foundation/math/statistics.h"
#include "support/shipped_ephemeris.h"

namespace astronav::dynamics {
namespace {

const Ephemeris& ephemeris() {
  return testing::shipped_ephemeris();
}
Epoch when() {
  return Epoch::parse("2027-03-01T00:00:00 TDB").value();
}

ForceSettings only(std::vector<BodyId> bodies) {
  return {.bodies = std::move(bodies), .relativity = false, .srp_cr_area_over_mass_m2_kg = 0.0};
}

// One astronomical unit from the Sun, off every plane; at rest with respect to it.
State beside_sun(double distance_m) {
  const State sun = ephemeris().state(body::sun, body::solar_system_barycenter, when()).value();
  return {sun.p_m + distance_m * Vec3(2.0, 3.0, 6.0) / 7.0, sun.v_m_s};
}

TEST(Forces, SunAlone) {
  const auto model = ForceModel::create(ephemeris(), only({body::sun}));
  ASSERT_TRUE(model) << describe(model.error());
  const Vec3 a = model->acceleration(when(), beside_sun(kAstronomicalUnit)).value();
  // GM of the Sun 1.32712440041e20 m^3/s^2 over the astronomical unit squared.
  EXPECT_NEAR(a.norm(), 5.930083e-3, 1e-9);
  EXPECT_LT((a.normalized() + Vec3(2.0, 3.0, 6.0) / 7.0).norm(), 1e-12) << "towards the Sun";
}

TEST(Forces, EarthPullsAsGM) {
  const auto model = ForceModel::create(ephemeris(), only({body::earth}));
  ASSERT_TRUE(model) << describe(model.error());
  State s = ephemeris().state(body::earth, body::solar_system_barycenter, when()).value();
  s.p_m += Vec3(0.0, 42164.17e3, 0.0);
  const Vec3 a = model->acceleration(when(), s).value();
  // The pull on a geostationary satellite: the rate of the sidereal day squared times its radius.
  EXPECT_NEAR(-a.y(), 7.292115e-5 * 7.292115e-5 * 42164.17e3, 2e-6);
}

TEST(Forces, MoonAndEarthAreApart) {
  const auto model = ForceModel::create(ephemeris(), only({body::moon}));
  ASSERT_TRUE(model) << describe(model.error());
  State s = ephemeris().state(body::moon, body::solar_system_barycenter, when()).value();
  s.p_m += Vec3(1737.4e3, 0.0, 0.0);
  EXPECT_NEAR(model->acceleration(when(), s).value().x(), -1.625, 0.002) << "gravity on the Moon's surface";
}

TEST(Forces, SolarPressure) {
  ForceSettings settings = only({});
  settings.srp_cr_area_over_mass_m2_kg = 0.026;
  const auto model = ForceModel::create(ephemeris(), settings);
  ASSERT_TRUE(model);
  const Vec3 near = model->acceleration(when(), beside_sun(kAstronomicalUnit)).value();
  const Vec3 far = model->acceleration(when(), beside_sun(2.0 * kAstronomicalUnit)).value();
  EXPECT_NEAR(near.norm(), 1.1856e-7, 1e-11);
  EXPECT_NEAR(near.norm() / far.norm(), 4.0, 1e-9);
  EXPECT_GT(near.dot(Vec3(2.0, 3.0, 6.0)), 0.0) << "away from the Sun";
  settings.srp_scale = 1.1;
  const auto scaled = ForceModel::create(ephemeris(), settings);
  EXPECT_NEAR(scaled->acceleration(when(), beside_sun(kAstronomicalUnit)).value().norm() / near.norm(), 1.1, 1e-12);
}

TEST(Forces, ErrorsAreHandedOn) {
  const auto unknown = ForceModel::create(ephemeris(), only({BodyId{-12345}}));
  EXPECT_FALSE(unknown);
  const auto model = ForceModel::create(ephemeris());
  ASSERT_TRUE(model);
  const auto late = model->acceleration(Epoch::parse("2150-01-01T00:00:00 TDB").value(), State{});
  ASSERT_FALSE(late);
  EXPECT_EQ(late.error().code, ErrorCode::out_of_range);
}

}  // namespace
}  // namespace astronav::dynamics
