// SPDX-License-Identifier: Apache-2.0
#include "onboard/vision/planets.h"

#include <cmath>

#include <Eigen/LU>

#include "foundation/math/rotation.h"

namespace astronav::vision {

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
                        const PlanetSettings& settings) {
  PlanetMatch match;
  match.body = prediction.body;
  const Result<PredictedPixel> predicted = predict_pixel(prediction, attitude);
  if (!predicted) return match;
  match.predicted = predicted->pixel;
  double best = -1.0, second = -1.0;  // likelihoods; the densities' common factors are left out
  for (std::size_t i = 0; i < spots.size(); ++i) {
    if (is_star[i]) continue;
    const Mat2 covariance = predicted->covariance_px2 + spots[i].covariance_px2;
    const Vec2 innovation = spots[i].pixel.vec() - predicted->pixel.vec();
    const double d2 = innovation.dot(covariance.inverse() * innovation);
    if (!(d2 < settings.gate_d2)) continue;
    double exponent = -0.5 * d2;
    if (prediction.expected_flux_dn > 0.0) {
      const double difference_mag = -2.5 * std::log10(std::max(spots[i].flux_dn, 1e-3) / prediction.expected_flux_dn);
      // What a saturated spot holds is known only from its wings.
      const double sigma = settings.brightness_sigma_mag * (spots[i].saturated ? 2.0 : 1.0);
      if (std::abs(difference_mag) > settings.brightness_gate_mag * (spots[i].saturated ? 2.0 : 1.0)) continue;
      exponent -= 0.5 * difference_mag * difference_mag / (sigma * sigma);
    }
    const double likelihood = std::exp(exponent) / std::sqrt(covariance.determinant());
    if (likelihood > best) {
      second = best;
      best = likelihood;
      match.centroid = static_cast<std::uint32_t>(i);
      match.mahalanobis = d2;
    } else if (likelihood > second) {
      second = likelihood;
    }
  }
  match.found = best > 0.0 && (second <= 0.0 || best > settings.ambiguity * second);
  return match;
}

}  // namespace astronav::vision
