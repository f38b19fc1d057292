// SPDX-License-Identifier: Apache-2.0
#include "verification/opensky/solver_picture.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include "foundation/math/statistics.h"

namespace astronav::opensky {
namespace {

using Colour = std::array<std::uint8_t, 3>;
constexpr Colour kStar{70, 220, 90}, kPlanet{255, 170, 30}, kNeither{230, 60, 60};

class Canvas {
 public:
  explicit Canvas(const ImageF& pixels) : image_(3 * pixels.width(), pixels.height()), width_(pixels.width()) {
    std::vector<double> levels;
    for (std::size_t i = 0; i < pixels.pixels().size(); i += 13)
      if (std::isfinite(pixels.pixels()[i])) levels.push_back(static_cast<double>(pixels.pixels()[i]));
    const double middle = levels.empty() ? 0.0 : median(levels);
    const double high = levels.empty() ? 1.0 : quantile(levels, 0.999);
    const double low = levels.empty() ? 0.0 : quantile(levels, 0.05);
    const double soft = std::max(high - middle, 1.0);
    for (int v = 0; v < pixels.height(); ++v) {
      for (int u = 0; u < width_; ++u) {
        const double share =
            std::asinh(std::max(0.0, static_cast<double>(pixels(u, v)) - low) / soft) / std::asinh(12.0);
        const auto grey = static_cast<std::uint8_t>(std::lround(255.0 * std::clamp(share, 0.0, 1.0)));
        put(u, v, {grey, grey, grey});
      }
    }
  }
  void put(double u, double v, const Colour& colour) {
    const auto x = static_cast<int>(std::lround(u)), y = static_cast<int>(std::lround(v));
    if (x < 0 || y < 0 || x >= width_ || y >= image_.height()) return;
    for (int c = 0; c < 3; ++c) image_(3 * x + c, y) = colour[static_cast<std::size_t>(c)];
  }
  void circle(Pixel p, double radius, const Colour& colour) {
    const int steps = static_cast<int>(8.0 * radius);
    for (int k = 0; k < steps; ++k)
      put(p.u + radius * std::cos(2.0 * kPi * k / steps), p.v + radius * std::sin(2.0 * kPi * k / steps), colour);
  }
  void brackets(Pixel p, double size, const Colour& colour) {
    for (double k = 0.0; k <= 0.6 * size; k += 0.5) {
      for (const double side : {-1.0, 1.0}) {
        for (const double thick : {0.0, 1.0}) {
          put(p.u + side * (size - k), p.v - size + thick, colour);
          put(p.u + side * (size - k), p.v + size - thick, colour);
          put(p.u - size + thick, p.v + side * (size - k), colour);
          put(p.u + size - thick, p.v + side * (size - k), colour);
        }
      }
    }
  }
  void cross(Pixel p, double size, const Colour& colour) {
    for (double k = -size; k <= size; k += 0.5) {
      put(p.u + k, p.v + k, colour);
      put(p.u + k, p.v - k, colour);
    }
  }
  Image<std::uint8_t> take() { return std::move(image_); }

 private:
  Image<std::uint8_t> image_;
  int width_;
};

}  // namespace

Image<std::uint8_t> annotated(const Picture& picture, const Solution& solution) {
  Canvas canvas(picture.pixels);
  for (const vision::Centroid& spot : solution.unknown) canvas.cross(spot.pixel, 3.0, kNeither);
  for (const SolvedStar& star : solution.stars) {
    const double radius = std::clamp(14.0 - star.v_mag, 6.0, 14.0);
    canvas.circle(star.spot.pixel, radius, kStar);
    canvas.circle(star.spot.pixel, radius + 0.7, kStar);
  }
  for (const SolvedPlanet& planet : solution.planets) canvas.brackets(planet.spot.pixel, 18.0, kPlanet);
  return canvas.take();
}

}  // namespace astronav::opensky
