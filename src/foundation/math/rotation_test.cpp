// SPDX-License-Identifier: Apache-2.0
#include "foundation/math/rotation.h"

#include <gtest/gtest.h>

#include "foundation/math/random.h"

namespace astronav {
namespace {

Vec3 random_vector(RandomStream& r) {
  return {r.normal(), r.normal(), r.normal()};
}

TEST(Rotation, QuaternionMeansTheSameAsTheMatrix) {
  // A rotation by +90 degrees about z takes x to y.
  const Quaternion q{std::sqrt(0.5), 0.0, 0.0, std::sqrt(0.5)};
  EXPECT_LT((to_matrix(q) * Vec3::UnitX() - Vec3::UnitY()).norm(), 1e-15);
  EXPECT_LT((rotation_exp(Vec3(0, 0, kPi / 2)) * Vec3::UnitX() - Vec3::UnitY()).norm(), 1e-15);
}

TEST(Rotation, RoundTrips) {
  RandomStream r({.seed = 1, .purpose = "rotation"});
  for (int i = 0; i < 1000; ++i) {
    const Vec3 phi = random_vector(r).normalized() * r.uniform(0.0, 3.1);
    const Mat3 R = rotation_exp(phi);
    EXPECT_LT((R * R.transpose() - Mat3::Identity()).norm(), 1e-14);
    EXPECT_LT((rotation_log(R) - phi).norm(), 1e-12);
    EXPECT_LT((to_matrix(to_quaternion(R)) - R).norm(), 1e-14);
    EXPECT_LT((R_CN_from_pointing(pointing_from_R_CN(R)) - R).norm(), 1e-12);
    const Vec3 v = random_vector(r);
    EXPECT_LT((cross_matrix(phi) * v - phi.cross(v)).norm(), 1e-14 * (1 + v.norm()));
    const RaDec at = radec_from_direction(v);
    EXPECT_LT((direction_from_radec(at.ra_rad, at.dec_rad) - v.normalized()).norm(), 1e-14);
  }
}

TEST(Rotation, NorthUpHasEastToTheLeft) {
  const Mat3 R_CN = R_CN_from_pointing({1.0, 0.3, 0.0});
  const Vec3 east = east_north(direction_from_radec(1.0, 0.3)).east;
  const Vec3 north = east_north(direction_from_radec(1.0, 0.3)).north;
  EXPECT_NEAR((R_CN * east).x(), -1.0, 1e-14);
  EXPECT_NEAR((R_CN * north).y(), -1.0, 1e-14);
  EXPECT_NEAR(R_CN.determinant(), 1.0, 1e-14);
  // Roll 90 degrees: up is east.
  EXPECT_NEAR((R_CN_from_pointing({1.0, 0.3, kPi / 2}) * east).y(), -1.0, 1e-14);
}

}  // namespace
}  // namespace astronav
