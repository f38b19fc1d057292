// SPDX-License-Identifier: Apache-2.0
// Identifier: which spot is which star, and so the attitude.
//
// Lost in space: triangles of bright spots in the pyramid's order (Mortari et al. 2004: no bad spot twice running) are
// looked up in the pair index; near-collinear ones are refused, handedness must agree, further spots must confirm. Each
// hypothesis is judged by all catalogue stars in the field, as in RANSAC, and taken only if chance would do as well
// with a probability below `max_chance` (docs/theory/vision.md eq. 9). The search begins with narrow tolerances and few
// spots; those that follow look at all triangles of a spot at once. With a prior attitude the judging comes at once.
// Allocates in its constructor and never again; the work is bounded by `max_pairs` and `max_hypotheses`.
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "onboard/vision/attention.h"
#include "onboard/vision/attitude.h"
#include "onboard/vision/pair_index.h"
#include "onboard/vision/star_field.h"
#include "onboard/vision/types.h"

namespace astronav::vision {

enum class Parity : unsigned char { as_seen, mirrored, unknown };

struct IdentifySettings {
  int first_spots = 14;             // brightest, evenly spread: the corners of the first triangles
  int asterism_spots = 200;         // and of the last, less evenly: many may be no stars
  double pair_tolerance_px = 0.6;   // of the distance of two spots, beside what their covariances say: what distortion
                                    // is left. Narrow searches take a sixth of it.
  double scale_tolerance = 1.5e-3;  // how wrong the believed focal length may be; narrow searches take an eighth of
                                    // it (aberration alone is 1e-4)
  double focal_uncertainty = 0.0;   // relative; where it is more than that, a ladder of focal lengths is climbed, and
                                    // the focal length is solved for
  Parity parity = Parity::as_seen;
  double first_match_px = 4.0;   // star to spot, for a fresh hypothesis
  double match_px = 1.0;         // star to spot, at the end; wider where the covariances are
  std::size_t rough_stars = 40;  // brightest, while the net is wide
  // Work of one search: entries of the pair index that are looked at (5 to 10 ns each).
  std::int64_t max_pairs = 5000000;
  int max_hypotheses = 400;  // confirmed and judged
  int min_matched = 4;       // lost in space
  int min_tracked = 5;       // with a prior attitude
  double max_chance = 1e-6;
  double psf_sigma_px = 0.8;         // for leaving out close pairs
  double brightness_gate_mag = 1.5;  // of a matched star from the others' median zero point; 0: brightness is not used
  // From so many stars on, k1 (and p1, p2 from twice as many) are solved for too, where that explains the places far
  // better; 0: never.
  int distortion_from_stars = 0;
  AttitudeOptions attitude;
};

struct Identification {
  AttitudeSolution attitude;
  std::size_t matched = 0;  // entries written
  int triples = 0;          // of spots looked up
  int hypotheses = 0;       // judged by all stars
};

// Upper bound (Chernoff) of the probability that at least `matched` of `spots` hit by chance, each with probability p.
double chance_of_matches(int spots, int matched, double p);

class Identifier {
 public:
  // The field and the index must outlive the object.
  Identifier(const StarField& field, const PairIndex& index, const Intrinsics& camera, const IdentifySettings& settings,
             std::size_t max_spots);

  // Spots in order of falling flux. Matches (bright stars first) into `matches`. no_match where nothing convinces.
  // Of a mirrored picture (`mirrored` in the answer) the attitude and the residuals are those of the picture turned
  // right: u counts from the right.
  Result<Identification> lost_in_space(std::span<const Centroid> spots, const Observer& observer,
                                       std::span<MatchedStar> matches);
  // `radius_px`: how far off the prior may put the stars. no_match where it does not hold.
  Result<Identification> track(std::span<const Centroid> spots, const Observer& observer, const Mat3& prior_R_CN,
                               double radius_px, std::span<MatchedStar> matches);
  // The same with the spots of a part of the frame: stars count there alone. After gather() of the same frame.
  Result<Identification> track_within(std::span<const Centroid> spots, const Attention& attention,
                                      const Mat3& prior_R_CN, double radius_px, std::span<MatchedStar> matches);
  // The camera as it is believed from now on; of the same size in pixels.
  void set_camera(const Intrinsics& camera) { believed_ = camera; }
  // The field's stars about a prior attitude, so many that `most` of them are in the frame where there are as many.
  void gather(const Observer& observer, const Mat3& prior_R_CN, std::size_t most);
  // Where an attitude puts the brightest of them that are in the frame; returns how many were written.
  std::size_t place(const Mat3& R_CN, std::span<Pixel> out) const;
  // Of the last answer: spots that lie on a catalogue star of their brightness, whether it took part in the fit or not.
  std::span<const unsigned char> on_star() const { return on_star_; }
  // Of the last answer: V + 2.5 log10 of the light (DN) of its stars, the median; NaN where too few tell it.
  double zero_point_mag() const { return zero_point_; }

 private:
  struct Star {
    Vec3 direction_N;         // apparent
    std::uint32_t field = 0;  // index into the field
    Pixel pixel;              // predicted
    std::int32_t spot = -1;
    bool visible = false;
    bool attended = true;  // in the part of the frame that is looked at
  };
  struct Candidate {
    std::uint16_t a, b, c;
  };
  // One pass over the triangles.
  struct Search {
    double pair_px = 0.0;
    double scale = 0.0;
    double first_match_px = 0.0;
    double least_sine = 0.3;
    double reach = 0.0;  // of a star of spots: cosine of the longest ray
    std::int64_t pairs = 0;
  };
  // A distance between two spots, and what it may be in the catalogue.
  struct Side {
    double angle = 0.0, tolerance = 0.0, cos_min = 0.0, cos_max = 0.0;
    bool holds(double cosine) const { return cosine >= cos_min && cosine <= cos_max; }
  };
  // What may be told of a hypothesis before it is judged.
  struct Claim {
    Mat3 R_CN;
    double radius_px = 0.0;
    int given = 0;          // matches that made it, and so prove nothing
    double expected = 1.0;  // how many such hypotheses chance makes
    int min_matched = 0;
    bool free_focal = false;
    bool gathered = false;  // stars_ are there
  };

  // identify.cpp: from spots to hypotheses.
  void load_spots(std::span<const Centroid> spots);
  void choose_asterism_spots(std::span<const Centroid> spots, std::size_t count, int neighbours);
  Result<Identification> follow(std::span<const Centroid> spots, const Observer& observer, const Claim& claim,
                                std::span<MatchedStar> matches);
  double typical_sigma_px(std::span<const Centroid> spots) const;
  // Triple after triple, far apart as they come.
  bool search(std::span<const Centroid> spots, const Observer& observer, const Search& how, Identification& out,
              std::span<MatchedStar> matches);
  // Star-shaped: all triples of one spot and two fainter ones near it at the cost of its rays.
  bool search_near(std::span<const Centroid> spots, const Observer& observer, const Search& how, Identification& out,
                   std::span<MatchedStar> matches);
  bool try_candidate(std::span<const Centroid> spots, const Observer& observer, const Search& how,
                     const Candidate& candidate, const int (&corner)[3], Identification& out,
                     std::span<MatchedStar> matches);
  Side side(std::span<const Centroid> spots, int i, int j, const Search& how) const;
  double chance_triangles(std::size_t pairs, const Side& ab, const Side& bc, double sine_b) const;
  // All triples of index stars that look like these spots, into candidates_; returns how many chance makes (eq. 8b).
  double triangles(std::span<const Centroid> spots, const int (&corner)[3], const Search& how);
  bool confirmed(const Mat3& R_CN, const int (&corner)[3], double radius_px) const;

  // identify_judge.cpp: from a hypothesis to an attitude, or to nothing.
  void gather_stars(const Mat3& R_CN, const Observer& observer, std::size_t spots, double margin_px);
  int match(std::span<const Centroid> spots, const Mat3& R_CN, const Intrinsics& camera, double radius_px,
            std::size_t enough);
  void drop_mixed(std::span<const Centroid> spots);
  void drop_wrong_brightness(std::span<const Centroid> spots);
  double zero_point(const Star& star, std::span<const Centroid> spots) const;
  void mark_stars(std::span<const Centroid> spots, double radius_px);
  double unexplained_sigma_px();
  Result<AttitudeFit> fit(const AttitudeFit& start, AttitudeOptions options);
  std::optional<AttitudeFit> fit_bent(const AttitudeFit& start, const AttitudeFit& straight, AttitudeOptions& options);
  double chance(std::span<const Centroid> spots, const Claim& claim, double radius_px, int parameters) const;
  void attend(const Mat3& R_CN);
  bool judge(std::span<const Centroid> spots, const Observer& observer, const Claim& claim, Identification& out,
             std::span<MatchedStar> matches);

  const StarField& field_;
  const PairIndex& index_;
  Intrinsics believed_;
  Intrinsics camera_;  // as tried just now: with another focal length where that is not known
  IdentifySettings settings_;
  double pixel_rad_ = 0.0;
  bool mirrored_ = false;                 // tried just now
  const Attention* attention_ = nullptr;  // what the spots are of; nullptr: the whole frame
  std::int64_t looked_at_ = 0;            // entries of the pair index
  double zero_point_ = 0.0;               // of the stars' magnitudes, NaN where too few tell it
  double expected_ = 0.0;                 // chance hypotheses among all that were looked up

  std::vector<Centroid> turned_;           // a mirrored picture's spots, turned right
  std::vector<Vec3> spot_C_;               // directions of all spots
  std::vector<int> asterism_;              // indices of spots
  std::vector<std::int32_t> grid_, next_;  // spots by 32-pixel tiles
  std::vector<std::int32_t> star_grid_, star_next_;
  int grid_width_ = 0, grid_height_ = 0;
  std::vector<Star> stars_;
  std::vector<std::uint32_t> cone_;
  double cone_radius_rad_ = 0.0;
  struct Bright {
    float v_mag;
    std::uint32_t star;
  };
  std::vector<Bright> by_brightness_;
  std::vector<StarSight> sights_;
  std::vector<std::uint32_t> sight_star_;
  std::vector<unsigned char> on_star_;
  std::vector<double> numbers_;     // for medians
  std::vector<std::int32_t> head_;  // of each index star: chain of partners for one side of the triangle
  std::vector<std::uint32_t> stamp_;
  std::uint32_t now_ = 0;
  struct Link {
    std::uint16_t partner;
    std::uint16_t ray;  // of a star of spots
    std::int32_t next;
  };
  struct Ray {
    int spot = 0;
    Side side;
    std::span<const PairIndex::Pair> pairs;
  };
  struct Corner {  // between two rays
    Side side;
    bool right_handed = false;
    bool wanted = false;
  };
  std::vector<Link> links_;
  std::vector<Candidate> candidates_;
  std::vector<Ray> rays_;
  std::vector<Corner> corners_;  // of the newest ray with those before it
};

}  // namespace astronav::vision
