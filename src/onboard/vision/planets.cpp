// SPDX-License-Identifier: Apache-2.0
#include "onboard/vision/planets.h"

#include <cmath>

#include <Eigen/LU>

#include "foundation/math/rotation.h"

namespace astronav::vision {
namespace {

// How many spots that are neither stars nor planets fall by chance on a pixel (and on a magnitude, where brightness is
// used: those about as bright as the planet are counted). The planet itself is one of them, and half a spot stands for
// what has not shown up in this frame.
double clutter_density(const PlanetPrediction& prediction, double area, double frame, std::span<const Centroid> spots,
                       std::span<const unsigned char> is_star) {
  constexpr double kHalfSpot = 0.5, kAboutAsBrightMag = 1.5;
  const bool by_brightness = prediction.expected_flux_dn > 0.0;
  int alike = 0;
  for (std::size_t i = 0; i < spots.size(); ++i) {
    if (is_star[i]) continue;
    if (by_brightness &&
        std::abs(2.5 * std::log10(std::max(spots[i].flux_dn, 1e-3) / prediction.expected_flux_dn)) > kAboutAsBrightMag)
      continue;
    ++alike;
  }
  const double density = std::max(alike - 1, 0) / area + kHalfSpot / frame;
  return by_brightness ? density / (2.0 * kAboutAsBrightMag) : density;
}

}  // namespace

Result<PredictedPixel> predict_pixel(const PlanetPrediction& prediction, const AttitudeSolution& attitude) {
  const Vec3 direction_C = attitude.R_CN * prediction.direction_N;
  Mat23 by_direction;
  const Result<Pixel> pixel = project(attitude.intrinsics, direction_C, &by_direction);
  if (!pixel) return forward(pixel);
  const Mat23 by_navigation = by_direction * attitude.R_CN;
  const Mat23 by_attitude = by_direction * cross_matrix(direction_C);
  return PredictedPixel{*pixel, by_navigation * prediction.direction_covariance * by_navigation.transpose() +
                                    by_attitude * attitude.covariance_rad2 * by_attitude.transpose()};
}

PlanetMatch find_planet(const PlanetPrediction& prediction, const AttitudeSolution& attitude,
                        std::span<const Centroid> spots, std::span<const unsigned char> is_star,
                        const PlanetSettings& settings, double area_px) {
  PlanetMatch match;
  match.body = prediction.body;
  const Result<PredictedPixel> predicted = predict_pixel(prediction, attitude);
  if (!predicted) return match;
  match.predicted = predicted->pixel;
  const double frame_px = static_cast<double>(attitude.intrinsics.width_px) * attitude.intrinsics.height_px;
  const double clutter = clutter_density(prediction, area_px > 0.0 ? area_px : frame_px, frame_px, spots, is_star);
  // A fit that began at a faint neighbour may have slid onto a brighter spot: the same light, which counts once.
  constexpr double kSameSpotPx = 0.5;
  const auto seen_before = [&](std::size_t i) {
    for (std::size_t k = 0; k < i; ++k)
      if (!is_star[k] && (spots[k].pixel.vec() - spots[i].pixel.vec()).norm() < kSameSpotPx) return true;
    return false;
  };
  double best = 0.0, sum = 0.0;  // likelihoods, as densities by the same
  for (std::size_t i = 0; i < spots.size(); ++i) {
    if (is_star[i]) continue;
    const Mat2 covariance = predicted->covariance_px2 + spots[i].whole_covariance_px2();
    const Vec2 innovation = spots[i].pixel.vec() - predicted->pixel.vec();
    const double d2 = innovation.dot(covariance.inverse() * innovation);
    if (!(d2 < settings.gate_d2) || seen_before(i)) continue;
    double exponent = -0.5 * d2, scale = 2.0 * kPi * std::sqrt(covariance.determinant());
    if (prediction.expected_flux_dn > 0.0) {
      const double difference_mag = -2.5 * std::log10(std::max(spots[i].flux_dn, 1e-3) / prediction.expected_flux_dn);
      const bool lost = spots[i].saturated && difference_mag > 0.0;
      const double sigma = lost ? settings.saturated_sigma_mag : settings.brightness_sigma_mag;
      if (std::abs(difference_mag) > (lost ? settings.saturated_gate_mag : settings.brightness_gate_mag)) continue;
      exponent -= 0.5 * difference_mag * difference_mag / (sigma * sigma);
      // Two halves of different width.
      const double other = spots[i].saturated ? settings.saturated_sigma_mag : settings.brightness_sigma_mag;
      scale *= std::sqrt(2.0 * kPi) * 0.5 * (settings.brightness_sigma_mag + other);
    }
    const double likelihood = std::exp(exponent) / scale;
    sum += likelihood;
    if (likelihood <= best) continue;
    best = likelihood;
    match.centroid = static_cast<std::uint32_t>(i);
    match.mahalanobis = d2;
  }
  if (best > 0.0)
    match.probability = settings.detection * best / (settings.detection * sum + (1.0 - settings.detection) * clutter);
  match.found = match.probability >= settings.min_probability;
  return match;
}

bool PlanetMemory::agrees(BodyId body, const Vec3& direction_N, double sigma_rad, Epoch epoch,
                          const PlanetSettings& settings) {
  const Sighting now{body, direction_N, sigma_rad, epoch};
  for (Sighting& last : seen_) {
    if (last.body != body) continue;
    const double seconds = std::abs((epoch - last.epoch).seconds());
    const double allowed = 5.0 * std::hypot(sigma_rad, last.sigma_rad) + settings.max_rate_rad_s * seconds;
    const bool good = seconds > settings.memory_s || (direction_N - last.direction_N).norm() < allowed;
    last = now;
    return good;
  }
  if (seen_.size() < seen_.capacity()) seen_.push_back(now);
  return true;
}

}  // namespace astronav::vision
