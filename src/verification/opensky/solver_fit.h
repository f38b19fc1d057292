// SPDX-License-Identifier: Apache-2.0
// The last fit of a solution: stars that are known by name, seen through the air, by a lens that may bend lines in ways
// of its own.
#pragma once

#include <optional>
#include <span>
#include <vector>

#include "models/ephemeris/ephemeris.h"
#include "models/ephemeris/refraction.h"
#include "models/stars/catalogue.h"
#include "onboard/vision/attitude.h"
#include "onboard/vision/types.h"

namespace astronav::opensky {

// What the identification has told.
struct NamedStars {
  struct Name {
    std::uint32_t catalogue_index = 0;
    std::uint32_t spot = 0;
  };
  std::vector<Name> names;
  Mat3 R_CN = Mat3::Identity();
  Intrinsics camera;
  bool lens_is_known = false;    // then only the attitude is solved for
  bool shape_is_known = false;   // centre and distortion to begin with, the focal length only about
  bool mirrored = false;         // the spots are those of the picture turned right
  double extra_sigma_px = 0.25;  // of an axis: catalogue, lens and blends, beside the centroids' own
  double chance_probability = 1.0;
};

struct SeenFrom {
  Epoch epoch;
  std::optional<State> observer{};  // barycentric
  std::optional<Refraction> refraction{};
};

// Attitude, and what of the lens is not known: focal length and k1 (p1 and p2 from 20 stars on); where those leave more
// than half a pixel an axis, of richer models the one that foretells held-out stars best (docs/theory/camera.md).
// How far stars scatter beside what their spots say is found from the residuals, and so is the covariance; where
// fewer than kFreedomThatTells degrees of freedom are left, NamedStars::extra_sigma_px is believed if it is more
// (docs/theory/vision.md, open skies). `stars`: those that took part. not_converged where that fails.
inline constexpr int kFreedomThatTells = 8;
struct FinalFit {
  vision::AttitudeSolution attitude;
  // Of the picture's middle, where a lens that is not known lets it be told better than the camera's own axis: turns
  // about right, down and into the picture there.
  Mat3 center_covariance_rad2 = Mat3::Zero();
  std::vector<vision::MatchedStar> stars;
};
Result<FinalFit> fit_named_stars(const StarCatalogue& catalogue, const NamedStars& named,
                                 std::span<const vision::Centroid> spots, const SeenFrom& from);

}  // namespace astronav::opensky
