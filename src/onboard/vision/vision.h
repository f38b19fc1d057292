// SPDX-License-Identifier: Apache-2.0
// Vision: one frame in, attitude and planets out. The whole image processing of the flight software.
//
//   Vision vision(settings, camera, sensor, field, index);          // allocates, once
//   const FrameResult& result = vision.process(frame, observer, prior, predictions);   // never allocates
//
// The result lives in the Vision object until the next frame.
#pragma once

#include <optional>
#include <span>
#include <vector>

#include "foundation/image/image.h"
#include "onboard/vision/centroids.h"
#include "onboard/vision/identify.h"
#include "onboard/vision/planets.h"
#include "onboard/vision/types.h"

namespace astronav::vision {

struct VisionSettings {
  CentroidSettings centroids;
  IdentifySettings identify;
  PlanetSettings planets;
  double prior_radius_px = 15.0;  // how far off a prior attitude may put the stars
  std::size_t max_planets = 16;
};

enum class AttitudeSource : unsigned char { none, lost_in_space, prior };

struct StageTimes {  // ms
  double centroid = 0.0, identify = 0.0, planets = 0.0, total = 0.0;
};

struct FrameResult {
  FrameLevel level;
  std::span<const Centroid> centroids;  // brightest first
  AttitudeSource source = AttitudeSource::none;
  AttitudeSolution attitude;  // valid where source != none
  std::span<const MatchedStar> stars;
  std::span<const PlanetMatch> planets;  // one for each prediction, in step; found or not
  int hypotheses = 0;
  StageTimes time_ms;
};

class Vision {
 public:
  // Field and index (made by StarField::build and build_pair_index, or mapped) must outlive the object.
  Vision(const VisionSettings& settings, const Intrinsics& camera, const SensorModel& sensor, const StarField& field,
         const PairIndex& index);

  // `observer`: place, velocity and mid-exposure epoch as believed; 100 m/s are 0.07 arcsec.
  const FrameResult& process(ImageView<const std::uint16_t> frame, const Observer& observer,
                             const std::optional<Mat3>& prior_R_CN = {},
                             std::span<const PlanetPrediction> predictions = {});

 private:
  // What a disc, fitted as a point, adds to the error that repeats.
  double repeating_of_disc(const PlanetPrediction& prediction) const;
  bool stayed(const PlanetMatch& match, Epoch epoch);
  // False where that is needed and fails.
  bool part_from_companion(ImageView<const std::uint16_t> frame, const PlanetPrediction& prediction);

  VisionSettings settings_;
  double psf_sigma_px_;
  CentroidFinder finder_;
  Identifier identifier_;
  PlanetMemory memory_;
  std::vector<Centroid> centroids_;
  std::vector<MatchedStar> stars_;
  std::vector<PlanetMatch> planets_;
  std::vector<unsigned char> is_star_;
  FrameResult result_;
};

}  // namespace astronav::vision
