// SPDX-License-Identifier: Apache-2.0
// Gaussians integrated over the pixels of one axis, with derivatives (docs/theory/vision.md eq. 4, 5). Internal to this
// folder.
#pragma once

#include <array>
#include <cmath>
#include <cstddef>

#include "foundation/math/linear.h"

namespace astronav::vision {

inline constexpr int kMaxFitWindow = 32;  // px, each way
inline constexpr int kLanes = 8;          // rows are worked on in groups of so many pixels

// The first pixels of a row of which `left` remain; zero beyond its end.
template <typename T>
std::array<double, kLanes> lanes_of(const T* pixels, int left) {
  std::array<double, kLanes> lanes{};
  if (left >= kLanes) {
    for (std::size_t l = 0; l < kLanes; ++l) lanes[l] = static_cast<double>(pixels[l]);
  } else {
    for (int l = 0; l < left; ++l) lanes[static_cast<std::size_t>(l)] = static_cast<double>(pixels[l]);
  }
  return lanes;
}

// The normal law and its density from a table: cubic Hermite between nodes 1/16 apart, good to 1e-7 and 1e-6. Every
// star asks for dozens of values, and erf would take most of the fit's time.
class NormalTable {
 public:
  NormalTable() {
    for (int i = 0; i <= kNodes; ++i) {
      const double x = -kReach + static_cast<double>(i) / kPerUnit;
      const double density = std::exp(-0.5 * x * x) / std::sqrt(2.0 * kPi);
      node_[static_cast<std::size_t>(i)] = {0.5 * std::erfc(-x / std::sqrt(2.0)), density, -x * density};
    }
  }
  struct Value {
    double cumulative;
    double density;
  };
  Value operator()(double x) const {
    const double at = (x + kReach) * kPerUnit;
    if (!(at > 0.0)) return {0.0, 0.0};
    if (at >= kNodes) return {1.0, 0.0};
    const auto i = static_cast<std::size_t>(at);
    const double t = at - static_cast<double>(i);
    const Node& a = node_[i];
    const Node& b = node_[i + 1];
    return {hermite(t, a.cumulative, b.cumulative, a.density / kPerUnit, b.density / kPerUnit),
            hermite(t, a.density, b.density, a.slope / kPerUnit, b.slope / kPerUnit)};
  }

 private:
  static double hermite(double t, double a, double b, double slope_a, double slope_b) {
    const double rise = b - a;
    return a + t * (slope_a + t * ((3.0 * rise - 2.0 * slope_a - slope_b) + t * (slope_a + slope_b - 2.0 * rise)));
  }
  static constexpr double kReach = 8.0;
  static constexpr int kPerUnit = 16;
  static constexpr int kNodes = 16 * kPerUnit;
  struct Node {
    double cumulative;
    double density;
    double slope;
  };
  std::array<Node, kNodes + 1> node_;
};

inline const NormalTable kNormal;

// Entries from `count` up to the next whole group of lanes are zero.
struct AxisProfile {
  alignas(64) std::array<double, kMaxFitWindow> share;
  alignas(64) std::array<double, kMaxFitWindow> by_center;
  alignas(64) std::array<double, kMaxFitWindow> by_sigma;

  // `spread2`: by how much the light's own form widens the Gaussian, squared.
  void compute(int first, int count, double center, double sigma, double spread2 = 0.0) {
    const double wide = std::sqrt(sigma * sigma + spread2), scale = 1.0 / wide, slope = scale * sigma / wide;
    double edge = (first - 0.5 - center) * scale;
    NormalTable::Value left = kNormal(edge);
    int i = 0;
    for (; i < count; ++i) {
      const double next = edge + scale;
      const NormalTable::Value right = kNormal(next);
      share[static_cast<std::size_t>(i)] = right.cumulative - left.cumulative;
      by_center[static_cast<std::size_t>(i)] = (left.density - right.density) * scale;
      by_sigma[static_cast<std::size_t>(i)] = (edge * left.density - next * right.density) * slope;
      edge = next;
      left = right;
    }
    for (; i % kLanes != 0; ++i) {
      share[static_cast<std::size_t>(i)] = by_center[static_cast<std::size_t>(i)] = 0.0;
      by_sigma[static_cast<std::size_t>(i)] = 0.0;
    }
  }
};

}  // namespace astronav::vision
