// SPDX-License-Identifier: Apache-2.0
#include "simulator/render/disc.h"

#include <algorithm>
#include <cmath>

#include "simulator/sky/sky.h"

namespace astronav::render {
namespace {

// Where the cosines of the Sun's and the observer's height are these (eq. 10).
double brightness(double sun, double observer, double minnaert) {
  if (!(sun > 0.0)) return 0.0;
  return minnaert == 1.0 ? sun : std::pow(sun, minnaert) * std::pow(observer, minnaert - 1.0);
}

// Light of a cell, x and y in radii about its middle: the mean of the brightness over fine x fine points.
double light_of(const Globe& globe, double x, double y, double size, int fine) {
  const double towards = std::sin(globe.phase_angle_rad);
  const double outwards = std::cos(globe.phase_angle_rad);
  double light = 0.0;
  for (int k = 0; k < fine * fine; ++k) {
    const double at_x = x + size * ((k % fine + 0.5) / fine - 0.5);
    const double at_y = y + size * ((k / fine + 0.5) / fine - 0.5);
    const double z2 = 1.0 - at_x * at_x - at_y * at_y;
    if (z2 <= 0.0) continue;
    const double sunward = at_x * globe.sunward.x() + at_y * globe.sunward.y();
    const double z = std::sqrt(z2);
    light += brightness(towards * sunward + outwards * z, z, globe.minnaert);
  }
  return light / (fine * fine);
}

void sample(const Globe& globe, int fine, LitDisc& disc) {
  disc.light.resize(static_cast<std::size_t>(disc.columns) * static_cast<std::size_t>(disc.rows));
  const double size = disc.step_px / globe.radius_px;
  float* out = disc.light.data();
  for (int j = 0; j < disc.rows; ++j) {
    for (int i = 0; i < disc.columns; ++i) {
      *out++ = static_cast<float>(
          light_of(globe, disc.u_px(i) / globe.radius_px, disc.v_px(j) / globe.radius_px, size, fine));
    }
  }
}

}  // namespace

LitDisc lit_disc(const Globe& globe, int cells) {
  constexpr int kFine = 4;
  LitDisc disc;
  disc.columns = disc.rows = cells;
  disc.step_px = 2.0 * globe.radius_px / cells;
  disc.left_px = disc.top_px = -globe.radius_px + 0.5 * disc.step_px;
  sample(globe, kFine, disc);
  double sum = 0.0;
  Vec2 moment = Vec2::Zero();
  const float* light = disc.light.data();
  for (int j = 0; j < disc.rows; ++j) {
    for (int i = 0; i < disc.columns; ++i, ++light) {
      sum += static_cast<double>(*light);
      moment += static_cast<double>(*light) * Vec2(disc.u_px(i), disc.v_px(j));
    }
  }
  if (!(sum > 0.0)) return {};
  for (float& each : disc.light) each = static_cast<float>(static_cast<double>(each) / sum);
  disc.photocentre_px = moment / sum;
  return disc;
}

LitDisc lit_disc_part(const Globe& globe, const Part& part) {
  constexpr int kFine = 2;
  LitDisc disc;
  const double a = globe.phase_angle_rad;
  disc.photocentre_px = sky::lambert_photocentre_shift(globe.radius_px, a) * globe.sunward;
  const double left = std::max(part.left, -globe.radius_px), right = std::min(part.right, globe.radius_px);
  const double top = std::max(part.top, -globe.radius_px), bottom = std::min(part.bottom, globe.radius_px);
  // The integral of the cosine of the Sun's height over the disc, in radii.
  const double all = 2.0 / 3.0 * (std::sin(a) + (kPi - a) * std::cos(a));
  if (!(left < right && top < bottom && all > 1e-12)) return disc;
  disc.columns = static_cast<int>(std::ceil(right - left));
  disc.rows = static_cast<int>(std::ceil(bottom - top));
  disc.step_px = 1.0;
  disc.left_px = left + 0.5;
  disc.top_px = top + 0.5;
  sample(globe, kFine, disc);
  const double cell = 1.0 / globe.radius_px;
  for (float& each : disc.light) each = static_cast<float>(static_cast<double>(each) * cell * cell / all);
  return disc;
}

}  // namespace astronav::render
