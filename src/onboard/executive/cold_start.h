// SPDX-License-Identifier: Apache-2.0
// ColdStart: from a clock, a map of the stars, an ephemeris and where the Sun is to a first state of the filter. No
// place and no velocity is known before, and no planet.
//
//   ColdStart start(settings, ephemeris, field);
//   start.begin_survey(to_sun_N);                         // pictures along the ecliptic, the Sun left out
//   for (int k = 0; k < start.pictures(); ++k)            // one each picture_period(), camera at picture_R_CN(k)
//     start.see(eyes.process(frame, {.epoch = t}), t);
//   navigator.start(*start.locate());                     // good enough to point, and to find planets
//   ...two windows, each image by Navigator::watch: start.add(look)
//   navigator.start(*start.solve());                      // from now on as with any other start
//
// The Sun's direction comes from a sun sensor, which every spacecraft has; a few degrees are enough, as it only says
// which part of the ecliptic is left out. Allocates nothing.
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <span>

#include "foundation/base/error.h"
#include "foundation/time/epoch.h"
#include "models/ephemeris/ephemeris.h"
#include "onboard/executive/navigator.h"
#include "onboard/navigation/batch.h"
#include "onboard/navigation/survey.h"
#include "onboard/vision/star_field.h"
#include "onboard/vision/vision.h"

namespace astronav::executive {

struct ColdStartSettings {
  navigation::SurveySettings survey;
  navigation::FilterSettings filter;  // what the batch believes of forces, sights and biases
  double mass_kg = 25.0;
  navigation::Agility agility;
  double sun_exclusion_rad = 35.0 * kDegree;
  double sun_sensor_rad = 3.0 * kDegree;  // at most: pictures keep so much farther from the Sun
  double limit_v_mag = 6.0;               // fainter spots are not asked
  double match_px = 3.0;                  // a spot so near to a star of about its brightness is that star
  double least_sigma_px = 0.05;           // of a spot: nobody knows yet how planets are lit
  int images_per_window = 36;
};

// What a survey made of the sky, for the record.
struct SurveyCount {
  int pictures = 0, solved = 0;  // those whose attitude was found
  int spots = 0;                 // that are no stars
};

class ColdStart {
 public:
  // The ephemeris must outlive it; `field` (nullptr: no pictures, only see_spots) too.
  ColdStart(const ColdStartSettings& settings, const Ephemeris& ephemeris, const vision::StarField* field);

  // Plans the pictures, forgets what was seen before. limit_exceeded: the field of view is too narrow for a survey.
  Result<void> begin_survey(const Vec3& to_sun_N);
  int pictures() const { return pictures_; }
  // From one picture to the next: the time that the platform needs to turn.
  Duration picture_period() const;
  // Of all pictures, with the turn to the first beacon.
  Duration survey_duration() const { return picture_period() * (pictures_ + 1); }
  // How the camera has to stand: rows along the ecliptic, north up.
  Mat3 picture_R_CN(int picture) const;

  // A picture, looked at by eyes that were told an observer at rest. Returns its spots that are no stars.
  int see(const vision::FrameResult& picture, Epoch mid_exposure);
  // The same where somebody else made the spots; SurveySpot::frame is filled in here.
  void see_spots(const Mat3& R_CN, Epoch mid_exposure, std::span<const navigation::SurveySpot> spots);
  const SurveyCount& count() const { return count_; }

  // Where the spacecraft is, by the survey, moving on a circle give or take 8 km/s. Errors of navigation::survey.
  Result<navigation::InitialState> locate();
  // The naming behind it; valid after locate().
  const navigation::SurveySolution& place() const { return place_; }
  // Which planets were named, each once.
  std::span<const BodyId> named() const { return {named_.data(), named_count_}; }

  // An image of a window (Navigator::watch, measured).
  void add(const navigation::BeaconMeasurement& measurement);
  // The state at the last image. no_match: one planet alone, or windows that do not agree with the survey.
  Result<navigation::InitialState> solve();

 private:
  navigation::SurveyFrame& begin_frame(const Mat3& R_CN, Epoch epoch);
  void keep(const navigation::SurveySpot& spot);
  double photocentre_sigma_rad(BodyId body, Epoch epoch, double* ephemeris_sigma_m) const;

  ColdStartSettings settings_;
  const Ephemeris* ephemeris_;
  const vision::StarField* field_;
  double half_gap_rad_, step_rad_ = 0.0;
  double sun_longitude_rad_ = 0.0;
  int pictures_ = 0;
  SurveyCount count_;

  std::array<navigation::SurveyFrame, navigation::kMaxSurveyFrames> frames_{};
  std::size_t frame_count_ = 0;
  std::array<navigation::SurveySpot, navigation::kMaxSurveySpots> spots_{};  // the brightest
  std::size_t spot_count_ = 0;
  navigation::SurveySolution place_;
  navigation::BatchStart start_;
  std::array<BodyId, navigation::kMaxSurveySpots> named_{};
  std::size_t named_count_ = 0;

  std::array<navigation::BatchSight, navigation::kMaxBatchSights> sights_{};
  std::size_t sight_count_ = 0;
  int images_ = 0;
  double bias_rad_ = 0.0;  // that all sights of a window share, the largest
};

}  // namespace astronav::executive
