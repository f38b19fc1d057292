// SPDX-License-Identifier: Apache-2.0
// Spots of light in a picture of which nothing is known: uneven background, haze, JPEG noise, hot pixels, roofs and
// trees.
#pragma once

#include <span>
#include <vector>

#include "foundation/image/image.h"
#include "foundation/raster/raster.h"
#include "onboard/vision/types.h"

namespace astronav::opensky {

struct SpotSettings {
  double threshold_sigma = 5.0;  // in the smoothed picture
  double smoothing_sigma_px = 1.2;
  int tile_px = 32;  // of the background
  std::size_t max_spots = 400;
  // Stars a pixel or two wide on a sky with the Milky Way, aurora and a bright rim.
  static SpotSettings all_sky() {
    return {.threshold_sigma = 4.0, .smoothing_sigma_px = 0.7, .tile_px = 12, .max_spots = 1500};
  }
};

struct Spots {
  std::vector<vision::Centroid> spots;  // the most certain first; flux above the local background, in DN
  double background_dn = 0.0;           // medians over the picture
  double noise_dn = 0.0;
  double threshold_dn = 0.0;  // above the background, in the middle of the picture's noise
};

// From the picture to a camera that is not mirrored, and back.
void turn_round(std::span<vision::Centroid> spots, int width_px);

Spots find_spots(const Picture& picture, const SpotSettings& settings = {});

}  // namespace astronav::opensky
