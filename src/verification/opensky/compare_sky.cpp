// SPDX-License-Identifier: Apache-2.0
#include "verification/opensky/compare_sky.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include <Eigen/Cholesky>
#include <Eigen/Core>

#include "foundation/math/statistics.h"

namespace astronav::opensky {
namespace {

constexpr int kOrder = 6;
constexpr double kClip = 3.0;  // sigma
// A normal law cut at 3 sigma keeps this much of its variance.
constexpr double kClippedVariance = 0.9733;

struct Tile {
  double u = 0.0, v = 0.0;  // middle, px
  double level = 0.0;
  double variance = 0.0;
  double pixels = 0.0;
};

// Mean and variance about `sky` (or about nothing) of what lies within 3 sigma of the median.
std::vector<Tile> measure(const ImageF& picture, const ImageF* sky, int size, double step) {
  std::vector<Tile> tiles;
  std::vector<double> values;
  for (int v0 = 0; v0 + size <= picture.height(); v0 += size) {
    for (int u0 = 0; u0 + size <= picture.width(); u0 += size) {
      values.clear();
      double under = 0.0;
      for (int v = v0; v < v0 + size; ++v) {
        for (int u = u0; u < u0 + size; ++u) {
          if (!std::isfinite(picture(u, v))) continue;
          const double level = sky != nullptr ? static_cast<double>((*sky)(u, v)) : 0.0;
          values.push_back(static_cast<double>(picture(u, v)) - level);
          under += level;
        }
      }
      if (values.size() < 16) continue;
      under /= static_cast<double>(values.size());
      double centre = median(values);
      std::vector<double> off;
      for (const double x : values) off.push_back(std::abs(x - centre));
      double spread = 1.4826 * median(off);
      Tile tile;
      for (int round = 0; round < 5; ++round) {
        double n = 0.0, sum = 0.0, sum2 = 0.0;
        for (const double x : values) {
          if (std::abs(x - centre) > kClip * std::max({spread, 0.5 * step, 1e-6})) continue;
          n += 1.0;
          sum += x - centre;
          sum2 += (x - centre) * (x - centre);
        }
        if (n < 8.0) break;
        const double mean = sum / n;
        tile.variance = (sum2 / n - mean * mean) / kClippedVariance;
        tile.level = centre + mean;
        tile.pixels = n;
        centre = tile.level;
        spread = std::sqrt(std::max(tile.variance, 0.0));
      }
      if (tile.pixels == 0.0) continue;
      tile.level += under;
      tile.u = u0 + 0.5 * (size - 1);
      tile.v = v0 + 0.5 * (size - 1);
      tiles.push_back(tile);
    }
  }
  return tiles;
}

int tile_size(const ImageF& picture) {
  return std::clamp(std::min(picture.width(), picture.height()) / 24, 12, 48);
}

// Powers x^i y^j with i + j <= kOrder.
std::array<double, (kOrder + 1) * (kOrder + 2) / 2> terms(double x, double y) {
  std::array<double, (kOrder + 1) * (kOrder + 2) / 2> t;
  std::size_t k = 0;
  double xi = 1.0;
  for (int i = 0; i <= kOrder; ++i, xi *= x) {
    double yj = 1.0;
    for (int j = 0; i + j <= kOrder; ++j, yj *= y) t[k++] = xi * yj;
  }
  return t;
}

}  // namespace

SmoothSky smooth_sky(const ImageF& picture, double step) {
  const int size = tile_size(picture);
  const std::vector<Tile> tiles = measure(picture, nullptr, size, step);
  constexpr Eigen::Index kTerms = (kOrder + 1) * (kOrder + 2) / 2;
  const double unit = 0.5 * std::max(picture.width(), picture.height());
  const double mid_u = 0.5 * (picture.width() - 1), mid_v = 0.5 * (picture.height() - 1);
  SmoothSky out;
  out.level_dn = ImageF(picture.width(), picture.height());
  Eigen::VectorXd shape = Eigen::VectorXd::Zero(kTerms);
  std::vector<char> used(tiles.size(), 1);
  std::vector<double> off(tiles.size());
  for (int round = 0; round < 6; ++round) {
    Eigen::MatrixXd normal = Eigen::MatrixXd::Identity(kTerms, kTerms) * 1e-9;
    Eigen::VectorXd right = Eigen::VectorXd::Zero(kTerms);
    for (std::size_t i = 0; i < tiles.size(); ++i) {
      if (!used[i]) continue;
      const auto t = terms((tiles[i].u - mid_u) / unit, (tiles[i].v - mid_v) / unit);
      const Eigen::Map<const Eigen::VectorXd> row(t.data(), kTerms);
      normal += row * row.transpose();
      right += row * tiles[i].level;
    }
    shape = normal.ldlt().solve(right);
    std::vector<double> sizes;
    for (std::size_t i = 0; i < tiles.size(); ++i) {
      const auto t = terms((tiles[i].u - mid_u) / unit, (tiles[i].v - mid_v) / unit);
      off[i] = tiles[i].level - Eigen::Map<const Eigen::VectorXd>(t.data(), kTerms).dot(shape);
      sizes.push_back(std::abs(off[i]));
    }
    const double spread = 1.4826 * median(sizes);
    std::vector<double> shares;
    for (std::size_t i = 0; i < tiles.size(); ++i) {
      used[i] = sizes[i] <= kClip * spread + 1e-9;
      if (used[i] && tiles[i].variance > 0.0) shares.push_back(off[i] * off[i] * tiles[i].pixels / tiles[i].variance);
    }
    out.scatter = shares.empty() ? 0.0 : std::sqrt(mean(shares));
  }
  for (int v = 0; v < picture.height(); ++v) {
    for (int u = 0; u < picture.width(); ++u) {
      const auto t = terms((u - mid_u) / unit, (v - mid_v) / unit);
      out.level_dn(u, v) = static_cast<float>(Eigen::Map<const Eigen::VectorXd>(t.data(), kTerms).dot(shape));
    }
  }
  return out;
}

NoiseLaw photon_transfer(const ImageF& picture, const SmoothSky& sky, double step,
                         std::optional<double> known_slope_dn) {
  const std::vector<Tile> tiles = measure(picture, &sky.level_dn, tile_size(picture), step);
  std::vector<char> used(tiles.size(), 1);
  std::vector<double> variances;
  for (const Tile& tile : tiles) variances.push_back(tile.variance - known_slope_dn.value_or(0.0) * tile.level);
  NoiseLaw law;
  law.least_dn2 = std::max(step * step / 12.0, 1e-12);
  law.floor_dn2 = variances.empty() ? 1.0 : median(variances);
  if (known_slope_dn) {
    law.slope_dn = *known_slope_dn;
    return law;
  }
  double slope = 0.0, floor = law.floor_dn2, slope_sigma = 0.0;
  for (int round = 0; round < 5; ++round) {
    double n = 0.0, x = 0.0, y = 0.0, xx = 0.0, xy = 0.0;
    for (std::size_t i = 0; i < tiles.size(); ++i) {
      if (!used[i]) continue;
      n += 1.0;
      x += tiles[i].level;
      y += tiles[i].variance;
    }
    if (n < 10.0) return law;
    for (std::size_t i = 0; i < tiles.size(); ++i) {
      if (!used[i]) continue;
      xx += (tiles[i].level - x / n) * (tiles[i].level - x / n);
      xy += (tiles[i].level - x / n) * (tiles[i].variance - y / n);
    }
    if (!(xx > 0.0)) return law;
    slope = xy / xx;
    floor = y / n - slope * x / n;
    std::vector<double> off;
    for (const Tile& tile : tiles) off.push_back(std::abs(tile.variance - floor - slope * tile.level));
    const double spread = 1.4826 * median(off);
    slope_sigma = spread / std::sqrt(xx);
    for (std::size_t i = 0; i < tiles.size(); ++i) used[i] = off[i] <= kClip * spread;
  }
  if (slope > 5.0 * slope_sigma) {
    law.floor_dn2 = floor;
    law.slope_dn = slope;
  }
  return law;
}

ImageF structural_similarity(const ImageF& a, const ImageF& b, double levels) {
  constexpr int kReach = 5;
  std::array<double, 2 * kReach + 1> weight;
  double sum = 0.0;
  for (int i = -kReach; i <= kReach; ++i) {
    weight[static_cast<std::size_t>(i + kReach)] = std::exp(-0.5 * i * i / (1.5 * 1.5));
    sum += weight[static_cast<std::size_t>(i + kReach)];
  }
  for (double& w : weight) w /= sum;
  const int width = a.width(), height = a.height();
  // Five means: of a, b, a^2, b^2 and ab; along rows, then along columns. Beyond the rim the last pixel repeats.
  using Moments = Eigen::Array<double, 5, 1>;
  std::vector<Moments> across(static_cast<std::size_t>(width) * height);
  for (int v = 0; v < height; ++v) {
    for (int u = 0; u < width; ++u) {
      Moments m = Moments::Zero();
      for (int i = -kReach; i <= kReach; ++i) {
        const int at = std::clamp(u + i, 0, width - 1);
        const double x = static_cast<double>(a(at, v)), y = static_cast<double>(b(at, v));
        m += weight[static_cast<std::size_t>(i + kReach)] * (Moments() << x, y, x * x, y * y, x * y).finished();
      }
      across[static_cast<std::size_t>(v) * width + u] = m;
    }
  }
  const double c1 = std::pow(0.01 * levels, 2), c2 = std::pow(0.03 * levels, 2);
  ImageF out(width, height);
  for (int v = 0; v < height; ++v) {
    for (int u = 0; u < width; ++u) {
      Moments m = Moments::Zero();
      for (int i = -kReach; i <= kReach; ++i)
        m += weight[static_cast<std::size_t>(i + kReach)] *
             across[static_cast<std::size_t>(std::clamp(v + i, 0, height - 1)) * width + u];
      const double aa = m[2] - m[0] * m[0], bb = m[3] - m[1] * m[1], ab = m[4] - m[0] * m[1];
      out(u, v) = static_cast<float>((2.0 * m[0] * m[1] + c1) * (2.0 * ab + c2) /
                                     ((m[0] * m[0] + m[1] * m[1] + c1) * (aa + bb + c2)));
    }
  }
  return out;
}

}  // namespace astronav::opensky
