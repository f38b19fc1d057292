// SPDX-License-Identifier: Apache-2.0
#include "onboard/vision/lit_disc.h"

#include <algorithm>
#include <cmath>

namespace astronav::vision {
namespace {

// Gauss-Legendre of six nodes on [-1, 1]. With four, wings of a disc as large as the core's width come out 8 % wrong.
constexpr std::array<double, 6> kNode{-0.9324695142031521, -0.6612093864662645, -0.2386191860831969,
                                      0.2386191860831969,  0.6612093864662645,  0.9324695142031521};
constexpr std::array<double, 6> kWeight{0.1713244923791703, 0.3607615730481386, 0.4679139345726910,
                                        0.4679139345726910, 0.3607615730481386, 0.1713244923791703};

}  // namespace

// In radii, x towards the Sun as it is seen, z towards the observer: the light at (x, y) is the cosine of the Sun's
// height there.
DiscPoints points_of(const LitDisc& disc) {
  const double sine = std::sin(disc.phase_rad), cosine = std::cos(disc.phase_rad);
  const Vec2 x_axis = disc.sunward.normalized(), y_axis(-x_axis.y(), x_axis.x());
  DiscPoints points;
  double all = 0.0;
  Vec2 moment = Vec2::Zero();
  std::size_t k = 0;
  for (std::size_t j = 0; j < kDiscRows; ++j) {
    const double y = kNode[j], limb = std::sqrt(1.0 - y * y);
    const double middle = 0.5 * limb * (1.0 - cosine), half = 0.5 * limb * (1.0 + cosine);
    for (std::size_t i = 0; i < kDiscColumns; ++i, ++k) {
      const double x = middle + half * kNode[i];
      const double z = std::sqrt(std::max(0.0, limb * limb - x * x));
      const double light = kWeight[j] * kWeight[i] * half * std::max(0.0, x * sine + z * cosine);
      points[k] = {disc.radius_px * (x * x_axis + y * y_axis), light};
      all += light;
      moment += light * points[k].offset_px;
    }
  }
  for (DiscPoint& point : points) {
    point.share /= all;
    point.offset_px -= moment / all;
  }
  return points;
}

Vec2 spread_px2(const LitDisc& disc) {
  Vec2 sum = Vec2::Zero();
  if (!(disc.radius_px > 0.0)) return sum;
  for (const DiscPoint& point : points_of(disc)) sum += point.share * point.offset_px.cwiseAbs2();
  return sum;
}

}  // namespace astronav::vision
