// SPDX-License-Identifier: Apache-2.0
#include "onboard/vision/spot_shape.h"

#include <algorithm>
#include <cmath>

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
  double uu = 0.0, uv = 0.0, vv = 0.0, noise4 = 0.0, brightest = 0.0;
  int peak_u = region.box.u0, peak_v = region.box.v0;
  for (int v = w.v0; v <= w.v1; ++v) {
    const T* row = image.row(v);
    for (int u = w.u0; u <= w.u1; ++u) {
      const double d = static_cast<double>(row[u]) - level.under(u, v);
      if (!(d > least)) continue;
      const double x = u - cu, y = v - cv;
      m.flux += d;
      m.centre += d * Vec2(x, y);
      uu += d * x * x;
      uv += d * x * y;
      vv += d * y * y;
      const double r2 = x * x + y * y;
      noise4 += sensor.pixel_variance_dn2(d, level.noise_dn) * r2 * r2;
      if (d > brightest) {
        brightest = d;
        peak_u = u;
        peak_v = v;
      }
    }
  }
  if (!(m.flux > 0.0)) return m;
  m.centre /= m.flux;
  m.second << uu, uv, uv, vv;
  m.second = m.second / m.flux - m.centre * m.centre.transpose();
  m.second_sigma = std::sqrt(noise4) / m.flux;
  m.centre += Vec2(cu, cv);
  const auto near = [&](int u, int v) { return static_cast<double>(image(u, v)) - level.under(u, v); };
  m.middle = near(static_cast<int>(std::lround(m.centre.x())), static_cast<int>(std::lround(m.centre.y()))) / brightest;
  double sum = 0.0;
  const Window about = grown({peak_u, peak_v, peak_u, peak_v}, 1, image.width(), image.height());
  for (int v = about.v0; v <= about.v1; ++v) {
    for (int u = about.u0; u <= about.u1; ++u) sum += near(u, v);
  }
  sum = std::max(sum, brightest);
  m.sharpest = brightest / sum;
  m.sharpest_sigma = std::hypot(3.0 * level.noise_dn * m.sharpest,
                                std::sqrt(sensor.pixel_variance_dn2(brightest, level.noise_dn)) * (1.0 - m.sharpest)) /
                     sum;
  m.peak = {static_cast<double>(peak_u), static_cast<double>(peak_v)};
  m.peak_over_noise = brightest / level.noise_dn;
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
