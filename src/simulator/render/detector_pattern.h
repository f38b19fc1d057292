// SPDX-License-Identifier: Apache-2.0
// What belongs to one piece of silicon and one lens, and is the same in every frame. Internal to this folder.
#pragma once

#include <cstdint>
#include <vector>

#include "foundation/image/image.h"
#include "models/camera/camera.h"

namespace astronav::render {

// Share of the light that arrives at a pixel (docs/theory/rendering.md eq. 7). 1 where the camera has no vignetting.
double vignetting(const Camera& camera, Pixel at, const Vec3& direction_C);
bool has_vignetting(const Camera& camera);

struct HotPixel {
  std::uint32_t index = 0;  // row-major
  float leak = 0.0f;        // electrons a second at the reference temperature
};

struct DetectorPattern {
  DetectorPattern(const Camera& camera, std::uint64_t detector_seed);

  ImageF prnu;  // relative deviation of each pixel
  ImageF dsnu;
  ImageF vignetting;  // share of the light; empty where all of it arrives
  std::vector<HotPixel> hot;
};

}  // namespace astronav::render
