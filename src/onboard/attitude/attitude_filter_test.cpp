// SPDX-License-Identifier: Apache-2.0
#include "onboard/attitude/attitude_filter.h"

#include <cmath>
#include <cstdio>

#include <gtest/gtest.h>

#include "foundation/math/random.h"
#include "foundation/math/rotation.h"
#include "foundation/math/statistics.h"

namespace astronav::attitude {
namespace {

Epoch start_epoch() {
  return Epoch::tdb_seconds(8e8);
}
Vec3 normal3(RandomStream& random) {
  const double x = random.normal(), y = random.normal(), z = random.normal();
  return {x, y, z};
}

// A spacecraft that turns, and the gyro aboard: exactly Farrenkopf's model over each step, in which the true rate is
// constant (J. L. Crassidis & J. L. Junkins, Optimal Estimation of Dynamic Systems, eq. 7.145).
struct Craft {
  Mat3 R_BN = Mat3::Identity();
  Vec3 bias = Vec3::Zero();
  GyroModel gyro;

  Vec3 turn(const Vec3& rate, double t, RandomStream& random) {
    const double v = gyro.angle_random_walk_rad_sqrt_s, u = gyro.bias_random_walk_rad_s_sqrt_s;
    R_BN = rotation_exp(-rate * t) * R_BN;
    const Vec3 before = bias;
    bias += u * std::sqrt(t) * normal3(random);
    return rate + 0.5 * (before + bias) + std::sqrt(v * v / t + u * u * t / 12.0) * normal3(random);
  }
};

// Errors of a 20-degree camera: across 0.4 arcsec, about the boresight 3.
Mat3 frame_covariance() {
  return Vec3(std::pow(0.4 * kArcsecond, 2), std::pow(0.4 * kArcsecond, 2), std::pow(3.0 * kArcsecond, 2)).asDiagonal();
}
AttitudeMeasurement frame(const Craft& craft, const Mat3& R_CB, const Mat3& covariance, Epoch epoch,
                          RandomStream& random) {
  const Vec3 theta = covariance.diagonal().cwiseSqrt().cwiseProduct(normal3(random));
  return {epoch, rotation_exp(theta) * R_CB * craft.R_BN, covariance};
}

Vec6 error_of(const AttitudeFilter& filter, const Craft& craft) {
  Vec6 error;
  error << -rotation_log(craft.R_BN * filter.R_BN().transpose()), craft.bias - filter.gyro_bias_rad_s();
  return error;
}

// An hour of frames each 100 s with the pointing held, a slew of 90 degrees without frames, an hour again. The NEES of
// six states (all times of all runs) and the NIS of three: bands that a right program leaves once in 1000 times, with
// the runs, not the times, as what is independent.
TEST(AttitudeFilter, ConsistentBetweenFramesAndThroughSlews) {
  constexpr int kRuns = 200;
  const Mat3 R_CB = rotation_exp(Vec3(0.3, -1.1, 0.7));
  double nees_window = 0.0, nees_slew = 0.0, nis = 0.0;
  int updates = 0, gated = 0;
  for (int run = 0; run < kRuns; ++run) {
    RandomStream random(StreamId{.seed = 5, .sample = static_cast<std::uint64_t>(run), .purpose = "gyro"});
    Craft craft;
    craft.R_BN = rotation_exp(normal3(random));
    craft.bias = craft.gyro.bias_sigma_rad_s * normal3(random);
    AttitudeFilter filter({.gyro = craft.gyro, .R_CB = R_CB});
    const AttitudeMeasurement first = frame(craft, R_CB, frame_covariance(), start_epoch(), random);
    ASSERT_TRUE(filter.initialise(
        {start_epoch(), R_CB.transpose() * first.R_CN, R_CB.transpose() * first.covariance_rad2 * R_CB}));
    Epoch now = start_epoch();
    const auto go = [&](const Vec3& rate, int seconds) {
      for (int k = 0; k < seconds; ++k) {
        now = now + Duration::seconds(1.0);
        ASSERT_TRUE(filter.propagate(now, craft.turn(rate, 1.0, random)));
      }
    };
    const auto window = [&] {
      for (int image = 0; image < 36; ++image) {
        go(1e-5 * normal3(random), 100);
        const AttitudeUpdate update = filter.update(frame(craft, R_CB, frame_covariance(), now, random));
        ++updates;
        gated += update.verdict == AttitudeVerdict::gated;
        if (update.accepted()) nis += update.nis;
      }
    };
    window();
    auto error = error_of(filter, craft);
    nees_window += error.dot(filter.covariance().inverse() * error) / kRuns;
    go(Vec3(0.1, -0.05, 0.2) * kDegree, 400);
    error = error_of(filter, craft);
    nees_slew += error.dot(filter.covariance().inverse() * error) / kRuns;
    window();
  }
  nis /= updates - gated;
  const Band band = chi_square_mean_band(0.999, 6, kRuns);
  EXPECT_TRUE(band.contains(nees_window)) << nees_window;
  EXPECT_TRUE(band.contains(nees_slew)) << nees_slew;
  EXPECT_TRUE(chi_square_mean_band(0.999, 3, updates).contains(nis)) << nis;
  EXPECT_LE(gated, 10);  // 1.4 of 14,400 expected
  std::printf("  NEES (6) after a window %.2f, after a slew %.2f; NIS (3) %.3f, gated %d of %d\n", nees_window,
              nees_slew, nis, gated, updates);
}

// Farrenkopf's steady state in closed form (1978; with the constants as in Markley & Reynolds 2000, J. Guid. Control
// Dyn. 23(6)): one axis, star tracker sigma n every T seconds, S_u = u T^1.5/n, S_v = v T^0.5/n,
//   gamma = sqrt(1 + S_v^2/4 + S_u^2/48), zeta = gamma + S_u/4 + sqrt(2 gamma S_u + S_v^2 + S_u^2/3)/2,
//   attitude variance n^2 (zeta^2 - 1) before an update, n^2 (1 - zeta^-2) after it;
//   bias variance u n (zeta - 1/zeta)/sqrt(T) +- u^2 T/2.
TEST(AttitudeFilter, SettlesWhereFarrenkopfSays) {
  const double n = 5.0 * kArcsecond, T = 10.0;
  GyroModel gyro;
  gyro.angle_random_walk_rad_sqrt_s = 1e-6;
  gyro.bias_random_walk_rad_s_sqrt_s = 3e-8;
  AttitudeFilter filter({.gyro = gyro, .longest_step = Duration::seconds(T)});
  ASSERT_TRUE(filter.initialise({start_epoch(), Mat3::Identity(), Mat3::Identity() * n * n}));
  Mat6 before;
  for (int k = 1; k < 5000; ++k) {
    const Epoch now = start_epoch() + Duration::seconds(T * k);
    ASSERT_TRUE(filter.propagate(now, Vec3::Zero()));
    before = filter.covariance();
    ASSERT_TRUE(filter.update({now, filter.R_BN(), Mat3::Identity() * n * n}).accepted());
  }
  const double u = gyro.bias_random_walk_rad_s_sqrt_s, v = gyro.angle_random_walk_rad_sqrt_s;
  const double S_u = u * std::pow(T, 1.5) / n, S_v = v * std::sqrt(T) / n;
  const double gamma = std::sqrt(1.0 + S_v * S_v / 4.0 + S_u * S_u / 48.0);
  const double zeta = gamma + S_u / 4.0 + 0.5 * std::sqrt(2.0 * gamma * S_u + S_v * S_v + S_u * S_u / 3.0);
  const double bias2 = u * n / std::sqrt(T) * (zeta - 1.0 / zeta);
  for (int axis = 0; axis < 3; ++axis) {
    EXPECT_NEAR(before(axis, axis) / (n * n * (zeta * zeta - 1.0)), 1.0, 1e-6);
    EXPECT_NEAR(filter.covariance()(axis, axis) / (n * n * (1.0 - 1.0 / (zeta * zeta))), 1.0, 1e-6);
    EXPECT_NEAR(before(axis + 3, axis + 3) / (bias2 + 0.5 * u * u * T), 1.0, 1e-6);
    EXPECT_NEAR(filter.covariance()(axis + 3, axis + 3) / (bias2 - 0.5 * u * u * T), 1.0, 1e-6);
  }
}

// Without noise it follows any turn to the rounding, and finds a bias.
TEST(AttitudeFilter, FollowsATurnAndFindsABias) {
  const Vec3 rate = Vec3(0.5, -0.3, 0.2) * kDegree, bias(1e-5, -2e-5, 3e-5);
  const Mat3 R_CB = rotation_exp(Vec3(0.1, 0.2, 0.3));
  AttitudeFilter filter({.gyro = {}, .R_CB = R_CB});
  Mat3 R_BN = rotation_exp(Vec3(1.0, 2.0, 0.5));
  ASSERT_TRUE(filter.initialise({start_epoch(), R_BN, Mat3::Identity() * 1e-12}));
  for (int k = 1; k <= 600; ++k) {
    const Epoch now = start_epoch() + Duration::seconds(k);
    R_BN = rotation_exp(-rate) * R_BN;
    ASSERT_TRUE(filter.propagate(now, rate + bias));
    if (k % 10 != 0) continue;
    ASSERT_TRUE(filter.update({now, R_CB * R_BN, Mat3::Identity() * 1e-12}).accepted()) << k;
  }
  EXPECT_LT(rotation_log(filter.R_BN() * R_BN.transpose()).norm(), 1e-6);
  EXPECT_LT((filter.gyro_bias_rad_s() - bias).norm(), 1e-6);
  // The prior that it has for the next frame is that of the body, turned into the camera.
  EXPECT_NEAR(filter.covariance_CN_rad2().trace(), filter.covariance().diagonal().head(3).sum(), 1e-18);
}

TEST(AttitudeFilter, RefusesWhatMakesNoSense) {
  AttitudeFilter filter({});
  EXPECT_EQ(filter.initialise({start_epoch(), 2.0 * Mat3::Identity(), Mat3::Identity()}).error().code,
            ErrorCode::invalid_argument);
  EXPECT_EQ(filter.initialise({start_epoch(), Mat3::Identity(), Mat3::Zero()}).error().code,
            ErrorCode::invalid_argument);
  ASSERT_TRUE(filter.initialise({start_epoch(), Mat3::Identity(), Mat3::Identity() * 1e-12}));
  EXPECT_FALSE(filter.propagate(start_epoch() - Duration::seconds(1.0), Vec3::Zero()));
  EXPECT_FALSE(filter.propagate(start_epoch() + Duration::seconds(1.0), Vec3(std::nan(""), 0.0, 0.0)));
  const Mat3 small = Mat3::Identity() * 1e-12;
  EXPECT_EQ(filter.update({start_epoch() + Duration::seconds(5.0), Mat3::Identity(), small}).verdict,
            AttitudeVerdict::not_now);
  EXPECT_EQ(filter.update({start_epoch(), rotation_exp(Vec3(0.1, 0.0, 0.0)), small}).verdict, AttitudeVerdict::gated);
  EXPECT_EQ(filter.update({start_epoch(), Mat3::Identity() * 1.1, small}).verdict, AttitudeVerdict::bad_measurement);
  EXPECT_STREQ(name(AttitudeVerdict::gated), "gated");
}

}  // namespace
}  // namespace astronav::attitude
