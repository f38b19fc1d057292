// SPDX-License-Identifier: Apache-2.0
// Blind search: where the camera looks and how wide, from spots alone.
//
// Two bright spots are held to be each pair of catalogue stars at a fitting distance, in both orders; distance over
// angle gives the focal length, and a few more bright spots must then fall on stars. What passes goes to the onboard
// Identifier with the focal length free, which judges it by all stars and by what chance could do.
#pragma once

#include <map>
#include <memory>
#include <optional>
#include <span>
#include <vector>

#include "foundation/base/error.h"
#include "onboard/vision/identify.h"

namespace astronav::opensky {

struct Near {
  Vec3 direction_N;
  double radius_rad = 0.0;
};

struct BlindSettings {
  int spots = 14;  // the most certain, evenly spread, that make hypotheses
  int confirm_hits = 3;
  double tolerance = 0.005;  // of the picture's width: how far spots may be off under a first guess
  double match_px = 2.0;
  double max_chance = 1e-8;        // that a solution is none, all hypotheses counted
  std::size_t judged_spots = 120;  // the most certain
  std::optional<Near> near;
};

struct BlindSolution {
  vision::Identification identification;
  std::vector<vision::MatchedStar> stars;
  double refine_ms = 0.0;  // of the search: from the first accepted attitude to the last
};

// Which parts of the sky lie close to a star: one bit for each small cell on the faces of a cube.
class SkyMask {
 public:
  SkyMask(const vision::StarField& stars, double radius_rad);
  // True for every direction within the radius of a star, and for some a little farther off.
  bool near_star(const Vec3& direction_N) const;

 private:
  std::size_t cell(const Vec3& direction) const;
  int cells_ = 0;  // along the edge of a face
  std::vector<std::uint64_t> bits_;
};

class BlindSearch {
 public:
  explicit BlindSearch(const vision::StarField& field) : field_(field) {}

  // Fields of view are horizontal. `spots` brightest first. no_match where nothing convinces.
  Result<BlindSolution> search(std::span<const vision::Centroid> spots, int width, int height, double fov_min_rad,
                               double fov_max_rad, const vision::Observer& observer, const BlindSettings& settings);

 private:
  struct Asterisms {
    std::vector<std::byte> bytes;
    vision::PairIndex index;
    vision::StarField bright;
    std::unique_ptr<SkyMask> mask;
    double mask_radius_rad = 0.0;
  };
  const Asterisms& asterisms(double shorter_fov_rad, double longest_rad, double mask_radius_rad);

  const vision::StarField& field_;
  std::map<int, std::unique_ptr<Asterisms>> made_;  // by size of field
};

}  // namespace astronav::opensky
