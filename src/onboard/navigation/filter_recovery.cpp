// SPDX-License-Identifier: Apache-2.0
// What the filter does when everything is being rejected.
#include <algorithm>
#include <cmath>

#include "onboard/navigation/filter.h"
#include "onboard/navigation/two_by_two.h"

namespace astronav::navigation {

// The rejected innovations agree with each other to within their noise, so it is the state that is wrong. Which of its
// errors would explain their mean?
bool Filter::recover(const MeasurementMatrix& by_state) {
  const double n = rejections_.count;
  const Vec2 mean = rejections_.sum / n;
  const double scatter2 = rejections_.sum2 / n - mean.squaredNorm();
  if (scatter2 > 4.0 * rejections_.noise / n) return false;
  if (accepted_in_window_ > 0) return undo(by_state, mean);
  return allow_push(by_state, mean) || allow_displacement(by_state, mean);
}

// This window said something else before, and that was wrong: an outlier while the gate was wide. Of all changes that
// explain the mean, b = P H' (H P H')^-1 mean is the least in the covariance's own measure; P + b b' holds it possible,
// and leaves what it has nothing to do with as it was.
bool Filter::undo(const MeasurementMatrix& by_state, const Vec2& mean) {
  const MeasurementMatrix f = by_state * covariance_.u;
  const Mat2 prior = f * covariance_.d.asDiagonal() * f.transpose();
  if (!is_covariance(prior)) return false;
  StateVector change = covariance_.u * covariance_.d.cwiseProduct(f.transpose() * (prior.inverse() * mean));
  const double moved_m = change.segment<3>(index::position).norm() * unit::length_m;
  change *= std::min(1.0, settings_.recovery_max_position_m / moved_m);
  add_outer_product(covariance_, change, 1.0);
  return true;
}

// The state came wrong into the window: somebody pushed the spacecraft, at any time since the last sight that was
// accepted. A push of variance s^2 an axis then has the covariance s^2 [T^2/3, T/2; T/2, 1] of position and velocity
// now (gravity's gradient left out); s is such that the mean is an ordinary innovation, with room to spare.
bool Filter::allow_push(const MeasurementMatrix& by_state, const Vec2& mean) {
  constexpr double kRoom = 2.0;
  constexpr double kLeastPause_s = 3600.0;
  constexpr double kLargestPush_m_s = 1000.0;
  if (!last_accepted_) return false;
  const double pause_s = (epoch_ - *last_accepted_).seconds();
  if (pause_s < kLeastPause_s) return false;
  const double T = pause_s / unit::time_s;
  const Mat23 by_position = by_state.middleCols<3>(index::position);
  const Mat2 of_unit_push = T * T / 3.0 * by_position * by_position.transpose();
  if (!is_covariance(of_unit_push)) return false;
  const double push = kRoom * std::sqrt(0.5 * quadratic(mean, of_unit_push));
  if (push * unit::velocity_m_s > kLargestPush_m_s) return false;
  for (int axis = 0; axis < 3; ++axis) {
    StateVector shared = StateVector::Zero();
    shared[index::position + axis] = T / std::sqrt(3.0);
    shared[index::velocity + axis] = 0.5 * std::sqrt(3.0);
    add_outer_product(covariance_, shared, push * push);
    add_outer_product(covariance_, StateVector::Unit(index::velocity + axis), 0.25 * push * push);
  }
  return true;
}

// Or it was wrong from the start, in no direction more than in another: position and velocity covariance grow until the
// mean is an ordinary innovation.
bool Filter::allow_displacement(const MeasurementMatrix& by_state, const Vec2& mean) {
  const MeasurementMatrix f = by_state * covariance_.u;
  const Mat2 prior = f * covariance_.d.asDiagonal() * f.transpose();
  if (!is_covariance(prior)) return false;
  const double sigma_m = std::sqrt(covariance_pv().topLeftCorner<3, 3>().trace());
  const double growth = std::min(std::sqrt(0.5 * quadratic(mean, prior)), settings_.recovery_max_position_m / sigma_m);
  if (!(growth > 1.0)) return false;
  StateVector factor = StateVector::Ones();
  factor.head<6>().setConstant(growth);
  scale(covariance_, factor);
  return true;
}

}  // namespace astronav::navigation
