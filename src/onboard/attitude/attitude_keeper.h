// SPDX-License-Identifier: Apache-2.0
// AttitudeKeeper: an AttitudeFilter that needs no nurse: it starts with the first frame that is solved, follows the
// gyro, and starts anew where a frame shows it wrong or the gyro was silent.
//
//   AttitudeKeeper keeper(settings);
//   keeper.sense(sample);                 // each of the gyro, in order, up to the one with the next mid-exposure
//   const auto foretold = keeper.at(t);   // where the stars of the frame at t should be looked for
//   keeper.take({t, R_CN, covariance});   // what the frame said
//
// No heap.
#pragma once

#include <optional>

#include "onboard/attitude/attitude_filter.h"

namespace astronav::attitude {

// The mean rate of B with respect to N between two epochs, in B, as measured.
struct GyroSample {
  Epoch begin;
  Epoch end;
  Vec3 rate_rad_s = Vec3::Zero();
};

struct AttitudeEstimate {
  Epoch epoch;
  Mat3 R_CN = Mat3::Identity();
  Mat3 covariance_rad2 = Mat3::Zero();  // of theta, camera axes: R_CN_true = exp(-[theta]x) R_CN
  Vec3 gyro_bias_rad_s = Vec3::Zero();  // body axes
  Vec3 gyro_bias_sigma_rad_s = Vec3::Zero();
};

class AttitudeKeeper {
 public:
  explicit AttitudeKeeper(const AttitudeFilterSettings& settings);

  // A rate holds for as long again before and after its sample, so that a single lost one is bridged; a longer silence
  // loses the attitude.
  void sense(const GyroSample& sample);
  // Nothing before the first frame, after a silence, and for an epoch that is past.
  std::optional<AttitudeEstimate> at(Epoch epoch);
  // `started`: nothing was known before. `gated`: the gyro went wrong, as frames that are solved wrongly are rarer. The
  // frame is the new start, and the bias may be wrong by as much as brought the attitude here since the last frame.
  // `not_now`: a frame of before the last sample, which is passed over.
  AttitudeUpdate take(const AttitudeMeasurement& frame);
  // After the last of all these; nothing where no attitude is known.
  std::optional<AttitudeEstimate> now() const;

 private:
  bool advance(Epoch epoch);

  AttitudeFilterSettings settings_;
  AttitudeFilter filter_;
  bool knows_ = false;
  GyroSample last_;
  Epoch last_frame_;
};

}  // namespace astronav::attitude
