// SPDX-License-Identifier: Apache-2.0
#include "onboard/executive/stance.h"

namespace astronav::executive {

Result<Mat3> pixel_axes(const Intrinsics& camera) {
  const Pixel middle{0.5 * (camera.width_px - 1), 0.5 * (camera.height_px - 1)};
  const auto z = unproject(camera, middle);
  const auto right = unproject(camera, {middle.u + 0.25 * camera.width_px, middle.v});
  if (!z) return forward(z, "camera");
  if (!right) return forward(right, "camera");
  const Vec3 y = z->cross(*right).normalized();
  Mat3 axes;
  axes << y.cross(*z), y, *z;
  return axes;
}

Stance::Stance(const StanceSettings& settings) : settings_(settings) {
  if (settings.gyro) keeper_.emplace(*settings.gyro);
}

void Stance::sense(const attitude::GyroSample& sample) {
  if (keeper_) keeper_->sense(sample);
}

std::optional<Mat3> Stance::expected_R_CN(Epoch mid_exposure, const Intrinsics& camera,
                                          const std::optional<Mat3>& commanded) {
  report_ = {};
  if (keeper_) {
    report_.foretold = keeper_->at(mid_exposure);
    const auto axes = pixel_axes(camera);
    if (!settings_.expects || !report_.foretold || !axes) return std::nullopt;
    return *axes * report_.foretold->R_CN;
  }
  // What points the camera is off by the same from one image to the next, but for its jitter.
  if (!settings_.expects || !commanded || !last_ || mid_exposure - last_->epoch > settings_.command_holds)
    return std::nullopt;
  return last_->R_found_commanded * *commanded;
}

void Stance::take(Epoch mid_exposure, const vision::AttitudeSolution& found, const std::optional<Mat3>& commanded) {
  if (commanded) last_ = Stand{mid_exposure, found.R_CN * commanded->transpose()};
  const auto axes = pixel_axes(found.intrinsics);
  if (!keeper_ || !axes || found.mirrored) return;
  const Mat3 R_PC = axes->transpose();
  report_.update = keeper_->take({mid_exposure, R_PC * found.R_CN, R_PC * found.covariance_rad2 * R_PC.transpose()});
  report_.after = keeper_->now();
}

}  // namespace astronav::executive
