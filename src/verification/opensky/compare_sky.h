// SPDX-License-Identifier: Apache-2.0
// What a picture holds beside its stars: the smooth sky and the noise. Internal.
#pragma once

#include <algorithm>
#include <optional>

#include "foundation/image/image.h"

namespace astronav::opensky {

// A surface of low order through the clipped means of tiles, so that a star is no part of it.
struct SmoothSky {
  ImageF level_dn;
  double scatter = 0.0;  // of the tiles about it, over what their own noise explains
};
// `step`: between levels, 0 for fractions.
SmoothSky smooth_sky(const ImageF& picture, double step);

// sigma^2 = floor + slope * level (a pedestal under the levels makes the floor negative): the photon transfer of the
// picture's own tiles (docs/real-sky.md). Without a slope worth the name (a dark or an evenly lit picture) all
// of it is floor. `known_slope_dn` where the gain is known.
struct NoiseLaw {
  double floor_dn2 = 0.0;
  double slope_dn = 0.0;  // 1 / (electrons per DN), where the picture shows it
  double least_dn2 = 1e-12;
  double variance(double level_dn) const { return std::max(floor_dn2 + slope_dn * level_dn, least_dn2); }
};
NoiseLaw photon_transfer(const ImageF& picture, const SmoothSky& sky, double step,
                         std::optional<double> known_slope_dn = {});

// Structural similarity of every pixel (Wang et al. 2004: Gaussian window of 1.5 px, K1 = 0.01, K2 = 0.03), with the
// range of levels that the picture's format can hold.
ImageF structural_similarity(const ImageF& a, const ImageF& b, double levels);

}  // namespace astronav::opensky
