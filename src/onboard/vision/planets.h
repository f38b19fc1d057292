// SPDX-License-Identifier: Apache-2.0
// Planets by predicted place: the innovation's Mahalanobis distance under the covariances of navigation, attitude and
// centroid; brightness where it is expected; never a spot that is a catalogue star (docs/theory/vision.md eq. 13, 14).
#pragma once

#include <span>

#include "onboard/vision/identify.h"
#include "onboard/vision/types.h"

namespace astronav::vision {

struct PlanetSettings {
  double gate_d2 = 18.4;              // chi-square, 2 degrees of freedom, 99.99 %
  double brightness_sigma_mag = 0.5;  // of predicted against measured
  double brightness_gate_mag = 2.5;
  double ambiguity = 20.0;  // the best spot must be this many times likelier than the next
  double star_max_v_mag = 8.0;
};

// Pixel where a predicted direction falls, with the covariance of (centroid - prediction) from navigation and attitude.
struct PredictedPixel {
  Pixel pixel;
  Mat2 covariance_px2;
};
Result<PredictedPixel> predict_pixel(const PlanetPrediction& prediction, const AttitudeSolution& attitude);

// `is_star[i]`: spot i was matched to a star, or to another planet before. Not found where two spots are about as
// likely.
PlanetMatch find_planet(const PlanetPrediction& prediction, const AttitudeSolution& attitude,
                        std::span<const Centroid> spots, std::span<const unsigned char> is_star,
                        const PlanetSettings& settings = {});

}  // namespace astronav::vision
