// SPDX-License-Identifier: Apache-2.0
// Vision: one frame in, attitude and planets out. The whole image processing of the flight software.
//
//   Vision vision(settings, camera, sensor, field, index);          // allocates, once
//   const FrameResult& result = vision.process(frame, observer, prior, predictions);   // never allocates
//
// The result lives in the Vision object until the next frame.
#pragma once

#include <array>
#include <optional>
#include <span>
#include <vector>

#include "foundation/image/image.h"
#include "onboard/vision/camera_belief.h"
#include "onboard/vision/centroids.h"
#include "onboard/vision/identify.h"
#include "onboard/vision/planets.h"
#include "onboard/vision/psf_group_fit.h"
#include "onboard/vision/star_memory.h"
#include "onboard/vision/types.h"

namespace astronav::vision {

struct VisionSettings {
  CentroidSettings centroids;
  IdentifySettings identify;
  PlanetSettings planets;
  CameraSigmas camera;            // what is learned of the camera's geometry in flight
  double prior_radius_px = 15.0;  // how far off a prior attitude may put the stars
  // With a prior attitude only the surroundings of so many of the brightest stars, and of the planets, are looked at;
  // the whole frame where that does not convince. 0: always the whole frame.
  std::size_t guide_stars = 40;
  std::size_t first_guides = 10;  // looked for in the whole radius; where they are tells where the others must be
  std::size_t max_planets = 16;
};

enum class AttitudeSource : unsigned char { none, lost_in_space, prior };

struct StageTimes {  // ms
  double centroid = 0.0, identify = 0.0, planets = 0.0, total = 0.0;
};

struct FrameResult {
  FrameLevel level;
  std::span<const Centroid> centroids;  // brightest first; then discs, and bodies in the wings of others
  bool whole = true;                    // false: only the surroundings of what was expected were looked at
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

  // From now on the stars that stand in a body's light are looked up in `deeper`, which must outlive the object.
  void look_up_neighbours_in(const StarField& deeper) { neighbours_ = &deeper; }

  // `observer`: place, velocity and mid-exposure epoch as believed; 100 m/s are 0.07 arcsec.
  const FrameResult& process(ImageView<const std::uint16_t> frame, const Observer& observer,
                             const std::optional<Mat3>& prior_R_CN = {},
                             std::span<const PlanetPrediction> predictions = {});

  // What is believed of the camera's geometry by now.
  const Intrinsics& camera() const { return geometry_.camera(); }
  // What was learned of the optics, for the middle of the field.
  LocalPsf psf_in_the_middle() const { return finder_.psf().at(middle_); }

 private:
  Result<Identification> identify_within(ImageView<const std::uint16_t> frame, const Observer& observer,
                                         const Mat3& prior_R_CN, std::span<const PlanetPrediction> predictions);
  Result<Identification> identify_whole(ImageView<const std::uint16_t> frame, const Observer& observer,
                                        const std::optional<Mat3>& prior_R_CN);
  void refine_attitude();
  void attend_stars(const Mat3& R_CN, std::size_t most, double reach_px);
  void attend_planets(const AttitudeSolution& attitude, std::span<const PlanetPrediction> predictions);
  bool stayed(const PlanetMatch& match, Epoch epoch);
  void admit_discs(std::span<const PlanetPrediction> predictions);
  // vision_planets.cpp: which spot is which body.
  void name_planets(ImageView<const std::uint16_t> frame, const Observer& observer,
                    std::span<const PlanetPrediction> predictions);
  static constexpr std::size_t kNone = static_cast<std::size_t>(-1);
  // A body that shines in the frame: one that is looked for (at its index among them), or one told beside it.
  struct Body {
    Pixel at;  // foretold
    Mat2 covariance_px2 = Mat2::Identity();
    double flux_dn = 0.0;  // 0: nothing is known of its light
    LitDisc disc{};        // of no radius where it is a point, or its Sun is not known
    bool asked = true;
    // The other of a pair whose offset is foretold better than their places (the Earth and the Moon).
    std::size_t partner = kNone;
    double offset_sigma_px = 0.0;
    // Once it was measured beside others:
    std::size_t spot = kNone;      // its own
    std::size_t leans_on = kNone;  // the brighter one among them: named only if that is
    bool mixed = false;            // its light cannot be told from theirs
  };
  void list_bodies(std::span<const PlanetPrediction> predictions);
  LitDisc disc_of(const PlanetPrediction& prediction) const;
  static double foretold_px(const Body& body) { return std::sqrt(body.covariance_px2.trace()); }
  void see_discs(ImageView<const std::uint16_t> frame, std::size_t asked);
  void see_as_disc(ImageView<const std::uint16_t> frame, const Body& body, Centroid& spot);
  // What a disc adds to the error that repeats.
  double repeating_of_disc(const PlanetPrediction& prediction, const Body& body) const;
  // What runs into a body's light.
  struct Company {
    std::array<LightBeside, kMostBeside> lights;
    std::size_t count = 0, bodies = 0;  // bodies, then stars
    std::size_t brightest = kNone;      // body, measured and brighter than this one
    bool mixed = false;                 // one is brighter and cannot be told itself
    double pull_px = 0.0;               // by how much stars may move its spot, if they are left in it
    std::span<const LightBeside> all() const { return {lights.data(), count}; }
  };
  Company company_of(std::size_t index, const Observer& observer);
  void add_stars(const Body& body, const Observer& observer, Company& company);
  bool is_free(std::size_t spot, const Body& body) const;
  std::size_t free_spot(const Body& body, double radius_px, bool alike) const;
  void part(ImageView<const std::uint16_t> frame, const Observer& observer, std::size_t index);
  bool part_brightest(ImageView<const std::uint16_t> frame, Body& body, const Company& company);
  void keep(Body& body, Centroid measured);
  bool cleared_of_stars(ImageView<const std::uint16_t> frame, const Observer& observer, const Body& foretold,
                        Centroid& spot);

  VisionSettings settings_;
  double psf_sigma_px_, saturation_dn_;
  const StarField& field_;
  const StarField* neighbours_ = &field_;
  Intrinsics camera_;
  Pixel middle_;
  CentroidFinder finder_;
  Identifier identifier_;
  CameraBelief geometry_;
  StarMemory star_memory_;
  std::vector<StarSight> sights_;
  Attention attention_;
  std::vector<Pixel> guides_;
  double centroided_ms_ = 0.0;  // the clock when the spots were there
  PlanetMemory memory_;
  std::vector<Centroid> centroids_;
  std::vector<MatchedStar> stars_;
  std::vector<PlanetMatch> planets_;
  std::vector<unsigned char> is_star_;
  std::vector<Body> bodies_;           // predictions first
  std::vector<std::size_t> by_light_;  // bodies
  std::vector<std::uint32_t> near_;    // stars
  FrameResult result_;
};

}  // namespace astronav::vision
