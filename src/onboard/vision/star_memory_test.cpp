// SPDX-License-Identifier: Apache-2.0
#include "onboard/vision/star_memory.h"

#include <cmath>
#include <vector>

#include <gtest/gtest.h>

#include "foundation/math/random.h"
#include "foundation/math/rotation.h"

namespace astronav::vision {
namespace {

constexpr double kNoisePx = 0.008;
constexpr std::uint32_t kStars = 40;

Intrinsics camera_of_20_degrees() {
  Intrinsics camera;
  camera.width_px = camera.height_px = 1024;
  camera.fx_px = camera.fy_px = 2903.7;
  camera.cx_px = camera.cy_px = 511.5;
  return camera;
}

// A sky of 40 stars, a fifth of them pulled by companions that nobody listed.
struct DoubleSky {
  std::vector<Vec3> listed_N, shown_N;

  DoubleSky(const Intrinsics& camera, const Mat3& R_CN, RandomStream& random) {
    for (std::uint32_t i = 0; i < kStars; ++i) {
      const Vec3 s = R_CN.transpose() * *unproject(camera, {random.uniform(0.0, 1023.0), random.uniform(0.0, 1023.0)});
      const EastNorth axes = east_north(s);
      double pull_px = 0.0;
      if (random.uniform() < 0.2) {  // 0.1 to 10 arcsec, up to 4 mag fainter, 70 arcsec a pixel
        const double light = std::pow(10.0, -1.6 * random.uniform());
        pull_px = 0.1 * std::pow(100.0, random.uniform()) / 70.0 * light / (1.0 + light);
      }
      const double angle = random.uniform(0.0, 2.0 * kPi);
      const Vec3 off =
          pull_px * camera.plate_scale_rad_px() * (std::cos(angle) * axes.east + std::sin(angle) * axes.north);
      listed_N.push_back(s);
      shown_N.push_back((s + off).normalized());
    }
  }

  std::vector<StarSight> image(const Intrinsics& camera, const Mat3& R_CN, RandomStream& random) const {
    std::vector<StarSight> out(kStars);
    for (std::uint32_t i = 0; i < kStars; ++i) {
      const Vec2 noise(random.normal(0.0, kNoisePx), random.normal(0.0, kNoisePx));
      const Vec2 at = project(camera, R_CN * shown_N[i])->vec() + noise;
      out[i].pixel = {at.x(), at.y()};
      out[i].covariance_px2 = kNoisePx * kNoisePx * Mat2::Identity();
      out[i].direction_N = listed_N[i];
    }
    return out;
  }
};

TEST(StarMemory, DoublesOfAWindowAreBelievedLessInTheNext) {
  // The camera turns about its axis by a quarter between the windows: what is remembered is on the sky, not in the
  // picture.
  const Intrinsics camera = camera_of_20_degrees();
  RandomStream random(StreamId{.seed = 3, .purpose = "double stars"});
  constexpr int kSkies = 150, kImages = 60;
  double with2 = 0.0, without2 = 0.0, told2 = 0.0;
  for (int k = 0; k < kSkies; ++k) {
    const Mat3 first = R_CN_from_pointing(
        {random.uniform(0.0, 2.0 * kPi), std::asin(random.uniform(-1.0, 1.0)), random.uniform(0.0, 2.0 * kPi)});
    const DoubleSky sky(camera, first, random);
    StarMemory memory(kStars);
    for (const double roll : {0.0, 0.5 * kPi}) {
      const Mat3 R_CN = rotation_exp(roll * Vec3::UnitZ()) * first;
      Vec3 with = Vec3::Zero(), without = Vec3::Zero();
      double told = 0.0;
      for (int image = 0; image < kImages; ++image) {
        std::vector<StarSight> sights = sky.image(camera, R_CN, random);
        const auto plain = fit_attitude(sights, R_CN, camera);
        ASSERT_TRUE(plain);
        without += rotation_log(plain->R_CN * R_CN.transpose()) / kImages;
        for (std::uint32_t i = 0; i < kStars; ++i) {
          sights[i].extra_px2 = memory.expected_px2(i);
          sights[i].lasting_px2 = memory.lasting_px2(i, 1.0 / (kNoisePx * kNoisePx));
        }
        const auto fit = fit_attitude(sights, R_CN, camera);
        ASSERT_TRUE(fit);
        with += rotation_log(fit->R_CN * R_CN.transpose()) / kImages;
        told += 0.5 * fit->repeating_rad2.topLeftCorner<2, 2>().trace() / kImages;
        for (std::uint32_t i = 0; i < kStars; ++i) memory.learn(i, sights[i], fit->R_CN, camera);
      }
      if (roll == 0.0) continue;
      with2 += 0.5 * with.head<2>().squaredNorm() / kSkies;
      without2 += 0.5 * without.head<2>().squaredNorm() / kSkies;
      told2 += told / kSkies;
    }
  }
  // The noise of the window's mean is in both.
  const double f = camera.fx_px, noise2 = kNoisePx * kNoisePx / (kStars * kImages);
  const double found_px = std::sqrt(f * f * with2 - noise2), plain_px = std::sqrt(f * f * without2 - noise2);
  const double told_px = f * std::sqrt(told2);
  RecordProperty("found_px", std::to_string(found_px));
  RecordProperty("plain_px", std::to_string(plain_px));
  RecordProperty("told_px", std::to_string(told_px));
  EXPECT_GT(plain_px, 0.00025);
  EXPECT_LT(found_px, 0.75 * plain_px);
  // What is told is true: not smaller than what was found, nor twice that.
  EXPECT_GT(told_px, 0.9 * found_px);
  EXPECT_LT(told_px, 2.0 * found_px);
}

TEST(StarMemory, WhatIsExpectedOfAStar) {
  const double unknown2 = std::pow(AttitudeOptions{}.extra_sigma_px, 2);
  EXPECT_DOUBLE_EQ(StarMemory::expected_px2(0.0, 0.0), unknown2);
  // Little was seen: little has changed.
  EXPECT_NEAR(StarMemory::expected_px2(1.0, 0.0) / unknown2, 1.0, 1e-3);
  const double often = 1.0 / (0.001 * 0.001);
  // One that stays where it is listed; one that is 0.03 px off: rms an axis.
  EXPECT_LT(std::sqrt(StarMemory::expected_px2(often, 0.0)), 0.0016);
  EXPECT_NEAR(std::sqrt(StarMemory::expected_px2(often, 0.03 * 0.03)), 0.03 / std::sqrt(2.0), 0.001);
}

}  // namespace
}  // namespace astronav::vision
