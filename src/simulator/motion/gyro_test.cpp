// SPDX-License-Identifier: Apache-2.0
#include "simulator/motion/gyro.h"

#include <cmath>

#include <gtest/gtest.h>

#include "foundation/math/statistics.h"

namespace astronav::motion {
namespace {

constexpr GyroErrors kErrors{
    .angle_random_walk_rad_sqrt_s = 4e-5, .bias_random_walk_rad_s_sqrt_s = 2e-6, .bias_sigma_rad_s = 5e-5};

Gyro gyro(int sample) {
  return {kErrors, {.seed = 3, .sample = static_cast<std::uint64_t>(sample), .purpose = "gyro"}};
}

// The variances of the law itself (Farrenkopf's Q): of the angle after a time T that starts with a known bias,
// v^2 T + u^2 T^3/3, and of the bias u^2 T, whatever the samples are cut into. Bands that are left once in 1000 times.
TEST(Gyro, AngleAndBiasWalkAsFarrenkopfSays) {
  constexpr int kRuns = 2000;
  const double T = 60.0;
  const double v = kErrors.angle_random_walk_rad_sqrt_s, u = kErrors.bias_random_walk_rad_s_sqrt_s;
  for (const int samples : {1, 60}) {
    double angle2 = 0.0, walk2 = 0.0, start2 = 0.0;
    for (int run = 0; run < kRuns; ++run) {
      Gyro one = gyro(run);
      const Vec3 bias = one.bias_rad_s(), rate(1e-3, 2e-3, -3e-3);
      Vec3 angle = Vec3::Zero();
      for (int k = 0; k < samples; ++k) angle += (one.measure(rate, T / samples) - rate - bias) * (T / samples);
      angle2 += angle.squaredNorm();
      walk2 += (one.bias_rad_s() - bias).squaredNorm();
      start2 += bias.squaredNorm();
    }
    const Band band = chi_square_mean_band(0.999, 3, kRuns);
    EXPECT_TRUE(band.contains(angle2 / kRuns / (v * v * T + u * u * T * T * T / 3.0))) << samples;
    EXPECT_TRUE(band.contains(walk2 / kRuns / (u * u * T))) << samples;
    EXPECT_TRUE(band.contains(start2 / kRuns / std::pow(kErrors.bias_sigma_rad_s, 2)));
  }
}

TEST(Gyro, JumpsByWhatItIsTold) {
  Gyro one = gyro(1);
  const Vec3 before = one.bias_rad_s();
  one.jump(1e-3);
  EXPECT_NEAR((one.bias_rad_s() - before).norm(), 1e-3, 1e-15);
}

}  // namespace
}  // namespace astronav::motion
