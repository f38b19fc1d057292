// SPDX-License-Identifier: Apache-2.0
#include "onboard/vision/spot_shape.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>

namespace astronav::vision {
namespace {

// Just below the threshold of detection: with fainter pixels the noise of a long streak's box would count as light.
constexpr double kLight = 4.0;  // of the noise
// Longer than wide by this factor (in variance) is no star: at that length (3.2 px for a core of 0.8) two stars show a
// gap between them, and a line of light does not.
constexpr double kElongated = 4.5;
constexpr double kGap = 0.5;
// Wider than the point-spread function by 1.6, in every direction.
constexpr double kExtended = 1.6 * 1.6;
// A track narrower than the point-spread function, where that can be seen.
constexpr double kThin = 0.35;
constexpr double kThinSeen = 30.0;  // peak over noise: then the pixel beside it stands out by 7 even at a width of 0.5
constexpr int kColumnWidth = 2, kColumnHeight = 8;

// Share of the light of the 3x3 pixels around it that a centred star leaves in its brightest pixel.
double central_share(double sigma) {
  const double one = 2.0 * kNormal(0.5 / sigma).cumulative - 1.0;
  const double three = 2.0 * kNormal(1.5 / sigma).cumulative - 1.0;
  return one * one / (three * three);
}

}  // namespace

template <typename T>
Moments moments_of(ImageView<const T> image, const Region& region, const LocalLevel& level, const SensorModel& sensor) {
  Moments m;
  const Window w = grown(region.box, 1, image.width(), image.height());
  const double cu = 0.5 * (w.u0 + w.u1), cv = 0.5 * (w.v0 + w.v1);
  const double least = kLight * level.noise_dn;
  using Lanes = std::array<double, kLanes>;
  alignas(64) Lanes flux{}, of_x{}, of_y{}, of_xx{}, of_xy{}, of_yy{}, noise4{}, brightest{};
  alignas(64) std::array<std::int64_t, kLanes> peak{};  // row * 2^16 + column
  const double noise2 = level.noise_dn * level.noise_dn, shot = 1.0 / sensor.gain_e_dn;
  const double prnu2 = sensor.photo_nonuniformity * sensor.photo_nonuniformity;
  for (int v = w.v0; v <= w.v1; ++v) {
    const double first = level.plane(w.u0, v), y = v - cv;
    for (int u = w.u0; u <= w.u1; u += kLanes) {
      auto light = lanes_of(image.row(v) + u, image.width() - u);
      if (level.columns_dn != nullptr)
        for (int l = 0; u + l <= w.u1 && l < kLanes; ++l) light[static_cast<std::size_t>(l)] -= level.column(u + l);
      for (std::size_t l = 0; l < kLanes; ++l) {
        const int at = u + static_cast<int>(l);
        const double above = light[l] - (first + level.slope_u_dn * (at - w.u0));
        const double one = above > least && at <= w.u1 ? 1.0 : 0.0;
        const double d = one * above, x = at - cu, r2 = x * x + y * y;
        flux[l] += d;
        of_x[l] += d * x;
        of_y[l] += d * y;
        of_xx[l] += d * x * x;
        of_xy[l] += d * x * y;
        of_yy[l] += d * y * y;
        noise4[l] += one * (noise2 + d * (shot + prnu2 * d)) * r2 * r2;
        peak[l] = d > brightest[l] ? (std::int64_t{v} << 16) + at : peak[l];
        brightest[l] = std::max(brightest[l], d);
      }
    }
  }
  const auto total = [](const Lanes& lanes) {
    double sum = 0.0;
    for (const double lane : lanes) sum += lane;
    return sum;
  };
  m.flux = total(flux);
  if (!(m.flux > 0.0)) return m;
  m.centre = Vec2(total(of_x), total(of_y)) / m.flux;
  m.second << total(of_xx), total(of_xy), total(of_xy), total(of_yy);
  m.second = m.second / m.flux - m.centre * m.centre.transpose();
  m.second_sigma = std::sqrt(total(noise4)) / m.flux;
  m.centre += Vec2(cu, cv);
  const auto top = static_cast<std::size_t>(std::max_element(brightest.begin(), brightest.end()) - brightest.begin());
  const double most = brightest[top];
  const int peak_u = static_cast<int>(peak[top] & 0xffff), peak_v = static_cast<int>(peak[top] >> 16);
  const auto near = [&](int u, int v) { return static_cast<double>(image(u, v)) - level.under(u, v); };
  m.middle = near(static_cast<int>(std::lround(m.centre.x())), static_cast<int>(std::lround(m.centre.y()))) / most;
  double sum = 0.0;
  const Window about = grown({peak_u, peak_v, peak_u, peak_v}, 1, image.width(), image.height());
  for (int v = about.v0; v <= about.v1; ++v) {
    for (int u = about.u0; u <= about.u1; ++u) sum += near(u, v);
  }
  sum = std::max(sum, most);
  m.sharpest = most / sum;
  m.sharpest_sigma = std::hypot(3.0 * level.noise_dn * m.sharpest,
                                std::sqrt(sensor.pixel_variance_dn2(most, level.noise_dn)) * (1.0 - m.sharpest)) /
                     sum;
  m.peak = {static_cast<double>(peak_u), static_cast<double>(peak_v)};
  m.peak_over_noise = most / level.noise_dn;
  return m;
}

template Moments moments_of<std::uint8_t>(ImageView<const std::uint8_t>, const Region&, const LocalLevel&,
                                          const SensorModel&);
template Moments moments_of<std::uint16_t>(ImageView<const std::uint16_t>, const Region&, const LocalLevel&,
                                           const SensorModel&);
template Moments moments_of<float>(ImageView<const float>, const Region&, const LocalLevel&, const SensorModel&);

double spot_variance_px2(const LocalPsf& psf) {
  const double width = psf.sigma_px(), halo = psf.value[LocalPsf::halo_width];
  constexpr double kOuterMore = LocalPsf::kOuterWidth * LocalPsf::kOuterWidth - 1.0;
  const double of_halo = halo * halo * (1.0 + kOuterMore * psf.value[LocalPsf::outer_share]);
  return width * width + 1.0 / 12.0 + psf.value[LocalPsf::halo_share] * of_halo;
}

SpotKind kind_of(const Region& region, const Moments& m, const LocalPsf& psf, const Mat2& motion_px2) {
  if (region.box.width() <= kColumnWidth && region.box.height() >= kColumnHeight) return SpotKind::column;
  // Saturation blunts all that follows. A saturated spot may be the Earth with the Moon beside it: it stays.
  if (region.saturated) return SpotKind::point;
  const double width = psf.sigma_px();
  const double least_width = width - 2.0 * std::sqrt(psf.covariance(LocalPsf::width, LocalPsf::width));
  if (m.sharpest - central_share(std::max(least_width, 0.8 * width)) > 3.0 * m.sharpest_sigma)
    return SpotKind::cosmic_ray;
  const double one = spot_variance_px2(psf);
  const Mat2 own = m.second - motion_px2;
  const double middle = 0.5 * own.trace(), half = std::hypot(0.5 * (own(0, 0) - own(1, 1)), own(0, 1));
  const double across = middle - half, along = middle + half;
  const double doubt = 3.0 * m.second_sigma;
  if (across < kThin * one && m.peak_over_noise > kThinSeen) return SpotKind::cosmic_ray;
  if (along > kElongated * std::max(one, across) + doubt && m.middle > kGap) return SpotKind::streak;
  if (across > kExtended * one + doubt) return SpotKind::extended;
  return SpotKind::point;
}

template <typename T>
Window core_of_bloomed(ImageView<const T> image, const Window& box, double saturation_dn) {
  int widest = 0;
  Window core = box;
  for (int v = box.v0; v <= box.v1; ++v) {
    const T* row = image.row(v);
    int first = box.u1 + 1, last = box.u0 - 1;
    for (int u = box.u0; u <= box.u1; ++u) {
      if (static_cast<double>(row[u]) < saturation_dn) continue;
      first = std::min(first, u);
      last = u;
    }
    const int width = last - first + 1;
    if (width < widest) continue;
    if (width > widest) core = {first, v, last, v};
    core.u0 = std::min(core.u0, first);
    core.u1 = std::max(core.u1, last);
    core.v1 = v;
    widest = width;
  }
  // The core is about as high as wide.
  const double middle = 0.5 * (core.v0 + core.v1);
  const int half = (widest + 1) / 2;
  core.v0 = std::max(box.v0, static_cast<int>(std::floor(middle)) - half);
  core.v1 = std::min(box.v1, static_cast<int>(std::ceil(middle)) + half);
  return core;
}

template Window core_of_bloomed<std::uint8_t>(ImageView<const std::uint8_t>, const Window&, double);
template Window core_of_bloomed<std::uint16_t>(ImageView<const std::uint16_t>, const Window&, double);
template Window core_of_bloomed<float>(ImageView<const float>, const Window&, double);

}  // namespace astronav::vision
