// SPDX-License-Identifier: Apache-2.0
// Cosmic rays: protons that cross the detector and leave charge along straight tracks (docs/theory/rendering.md
// eq. 13). Internal to this folder.
#pragma once

#include <vector>

#include "foundation/math/random.h"
#include "models/camera/camera.h"

namespace astronav::render {

struct ProtonPixel {
  int u = 0;
  int v = 0;
  double electrons = 0.0;
};

// What all hits of one exposure leave, pixel by pixel; a pixel may come more than once.
std::vector<ProtonPixel> proton_hits(const Camera& camera, double exposure_s, RandomStream& random);

}  // namespace astronav::render
