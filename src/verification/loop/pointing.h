// SPDX-License-Identifier: Apache-2.0
// Pointing: how the camera is told to stand for each picture, how it really stands, and what the gyro says on the way.
// Between two pictures of a cycle the truth turns from rest to rest; the gyro is on from the first to the last of them.
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "foundation/base/error.h"
#include "foundation/math/linear.h"
#include "foundation/time/epoch.h"
#include "models/camera/camera.h"
#include "onboard/attitude/attitude_keeper.h"
#include "simulator/motion/gyro.h"
#include "verification/loop/mission.h"
#include "verification/loop/records.h"
#include "verification/loop/world.h"
#include "verification/scenario/scenario.h"

namespace astronav::loop {

class Pointing {
 public:
  static Result<Pointing> create(const scenario::Scenario& scenario, const FlyOptions& options, const World& world,
                                 const Camera& believed);

  // A window has one roll angle.
  void begin_window(int cycle, int window);
  // At a direction, for the picture with this running number: dithered, and shaken.
  void point(const Vec3& aim_N, Epoch mid_exposure, int image);

  const Mat3& commanded_R_CN() const { return commanded_R_CN_; }
  const Mat3& R_CN() const { return R_CN_; }
  // What the gyro said since the picture before, by the onboard clock; nothing at the first of a cycle, or without one.
  std::span<const attitude::GyroSample> gyro() const { return samples_; }
  // Of its axes: axes that hang on pixels (executive::pixel_axes), true ones.
  Mat3 R_PN() const { return R_CP_.transpose() * R_CN_; }
  std::optional<Vec3> gyro_bias_rad_s() const;
  bool after_slew() const { return after_slew_; }

 private:
  Pointing(const scenario::Scenario& scenario, const FlyOptions& options, const World& world, double plate_scale_rad_px,
           const Mat3& R_CP)
      : scenario_(scenario), options_(options), world_(world), plate_scale_rad_px_(plate_scale_rad_px), R_CP_(R_CP) {}
  StreamId stream(std::string_view purpose, int number) const;
  void turn(const Mat3& R_PN_before, Epoch before, Epoch now);

  const scenario::Scenario& scenario_;
  const FlyOptions& options_;
  const World& world_;
  double plate_scale_rad_px_;
  Mat3 R_CP_;
  double roll_rad_ = 0.0;
  int cycle_ = -1, window_ = 0;
  Mat3 commanded_R_CN_ = Mat3::Identity();
  Mat3 R_CN_ = Mat3::Identity();
  std::optional<Epoch> last_picture_;  // of this cycle
  int last_window_ = 0;
  bool after_slew_ = false;
  std::optional<motion::Gyro> gyro_;
  std::vector<attitude::GyroSample> samples_;
};

}  // namespace astronav::loop
