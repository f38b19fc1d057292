// SPDX-License-Identifier: Apache-2.0
#include "verification/opensky/spots.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>

#include "onboard/vision/centroids.h"

namespace astronav::opensky {
namespace {

struct Tiles {
  int width = 0, height = 0, size = 32;
  std::vector<float> level, spread;  // clipped mean and standard deviation
  float at(const std::vector<float>& values, int x, int y) const {
    return values[static_cast<std::size_t>(std::clamp(y, 0, height - 1)) * width + std::clamp(x, 0, width - 1)];
  }
  // Bilinear between the tiles' centres.
  float between(const std::vector<float>& values, int u, int v) const {
    const float x = (static_cast<float>(u) + 0.5f) / static_cast<float>(size) - 0.5f;
    const float y = (static_cast<float>(v) + 0.5f) / static_cast<float>(size) - 0.5f;
    const int i = static_cast<int>(std::floor(x)), j = static_cast<int>(std::floor(y));
    const float a = x - static_cast<float>(i), b = y - static_cast<float>(j);
    return (at(values, i, j) * (1 - a) + at(values, i + 1, j) * a) * (1 - b) +
           (at(values, i, j + 1) * (1 - a) + at(values, i + 1, j + 1) * a) * b;
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
      for (int j = std::max(0, y - 1); j <= std::min(tiles.height - 1, y + 1); ++j)
        for (int i = std::max(0, x - 1); i <= std::min(tiles.width - 1, x + 1); ++i)
          near.push_back(values[static_cast<std::size_t>(j) * tiles.width + i]);
      out[static_cast<std::size_t>(y) * tiles.width + x] = middle_of(near);
    }
  }
  return out;
}

// `step`: between grey levels.
Tiles measure(const ImageF& image, int size, float step) {
  Tiles tiles;
  tiles.size = size;
  tiles.width = (image.width() + size - 1) / size;
  tiles.height = (image.height() + size - 1) / size;
  std::vector<float> values, deviations;
  for (int y = 0; y < tiles.height; ++y) {
    for (int x = 0; x < tiles.width; ++x) {
      values.clear();
      for (int v = y * size; v < std::min((y + 1) * size, image.height()); ++v)
        for (int u = x * size; u < std::min((x + 1) * size, image.width()); ++u)
          if (std::isfinite(image(u, v))) values.push_back(image(u, v));
      const float median = middle_of(values);
      deviations.clear();
      for (const float value : values) deviations.push_back(std::abs(value - median));
      const float limit = std::max(4.0f * 1.4826f * middle_of(deviations), 2.0f * step);
      // In a picture of few grey levels the median jumps from level to level: the clipped mean does not.
      double n = 0.0, sum = 0.0, sum2 = 0.0;
      for (const float value : values) {
        const double d = value - median;
        if (std::abs(d) > limit) continue;
        n += 1.0;
        sum += d;
        sum2 += d * d;
      }
      tiles.level.push_back(n > 0.0 ? median + static_cast<float>(sum / n) : median);
      tiles.spread.push_back(n > 0.0 ? static_cast<float>(std::sqrt(std::max(sum2 / n - sum * sum / (n * n), 0.0)))
                                     : 0.0f);
    }
  }
  tiles.level = median3(tiles, tiles.level);
  tiles.spread = median3(tiles, tiles.spread);
  return tiles;
}

ImageF smooth(const ImageF& image, double sigma) {
  const int reach = static_cast<int>(std::ceil(3.0 * sigma));
  std::vector<float> kernel;
  float sum = 0.0f;
  for (int i = -reach; i <= reach; ++i) {
    kernel.push_back(static_cast<float>(std::exp(-0.5 * i * i / (sigma * sigma))));
    sum += kernel.back();
  }
  for (float& k : kernel) k /= sum;
  const int w = image.width(), h = image.height();
  ImageF across(w, h), out(w, h);
  for (int v = 0; v < h; ++v) {
    for (int u = 0; u < w; ++u) {
      float s = 0.0f;
      for (int i = -reach; i <= reach; ++i) s += kernel[i + reach] * image(std::clamp(u + i, 0, w - 1), v);
      across(u, v) = s;
    }
  }
  for (int v = 0; v < h; ++v) {
    float* row = out.row(v);
    std::fill(row, row + w, 0.0f);
    for (int i = -reach; i <= reach; ++i) {
      const float* from = across.row(std::clamp(v + i, 0, h - 1));
      for (int u = 0; u < w; ++u) row[u] += kernel[i + reach] * from[u];
    }
  }
  return out;
}

// One pixel alone, far above its neighbours: no optics does that, not even with half the light in one pixel.
bool lone_pixel(const ImageF& residual, const vision::Centroid& spot) {
  const int u0 = static_cast<int>(std::lround(spot.pixel.u)), v0 = static_cast<int>(std::lround(spot.pixel.v));
  float peak = -1e30f, second = -1e30f, sum = 0.0f;
  for (int v = std::max(0, v0 - 1); v <= std::min(residual.height() - 1, v0 + 1); ++v) {
    for (int u = std::max(0, u0 - 1); u <= std::min(residual.width() - 1, u0 + 1); ++u) {
      const float x = residual(u, v);
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

Spots find_spots(const Picture& picture, const SpotSettings& settings) {
  Spots out;
  const ImageF& image = picture.pixels;
  const int w = image.width(), h = image.height();
  if (w < 16 || h < 16) return out;
  const Tiles tiles = measure(image, settings.tile_px, picture.bits <= 16 ? 1.0f : 0.0f);
  std::vector<float> levels = tiles.level, spreads = tiles.spread;
  out.background_dn = middle_of(levels);
  out.noise_dn = std::max(middle_of(spreads), 1e-6f);
  // Pictures of 8 bits, and all after JPEG, have flat parts whose noise is no measure of anything; whole numbers have
  // at least the noise of their rounding.
  const float least = static_cast<float>(std::max(0.5 * out.noise_dn, picture.bits <= 8    ? 0.4
                                                                      : picture.bits <= 16 ? 0.29
                                                                                           : 1e-6));

  ImageF residual(w, h), contrast(w, h);
  for (int v = 0; v < h; ++v) {
    for (int u = 0; u < w; ++u) {
      const float x = image(u, v);
      const float r = std::isfinite(x) ? x - tiles.between(tiles.level, u, v) : 0.0f;
      residual(u, v) = r;
      contrast(u, v) = r / std::max(tiles.between(tiles.spread, u, v), least);
    }
  }
  const ImageF smoothed = smooth(contrast, settings.smoothing_sigma_px);

  vision::CentroidSettings finding;
  finding.method = vision::CentroidMethod::squared_intensity;
  finding.threshold_sigma = settings.threshold_sigma;
  finding.min_region_px = 3;
  finding.max_region_px = std::max(300, w * h / 1000);
  finding.max_centroids = static_cast<int>(settings.max_spots);
  finding.refuse_sharp = false;
  vision::SensorModel sensor;
  sensor.gain_e_dn = 1e9;  // no shot noise in a picture of contrasts
  sensor.photo_nonuniformity = 0.02;
  sensor.saturation_dn = 1e30;
  sensor.psf_sigma_px = 1.6;
  vision::CentroidFinder finder(finding, sensor, w, h);
  std::vector<vision::Centroid> found(settings.max_spots);
  vision::FrameLevel level;
  const std::size_t count = finder.find(smoothed, found, &level);
  found.resize(count);
  out.threshold_dn = (level.threshold_dn - level.background_dn) * out.noise_dn;

  const double full = 0.98 * picture.white_level;
  std::vector<double> contrasts;
  for (vision::Centroid& spot : found) {
    if (lone_pixel(residual, spot)) continue;
    // Light within 4 px, in the picture's own units.
    const int u0 = static_cast<int>(std::lround(spot.pixel.u)), v0 = static_cast<int>(std::lround(spot.pixel.v));
    double flux = 0.0, peak = 0.0;
    bool saturated = false;
    for (int v = std::max(0, v0 - 4); v <= std::min(h - 1, v0 + 4); ++v) {
      for (int u = std::max(0, u0 - 4); u <= std::min(w - 1, u0 + 4); ++u) {
        if ((u - u0) * (u - u0) + (v - v0) * (v - v0) > 16) continue;
        flux += residual(u, v);
        peak = std::max(peak, static_cast<double>(residual(u, v)));
        saturated |= image(u, v) >= full;
      }
    }
    contrasts.push_back(spot.peak_dn);
    spot.flux_dn = std::max(flux, 1e-3);
    spot.peak_dn = peak;
    spot.saturated = saturated;
    out.spots.push_back(spot);
  }
  order_by_certainty(out.spots, contrasts);
  return out;
}

}  // namespace astronav::opensky
