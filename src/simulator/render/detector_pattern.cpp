// SPDX-License-Identifier: Apache-2.0
#include "simulator/render/detector_pattern.h"

#include <algorithm>
#include <cmath>
#include <set>

#include "foundation/math/random.h"
#include "simulator/render/coarse_map.h"

namespace astronav::render {
namespace {

ImageF normal_map(int width, int height, double sigma, const StreamId& id) {
  ImageF map(width, height);
  if (sigma == 0.0) return map;
  RandomStream random(id);
  // A pixel never loses more than all of its signal.
  for (float& x : map.pixels()) x = static_cast<float>(std::max(-1.0, sigma * random.normal()));
  return map;
}

ImageF vignetting_map(const Camera& camera) {
  if (!has_vignetting(camera)) return {};
  const CoarseMap<8> smooth(camera.intrinsics, [&](Pixel at) {
    const Result<Vec3> direction_C = unproject(camera.intrinsics, at);
    return direction_C ? vignetting(camera, at, *direction_C) : 0.0;
  });
  ImageF map(camera.intrinsics.width_px, camera.intrinsics.height_px);
  for (int v = 0; v < map.height(); ++v) {
    for (int u = 0; u < map.width(); ++u) map(u, v) = smooth(u, v);
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
  const double corner = k.half_diagonal_px();
  const double lost = camera.optics.vignetting_corner_loss * (du * du + dv * dv) / (corner * corner);
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
