// SPDX-License-Identifier: Apache-2.0
// Stance: how the camera is believed to stand when a frame comes, so that its stars are looked for where they must be.
// With a gyro by an attitude filter (onboard/attitude), between frames and through slews; without one by what was
// commanded since the last frame. Where it is wrong the eyes find the stars without it.
//
// The filter's axes hang on pixels: z through the middle of the picture, x towards its right. They stay where they are
// while the camera's centre is being learned, and are how the gyro's mounting (R_CB) is told.
#pragma once

#include <optional>

#include "foundation/base/error.h"
#include "foundation/time/epoch.h"
#include "models/camera/camera.h"
#include "onboard/attitude/attitude_keeper.h"
#include "onboard/vision/types.h"

namespace astronav::executive {

// Those axes, P, in camera axes: v_C = R_CP v_P.
Result<Mat3> pixel_axes(const Intrinsics& camera);

struct StanceSettings {
  bool expects = true;                                   // false: each frame is lost in space
  std::optional<attitude::AttitudeFilterSettings> gyro;  // there is one
  Duration command_holds = Duration::seconds(900.0);     // without a gyro: the longest way from frame to frame
};

// What the attitude filter made of a frame; in pixel axes. Empty without a gyro.
struct StanceReport {
  std::optional<attitude::AttitudeEstimate> foretold;  // before the frame was looked at
  std::optional<attitude::AttitudeUpdate> update;      // by the frame's attitude, where one was found
  std::optional<attitude::AttitudeEstimate> after;
};

class Stance {
 public:
  explicit Stance(const StanceSettings& settings);

  void sense(const attitude::GyroSample& sample);
  // Before a frame is looked at with this camera. `commanded`: how it was told to stand.
  std::optional<Mat3> expected_R_CN(Epoch mid_exposure, const Intrinsics& camera, const std::optional<Mat3>& commanded);
  // What was found; not called where nothing was.
  void take(Epoch mid_exposure, const vision::AttitudeSolution& found, const std::optional<Mat3>& commanded);
  // Of the last frame.
  const StanceReport& report() const { return report_; }

 private:
  StanceSettings settings_;
  std::optional<attitude::AttitudeKeeper> keeper_;
  StanceReport report_;
  // The last attitude that was found beside what was commanded then.
  struct Stand {
    Epoch epoch;
    Mat3 R_found_commanded = Mat3::Identity();
  };
  std::optional<Stand> last_;
};

}  // namespace astronav::executive
