// SPDX-License-Identifier: Apache-2.0
// From the sky to the detector: where sources fall, and how they move during the exposure.
#include <cmath>
#include <optional>

#include "simulator/render/detector_pattern.h"
#include "simulator/render/renderer.h"

namespace astronav::render {
namespace {

struct Placement {
  const Camera& camera;
  const Exposure& exposure;
  Mat3 R_CN;
  bool turning;
  bool rolling;

  // Where a direction is seen `t` seconds after the middle of the frame's exposure.
  std::optional<Pixel> at(const Vec3& direction_C, double t) const {
    const Result<Pixel> pixel =
        project(camera.intrinsics,
                turning && t != 0.0 ? Vec3(rotation_exp(-exposure.rate_C_rad_s * t) * direction_C) : direction_C);
    if (!pixel) return {};
    return *pixel;
  }

  // The middle of the exposure of the row on which the direction falls then. A few steps suffice: a source crosses far
  // less than a row while a row is read.
  double row_time(const Vec3& direction_C, Pixel pixel) const {
    if (!turning || !rolling) return 0.0;
    double t = 0.0;
    for (int i = 0; i < 8; ++i) {
      const double next = (pixel.v - 0.5 * (camera.intrinsics.height_px - 1)) * camera.detector.rolling_row_us * 1e-6;
      if (std::abs(next - t) < 1e-12) break;
      t = next;
      const std::optional<Pixel> there = at(direction_C, t);
      if (!there) break;
      pixel = *there;
    }
    return t;
  }
};

}  // namespace

std::vector<RenderedSource> place_sources(std::span<const sky::SkySource> sky, const Camera& camera, const Mat3& R_CN,
                                          const Exposure& exposure, double margin_px, const Effects& effects) {
  const Placement place{camera, exposure, R_CN, effects.motion && exposure.rate_C_rad_s.norm() > 0.0,
                        camera.detector.shutter == Shutter::rolling && camera.detector.rolling_row_us > 0.0};
  const bool vignetted = effects.vignetting && has_vignetting(camera);
  std::vector<RenderedSource> placed;
  placed.reserve(sky.size());
  const double u_max = camera.intrinsics.width_px - 0.5;
  const double v_max = camera.intrinsics.height_px - 0.5;
  for (const sky::SkySource& source : sky) {
    const Vec3 direction_C = R_CN * source.direction_N;
    const std::optional<Pixel> pixel = place.at(direction_C, 0.0);
    if (!pixel) continue;
    RenderedSource one{.source = source, .pixel = *pixel};
    if (place.turning) {
      const double middle = place.row_time(direction_C, *pixel);
      const auto begin = place.at(direction_C, middle - 0.5 * exposure.duration_s);
      const auto centre = place.at(direction_C, middle);
      const auto end = place.at(direction_C, middle + 0.5 * exposure.duration_s);
      if (!begin || !centre || !end) continue;
      one.pixel = *centre;
      one.smear_px = end->vec() - begin->vec();
      one.bend_px = 0.5 * (end->vec() + begin->vec()) - centre->vec();
    }
    if (source.angular_radius_rad > 0.0) {
      const std::optional<Pixel> edge =
          place.at(direction_C + source.angular_radius_rad * (R_CN * source.sunward_N), 0.0);
      if (edge) {
        const Vec2 arm = edge->vec() - pixel->vec();
        one.radius_px = arm.norm();
        if (one.radius_px > 0.0) one.sunward_px = arm / one.radius_px;
      }
    }
    const double margin = margin_px + one.radius_px + 0.5 * one.smear_px.norm();
    if (one.pixel.u < -0.5 - margin || one.pixel.u > u_max + margin || one.pixel.v < -0.5 - margin ||
        one.pixel.v > v_max + margin) {
      continue;
    }
    one.electrons = source.flux.electrons_per_s * exposure.duration_s;
    if (vignetted) one.electrons *= vignetting(camera, one.pixel, direction_C);
    placed.push_back(one);
  }
  return placed;
}

std::vector<RenderedSource> place_sources(std::span<const sky::SkySource> sky, const Camera& camera, const Mat3& R_CN,
                                          double exposure_s, double margin_px) {
  return place_sources(sky, camera, R_CN, Exposure{.duration_s = exposure_s}, margin_px);
}

}  // namespace astronav::render
