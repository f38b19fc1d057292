// SPDX-License-Identifier: Apache-2.0
// Identifier: which spot is which star, and so the attitude.
//
// Lost in space: triangles of bright spots in the pyramid's order (Mortari et al. 2004: no bad spot twice running) are
// looked up in the pair index; near-collinear ones are refused, handedness must agree, a fourth spot must confirm. Each
// hypothesis is judged by all catalogue stars in the field, as in RANSAC, and taken only if chance would do as well
// with a probability below `max_chance` (docs/theory/vision.md eq. 9). With a prior attitude the judging comes at once.
// Allocates in its constructor and never again; the work is bounded by `max_hypotheses`.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "onboard/vision/attitude.h"
#include "onboard/vision/pair_index.h"
#include "onboard/vision/star_field.h"
#include "onboard/vision/types.h"

namespace astronav::vision {

struct IdentifySettings {
  int asterism_spots = 16;          // brightest, evenly spread: the corners of triangles
  double pair_tolerance_px = 0.6;   // of the distance of two spots: 3 sqrt(2) sigma, and what distortion is left
  double scale_tolerance = 1.5e-3;  // how wrong the believed focal length may be
  double first_match_px = 4.0;      // star to spot, for a fresh hypothesis
  double match_px = 1.0;            // star to spot, at the end
  std::size_t rough_stars = 40;     // brightest, while the net is wide
  int max_hypotheses = 400;         // triangles judged
  int min_matched = 5;
  double max_chance = 1e-9;
  double psf_sigma_px = 0.8;         // for leaving out close pairs
  double brightness_gate_mag = 1.5;  // of a matched star from the others' median zero point; 0: brightness is not used
  AttitudeOptions attitude;
};

struct Identification {
  AttitudeSolution attitude;
  std::size_t matched = 0;  // entries written
  int triples = 0;          // of spots looked up
  int hypotheses = 0;       // judged
};

// Upper bound (Chernoff) of the probability that at least `matched` of `spots` hit by chance, each with probability p.
double chance_of_matches(int spots, int matched, double p);

class Identifier {
 public:
  // The field and the index must outlive the object.
  Identifier(const StarField& field, const PairIndex& index, const Intrinsics& camera, const IdentifySettings& settings,
             std::size_t max_spots);

  // Spots in order of falling flux. Matches (bright stars first) into `matches`. no_match where nothing convinces.
  Result<Identification> lost_in_space(std::span<const Centroid> spots, const Observer& observer,
                                       std::span<MatchedStar> matches);
  // `radius_px`: how far off the prior may put the stars. no_match where it does not hold.
  Result<Identification> track(std::span<const Centroid> spots, const Observer& observer, const Mat3& prior_R_CN,
                               double radius_px, std::span<MatchedStar> matches);

 private:
  struct Star {
    Vec3 direction_N;         // apparent
    std::uint32_t field = 0;  // index into the field
    Pixel pixel;              // predicted
    std::int32_t spot = -1;
    bool visible = false;
  };
  struct Candidate {
    std::uint16_t a, b, c;
  };

  void load_spots(std::span<const Centroid> spots);
  void choose_asterism_spots(std::span<const Centroid> spots);
  void gather_stars(const Mat3& R_CN, const Observer& observer, std::size_t spots);
  int match(std::span<const Centroid> spots, const Mat3& R_CN, const Intrinsics& camera, double radius_px,
            std::size_t enough);
  void drop_mixed(std::span<const Centroid> spots);
  void drop_wrong_brightness(std::span<const Centroid> spots);
  std::size_t triangles(const Vec3& a, const Vec3& b, const Vec3& c);
  bool confirmed(std::span<const Centroid> spots, const Mat3& R_CN, const int (&corner)[3]) const;
  bool judge(std::span<const Centroid> spots, const Observer& observer, const Mat3& R_CN, double radius_px, int given,
             double tried, Identification& out, std::span<MatchedStar> matches);

  const StarField& field_;
  const PairIndex& index_;
  Intrinsics camera_;
  IdentifySettings settings_;
  double pixel_rad_ = 0.0;

  std::vector<Vec3> spot_C_;               // directions of all spots
  std::vector<int> asterism_;              // indices of spots
  std::vector<std::int32_t> grid_, next_;  // spots by 32-pixel tiles
  std::vector<std::int32_t> star_grid_, star_next_;
  int grid_width_ = 0, grid_height_ = 0;
  std::vector<Star> stars_;
  std::vector<std::uint32_t> cone_;
  std::vector<StarSight> sights_;
  std::vector<std::uint32_t> sight_star_;
  std::vector<double> zero_points_;
  std::vector<std::int32_t> head_;  // of each index star: chain of partners for one side of the triangle
  std::vector<std::uint32_t> stamp_;
  std::uint32_t now_ = 0;
  struct Link {
    std::uint16_t partner;
    std::int32_t next;
  };
  std::vector<Link> links_;
  std::vector<Candidate> candidates_;
};

}  // namespace astronav::vision
