// SPDX-License-Identifier: Apache-2.0
// First look of an all-sky camera: attitude, focal length and parity from its brightest spots.
#pragma once

#include <optional>
#include <span>

#include "foundation/base/error.h"
#include "models/camera/camera.h"
#include "onboard/vision/types.h"
#include "verification/opensky/blind.h"
#include "verification/opensky/calibrate_stars.h"

namespace astronav::opensky {

struct FisheyeLook {
  Intrinsics camera;  // equidistant, with a first centre and k1
  Mat3 R_CN = Mat3::Identity();
  bool mirrored = false;  // then u counts from the right: u = width - 1 - u_picture
  int matched = 0;
  double chance_probability = 1.0;
};

// Two bright spots are held to be each pair of bright stars at about their distance, for focal lengths between the two
// given, three lenses and both parities; other bright spots must fall near bright stars. The best are refined with
// growing lists of stars, and the one that chance explains least is taken (docs/theory/camera.md, all-sky). `sky`
// brightest first; `near`: where the boresight lies. no_match where chance would do as well with a probability above
// 1e-9.
Result<FisheyeLook> find_fisheye(std::span<const vision::Centroid> spots, std::span<const SkyStar> sky, int width,
                                 int height, double focal_min_px, double focal_max_px, const std::optional<Near>& near);

}  // namespace astronav::opensky
