// SPDX-License-Identifier: Apache-2.0
#include "simulator/render/protons.h"

#include <algorithm>
#include <cmath>

#include "simulator/render/renderer.h"

namespace astronav::render {
namespace {

constexpr double kStepPx = 0.05;
constexpr double kFlattest = 1e-3;  // cosine to the normal: a track no longer than a thousand times the depth
constexpr double kLossWidth = 0.1;  // of Moyal's law over its most probable value, as for thin silicon

double protons_expected(const Camera& camera, double exposure_s) {
  const Detector& d = camera.detector;
  const double area_cm2 =
      camera.intrinsics.width_px * camera.intrinsics.height_px * d.pixel_pitch_m * d.pixel_pitch_m * 1e4;
  return d.cosmic_rays_cm2_s * area_cm2 * exposure_s;
}

double depth_px(const Detector& d) {
  return d.depth_um * 1e-6 / d.pixel_pitch_m;
}

}  // namespace

double proton_work(const Camera& camera, double exposure_s) {
  // Each proton takes some twenty additions' time, each step two; a track is pi/2 of the depth long on average (a flux
  // through a plane).
  const double length_px = 0.5 * kPi * depth_px(camera.detector);
  return protons_expected(camera, exposure_s) * (20.0 + 2.0 * length_px / kStepPx);
}

std::vector<ProtonPixel> proton_hits(const Camera& camera, double exposure_s, RandomStream& random) {
  const Detector& d = camera.detector;
  const int width = camera.intrinsics.width_px;
  const int height = camera.intrinsics.height_px;
  const std::uint64_t count = random.poisson(protons_expected(camera, exposure_s));
  const double electrons_px = d.cosmic_ray_e_um * d.pixel_pitch_m * 1e6;  // per pixel's length of track
  std::vector<ProtonPixel> hits;
  for (std::uint64_t i = 0; i < count; ++i) {
    const double u = random.uniform(-0.5, width - 0.5);
    const double v = random.uniform(-0.5, height - 0.5);
    // Through a plane, an isotropic flux comes with a density proportional to the cosine.
    const double cosine = std::max(kFlattest, std::sqrt(1.0 - random.uniform()));
    const double around = random.uniform(0.0, 2.0 * kPi);
    // Moyal's law of what thin matter takes from a fast particle; its most probable value is 1.
    const double normal = random.normal();
    const double loss = std::max(0.3, 1.0 - kLossWidth * std::log(std::max(1e-12, normal * normal)));
    const double length = depth_px(d) / cosine;
    const double across = length * std::sqrt(1.0 - cosine * cosine);
    const int steps = 1 + static_cast<int>(across / kStepPx);
    for (int k = 0; k < steps; ++k) {
      const double along = across * (k + 0.5) / steps;
      const int at_u = static_cast<int>(std::floor(u + along * std::cos(around) + 0.5));
      const int at_v = static_cast<int>(std::floor(v + along * std::sin(around) + 0.5));
      if (at_u < 0 || at_u >= width || at_v < 0 || at_v >= height) break;
      const double electrons = loss * electrons_px * length / steps;
      if (!hits.empty() && k > 0 && hits.back().u == at_u && hits.back().v == at_v) {
        hits.back().electrons += electrons;
      } else {
        hits.push_back({at_u, at_v, electrons});
      }
    }
  }
  return hits;
}

}  // namespace astronav::render
