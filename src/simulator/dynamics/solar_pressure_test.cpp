// SPDX-License-Identifier: Apache-2.0
#include "simulator/dynamics/solar_pressure.h"

#include <cmath>

#include <gtest/gtest.h>

namespace astronav::dynamics {
namespace {

// A sphere of 1 m radius in facets, by latitude and longitude.
std::vector<Plate> sphere(double specular, double diffuse) {
  constexpr int kRings = 120;
  std::vector<Plate> plates;
  for (int i = 0; i < kRings; ++i) {
    const double colatitude = kPi * (i + 0.5) / kRings;
    for (int k = 0; k < 2 * kRings; ++k) {
      const double longitude = kPi * (k + 0.5) / kRings;
      plates.push_back({.area_m2 = (std::cos(kPi * i / kRings) - std::cos(kPi * (i + 1) / kRings)) * kPi / kRings,
                        .normal_B = {std::sin(colatitude) * std::cos(longitude),
                                     std::sin(colatitude) * std::sin(longitude), std::cos(colatitude)},
                        .specular = specular,
                        .diffuse = diffuse});
    }
  }
  return plates;
}

// What is known of spheres in closed form: CR is 1 where all is absorbed or all is mirrored, 13/9 where all is
// scattered after Lambert.
TEST(SolarPressure, SpheresOfPlates) {
  const Vec3 to_sun = Vec3(1.0, 2.0, -2.0) / 3.0;
  for (const auto& [specular, diffuse, cr] : {std::tuple{0.0, 0.0, 1.0}, {1.0, 0.0, 1.0}, {0.0, 1.0, 13.0 / 9.0}}) {
    const Vec3 push = pressure_area(sphere(specular, diffuse), to_sun);
    EXPECT_NEAR(-push.dot(to_sun) / kPi, cr, 1e-3) << specular << " " << diffuse;
    EXPECT_LT(push.cross(to_sun).norm(), 1e-3);
  }
}

TEST(SolarPressure, OnePlate) {
  const double a = 30.0 * kDegree;
  const Vec3 to_sun(std::cos(a), std::sin(a), 0.0);
  const auto push = [&](const Plate& p) { return pressure_area(std::vector{p}, to_sun); };
  // Black: along the light, its shadow's size. A mirror: along its normal, twice the square of the cosine.
  EXPECT_LT((push({.area_m2 = 2.0}) + 2.0 * std::cos(a) * to_sun).norm(), 1e-15);
  EXPECT_LT((push({.area_m2 = 2.0, .specular = 1.0}) + 4.0 * std::cos(a) * std::cos(a) * Vec3::UnitX()).norm(), 1e-15);
  EXPECT_EQ(push({.area_m2 = 2.0, .normal_B = -Vec3::UnitX()}), Vec3::Zero()) << "from behind";
  // Arrays on the z axis face this Sun; on the x axis they see its part across; on the line to it, none.
  EXPECT_LT((push({.area_m2 = 1.0, .hinge_B = Vec3::UnitZ()}) + to_sun).norm(), 1e-15);
  EXPECT_LT((push({.area_m2 = 1.0, .hinge_B = Vec3::UnitX()}) + std::sin(a) * to_sun).norm(), 1e-15);
  EXPECT_EQ(push({.area_m2 = 1.0, .hinge_B = to_sun}), Vec3::Zero());
}

TEST(SolarPressure, BoxWing) {
  const auto plates = box_wing({0.2, 0.3, 0.4}, 0.0, 0.0, 1.5, Vec3::UnitY(), 0.0, 0.0);
  ASSERT_TRUE(check_plates(plates));
  EXPECT_NEAR(pressure_area(plates, Vec3::UnitX()).x(), -(0.3 * 0.4 + 1.5), 1e-15);
  EXPECT_NEAR(pressure_area(plates, -Vec3::UnitZ()).z(), 0.2 * 0.3 + 1.5, 1e-15);
  EXPECT_NEAR(pressure_area(plates, Vec3::UnitY()).y(), -0.2 * 0.4, 1e-15);
}

TEST(SolarPressure, Attitudes) {
  const Vec3 axis = Vec3::UnitX(), second = Vec3::UnitY();
  const Attitude attitude = sun_pointing(axis, second);
  for (const Vec3& to_sun : {Vec3(0.6, 0.0, 0.8), Vec3(-1.0, 0.0, 0.0), Vec3(0.0, 0.0, 1.0), Vec3(0.0, 0.0, -1.0)}) {
    const Mat3 R_BN = attitude(Epoch(), to_sun);
    EXPECT_LT((R_BN * R_BN.transpose() - Mat3::Identity()).norm(), 1e-14);
    EXPECT_NEAR(R_BN.determinant(), 1.0, 1e-14);
    EXPECT_LT((R_BN * to_sun - axis).norm(), 1e-14);
    EXPECT_GE((R_BN * Vec3::UnitZ()).dot(second), -1e-15) << "the pole on the second axis' side";
    EXPECT_NEAR((R_BN * Vec3::UnitZ()).dot(axis.cross(second)), 0.0, 1e-14);
  }
}

TEST(SolarPressure, RefusesNonsense) {
  const auto refused = [](const Plate& p) { return !check_plates(std::vector{p}); };
  EXPECT_TRUE(refused({.area_m2 = -1.0}));
  EXPECT_TRUE(refused({.area_m2 = std::nan("")}));
  EXPECT_TRUE(refused({.area_m2 = 1.0, .normal_B = {1.0, 1.0, 0.0}}));
  EXPECT_TRUE(refused({.area_m2 = 1.0, .specular = 0.6, .diffuse = 0.6}));
  EXPECT_TRUE(refused({.area_m2 = 1.0, .hinge_B = Vec3::Zero()}));
}

}  // namespace
}  // namespace astronav::dynamics
