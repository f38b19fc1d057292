// SPDX-License-Identifier: Apache-2.0
// Solver: attitude, field of view and planets from one picture of the sky.
#pragma once

#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "foundation/base/error.h"
#include "foundation/raster/raster.h"
#include "models/camera/camera.h"
#include "models/ephemeris/ephemeris.h"
#include "models/stars/catalogue.h"
#include "verification/opensky/blind.h"
#include "verification/opensky/spots.h"

namespace astronav::opensky {

struct FieldRange {  // horizontal, rad
  double min_rad = 0.0;
  double max_rad = 0.0;
};

struct SolveRequest {
  std::optional<FieldRange> field;  // neither field nor camera: a ladder of fields from 4 to 60 degrees
  std::optional<Intrinsics> camera;
  std::optional<Epoch> epoch;     // J2025.0 for proper motion where it is not given
  std::optional<State> observer;  // barycentric; aberration is corrected where it is known
  std::optional<Near> near;
  const Ephemeris* ephemeris = nullptr;  // with epoch and observer: planets are looked for
};

struct SolvedStar {
  vision::MatchedStar match;
  vision::Centroid spot;
  double v_mag = 0.0;
};
struct SolvedPlanet {
  BodyId body;
  vision::Centroid spot;
  Pixel predicted;
  double mahalanobis = 0.0;
  double v_mag_predicted = 0.0;
  double v_mag_measured = 0.0;
};
struct SolveTimes {  // ms
  double centroid = 0.0, identify = 0.0, attitude = 0.0, planets = 0.0, total = 0.0;
};

struct Solution {
  int width = 0, height = 0;
  vision::AttitudeSolution attitude;  // of the picture as seen by a camera that is not mirrored: see `mirrored`
  bool mirrored = false;              // then u in `attitude` counts from the right: u_picture = width - 1 - u
  Epoch epoch;
  bool epoch_assumed = true;
  bool aberration_corrected = false;
  std::vector<SolvedStar> stars;  // pixels as in the picture
  std::vector<SolvedPlanet> planets;
  std::vector<vision::Centroid> unknown;  // what is neither
  std::size_t detected = 0;
  SolveTimes time_ms;
};

class Solver {
 public:
  // The catalogue must outlive the object. Lists of stars are made when a field first asks for them, and kept.
  explicit Solver(const StarCatalogue& catalogue, double max_v_mag = 11.0);

  // no_match where nothing convinces: never a guess. invalid_argument for an impossible field of view; unsupported for
  // a fisheye.
  Result<Solution> solve(const Picture& picture, const SolveRequest& request);

 private:
  Result<BlindSolution> identify(std::span<const vision::Centroid> spots, int width, int height,
                                 const SolveRequest& request, const vision::Observer& observer);
  void find_planets(const Picture& picture, const SolveRequest& request, std::span<const vision::Centroid> spots,
                    const BlindSolution& known, Solution& solution);

  const StarCatalogue& catalogue_;
  double max_v_mag_;
  vision::StarField field_;
  std::unique_ptr<BlindSearch> blind_;
};

}  // namespace astronav::opensky
