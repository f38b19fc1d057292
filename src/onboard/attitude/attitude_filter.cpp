// SPDX-License-Identifier: Apache-2.0
#include "onboard/attitude/attitude_filter.h"

#include <algorithm>
#include <cmath>

#include <Eigen/Cholesky>

#include "foundation/math/rotation.h"
#include "foundation/math/statistics.h"

namespace astronav::attitude {
namespace {

bool is_rotation(const Mat3& R) {
  return (R * R.transpose() - Mat3::Identity()).norm() < 1e-6 && R.determinant() > 0.0;
}

bool is_covariance(const Mat3& P) {
  return P.allFinite() && Eigen::LLT<Mat3>(P).info() == Eigen::Success;
}

// The integral of exp(-[w]x s) over s from 0 to t.
Mat3 integrated_rotation(const Vec3& w, double t) {
  const double phi2 = w.squaredNorm() * t * t;
  const Mat3 W = cross_matrix(w) * t;
  // (1 - cos phi)/phi^2 and (phi - sin phi)/phi^3, by their series where they would lose digits.
  double a = 0.5 - phi2 / 24.0, b = 1.0 / 6.0 - phi2 / 120.0;
  if (phi2 > 1e-4) {
    const double phi = std::sqrt(phi2);
    a = (1.0 - std::cos(phi)) / phi2;
    b = (phi - std::sin(phi)) / (phi2 * phi);
  }
  return t * (Mat3::Identity() - a * W + b * W * W);
}

}  // namespace

const char* name(AttitudeVerdict verdict) {
  switch (verdict) {
    case AttitudeVerdict::accepted:
      return "accepted";
    case AttitudeVerdict::started:
      return "started";
    case AttitudeVerdict::gated:
      return "gated";
    case AttitudeVerdict::not_now:
      return "not at the filter's epoch";
    case AttitudeVerdict::bad_measurement:
      return "bad measurement";
  }
  return "";
}

AttitudeFilter::AttitudeFilter(const AttitudeFilterSettings& settings)
    : settings_(settings), gate_(chi_square_quantile(settings.gate_probability, 3.0)) {}

Result<void> AttitudeFilter::initialise(const AttitudeStart& start) {
  if (!is_rotation(start.R_BN) || !is_covariance(start.covariance_rad2) || !start.gyro_bias_rad_s.allFinite())
    return fail(ErrorCode::invalid_argument, "an attitude filter starts from a rotation with a positive covariance");
  epoch_ = start.epoch;
  R_BN_ = start.R_BN;
  bias_ = start.gyro_bias_rad_s;
  P_.setZero();
  P_.topLeftCorner<3, 3>() = start.covariance_rad2;
  const double sigma = start.gyro_bias_sigma_rad_s.value_or(settings_.gyro.bias_sigma_rad_s);
  P_.bottomRightCorner<3, 3>() = Mat3::Identity() * sigma * sigma;
  return {};
}

// docs/theory/attitude.md eq. 2 and 3.
void AttitudeFilter::step(double t, const Vec3& rate) {
  const Mat3 turn = rotation_exp(-rate * t);
  R_BN_ = turn * R_BN_;
  Mat6 phi = Mat6::Identity();
  phi.topLeftCorner<3, 3>() = turn;
  phi.topRightCorner<3, 3>() = -integrated_rotation(rate, t);
  P_ = phi * P_ * phi.transpose();
  const double v = settings_.gyro.angle_random_walk_rad_sqrt_s, u = settings_.gyro.bias_random_walk_rad_s_sqrt_s;
  P_.topLeftCorner<3, 3>().diagonal().array() += v * v * t + u * u * t * t * t / 3.0;
  P_.bottomRightCorner<3, 3>().diagonal().array() += u * u * t;
  P_.topRightCorner<3, 3>().diagonal().array() -= 0.5 * u * u * t * t;
  P_.bottomLeftCorner<3, 3>().diagonal().array() -= 0.5 * u * u * t * t;
}

Result<void> AttitudeFilter::propagate(Epoch to, const Vec3& measured_rate_rad_s) {
  if (to < epoch_ || !measured_rate_rad_s.allFinite())
    return fail(ErrorCode::invalid_argument, "a gyro rate that is not finite, or of {0} s before the filter's epoch",
                {(epoch_ - to).seconds()});
  // Long ways in steps: the noise of the bias is taken as constant in direction over one.
  constexpr int kMostSteps = 100000;
  const Vec3 rate = measured_rate_rad_s - bias_;
  const double seconds = (to - epoch_).seconds();
  const int steps = std::clamp(static_cast<int>(std::ceil(seconds / settings_.longest_step.seconds())), 1, kMostSteps);
  for (int i = 0; i < steps; ++i) step(seconds / steps, rate);
  epoch_ = to;
  return {};
}

AttitudeUpdate AttitudeFilter::update(const AttitudeMeasurement& measurement) {
  AttitudeUpdate out;
  if (!is_rotation(measurement.R_CN) || !is_covariance(measurement.covariance_rad2)) return out;
  if (measurement.epoch != epoch_) {
    out.verdict = AttitudeVerdict::not_now;
    return out;
  }
  const Mat3& R_CB = settings_.R_CB;
  const Mat3 noise = R_CB.transpose() * measurement.covariance_rad2 * R_CB;
  out.innovation_rad = -rotation_log(R_CB.transpose() * measurement.R_CN * R_BN_.transpose());
  const Mat3 S = P_.topLeftCorner<3, 3>() + noise;
  const Eigen::LLT<Mat3> llt(S);
  out.nis = out.innovation_rad.dot(llt.solve(out.innovation_rad));
  if (!(out.nis <= gate_)) {
    out.verdict = AttitudeVerdict::gated;
    return out;
  }
  const Eigen::Matrix<double, 6, 3> gain = llt.solve(P_.topRows<3>()).transpose();
  const Vec6 correction = gain * out.innovation_rad;
  // Joseph's form: positive whatever the rounding.
  Mat6 keep = Mat6::Identity();
  keep.leftCols<3>() -= gain;
  P_ = keep * P_ * keep.transpose() + gain * noise * gain.transpose();
  P_ = 0.5 * (P_ + P_.transpose()).eval();
  R_BN_ = rotation_exp(-correction.head<3>()) * R_BN_;
  // Products of matrices drift away from a rotation by the last digit each.
  R_BN_ = to_matrix(to_quaternion(R_BN_));
  bias_ += correction.tail<3>();
  out.verdict = AttitudeVerdict::accepted;
  return out;
}

Mat3 AttitudeFilter::covariance_CN_rad2() const {
  return settings_.R_CB * P_.topLeftCorner<3, 3>() * settings_.R_CB.transpose();
}

}  // namespace astronav::attitude
