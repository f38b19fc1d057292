// SPDX-License-Identifier: Apache-2.0
#include "verification/opensky/compare_picture.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include "foundation/math/statistics.h"

namespace astronav::opensky {
namespace {

constexpr int kGap = 8;  // columns between the panels, white
constexpr double kDifferenceSigma = 8.0;

std::uint8_t grey(double share) {
  return static_cast<std::uint8_t>(std::lround(255.0 * std::clamp(share, 0.0, 1.0)));
}

}  // namespace

Image<std::uint8_t> side_by_side(const ImageF& picture_dn, const Comparison& comparison) {
  const int width = picture_dn.width(), height = picture_dn.height();
  const ImageF& rendering = comparison.rendering_dn;
  const ImageF& difference = comparison.difference_dn;
  // Noise from the middle half of the differences, the stars' share in which is small.
  std::vector<double> sizes, levels;
  for (std::size_t i = 0; i < difference.pixels().size(); i += 7) {
    sizes.push_back(std::abs(static_cast<double>(difference.pixels()[i])));
    levels.push_back(static_cast<double>(rendering.pixels()[i]));
  }
  const double sigma = std::max(1.4826 * median(sizes), 1e-6);
  const double low = quantile(levels, 0.02) - 3.0 * sigma;
  const double soft = 10.0 * sigma;
  const double high = std::asinh((quantile(levels, 0.9995) - low + 60.0 * sigma) / soft);
  const auto stretched = [&](float dn) { return grey(std::asinh((static_cast<double>(dn) - low) / soft) / high); };
  Image<std::uint8_t> out(3 * width + 2 * kGap, height, 255);
  for (int v = 0; v < height; ++v) {
    for (int u = 0; u < width; ++u) {
      out(u, v) = stretched(picture_dn(u, v));
      out(width + kGap + u, v) = stretched(rendering(u, v));
      out(2 * (width + kGap) + u, v) =
          grey(0.5 + 0.5 * static_cast<double>(difference(u, v)) / (kDifferenceSigma * sigma));
    }
  }
  return out;
}

}  // namespace astronav::opensky
