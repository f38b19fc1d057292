// SPDX-License-Identifier: Apache-2.0
#include "verification/opensky/spots.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>
#include <span>

#include "onboard/vision/centroids.h"

namespace astronav::opensky {
namespace {

struct Tiles {
  int width = 0, height = 0, size = 32;
  std::vector<float> level, spread;  // clipped mean and standard deviation
  // One tile beyond the edge it goes on as it ran: a sky that grows brighter does so to its rim.
  float at(const std::vector<float>& values, int x, int y) const {
    const auto inside = [&](int i, int j) { return values[static_cast<std::size_t>(j) * width + i]; };
    const auto along = [&](int j) {
      if (x < 0) return width > 1 ? 2.0f * inside(0, j) - inside(1, j) : inside(0, j);
      if (x >= width) return width > 1 ? 2.0f * inside(width - 1, j) - inside(width - 2, j) : inside(width - 1, j);
      return inside(x, j);
    };
    if (y < 0) return height > 1 ? 2.0f * along(0) - along(1) : along(0);
    if (y >= height) return height > 1 ? 2.0f * along(height - 1) - along(height - 2) : along(height - 1);
    return along(y);
  }
  // Bilinear between the tiles' centres: of one pixel, and of a row from its first pixel on.
  float between(const std::vector<float>& values, int u, int v) const {
    const float x = (static_cast<float>(u) + 0.5f) / static_cast<float>(size) - 0.5f;
    const int i = static_cast<int>(std::floor(x));
    const float a = x - static_cast<float>(i);
    return down(values, i, v) * (1 - a) + down(values, i + 1, v) * a;
  }
  void between(const std::vector<float>& values, int v, std::span<float> row) const {
    const int length = static_cast<int>(row.size());
    for (int i = -1; i < width; ++i) {
      const float left = down(values, i, v), slope = (down(values, i + 1, v) - left) / static_cast<float>(size);
      const int u0 = i * size + size / 2;  // its centre lies half a pixel before
      for (int u = std::max(0, u0); u < std::min(length, u0 + size); ++u)
        row[static_cast<std::size_t>(u)] = left + slope * (static_cast<float>(u - u0) + 0.5f);
    }
  }

 private:
  float down(const std::vector<float>& values, int i, int v) const {
    const float y = (static_cast<float>(v) + 0.5f) / static_cast<float>(size) - 0.5f;
    const int j = static_cast<int>(std::floor(y));
    const float b = y - static_cast<float>(j);
    return at(values, i, j) * (1 - b) + at(values, i, j + 1) * b;
  }
};

float middle_of(std::vector<float>& values) {
  if (values.empty()) return 0.0f;
  const auto m = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), m, values.end());
  return *m;
}

// Each value the median of its 3x3 neighbourhood: a star or a roof's edge does not pull the background.
std::vector<float> median3(const Tiles& tiles, const std::vector<float>& values) {
  std::vector<float> out(values.size()), near;
  for (int y = 0; y < tiles.height; ++y) {
    for (int x = 0; x < tiles.width; ++x) {
      near.clear();
      for (int j = y - 1; j <= y + 1; ++j)
        for (int i = x - 1; i <= x + 1; ++i) near.push_back(tiles.at(values, i, j));
      out[static_cast<std::size_t>(y) * tiles.width + x] = middle_of(near);
    }
  }
  return out;
}

// Between grey levels; 0 where there are none. Whole numbers have it also where they are stored as floating ones.
float grey_step(const Picture& picture) {
  if (picture.bits <= 16) return 1.0f;
  const auto pixels = picture.pixels.pixels();
  const std::size_t stride = std::max<std::size_t>(1, pixels.size() / 16'384) | 1;
  std::vector<float> values;
  for (std::size_t i = 0; i < pixels.size(); i += stride)
    if (std::isfinite(pixels[i])) values.push_back(pixels[i]);
  std::sort(values.begin(), values.end());
  const std::size_t all = values.size();
  values.erase(std::unique(values.begin(), values.end()), values.end());
  if (values.size() < 2 || 2 * values.size() > all) return 0.0f;
  float step = values.back() - values.front();
  for (std::size_t i = 1; i < values.size(); ++i) step = std::min(step, values[i] - values[i - 1]);
  return step;
}

Tiles measure(const ImageF& image, int size, float step) {
  Tiles tiles;
  tiles.size = size;
  tiles.width = (image.width() + size - 1) / size;
  tiles.height = (image.height() + size - 1) / size;
  std::vector<float> values, deviations, sums;
  // Every fourth pixel of a large tile fixes a median and a limit well enough.
  const int stride = size >= 24 ? 2 : 1;
  for (int y = 0; y < tiles.height; ++y) {
    const int v1 = std::min((y + 1) * size, image.height());
    for (int x = 0; x < tiles.width; ++x) {
      const int u1 = std::min((x + 1) * size, image.width());
      values.clear();
      for (int v = y * size; v < v1; v += stride) {
        const float* row = image.row(v);
        for (int u = x * size; u < u1; u += stride)
          if (std::isfinite(row[u])) values.push_back(row[u]);
      }
      const float median = middle_of(values);
      deviations.clear();
      for (const float value : values) deviations.push_back(std::abs(value - median));
      // Where more than half of the pixels are black, only what lies above them tells of noise.
      const auto upper = values.begin() + static_cast<std::ptrdiff_t>(values.size() * 84 / 100);
      std::nth_element(values.begin(), upper, values.end());
      const float above = values.empty() ? 0.0f : *upper - median;
      const float limit = std::max(4.0f * std::max(1.4826f * middle_of(deviations), above), 2.0f * step);
      // In a picture of few grey levels the median jumps from level to level: the clipped mean does not.
      sums.assign(3 * static_cast<std::size_t>(size), 0.0f);
      float *count = sums.data(), *first = count + size, *second = first + size;  // of each column
      for (int v = y * size; v < v1; ++v) {
        const float* row = image.row(v) + x * size;
        for (int k = 0; k < u1 - x * size; ++k) {
          const float d = row[k] - median;
          const bool inside = std::abs(d) <= limit;  // never of what is not finite
          count[k] += inside ? 1.0f : 0.0f;
          first[k] += inside ? d : 0.0f;
          second[k] += inside ? d * d : 0.0f;
        }
      }
      const double n = std::accumulate(count, first, 0.0), sum = std::accumulate(first, second, 0.0);
      const double sum2 = std::accumulate(second, second + size, 0.0);
      tiles.level.push_back(n > 0.0 ? median + static_cast<float>(sum / n) : median);
      tiles.spread.push_back(n > 0.0 ? static_cast<float>(std::sqrt(std::max(sum2 / n - sum * sum / (n * n), 0.0)))
                                     : 0.0f);
    }
  }
  tiles.level = median3(tiles, tiles.level);
  tiles.spread = median3(tiles, tiles.spread);
  return tiles;
}

// (picture - level) / spread, smoothed by a Gaussian; beyond the edges the outermost pixels go on.
ImageF smoothed_contrast(const ImageF& image, const Tiles& tiles, float least_spread, double sigma) {
  constexpr int kReach = 4;  // pixels: three sigma and more
  std::array<float, kReach + 1> kernel;
  float sum = 0.0f;
  for (int i = 0; i <= kReach; ++i) {
    kernel[i] = static_cast<float>(std::exp(-0.5 * i * i / (sigma * sigma)));
    sum += i == 0 ? kernel[i] : 2.0f * kernel[i];
  }
  for (float& k : kernel) k /= sum;
  const auto [k0, k1, k2, k3, k4] = kernel;
  const int w = image.width(), h = image.height();
  const auto width = static_cast<std::size_t>(w);
  ImageF across(w, h), out(w, h);
  std::vector<float> level(width), weight(width), padded(width + 2 * kReach);
  for (int v = 0; v < h; ++v) {
    tiles.between(tiles.level, v, level);
    tiles.between(tiles.spread, v, weight);
    const float* from = image.row(v);
    float* c = padded.data() + kReach;
    for (int u = 0; u < w; ++u) {
      const float r = (from[u] - level[u]) / std::max(weight[u], least_spread);
      c[u] = std::abs(r) < 1e30f ? r : 0.0f;  // what is not finite is nothing
    }
    std::fill(padded.begin(), padded.begin() + kReach, c[0]);
    std::fill(padded.end() - kReach, padded.end(), c[w - 1]);
    float* row = across.row(v);
    for (int u = 0; u < w; ++u)
      row[u] = k0 * c[u] + k1 * (c[u - 1] + c[u + 1]) + k2 * (c[u - 2] + c[u + 2]) + k3 * (c[u - 3] + c[u + 3]) +
               k4 * (c[u - 4] + c[u + 4]);
  }
  for (int v = 0; v < h; ++v) {
    std::array<const float*, kReach + 1> above, below;
    for (int i = 0; i <= kReach; ++i) {
      above[i] = across.row(std::max(v - i, 0));
      below[i] = across.row(std::min(v + i, h - 1));
    }
    const auto [a0, a1, a2, a3, a4] = above;
    const auto [b0, b1, b2, b3, b4] = below;
    float* row = out.row(v);
    for (int u = 0; u < w; ++u)
      row[u] = k0 * a0[u] + k1 * (a1[u] + b1[u]) + k2 * (a2[u] + b2[u]) + k3 * (a3[u] + b3[u]) + k4 * (a4[u] + b4[u]);
  }
  return out;
}

// Background and noise of the smoothed contrasts, which no star pulls: a clipped mean of some 30,000 of them.
vision::FrameLevel level_of(const ImageF& smoothed, double threshold_sigma) {
  const std::size_t stride = std::max<std::size_t>(1, smoothed.pixels().size() / 32'768) | 1;
  std::vector<float> samples, deviations;
  for (std::size_t i = 0; i < smoothed.pixels().size(); i += stride) samples.push_back(smoothed.pixels()[i]);
  double middle = static_cast<double>(middle_of(samples));
  for (const float x : samples) deviations.push_back(std::abs(x - static_cast<float>(middle)));
  double sigma = 1.4826 * static_cast<double>(middle_of(deviations));
  for (int pass = 0; pass < 4; ++pass) {
    double n = 0.0, sum = 0.0, sum2 = 0.0;
    for (const float x : samples) {
      const double d = static_cast<double>(x) - middle;
      if (std::abs(d) > 4.0 * sigma) continue;
      n += 1.0;
      sum += d;
      sum2 += d * d;
    }
    if (n < 2.0) break;
    middle += sum / n;
    sigma = std::sqrt(std::max(sum2 / n - sum * sum / (n * n), 0.0));
  }
  sigma = std::max(sigma, 1e-6);
  return {.background_dn = middle, .noise_dn = sigma, .threshold_dn = middle + threshold_sigma * sigma};
}

// One pixel alone, far above its neighbours: no optics does that, not even with half the light in one pixel.
bool lone_pixel(const ImageF& image, const Tiles& tiles, const vision::Centroid& spot) {
  const int u0 = static_cast<int>(std::lround(spot.pixel.u)), v0 = static_cast<int>(std::lround(spot.pixel.v));
  float peak = -1e30f, second = -1e30f, sum = 0.0f;
  for (int v = std::max(0, v0 - 1); v <= std::min(image.height() - 1, v0 + 1); ++v) {
    for (int u = std::max(0, u0 - 1); u <= std::min(image.width() - 1, u0 + 1); ++u) {
      const float x = image(u, v) - tiles.between(tiles.level, u, v);
      sum += x;
      if (x > peak) {
        second = peak;
        peak = x;
      } else if (x > second) {
        second = x;
      }
    }
  }
  return peak > 6.0f * std::max(second, 0.0f) && peak > 0.75f * sum;
}

// Light, peak and contrast each put the stars first in some pictures and something else in others: leaves against a
// bright sky have light but little contrast, clusters of hot pixels contrast but no peak. The best of the three places
// counts.
void order_by_certainty(std::vector<vision::Centroid>& spots, const std::vector<double>& contrasts) {
  const std::size_t n = spots.size();
  std::vector<std::size_t> best(n, n), sum(n, 0), order(n);
  const auto rank = [&](auto&& value) {
    std::iota(order.begin(), order.end(), std::size_t{0});
    std::stable_sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) { return value(a) > value(b); });
    for (std::size_t place = 0; place < n; ++place) {
      best[order[place]] = std::min(best[order[place]], place);
      sum[order[place]] += place;
    }
  };
  rank([&](std::size_t i) { return spots[i].flux_dn; });
  rank([&](std::size_t i) { return spots[i].peak_dn; });
  rank([&](std::size_t i) { return contrasts[i]; });
  std::iota(order.begin(), order.end(), std::size_t{0});
  std::stable_sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) {
    return best[a] != best[b] ? best[a] < best[b] : sum[a] < sum[b];
  });
  std::vector<vision::Centroid> sorted;
  for (const std::size_t i : order) sorted.push_back(spots[i]);
  spots = std::move(sorted);
}

}  // namespace

void turn_round(std::span<vision::Centroid> spots, int width_px) {
  for (vision::Centroid& spot : spots) spot.pixel.u = width_px - 1 - spot.pixel.u;
}

Spots find_spots(const Picture& picture, const SpotSettings& settings) {
  Spots out;
  const ImageF& image = picture.pixels;
  const int w = image.width(), h = image.height();
  if (w < 16 || h < 16) return out;
  const float step = grey_step(picture);
  const Tiles tiles = measure(image, settings.tile_px, step);
  std::vector<float> levels = tiles.level, spreads = tiles.spread;
  out.background_dn = middle_of(levels);
  out.noise_dn = std::max(middle_of(spreads), 1e-6f);
  // Pictures of 8 bits, and all after JPEG, have flat parts whose noise is no measure of anything; whole numbers have
  // at least the noise of their rounding.
  const float least = static_cast<float>(
      std::max(0.5 * out.noise_dn, picture.bits <= 8 ? 0.4 : std::max(0.29 * static_cast<double>(step), 1e-6)));

  const ImageF smoothed = smoothed_contrast(image, tiles, least, settings.smoothing_sigma_px);

  vision::CentroidSettings finding;
  finding.method = vision::CentroidMethod::squared_intensity;
  finding.threshold_sigma = settings.threshold_sigma;
  finding.min_region_px = 3;
  finding.max_region_px = std::max(300, w * h / 1000);
  // Hot pixels are told from stars afterwards.
  const std::size_t most = 4 * settings.max_spots;
  finding.max_centroids = static_cast<int>(most);
  finding.refuse_sharp = false;
  vision::SensorModel sensor;
  sensor.gain_e_dn = 1e9;  // no shot noise in a picture of contrasts
  sensor.photo_nonuniformity = 0.02;
  sensor.saturation_dn = 1e30;
  sensor.psf_sigma_px = 1.6;
  vision::CentroidFinder finder(finding, sensor, w, h);
  std::vector<vision::Centroid> found(most);
  const vision::FrameLevel level = level_of(smoothed, settings.threshold_sigma);
  const std::size_t count = finder.find_above(smoothed, level, found);
  found.resize(count);
  out.threshold_dn = (level.threshold_dn - level.background_dn) * out.noise_dn;

  const double full = 0.98 * picture.white_level;
  std::vector<double> contrasts;
  for (vision::Centroid& spot : found) {
    if (lone_pixel(image, tiles, spot)) continue;
    // Light within 4 px, in the picture's own units.
    const int u0 = static_cast<int>(std::lround(spot.pixel.u)), v0 = static_cast<int>(std::lround(spot.pixel.v));
    double flux = 0.0, peak = 0.0;
    bool saturated = false;
    for (int v = std::max(0, v0 - 4); v <= std::min(h - 1, v0 + 4); ++v) {
      for (int u = std::max(0, u0 - 4); u <= std::min(w - 1, u0 + 4); ++u) {
        if ((u - u0) * (u - u0) + (v - v0) * (v - v0) > 16) continue;
        const double x = image(u, v);
        if (!std::isfinite(x)) continue;
        const double above = x - static_cast<double>(tiles.between(tiles.level, u, v));
        flux += above;
        peak = std::max(peak, above);
        saturated |= x >= full;
      }
    }
    contrasts.push_back(spot.peak_dn);
    spot.flux_dn = std::max(flux, 1e-3);
    spot.peak_dn = peak;
    spot.saturated = saturated;
    out.spots.push_back(spot);
  }
  order_by_certainty(out.spots, contrasts);
  if (out.spots.size() > settings.max_spots) out.spots.resize(settings.max_spots);
  return out;
}

}  // namespace astronav::opensky
