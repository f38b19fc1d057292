// SPDX-License-Identifier: Apache-2.0
// The light of one star on the pixels around it: what fits need many thousand times. The law is that of PointSpread
// (models/camera/camera.h), written down a second time so that a fit does not have to set up a renderer for every
// star; a test holds the two together.
#pragma once

#include "foundation/image/image.h"
#include "models/camera/camera.h"

namespace astronav::opensky {

class StarShape {
 public:
  static constexpr int kReach = 8;  // pixels to either side
  static constexpr int kSide = 2 * kReach + 1;

  // On the pixels around `near`.
  StarShape(const Camera& camera, Pixel near);
  int u0() const { return u0_; }
  int v0() const { return v0_; }

  // Shares of the star's light in the pixels (u0 + x, v0 + y), for a star at `at`.
  const ImageF& draw(Pixel at);

 private:
  void add_gaussian(Pixel at, double sigma_px, double share);
  void add_kernel(Pixel at, double share);

  const PointSpread& psf_;
  double core_sigma_px_;
  int u0_, v0_;
  ImageF light_;
};

}  // namespace astronav::opensky
