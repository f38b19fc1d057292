// SPDX-License-Identifier: Apache-2.0
// Blind search: where the camera looks and how wide, from spots alone.
//
// The field of view is climbed in steps. In each, four of the most certain spots after four are held to be every four
// stars of their shape; size over size gives the focal length, a few more spots must then fall on stars. What passes
// goes to the onboard Identifier with the focal length free, which judges it by all stars and by what chance could do.
#pragma once

#include <map>
#include <memory>
#include <optional>
#include <span>
#include <vector>

#include "foundation/base/error.h"
#include "onboard/vision/identify.h"
#include "verification/opensky/quads.h"

namespace astronav::opensky {

struct Near {
  Vec3 direction_N;
  double radius_rad = 0.0;
};

struct FieldRange {  // horizontal, rad
  double min_rad = 0.0;
  double max_rad = 0.0;
};

struct BlindSettings {
  std::size_t spots = 20;    // the most certain, evenly spread, that make shapes; half as many again at the second try
  double match_px = 2.0;     // star to spot, at the end
  double max_chance = 1e-6;  // that a solution is none, all hypotheses counted
  std::size_t judged_spots = 120;  // the most certain
  std::optional<Near> near{};
  // Of the picture's size: its lens is believed, and its focal length where that is known.
  std::optional<Intrinsics> camera{};
  bool focal_is_known = true;
};

struct BlindSolution {
  vision::Identification identification;  // of a mirrored picture: of the picture turned right
  std::vector<vision::MatchedStar> stars;
  bool mirrored = false;
  double extra_sigma_px = 0.0;  // of an axis, beside the centroids' own: blur, lens, catalogue
  double lists_ms = 0.0;        // for making lists of stars that were not there yet
};

// Axes that two directions define: columns middle, normal, from the second to the first.
Mat3 pair_axes(const Vec3& p, const Vec3& q);

class BlindSearch {
 public:
  // The field must outlive the object. Lists of stars are made when a field of view first asks for them, and kept.
  explicit BlindSearch(const vision::StarField& field);

  // `spots` the most certain first. no_match where nothing convinces.
  Result<BlindSolution> search(std::span<const vision::Centroid> spots, int width, int height, const FieldRange& range,
                               const vision::Observer& observer, const BlindSettings& settings);

 private:
  struct Shapes {
    vision::StarField stars;
    QuadIndex quads;
  };
  struct Step;
  class Attempt;
  const Shapes& shapes(double shorter_fov_rad);

  const vision::StarField& field_;
  std::vector<std::uint32_t> by_brightness_;
  std::map<int, std::unique_ptr<Shapes>> made_;  // by size of field
  double lists_ms_ = 0.0;
};

}  // namespace astronav::opensky
