// SPDX-License-Identifier: Apache-2.0
// Planets by predicted place: the innovation's Mahalanobis distance under the covariances of navigation, attitude and
// centroid; brightness where it is expected; never a spot that is a catalogue star. What is left competes with the
// spots beside it and with the case that the planet is not seen at all, and is named where the odds are overwhelming
// (docs/theory/vision.md eq. 13, 14).
#pragma once

#include <span>
#include <vector>

#include "foundation/time/epoch.h"
#include "onboard/vision/identify.h"
#include "onboard/vision/types.h"

namespace astronav::vision {

struct PlanetSettings {
  double gate_d2 = 27.6;              // chi-square, 2 degrees of freedom: one in a million is outside
  double brightness_sigma_mag = 0.5;  // of predicted against measured
  double brightness_gate_mag = 2.5;
  // A saturated spot may hold far more light than its wings tell.
  double saturated_sigma_mag = 2.0;
  double saturated_gate_mag = 6.0;
  double detection = 0.98;  // share of predicted planets that have a spot of their own
  double min_probability = 0.999;
  // A body does not jump: from one frame to the next it moves by less than this against the stars, or neither is
  // believed. 30 km/s at 0.2 au.
  double max_rate_rad_s = 1e-6;
  double memory_s = 3600.0;  // older sightings are forgotten
};

// Pixel where a predicted direction falls, with the covariance of (centroid - prediction) from navigation and attitude.
struct PredictedPixel {
  Pixel pixel;
  Mat2 covariance_px2;
};
Result<PredictedPixel> predict_pixel(const PlanetPrediction& prediction, const AttitudeSolution& attitude);

// `is_star[i]`: spot i is a star, or another planet. `area_px`: the spots are those of so much of the frame; 0: of all.
PlanetMatch find_planet(const PlanetPrediction& prediction, const AttitudeSolution& attitude,
                        std::span<const Centroid> spots, std::span<const unsigned char> is_star,
                        const PlanetSettings& settings = {}, double area_px = 0.0);

// Where a body was seen last. A spot that was taken for it by mistake is not at the same place among the stars again.
class PlanetMemory {
 public:
  explicit PlanetMemory(std::size_t max_planets) { seen_.reserve(max_planets); }
  // True where the new sighting agrees with the last one, or there is none. Remembers it either way, so that a place
  // that persists is believed from the second frame on.
  bool agrees(BodyId body, const Vec3& direction_N, double sigma_rad, Epoch epoch, const PlanetSettings& settings);

 private:
  struct Sighting {
    BodyId body;
    Vec3 direction_N;
    double sigma_rad = 0.0;
    Epoch epoch;
  };
  std::vector<Sighting> seen_;
};

}  // namespace astronav::vision
