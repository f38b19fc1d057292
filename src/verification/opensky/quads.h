// SPDX-License-Identifier: Apache-2.0
// QuadIndex: stars by the shapes that four of them make, whatever the scale (as Lang et al. 2010).
//
// The two that are farthest apart, A and B, make the axes: x from A to B, y = middle x x, the unit their distance. The
// shape is (Cx, Cy, Dx, Dy), seen orthographically from the middle of AB, with Cx <= Dx and Cx + Dx >= 0. A mirrored
// picture has the same shape with y turned round.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "foundation/math/linear.h"
#include "onboard/vision/star_field.h"

namespace astronav::opensky {

struct QuadShape {
  std::array<float, 4> xy{};              // Cx, Cy, Dx, Dy
  double size_rad = 0.0;                  // of AB, as a chord of the unit sphere
  std::array<std::uint8_t, 4> corners{};  // which of the four directions is A, B, C, D
  QuadShape mirrored() const { return {{xy[0], -xy[1], xy[2], -xy[3]}, size_rad, corners}; }
};
QuadShape quad_shape(const std::array<Vec3, 4>& directions);

// Which of four may be A, B, C, D.
inline constexpr std::array<std::array<std::uint8_t, 4>, 6> kQuadSplits{
    {{0, 1, 2, 3}, {0, 2, 1, 3}, {0, 3, 1, 2}, {1, 2, 0, 3}, {1, 3, 0, 2}, {2, 3, 0, 1}}};
// The axes that A and B make, and of many shapes with the same A and B the part that they share.
struct QuadAxes {
  Vec3 middle, x, y;
  double size_rad = 0.0;
  QuadAxes() = default;
  QuadAxes(const Vec3& a, const Vec3& b);
};
QuadShape quad_shape(const QuadAxes& axes, const std::array<std::uint8_t, 4>& corners, const Vec3& c, const Vec3& d);

// The brightest stars, but nowhere more than `neighbours` within `radius_rad`: even over the sky, however narrow the
// field. At most the `looked_at` brightest are asked. Indices into the field, brightest first.
std::vector<std::uint32_t> even_stars(const vision::StarField& field, std::span<const std::uint32_t> by_brightness,
                                      double radius_rad, int neighbours, std::size_t looked_at);

struct QuadSettings {
  double radius_rad = 0.0;  // of the fainter three about the brightest
  int neighbours = 6;       // of those, the brightest that are used
};

class QuadIndex {
 public:
  struct Quad {
    std::array<std::uint32_t, 4> stars{};  // A, B, C, D: indices into the field
    std::array<std::int16_t, 4> xy{};      // in kSteps of a unit
  };
  static constexpr float kSteps = 16384.0f;

  QuadIndex() = default;
  QuadIndex(const vision::StarField& stars, const QuadSettings& settings);

  std::size_t size() const { return xy_.size(); }
  // Those whose four numbers are all within `tolerance`.
  template <typename Use>
  void look_up(const QuadShape& shape, float tolerance, Use&& use) const;

 private:
  // Cells of Cx, Cy and Dx; Dx, varying fastest, runs through memory.
  static constexpr float kCell = 1.0f / 32.0f;
  static constexpr int kCellsX = 34, kCellsY = 58;
  static int cell_x(float x);
  static int cell_y(float y);
  static std::size_t cell(int cx, int cy, int dx) {
    return (static_cast<std::size_t>(cx) * kCellsY + static_cast<std::size_t>(cy)) * kCellsX +
           static_cast<std::size_t>(dx);
  }
  std::vector<std::uint32_t> first_;  // of each cell, and the end
  // In the order of the cells; apart, since nearly all are only looked at.
  std::vector<std::array<std::int16_t, 4>> xy_;
  std::vector<std::array<std::uint32_t, 4>> stars_;
};

template <typename Use>
void QuadIndex::look_up(const QuadShape& shape, float tolerance, Use&& use) const {
  if (xy_.empty()) return;
  const int dx0 = cell_x(shape.xy[2] - tolerance), dx1 = cell_x(shape.xy[2] + tolerance);
  // One comparison a number: what lies below the least wraps round.
  const auto reach = static_cast<int>(tolerance * kSteps);
  const auto width = static_cast<std::uint16_t>(2 * reach);
  std::array<std::uint16_t, 4> least;
  for (std::size_t k = 0; k < 4; ++k)
    least[k] = static_cast<std::uint16_t>(static_cast<int>(shape.xy[k] * kSteps) - reach);
  for (int cx = cell_x(shape.xy[0] - tolerance); cx <= cell_x(shape.xy[0] + tolerance); ++cx) {
    for (int cy = cell_y(shape.xy[1] - tolerance); cy <= cell_y(shape.xy[1] + tolerance); ++cy) {
      const std::uint32_t end = first_[cell(cx, cy, dx1) + 1];
      for (std::uint32_t i = first_[cell(cx, cy, dx0)]; i < end; ++i) {
        bool close = true;
        for (std::size_t k = 0; k < 4; ++k) close &= static_cast<std::uint16_t>(xy_[i][k] - least[k]) <= width;
        if (close) use(Quad{stars_[i], xy_[i]});
      }
    }
  }
}

}  // namespace astronav::opensky
