// SPDX-License-Identifier: Apache-2.0
// AttitudeFilter: how the spacecraft stands between frames and through slews, from a gyro and the frames' attitudes.
//
//   AttitudeFilter filter(settings);
//   filter.initialise({epoch, R_BN, covariance});
//   filter.propagate(epoch, rate);            // each gyro sample, as measured; constant since the one before
//   filter.update({epoch, R_CN, covariance}); // each frame that was solved
//
// Multiplicative extended Kalman filter of six states: attitude error theta (rad, body axes; R_BN_true =
// exp(-[theta]x) R_BN) and gyro bias. Gyro model of Farrenkopf (1978): measured = true + bias + white noise, the bias
// a random walk. Lefferts, Markley & Shuster 1982, J. Guid. Control Dyn. 5(5); docs/theory/attitude.md. No heap.
#pragma once

#include <optional>

#include "foundation/base/error.h"
#include "foundation/math/linear.h"
#include "foundation/time/epoch.h"

namespace astronav::attitude {

struct GyroModel {
  double angle_random_walk_rad_sqrt_s = 0.15 * kDegree / 60.0;  // 0.15 deg/sqrt(h), a MEMS gyro's
  double bias_random_walk_rad_s_sqrt_s = 1e-7;                  // rad/s per sqrt(s)
  double bias_sigma_rad_s = 10.0 * kDegree / 3600.0;            // at the start, an axis
};

struct AttitudeFilterSettings {
  GyroModel gyro;
  Mat3 R_CB = Mat3::Identity();      // how the camera is mounted
  double gate_probability = 0.9999;  // chi-square of three degrees
  Duration longest_step = Duration::seconds(10.0);
};

struct AttitudeStart {
  Epoch epoch;
  Mat3 R_BN = Mat3::Identity();
  Mat3 covariance_rad2 = Mat3::Zero();  // of theta
  Vec3 gyro_bias_rad_s = Vec3::Zero();
  std::optional<double> gyro_bias_sigma_rad_s = {};  // an axis; without it that of the gyro's model
};

// Of a frame: R_CN_true = exp(-[theta]x) R_CN, theta in camera axes.
struct AttitudeMeasurement {
  Epoch epoch;  // the filter's own: propagate to it first
  Mat3 R_CN = Mat3::Identity();
  Mat3 covariance_rad2 = Mat3::Zero();
};

enum class AttitudeVerdict : unsigned char { accepted, started, gated, not_now, bad_measurement };
const char* name(AttitudeVerdict verdict);

struct AttitudeUpdate {
  AttitudeVerdict verdict = AttitudeVerdict::bad_measurement;
  Vec3 innovation_rad = Vec3::Zero();  // body axes
  double nis = 0.0;                    // three degrees of freedom
  bool accepted() const { return verdict == AttitudeVerdict::accepted; }
};

class AttitudeFilter {
 public:
  explicit AttitudeFilter(const AttitudeFilterSettings& settings);

  // invalid_argument: not a rotation, or a covariance that is not positive.
  Result<void> initialise(const AttitudeStart& start);
  // Of B with respect to N, in B, as the gyro has it. invalid_argument: backwards, or a rate that is not finite.
  Result<void> propagate(Epoch to, const Vec3& measured_rate_rad_s);
  AttitudeUpdate update(const AttitudeMeasurement& measurement);

  Epoch epoch() const { return epoch_; }
  const Mat3& R_BN() const { return R_BN_; }
  Mat3 R_CN() const { return settings_.R_CB * R_BN_; }
  Mat3 covariance_CN_rad2() const;  // of theta, camera axes: the prior for the next frame
  const Vec3& gyro_bias_rad_s() const { return bias_; }
  const Mat6& covariance() const { return P_; }  // theta, bias

 private:
  void step(double seconds, const Vec3& rate);

  AttitudeFilterSettings settings_;
  double gate_;
  Epoch epoch_;
  Mat3 R_BN_ = Mat3::Identity();
  Vec3 bias_ = Vec3::Zero();
  Mat6 P_ = Mat6::Identity();
};

}  // namespace astronav::attitude
