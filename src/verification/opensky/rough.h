// SPDX-License-Identifier: Apache-2.0
// Where a known camera looks when that is roughly known already: three or four spots are enough.
//
// Two spots after two are held to be each pair of bright stars or planets near the rough pointing, at their distance
// and of about their relative brightness; others must then fall on spots. How likely chance would do as well, over all
// pairs that were tried, is told, and bounded.
#pragma once

#include <span>
#include <vector>

#include "foundation/base/error.h"
#include "models/camera/camera.h"
#include "onboard/vision/types.h"
#include "verification/opensky/blind.h"
#include "verification/opensky/calibrate_stars.h"

namespace astronav::opensky {

struct RoughSettings {
  double net_px = 2.0;       // star to spot
  double max_chance = 1e-5;  // smaller than for a blind search: the pointing is told
};

struct RoughLook {
  Mat3 R_CN = Mat3::Identity();
  bool mirrored = false;
  std::vector<StarMatch> stars;  // into the sky and the spots given; no planets
  double chance_probability = 1.0;
};

// `spots` the most certain first, `sky` brightest first, both as apparent. no_match where chance would do as well, or
// fewer than three stars are seen.
Result<RoughLook> look_near(std::span<const vision::Centroid> spots, const Intrinsics& camera,
                            std::span<const SkyStar> sky, std::span<const SkyPlanet> planets, const Near& near,
                            const RoughSettings& settings = {});

}  // namespace astronav::opensky
