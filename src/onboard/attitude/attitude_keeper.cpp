// SPDX-License-Identifier: Apache-2.0
#include "onboard/attitude/attitude_keeper.h"

#include <algorithm>

namespace astronav::attitude {

AttitudeKeeper::AttitudeKeeper(const AttitudeFilterSettings& settings) : settings_(settings), filter_(settings) {}

bool AttitudeKeeper::advance(Epoch epoch) {
  if (!knows_ || epoch < filter_.epoch()) return false;
  if (epoch == filter_.epoch()) return true;
  const Duration holds = last_.end - last_.begin;
  knows_ = last_.begin - filter_.epoch() <= holds && epoch - last_.end <= holds &&
           filter_.propagate(epoch, last_.rate_rad_s).has_value();
  return knows_;
}

void AttitudeKeeper::sense(const GyroSample& sample) {
  // What is left of the one before.
  if (last_.end > filter_.epoch()) (void)advance(last_.end);
  last_ = sample;
}

std::optional<AttitudeEstimate> AttitudeKeeper::now() const {
  if (!knows_) return std::nullopt;
  return AttitudeEstimate{filter_.epoch(), filter_.R_CN(), filter_.covariance_CN_rad2(), filter_.gyro_bias_rad_s(),
                          filter_.covariance().diagonal().tail<3>().cwiseSqrt()};
}

std::optional<AttitudeEstimate> AttitudeKeeper::at(Epoch epoch) {
  return advance(epoch) ? now() : std::nullopt;
}

AttitudeUpdate AttitudeKeeper::take(const AttitudeMeasurement& frame) {
  const Mat3& R_CB = settings_.R_CB;
  AttitudeStart start{.epoch = frame.epoch,
                      .R_BN = R_CB.transpose() * frame.R_CN,
                      .covariance_rad2 = R_CB.transpose() * frame.covariance_rad2 * R_CB};
  AttitudeUpdate update;
  if (knows_ && frame.epoch < filter_.epoch()) {
    update.verdict = AttitudeVerdict::not_now;
    return update;
  }
  update.verdict = AttitudeVerdict::started;
  if (advance(frame.epoch)) {
    update = filter_.update(frame);
    if (update.accepted()) last_frame_ = frame.epoch;
    if (update.verdict != AttitudeVerdict::gated) return update;
    start.gyro_bias_rad_s = filter_.gyro_bias_rad_s();
    const double drift_rad_s = update.innovation_rad.norm() / std::max(1.0, (frame.epoch - last_frame_).seconds());
    start.gyro_bias_sigma_rad_s = std::max(settings_.gyro.bias_sigma_rad_s, drift_rad_s);
  }
  knows_ = filter_.initialise(start).has_value();
  if (knows_)
    last_frame_ = frame.epoch;
  else
    update.verdict = AttitudeVerdict::bad_measurement;
  return update;
}

}  // namespace astronav::attitude
