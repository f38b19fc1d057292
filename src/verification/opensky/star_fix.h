// SPDX-License-Identifier: Apache-2.0
// Star fix: where a camera is between the stars, from the parallax of near ones among far ones (docs/theory/fix.md).
//
// A frame's plate is from stars that are far; against them a near star stands off the place where the solar system's
// barycentre sees it, by its parallax times the observer's distance across the sight. Two near stars in different parts
// of the sky give the place. What the formal error of a centroid leaves out (pixels wider than the star's image, the
// plate itself) is measured: by what the stars of a field scatter from frame to frame. N, SI.
#pragma once

#include <optional>
#include <string>
#include <vector>

#include "foundation/base/error.h"
#include "foundation/time/epoch.h"
#include "models/camera/camera.h"
#include "models/stars/catalogue.h"
#include "onboard/vision/types.h"

namespace astronav::opensky {

struct FixFrame {
  Epoch epoch;  // mid-exposure
  double exposure_s = 1.0;
  // The plate: from places of stars that were not aberrated.
  Intrinsics plate;
  Mat3 R_CN = Mat3::Identity();
  bool mirrored = false;                // the plate's u counts from the right: u_picture = width - 1 - u
  std::vector<vision::Centroid> spots;  // pixels as in the picture
};

struct NearStar {
  std::string name;
  Star star;  // at J2000, with its parallax
};

struct StarFixSettings {
  double most_distance_au = 100.0;  // from the barycentre: how far off its barycentric place a star is looked for
  double same_place_px = 2.0;       // from frame to frame of a field, by the plates
  double same_light = 0.3;          // ... and this near in brightness
  // Of a field star that tells the scatter: the share of the near star's light. Fainter ones scatter by noise.
  double least_light_share = 0.07;
  std::size_t least_field_stars = 4;
  // Of a sight, an axis: used where frames and stars are too few to measure it; nothing: such frames are an error.
  std::optional<double> sight_sigma_rad;
  // Barycentric, where it is known: the way between the frames, and what aberration does differently within a frame.
  std::optional<Vec3> velocity_m_s;
};

struct StarSight {
  std::size_t frame = 0, star = 0;
  Pixel pixel;                       // as in the picture
  Vec3 direction_N;                  // among the far stars
  double sigma_rad = 0.0;            // an axis
  Vec2 parallax_shift_rad;           // east, north: off the place that the barycentre sees
  Vec2 residual_rad = Vec2::Zero();  // ... off the place that the fix foretells
};

// Frames that show one near star.
struct FixField {
  std::size_t star = 0;
  std::size_t frames = 0;
  std::size_t field_stars = 0;     // that were seen in all of them
  double star_scatter_rad = 0.0;   // of a star about its mean, an axis, the frame's common shift taken out
  double plate_scatter_rad = 0.0;  // of the frames' common shifts
  double sigma_rad = 0.0;          // of a sight
  bool measured = false;           // otherwise as given
};

struct StarFix {
  Epoch epoch;  // the mean of the frames'
  Vec3 p_O_N = Vec3::Zero();
  Mat3 covariance_m2 = Mat3::Zero();
  double chi2 = 0.0;
  int degrees_of_freedom = 0;
  std::vector<StarSight> sights;
  std::vector<FixField> fields;
};

// no_match: no near star is seen, or only one; the sights do not meet. invalid_argument: the errors of a field can
// neither be measured nor are they given.
Result<StarFix> fix_by_near_stars(const std::vector<FixFrame>& frames, const std::vector<NearStar>& stars,
                                  const StarFixSettings& settings = {});

}  // namespace astronav::opensky
