// SPDX-License-Identifier: Apache-2.0
#include "simulator/render/detector_pattern.h"

#include <algorithm>
#include <cmath>
#include <set>

#include "foundation/math/random.h"

namespace astronav::render {
namespace {

ImageF normal_map(int width, int height, double sigma, const StreamId& id) {
  ImageF map(width, height);
  RandomStream random(id);
  // A pixel never loses more than all of its signal.
  for (float& x : map.pixels()) x = static_cast<float>(std::max(-1.0, sigma * random.normal()));
  return map;
}

ImageF vignetting_map(const Camera& camera) {
  if (!has_vignetting(camera)) return {};
  // Smooth: on a grid, and linear between.
  constexpr int kStep = 8;
  const int width = camera.intrinsics.width_px;
  const int height = camera.intrinsics.height_px;
  const int columns = (width - 1) / kStep + 2;
  const int rows = (height - 1) / kStep + 2;
  ImageF grid(columns, rows);
  for (int j = 0; j < rows; ++j) {
    for (int i = 0; i < columns; ++i) {
      const Pixel at{static_cast<double>(i * kStep), static_cast<double>(j * kStep)};
      const Result<Vec3> direction_C = unproject(camera.intrinsics, at);
      grid(i, j) = direction_C ? static_cast<float>(vignetting(camera, at, *direction_C)) : 0.0f;
    }
  }
  ImageF map(width, height);
  for (int v = 0; v < height; ++v) {
    const float y = static_cast<float>(v % kStep) / kStep;
    for (int u = 0; u < width; ++u) {
      const float x = static_cast<float>(u % kStep) / kStep;
      const int i = u / kStep;
      const int j = v / kStep;
      map(u, v) = (1.0f - y) * ((1.0f - x) * grid(i, j) + x * grid(i + 1, j)) +
                  y * ((1.0f - x) * grid(i, j + 1) + x * grid(i + 1, j + 1));
    }
  }
  return map;
}

std::vector<HotPixel> hot_pixels(const Camera& camera, std::uint64_t seed) {
  const Detector& d = camera.detector;
  std::vector<HotPixel> hot;
  if (!(d.hot_pixel_share > 0.0 && d.hot_pixel_e_s > 0.0)) return hot;
  RandomStream random({.seed = seed, .purpose = "hot pixels of the detector"});
  const auto count = static_cast<std::uint64_t>(camera.intrinsics.width_px) * camera.intrinsics.height_px;
  std::uint64_t wanted = std::min(count, random.poisson(d.hot_pixel_share * static_cast<double>(count)));
  std::set<std::uint64_t> taken;
  while (taken.size() < wanted) taken.insert(random.next() % count);
  for (const std::uint64_t index : taken) {
    hot.push_back(
        {static_cast<std::uint32_t>(index), static_cast<float>(-d.hot_pixel_e_s * std::log(1.0 - random.uniform()))});
  }
  return hot;
}

}  // namespace

bool has_vignetting(const Camera& camera) {
  return camera.optics.vignetting_cos_power != 0.0 || camera.optics.vignetting_corner_loss != 0.0;
}

double vignetting(const Camera& camera, Pixel at, const Vec3& direction_C) {
  const Intrinsics& k = camera.intrinsics;
  const double du = at.u - k.cx_px;
  const double dv = at.v - k.cy_px;
  const double half_diagonal2 =
      0.25 * (static_cast<double>(k.width_px) * k.width_px + static_cast<double>(k.height_px) * k.height_px);
  const double lost = camera.optics.vignetting_corner_loss * (du * du + dv * dv) / half_diagonal2;
  const double cosine = std::max(0.0, direction_C.normalized().z());
  return std::max(0.0, 1.0 - lost) * std::pow(cosine, camera.optics.vignetting_cos_power);
}

DetectorPattern::DetectorPattern(const Camera& camera, std::uint64_t seed)
    : prnu(normal_map(camera.intrinsics.width_px, camera.intrinsics.height_px, camera.detector.photo_nonuniformity,
                      {.seed = seed, .purpose = "photo response of the detector"})),
      dsnu(normal_map(camera.intrinsics.width_px, camera.intrinsics.height_px, camera.detector.dark_nonuniformity,
                      {.seed = seed, .purpose = "dark signal of the detector"})),
      vignetting(vignetting_map(camera)),
      hot(hot_pixels(camera, seed)) {}

}  // namespace astronav::render
