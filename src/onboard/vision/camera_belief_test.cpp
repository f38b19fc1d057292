// SPDX-License-Identifier: Apache-2.0
#include "onboard/vision/camera_belief.h"

#include <cmath>
#include <vector>

#include <gtest/gtest.h>

#include "foundation/math/random.h"
#include "foundation/math/rotation.h"
#include "foundation/math/statistics.h"

namespace astronav::vision {
namespace {

constexpr double kNoisePx = 0.02;

Intrinsics told() {
  Intrinsics camera;
  camera.width_px = camera.height_px = 1024;
  camera.fx_px = camera.fy_px = 2903.7;  // 20 degrees
  camera.cx_px = camera.cy_px = 511.5;
  return camera;
}

Intrinsics wrong_by(double focal, double u, double v, double k1) {
  Intrinsics camera = told();
  camera.fx_px *= 1.0 + focal;
  camera.fy_px *= 1.0 + focal;
  camera.cx_px += u;
  camera.cy_px += v;
  camera.distortion.k1 += k1;
  return camera;
}

// Stars over one side of the picture more than over the other: an even field forgives every camera.
std::vector<StarSight> field(const Intrinsics& truth, const Mat3& R_CN, int stars, RandomStream& random) {
  std::vector<StarSight> out;
  while (static_cast<int>(out.size()) < stars) {
    const Pixel at{1024.0 * std::pow(random.uniform(), 1.5), random.uniform(0.0, 1024.0)};
    const auto direction_C = unproject(truth, at);
    if (!direction_C) continue;
    StarSight sight;
    sight.pixel = {at.u + random.normal(0.0, kNoisePx), at.v + random.normal(0.0, kNoisePx)};
    sight.covariance_px2 = kNoisePx * kNoisePx * Mat2::Identity();
    sight.direction_N = R_CN.transpose() * *direction_C;
    out.push_back(sight);
  }
  return out;
}

Mat3 somewhere(RandomStream& random) {
  return R_CN_from_pointing(
      {random.uniform(0.0, 2.0 * kPi), std::asin(random.uniform(-1.0, 1.0)), random.uniform(0.0, 2.0 * kPi)});
}

// What the attitude says of a body in the middle of the picture: its place by the answer, less its true place (px).
Vec2 middle_error(const AttitudeSolution& attitude, const Intrinsics& truth, const Mat3& R_CN, Pixel at) {
  const Vec3 body_N = R_CN.transpose() * *unproject(truth, at);
  return project(attitude.intrinsics, attitude.R_CN * body_N)->vec() - at.vec();
}

AttitudeSolution guess(const CameraBelief& belief, std::vector<StarSight>& sights, const Mat3& R_CN) {
  AttitudeOptions options;
  options.extra_sigma_px = 0.5;
  const auto fit = fit_attitude(sights, R_CN, belief.camera(), options);
  AttitudeSolution out;
  out.R_CN = fit->R_CN;
  out.intrinsics = belief.camera();
  return out;
}

TEST(CameraBelief, ErrorsOfTheCameraLeaveTheAttitudeAlone) {
  // 200 cameras, each wrong as told; after five frames the sixth is judged.
  const CameraSigmas sigmas{.focal_relative = 1e-3, .centre_px = 2.0, .k1 = 0.01};
  RandomStream random(StreamId{.seed = 5, .purpose = "cameras"});
  double chi2 = 0.0, with2 = 0.0, without2 = 0.0;
  constexpr int kCameras = 200;
  for (int k = 0; k < kCameras; ++k) {
    const Intrinsics truth =
        wrong_by(random.normal(0.0, 1e-3), random.normal(0.0, 2.0), random.normal(0.0, 2.0), random.normal(0.0, 0.01));
    CameraBelief belief(told(), sigmas);
    for (int frame = 0; frame < 6; ++frame) {
      const Mat3 R_CN = somewhere(random);
      auto sights = field(truth, R_CN, 60, random);
      AttitudeSolution attitude = guess(belief, sights, R_CN);
      if (frame == 5) {
        CameraBelief untaught(told(), {});
        without2 += middle_error(guess(untaught, sights, R_CN), truth, R_CN, {560.0, 480.0}).squaredNorm();
      }
      ASSERT_TRUE(belief.learn(sights, attitude));
      if (frame < 5) continue;
      const Pixel at{560.0, 480.0};
      const Vec2 error = middle_error(attitude, truth, R_CN, at);
      with2 += error.squaredNorm();
      const Vec3 body_C = attitude.R_CN * (R_CN.transpose() * *unproject(truth, at));
      Mat23 by_direction;
      ASSERT_TRUE(project(attitude.intrinsics, body_C, &by_direction));
      const Mat23 h = by_direction * cross_matrix(body_C);
      const CameraShare share = camera_share(attitude, body_C);
      const Mat2 cross = share.with_attitude * h.transpose();
      const Mat2 S = share.covariance_px2 + h * attitude.covariance_rad2 * h.transpose() + cross + cross.transpose();
      chi2 += error.dot(S.inverse() * error);
    }
  }
  const double rms = std::sqrt(0.5 * with2 / kCameras);
  const double rms_without = std::sqrt(0.5 * without2 / kCameras);
  EXPECT_LT(rms, 0.0045);  // 0.02 px of 60 stars, one-sided, alone: 0.003
  EXPECT_GT(rms_without, 5.0 * rms);
  const Band band = chi_square_mean_band(0.999, 2.0, kCameras);
  EXPECT_GT(chi2 / kCameras, 0.8 * band.lo);  // the least sigmas and the extra noise of stars make it cautious
  EXPECT_LT(chi2 / kCameras, band.hi);
}

TEST(CameraBelief, WhatIsToldExactlyStays) {
  RandomStream random(StreamId{.seed = 6, .purpose = "cameras"});
  CameraBelief belief(told(), {.focal_relative = 1e-3});
  const Intrinsics truth = wrong_by(5e-4, 0.0, 0.0, 0.0);
  for (int frame = 0; frame < 3; ++frame) {
    const Mat3 R_CN = somewhere(random);
    auto sights = field(truth, R_CN, 60, random);
    AttitudeSolution attitude = guess(belief, sights, R_CN);
    ASSERT_TRUE(belief.learn(sights, attitude));
  }
  EXPECT_NEAR(belief.camera().fx_px / truth.fx_px, 1.0, 2e-5);
  EXPECT_NEAR(belief.camera().cx_px, told().cx_px, 1e-9);
  EXPECT_NEAR(belief.camera().distortion.k1, 0.0, 1e-9);
  EXPECT_FALSE(CameraBelief(told(), {}).learns());
}

TEST(CameraBelief, FewStarsAndImpossibleCamerasTeachNothing) {
  RandomStream random(StreamId{.seed = 7, .purpose = "cameras"});
  CameraBelief belief(told(), {.focal_relative = 1e-5});
  const Mat3 R_CN = somewhere(random);
  auto few = field(wrong_by(1e-5, 0.0, 0.0, 0.0), R_CN, 19, random);
  AttitudeSolution attitude = guess(belief, few, R_CN);
  const Mat3 before = attitude.R_CN;
  EXPECT_FALSE(belief.learn(few, attitude));
  EXPECT_EQ(attitude.R_CN, before);
  auto other = field(wrong_by(5e-3, 0.0, 0.0, 0.0), R_CN, 60, random);
  attitude = guess(belief, other, R_CN);
  EXPECT_FALSE(belief.learn(other, attitude));
  EXPECT_EQ(belief.camera().fx_px, told().fx_px);
}

TEST(CameraBelief, APixelIsCarriedOverToTheCameraAsTold) {
  AttitudeSolution attitude;
  attitude.intrinsics = wrong_by(1e-3, 2.0, -1.0, 0.01);
  const Vec3 direction_C = Vec3(0.05, -0.08, 1.0).normalized();
  const auto seen = project(attitude.intrinsics, direction_C);
  const auto carried = as_told(attitude, told(), *seen);
  ASSERT_TRUE(carried);
  EXPECT_LT((carried->vec() - project(told(), direction_C)->vec()).norm(), 1e-9);
}

}  // namespace
}  // namespace astronav::vision
