// SPDX-License-Identifier: Apache-2.0
#include "verification/opensky/quads.h"

#include <algorithm>
#include <cmath>
#include <numeric>

#include <Eigen/Geometry>

namespace astronav::opensky {

QuadAxes::QuadAxes(const Vec3& a, const Vec3& b) : middle(0.5 * (a + b)) {
  const double length2 = (a - b).squaredNorm();
  size_rad = std::sqrt(length2);
  x = (b - a) / length2;  // divides by the distance once for the axis and once for the unit
  y = middle.cross(x) / middle.norm();
}

QuadShape quad_shape(const QuadAxes& axes, const std::array<std::uint8_t, 4>& corners, const Vec3& third,
                     const Vec3& fourth) {
  QuadShape shape;
  shape.size_rad = axes.size_rad;
  shape.corners = corners;
  auto& [a, b, c, e] = shape.corners;
  double cx = (third - axes.middle).dot(axes.x), cy = third.dot(axes.y);
  double ex = (fourth - axes.middle).dot(axes.x), ey = fourth.dot(axes.y);
  if (cx + ex < 0.0) {
    std::swap(a, b);
    cx = -cx, cy = -cy, ex = -ex, ey = -ey;
  }
  if (cx > ex) {
    std::swap(c, e);
    std::swap(cx, ex);
    std::swap(cy, ey);
  }
  shape.xy = {static_cast<float>(cx), static_cast<float>(cy), static_cast<float>(ex), static_cast<float>(ey)};
  return shape;
}

QuadShape quad_shape(const std::array<Vec3, 4>& d) {
  const auto* longest = &kQuadSplits[0];
  double length2 = -1.0;
  for (const auto& split : kQuadSplits) {
    const double d2 = (d[split[0]] - d[split[1]]).squaredNorm();
    if (d2 <= length2) continue;
    length2 = d2;
    longest = &split;
  }
  const auto& [a, b, c, e] = *longest;
  return quad_shape(QuadAxes(d[a], d[b]), *longest, d[c], d[e]);
}

std::vector<std::uint32_t> even_stars(const vision::StarField& field, std::span<const std::uint32_t> by_brightness,
                                      double radius_rad, int neighbours, std::size_t looked_at) {
  // What is taken, in cells of a cube that are no narrower than the radius.
  const int n = std::clamp(static_cast<int>(2.0 / radius_rad), 1, 64);
  std::vector<std::vector<Eigen::Vector3f>> taken(static_cast<std::size_t>(n) * n * n);
  const auto cell_of = [n](double x) { return std::clamp(static_cast<int>((x + 1.0) * 0.5 * n), 0, n - 1); };
  const float least_cos = static_cast<float>(std::cos(radius_rad));
  std::vector<std::uint32_t> chosen;
  for (const std::uint32_t i : by_brightness.first(std::min(looked_at, by_brightness.size()))) {
    const Vec3& d = field.stars()[i].direction_N;
    const Eigen::Vector3f place = d.cast<float>();
    const int x = cell_of(d.x()), y = cell_of(d.y()), z = cell_of(d.z());
    int near = 0;
    for (int a = std::max(0, x - 1); a <= std::min(n - 1, x + 1); ++a) {
      for (int b = std::max(0, y - 1); b <= std::min(n - 1, y + 1); ++b) {
        for (int c = std::max(0, z - 1); c <= std::min(n - 1, z + 1); ++c) {
          for (const Eigen::Vector3f& other : taken[static_cast<std::size_t>((a * n + b) * n + c)])
            near += other.dot(place) > least_cos;
        }
      }
    }
    if (near >= neighbours) continue;
    taken[static_cast<std::size_t>((x * n + y) * n + z)].push_back(place);
    chosen.push_back(i);
  }
  return chosen;
}

int QuadIndex::cell_x(float x) {
  return std::clamp(static_cast<int>((x + 0.53f) / kCell), 0, kCellsX - 1);
}
int QuadIndex::cell_y(float y) {
  return std::clamp(static_cast<int>((y + 0.9f) / kCell), 0, kCellsY - 1);
}

QuadIndex::QuadIndex(const vision::StarField& field, const QuadSettings& settings) {
  const std::span<const vision::FieldStar> stars = field.stars();
  std::vector<Quad> quads;
  std::vector<std::uint32_t> near(stars.size());
  for (std::uint32_t i = 0; i < stars.size(); ++i) {
    const std::size_t found = field.cone(stars[i].direction_N, settings.radius_rad, near);
    // Each quad once: from its brightest star.
    const auto fainter_end = std::partition(
        near.begin(), near.begin() + static_cast<std::ptrdiff_t>(found),
        [&](auto k) { return stars[k].v_mag > stars[i].v_mag || (stars[k].v_mag == stars[i].v_mag && k > i); });
    const auto count = std::min<std::ptrdiff_t>(settings.neighbours, fainter_end - near.begin());
    std::partial_sort(near.begin(), near.begin() + count, fainter_end,
                      [&](std::uint32_t a, std::uint32_t b) { return stars[a].v_mag < stars[b].v_mag; });
    for (std::ptrdiff_t a = 0; a < count; ++a) {
      for (std::ptrdiff_t b = a + 1; b < count; ++b) {
        for (std::ptrdiff_t c = b + 1; c < count; ++c) {
          const std::array<std::uint32_t, 4> of{i, near[a], near[b], near[c]};
          const QuadShape shape = quad_shape(
              {stars[of[0]].direction_N, stars[of[1]].direction_N, stars[of[2]].direction_N, stars[of[3]].direction_N});
          Quad& quad = quads.emplace_back();
          for (std::size_t k = 0; k < 4; ++k) {
            quad.stars[k] = of[shape.corners[k]];
            quad.xy[k] = static_cast<std::int16_t>(shape.xy[k] * kSteps);
          }
        }
      }
    }
  }
  const auto cell_of = [](const Quad& q) {
    return cell(cell_x(q.xy[0] / kSteps), cell_y(q.xy[1] / kSteps), cell_x(q.xy[2] / kSteps));
  };
  first_.assign(static_cast<std::size_t>(kCellsX) * kCellsY * kCellsX + 1, 0);
  std::vector<std::uint32_t> cells;
  cells.reserve(quads.size());
  for (const Quad& q : quads) {
    cells.push_back(static_cast<std::uint32_t>(cell_of(q)));
    ++first_[cells.back() + 1];
  }
  std::partial_sum(first_.begin(), first_.end(), first_.begin());
  std::vector<std::uint32_t> next(first_.begin(), first_.end() - 1);
  xy_.resize(quads.size());
  stars_.resize(quads.size());
  for (std::size_t i = 0; i < quads.size(); ++i) {
    const std::uint32_t at = next[cells[i]]++;
    xy_[at] = quads[i].xy;
    stars_[at] = quads[i].stars;
  }
}

}  // namespace astronav::opensky
