// SPDX-License-Identifier: Apache-2.0
// A body's small disc, lit from one side, and the handful of points of light that it is like.
#pragma once

#include <array>

#include "foundation/math/linear.h"

namespace astronav::vision {

struct LitDisc {
  double radius_px = 0.0;  // 0: a point
  Vec2 sunward{1.0, 0.0};  // towards the Sun in the image, of length 1
  double phase_rad = 0.0;  // Sun-body-observer
};

struct DiscPoint {
  Vec2 offset_px;  // from the disc's centre of light
  double share;    // of its light; all together 1
};
inline constexpr int kDiscRows = 6, kDiscColumns = 6;
using DiscPoints = std::array<DiscPoint, kDiscRows * kDiscColumns>;

// Lambert's law: Gauss-Legendre across the disc, and in each row from the terminator to the limb (docs/theory/vision.md
// eq. 8c).
DiscPoints points_of(const LitDisc& disc);

// How far they lie from its centre of light along u and v, mean squares; zero for a point.
Vec2 spread_px2(const LitDisc& disc);

}  // namespace astronav::vision
