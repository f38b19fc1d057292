// SPDX-License-Identifier: Apache-2.0
// CoarseMap: a smooth function of the picture, computed on a grid and linear between. Internal to this folder.
#pragma once

#include "foundation/image/image.h"
#include "models/camera/camera.h"

namespace astronav::render {

template <int kStep>
class CoarseMap {
 public:
  CoarseMap() = default;
  // `value(Pixel)`: of the function at a place on the detector.
  template <typename Value>
  CoarseMap(const Intrinsics& camera, const Value& value)
      : grid_((camera.width_px - 1) / kStep + 2, (camera.height_px - 1) / kStep + 2) {
    for (int j = 0; j < grid_.height(); ++j) {
      for (int i = 0; i < grid_.width(); ++i) {
        grid_(i, j) = static_cast<float>(value({static_cast<double>(i * kStep), static_cast<double>(j * kStep)}));
      }
    }
  }
  bool empty() const { return grid_.width() == 0; }
  float operator()(int u, int v) const {
    const int i = u / kStep;
    const int j = v / kStep;
    const float x = static_cast<float>(u % kStep) / kStep;
    const float y = static_cast<float>(v % kStep) / kStep;
    return (1.0f - y) * ((1.0f - x) * grid_(i, j) + x * grid_(i + 1, j)) +
           y * ((1.0f - x) * grid_(i, j + 1) + x * grid_(i + 1, j + 1));
  }

 private:
  ImageF grid_;
};

}  // namespace astronav::render
