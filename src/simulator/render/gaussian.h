// SPDX-License-Identifier: Apache-2.0
// Gaussians integrated over pixels, from a table. Internal to this folder.
#pragma once

#include <array>
#include <cmath>
#include <cstddef>

namespace astronav::render {

// The normal law's distribution function, to 2e-9: cubic Hermite between 1/32 sigma, 0 and 1 beyond 8 sigma.
class NormalTable {
 public:
  NormalTable() {
    for (int i = 0; i <= kNodes; ++i) {
      const double x = -kReach + static_cast<double>(i) / kPerSigma;
      node_[static_cast<std::size_t>(i)] = {0.5 * std::erfc(-x * 0.70710678118654752440),
                                            std::exp(-0.5 * x * x) * 0.39894228040143267794 / kPerSigma};
    }
  }

  double operator()(double x) const {
    const double at = (x + kReach) * kPerSigma;
    if (!(at > 0.0)) return 0.0;
    if (at >= kNodes) return 1.0;
    const auto i = static_cast<std::size_t>(at);
    const double t = at - static_cast<double>(i);
    const Node& a = node_[i];
    const Node& b = node_[i + 1];
    const double rise = b.value - a.value;
    return a.value +
           t * (a.slope + t * ((3.0 * rise - 2.0 * a.slope - b.slope) + t * (a.slope + b.slope - 2.0 * rise)));
  }

 private:
  static constexpr double kReach = 8.0;
  static constexpr int kPerSigma = 32;
  static constexpr int kNodes = 16 * kPerSigma;
  struct Node {
    double value;
    double slope;  // per node
  };
  std::array<Node, kNodes + 1> node_;
};

inline const NormalTable kNormal;

// Shares of a unit Gaussian in the pixels begin..begin+count-1 of one axis.
inline void integrate_gaussian(double centre, double sigma, int begin, int count, float* shares) {
  const double scale = 1.0 / sigma;
  double left = kNormal((begin - 0.5 - centre) * scale);
  for (int i = 0; i < count; ++i) {
    const double right = kNormal((begin + i + 0.5 - centre) * scale);
    shares[i] = static_cast<float>(right - left);
    left = right;
  }
}

}  // namespace astronav::render
