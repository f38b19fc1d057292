// SPDX-License-Identifier: Apache-2.0
// Planets in a solved picture: foretold, then looked for among the spots that are no stars.
#pragma once

#include <span>
#include <vector>

#include "models/ephemeris/bodies.h"
#include "onboard/vision/types.h"
#include "verification/opensky/calibrate_stars.h"

namespace astronav::opensky {

struct SolvedStar {
  vision::MatchedStar match;
  vision::Centroid spot;
  double v_mag = 0.0;
};
struct SolvedPlanet {
  BodyId body;
  vision::Centroid spot;
  Pixel predicted;
  double mahalanobis = 0.0;  // d^2
  double v_mag_predicted = 0.0;
  double v_mag_measured = 0.0;  // from the picture's own stars; too faint where the spot is saturated
};

// Not looked for: what is fainter than the faintest star by half a magnitude. `taken`: spots that are stars; those that
// turn out to be planets are added.
std::vector<SolvedPlanet> find_planets(std::span<const SkyPlanet> foretold, const vision::AttitudeSolution& attitude,
                                       std::span<const vision::Centroid> spots, std::span<const SolvedStar> stars,
                                       std::vector<unsigned char>& taken);

}  // namespace astronav::opensky
