// SPDX-License-Identifier: Apache-2.0
// What the accuracy of centroids is measured on: cameras whose optics are worse than the onboard software is told,
// frames of them with stars at known places, and the bound that no unbiased estimator passes.
#pragma once

#include <cmath>
#include <string>
#include <vector>

#include "models/camera_file/camera_file.h"
#include "onboard/vision/centroids.h"
#include "simulator/render/renderer.h"

namespace astronav::accuracy {

// The truth has what the onboard software does not know of; `believed` is the camera's file with the right width of the
// core at the boresight, to 1 %.
struct TestCamera {
  std::string name;
  Camera truth;
  Camera believed;
  Vec3 sun_C_m = Vec3::Zero();
};

inline render::Exposure exposure_of(const TestCamera& camera) {
  return {.duration_s = camera.truth.exposure_s, .sun_C_m = camera.sun_C_m};
}

// Moffat's profile, whose wings are a power of the distance, in place of Gaussians: no form that the onboard software
// fits. The full width at half maximum is that of the Gaussian.
inline PsfKernel moffat_kernel(double sigma_px, double beta) {
  constexpr int kHalf = 96, kSamples = 6;
  const double half_width = std::sqrt(2.0 * std::log(2.0)) * sigma_px;
  const double alpha = half_width / std::sqrt(std::exp2(1.0 / beta) - 1.0);
  PsfKernel kernel;
  kernel.width = kernel.height = 2 * kHalf + 1;
  kernel.samples_per_px = kSamples;
  double sum = 0.0;
  for (int j = -kHalf; j <= kHalf; ++j) {
    for (int i = -kHalf; i <= kHalf; ++i) {
      const double r = std::hypot(i, j) / kSamples;
      kernel.values.push_back(static_cast<float>(std::pow(1.0 + r * r / (alpha * alpha), -beta)));
      sum += static_cast<double>(kernel.values.back());
    }
  }
  for (float& value : kernel.values) value = static_cast<float>(value / sum);
  return kernel;
}

enum class Optics { mission, hard, moffat };

inline TestCamera test_camera(std::string_view file, double sigma_px, Optics optics, std::string name) {
  TestCamera camera{.name = std::move(name), .truth = *read_camera(std::string(file)), .believed = {}};
  if (sigma_px > 0.0) camera.truth.psf.sigma_px = sigma_px;
  camera.believed = camera.truth;
  PointSpread& psf = camera.truth.psf;
  psf.sigma_px *= 1.01;
  psf.halo_sigma_px = 2.5 * psf.sigma_px / 0.8;
  if (optics == Optics::moffat) {
    psf.kernel = moffat_kernel(psf.sigma_px, 4.0);
    return camera;
  }
  if (optics == Optics::mission) {  // scenarios/earth-mars-ballistic.toml, offsets at 1 sigma
    psf.sigma_growth_px = 0.02;
    psf.halo_fraction = 0.015;
    psf.halo_offset_u_px = 0.05;
    psf.halo_offset_v_px = -0.05;
  } else {
    psf.sigma_growth_px = 0.05;
    psf.halo_fraction = 0.02;
    psf.halo_offset_u_px = 0.16;
    psf.halo_offset_v_px = -0.12;
    psf.coma_px = 0.3;
  }
  return camera;
}

// The Sun 35 degrees off the boresight, beside a baffle that lets through 2,000 electrons a pixel at 30 degrees: 600 to
// 3,500 over the picture.
inline TestCamera in_stray_light(TestCamera camera) {
  camera.truth.optics.stray_light_e_s_px = 5000.0;
  camera.sun_C_m = kAstronomicalUnit * Vec3(std::sin(35.0 * kDegree), 0.0, std::cos(35.0 * kDegree));
  return camera;
}

// Width of the true core at a place.
inline double core_sigma(const Camera& camera, Pixel at) {
  const Intrinsics& c = camera.intrinsics;
  const double half_diagonal = 0.5 * std::hypot(c.width_px, c.height_px);
  const double r = std::hypot(at.u - c.cx_px, at.v - c.cy_px) / half_diagonal;
  return camera.psf.sigma_px + camera.psf.sigma_growth_px * r * r;
}

inline double share(double x, double sigma) {
  const double s = 1.0 / (std::sqrt(2.0) * sigma);
  return 0.5 * (std::erf((x + 0.5) * s) - std::erf((x - 0.5) * s));
}
inline double share_slope(double x, double sigma) {
  const double s = 1.0 / (std::sqrt(2.0 * kPi) * sigma);
  const auto density = [&](double e) { return s * std::exp(-0.5 * e * e / (sigma * sigma)); };
  return density(x - 0.5) - density(x + 0.5);
}

// Noise of a pixel without sources, electrons squared.
inline double dark_variance_e2(const Camera& camera) {
  const Detector& d = camera.detector;
  return d.read_noise_e * d.read_noise_e + (d.dark_current_e_s + d.background_e_s_px) * camera.exposure_s +
         d.gain_e_dn * d.gain_e_dn / 12.0;
}

// Stray light at a pixel (docs/theory/rendering.md eq. 12), electrons.
inline double stray_electrons(const TestCamera& camera, Pixel at) {
  if (camera.truth.optics.stray_light_e_s_px <= 0.0 || camera.sun_C_m.norm() == 0.0) return 0.0;
  const double angle = angle_between(*unproject(camera.truth.intrinsics, at), camera.sun_C_m);
  return camera.truth.optics.stray_light_e_s_px * camera.truth.exposure_s *
         std::pow(30.0 * kDegree / angle, camera.truth.optics.stray_light_power);
}

struct Bound {
  Mat2 covariance_px2 = Mat2::Zero();
  double snr = 0.0;  // in 5 x 5 px
};

// Cramer-Rao's bound of the place of a star with unknown flux: read noise, dark current, background, quantisation, shot
// noise and non-uniformity. Of the light only the core tells the place here; coma and halo blunt the true one further.
inline Bound cramer_rao(const Camera& camera, Pixel at, double electrons, double stray_e = 0.0) {
  constexpr int kReach = 12;
  const double sigma = core_sigma(camera, at);
  const double core = electrons * (1.0 - camera.psf.halo_fraction);
  const double dark = dark_variance_e2(camera) + stray_e;
  const double prnu = camera.detector.photo_nonuniformity;
  const int u0 = static_cast<int>(std::lround(at.u)), v0 = static_cast<int>(std::lround(at.v));
  Mat3 information = Mat3::Zero();
  double signal5 = 0.0, variance5 = 0.0;
  for (int dv = -kReach; dv <= kReach; ++dv) {
    for (int du = -kReach; du <= kReach; ++du) {
      const double x = u0 + du - at.u, y = v0 + dv - at.v;
      const double gx = share(x, sigma), gy = share(y, sigma);
      const double light = core * gx * gy;
      const double variance = dark + light + prnu * prnu * light * light;
      const Vec3 slope(core * share_slope(x, sigma) * gy, core * gx * share_slope(y, sigma), gx * gy);
      information += slope * slope.transpose() / variance;
      if (std::abs(du) <= 2 && std::abs(dv) <= 2) {
        signal5 += light;
        variance5 += variance;
      }
    }
  }
  return {information.inverse().topLeftCorner<2, 2>(), signal5 / std::sqrt(variance5)};
}

inline render::RenderedSource star_at(double u, double v, double electrons) {
  render::RenderedSource source;
  source.pixel = {u, v};
  source.electrons = electrons;
  return source;
}

// Electrons of an unsaturated star whose S/N in 5 x 5 px is as asked for, at the boresight.
inline double electrons_for_snr(const Camera& camera, double snr) {
  double low = 1.0, high = 1e9;
  const Pixel middle{camera.intrinsics.cx_px, camera.intrinsics.cy_px};
  for (int i = 0; i < 60; ++i) {
    const double flux = std::sqrt(low * high);
    (cramer_rao(camera, middle, flux).snr < snr ? low : high) = flux;
  }
  return std::sqrt(low * high);
}

// The brightest star that leaves the fullest pixel at `fill` of what it can hold.
inline double electrons_for_peak(const Camera& camera, double fill) {
  const Detector& d = camera.detector;
  const double converter = d.gain_e_dn * ((1 << d.bits) - 1 - d.bias_dn);
  const double room = std::min(d.full_well_e, converter);
  const double one = share(0.0, camera.psf.sigma_px);
  return fill * room / (one * one);
}

// The centroid nearest to a place, or nullptr.
inline const vision::Centroid* nearest(std::span<const vision::Centroid> spots, Pixel at, double within_px = 2.0) {
  const vision::Centroid* best = nullptr;
  for (const vision::Centroid& spot : spots) {
    const double distance = (spot.pixel.vec() - at.vec()).norm();
    if (distance >= within_px) continue;
    within_px = distance;
    best = &spot;
  }
  return best;
}

}  // namespace astronav::accuracy
