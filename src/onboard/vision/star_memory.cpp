// SPDX-License-Identifier: Apache-2.0
#include "onboard/vision/star_memory.h"

#include <algorithm>
#include <cmath>

#include <Eigen/LU>

#include "foundation/math/rotation.h"

namespace astronav::vision {
namespace {

// Companions pull the spots of their stars by so much: together what AttitudeOptions expects of a star of which nothing
// is known.
constexpr double kUnknown2 = AttitudeOptions{}.extra_sigma_px * AttitudeOptions{}.extra_sigma_px;
// Pixels that differ, the lens, and the attitudes found so far leave this of the others, however long one looks.
constexpr double kLeast2 = 0.0009 * 0.0009;
constexpr double kPulled2 = (kUnknown2 - kLeast2) / StarMemory::kDoubleShare;

}  // namespace

double StarMemory::expected_px2(double weight, double off2_px2) {
  if (!(weight > 0.0)) return kUnknown2;
  const double single2 = kLeast2 + 1.0 / weight, double2 = kPulled2 + 1.0 / weight;
  const double odds = kDoubleShare / (1.0 - kDoubleShare) * single2 / double2 *
                      std::exp(std::min(0.5 * off2_px2 * (1.0 / single2 - 1.0 / double2), 100.0));
  const double gain = kPulled2 / double2;
  const double pulled2 = 0.5 * gain * gain * off2_px2 + (1.0 - gain) * kPulled2;
  return kLeast2 + odds / (1.0 + odds) * pulled2;
}

double StarMemory::expected_px2(std::uint32_t star) const {
  const Seen& seen = seen_[star];
  return expected_px2(seen.weight, seen.east_px * seen.east_px + seen.north_px * seen.north_px);
}

double StarMemory::lasting_px2(std::uint32_t star, double weight) const {
  constexpr double kImages = 18.0;  // half a window
  const Seen& seen = seen_[star];
  const double known = seen.weight, more = kImages * weight;
  // As if they said the same as those before, give or take their noise.
  const double off2 = seen.east_px * seen.east_px + seen.north_px * seen.north_px;
  const double off2_then = (known * off2 + more * 2.0 / (known + more)) / (known + more);
  const double now = expected_px2(known, off2), then = std::min(now, expected_px2(known + more, off2_then));
  // While point-spread function and camera are being learned too, a double is not told from the rest so soon.
  constexpr double kYoung = 500.0;  // sights of stars: a third of a window
  const double unseen = more / (known + more), young = kYoung / (kYoung + sights_);
  return then + young * unseen * (now - then);
}

void StarMemory::learn(std::uint32_t star, const StarSight& sight, const Mat3& R_CN, const Intrinsics& camera) {
  Mat23 by_direction;
  if (!sight.used || !project(camera, R_CN * sight.direction_N, &by_direction)) return;
  const EastNorth axes = east_north(sight.direction_N);
  const double scale = camera.plate_scale_rad_px();
  Mat2 by_axes;  // px a px on the sky
  by_axes << by_direction * (R_CN * axes.east) * scale, by_direction * (R_CN * axes.north) * scale;
  const Vec2 off = by_axes.inverse() * sight.residual_px;
  const double weight = 2.0 / sight.covariance_px2.trace();
  if (!off.allFinite() || !std::isfinite(weight)) return;
  sights_ += 1.0;
  Seen& seen = seen_[star];
  // It forgets what it saw long ago: no mean becomes surer than the least.
  const double before = std::min<double>(seen.weight, 1.0 / kLeast2);
  const double share = weight / (before + weight);
  seen.east_px += static_cast<float>(share * (off.x() - seen.east_px));
  seen.north_px += static_cast<float>(share * (off.y() - seen.north_px));
  seen.weight = static_cast<float>(before + weight);
}

}  // namespace astronav::vision
