// SPDX-License-Identifier: Apache-2.0
// Solver: attitude, field of view and planets from one picture of the sky.
#pragma once

#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "foundation/base/error.h"
#include "foundation/math/rotation.h"
#include "foundation/raster/raster.h"
#include "models/camera/camera.h"
#include "models/ephemeris/ephemeris.h"
#include "models/stars/catalogue.h"
#include "verification/opensky/blind.h"
#include "verification/opensky/solver_fit.h"
#include "verification/opensky/solver_planets.h"
#include "verification/opensky/spots.h"

namespace astronav::opensky {

struct SolveRequest {
  std::optional<FieldRange> field{};  // neither field nor camera: a ladder of fields from 4 to 62 degrees
  // Lens and all are believed; where no stars fit, the focal length within 3 %. A fisheye must be given.
  std::optional<Intrinsics> camera{};
  std::optional<Epoch> epoch{};            // J2025.0 for proper motion where it is not given
  std::optional<State> observer{};         // barycentric; aberration is corrected where it is known
  std::optional<Refraction> refraction{};  // of an observer on the ground
  std::optional<Near> near{};              // with a camera three stars, or two and a planet, are enough
  const Ephemeris* ephemeris = nullptr;    // with epoch and observer: planets are looked for
};

struct SolveTimes {  // ms; lists of stars are made when a field of view is first asked for, and kept
  double centroid = 0.0, lists = 0.0, identify = 0.0, attitude = 0.0, planets = 0.0, total = 0.0;
};

struct Solution {
  int width = 0, height = 0;
  vision::AttitudeSolution attitude;  // of the picture as seen by a camera that is not mirrored: see `mirrored`
  bool mirrored = false;              // then u in `attitude` counts from the right: u_picture = width - 1 - u
  Mat3 center_covariance_rad2 = Mat3::Zero();  // as of FinalFit
  Epoch epoch;
  bool epoch_assumed = true;
  bool aberration_corrected = false;
  bool refraction_corrected = false;
  std::vector<SolvedStar> stars;  // pixels as in the picture
  std::vector<SolvedPlanet> planets;
  std::vector<vision::Centroid> unknown;  // what is neither
  std::size_t detected = 0;
  SolveTimes time_ms;
};

// Of the picture's centre, ((width-1)/2, (height-1)/2); up is towards row 0.
Pointing center_pointing(const Solution& solution);

class Solver {
 public:
  // The catalogue must outlive the object. Lists of stars are made when a field first asks for them, and kept.
  explicit Solver(const StarCatalogue& catalogue, double max_v_mag = 11.0);

  // no_match where nothing convinces: never a guess. invalid_argument for an impossible field of view.
  Result<Solution> solve(const Picture& picture, const SolveRequest& request);

 private:
  struct Known {
    NamedStars stars;
    double lists_ms = 0.0;
  };
  // The spots of a mirrored picture are turned round where the answer is mirrored.
  Result<Known> identify(std::vector<vision::Centroid>& spots, const SolveRequest& request, const SeenFrom& from,
                         int width, int height);
  Result<Known> identify_blind(std::span<const vision::Centroid> spots, const SolveRequest& request,
                               const SeenFrom& from, int width, int height);
  Result<Known> identify_roughly(std::span<const vision::Centroid> spots, const SolveRequest& request,
                                 const SeenFrom& from);
  Result<Known> identify_all_sky(std::span<const vision::Centroid> spots, const SolveRequest& request,
                                 const SeenFrom& from);

  const StarCatalogue& catalogue_;
  vision::StarField field_;
  std::unique_ptr<BlindSearch> blind_;
};

}  // namespace astronav::opensky
