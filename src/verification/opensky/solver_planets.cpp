// SPDX-License-Identifier: Apache-2.0
#include "verification/opensky/solver_planets.h"

#include <algorithm>
#include <cmath>

#include "foundation/math/statistics.h"
#include "onboard/vision/planets.h"

namespace astronav::opensky {

std::vector<SolvedPlanet> find_planets(std::span<const SkyPlanet> foretold, const vision::AttitudeSolution& attitude,
                                       std::span<const vision::Centroid> spots, std::span<const SolvedStar> stars,
                                       std::vector<unsigned char>& taken) {
  // The picture's magnitude scale, from its stars.
  std::vector<double> zero_points;
  double faintest = -99.0;
  for (const SolvedStar& star : stars) {
    faintest = std::max(faintest, star.v_mag);
    if (!star.spot.saturated) zero_points.push_back(star.v_mag + 2.5 * std::log10(star.spot.flux_dn));
  }
  const double zero_point = zero_points.empty() ? 0.0 : median(zero_points);
  // The centre of a blooming, saturated disc is no better than a part of its width.
  std::vector<vision::Centroid> doubted(spots.begin(), spots.end());
  for (vision::Centroid& spot : doubted) {
    if (spot.saturated) spot.covariance_px2 += 0.01 * spot.pixels * Mat2::Identity();
  }

  std::vector<SolvedPlanet> planets;
  for (const SkyPlanet& planet : foretold) {
    if (planet.body == body::moon || planet.v_mag > faintest + 0.5) continue;
    vision::PlanetPrediction prediction;
    prediction.body = planet.body;
    prediction.direction_N = planet.direction_N;
    prediction.v_mag = planet.v_mag;
    if (!zero_points.empty()) prediction.expected_flux_dn = std::pow(10.0, 0.4 * (zero_point - planet.v_mag));
    // Moons, phase and what the lens's model leaves over.
    const double sigma =
        std::hypot(3.0 * kArcsecond, std::max(0.7, attitude.residual_rms_px) / attitude.intrinsics.fx_px);
    prediction.direction_covariance = Mat3::Identity() * sigma * sigma;
    vision::PlanetSettings settings;
    settings.brightness_sigma_mag = 1.0;
    settings.brightness_gate_mag = 3.0;
    const vision::PlanetMatch match = vision::find_planet(prediction, attitude, doubted, taken, settings);
    if (!match.found) continue;
    taken[match.centroid] = 1;
    const vision::Centroid& spot = spots[match.centroid];
    planets.push_back({planet.body, spot, match.predicted, match.mahalanobis, planet.v_mag,
                       zero_point - 2.5 * std::log10(spot.flux_dn)});
  }
  return planets;
}

}  // namespace astronav::opensky
