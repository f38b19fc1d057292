// SPDX-License-Identifier: Apache-2.0
// Records: what a flown mission leaves behind, from which summary, files and report are made.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "foundation/image/image.h"
#include "foundation/math/linear.h"
#include "foundation/time/epoch.h"
#include "models/camera/camera.h"
#include "models/ephemeris/bodies.h"
#include "models/ephemeris/ephemeris.h"

namespace astronav::loop {

enum class EventKind : unsigned char {
  survey_image,  // of a start from nothing: an attitude and spots, but no estimate
  image,         // an image was taken (and, where a planet was found, the filter was updated)
  window_end,    // a tracking window ends
  cycle_end,     // the second window of a cycle ends: what "steady state" is read from
  coast_end,     // the long propagation ends
  coast_sample,  // a point in between, for plots only
};

// What the attitude filter knew of an image: of its attitude before it was looked at, in axes that hang on pixels, and
// of the gyro's bias after it. Errors are truth minus estimate (R_true = exp(-[error]x) R_estimate).
struct AttitudeRecord {
  bool foretold = false;
  bool after_slew = false;  // foretold through the slew between two windows
  Vec3 error_rad = Vec3::Zero();
  Vec3 sigma_rad = Vec3::Zero();
  double nees = 0.0;       // of three degrees
  bool accepted = false;   // the frame's attitude, by the filter
  bool restarted = false;  // it was not: the filter began anew
  double nis = 0.0;        // of three degrees
  bool knows_bias = false;
  Vec3 bias_error_rad_s = Vec3::Zero();
  Vec3 bias_sigma_rad_s = Vec3::Zero();
};

// One row of records.csv. Estimates are those after the event.
struct Event {
  EventKind kind = EventKind::image;
  Epoch epoch;
  int cycle = 0;   // from 0
  int window = 0;  // 0 or 1
  int image = -1;  // running number, -1 for events without an image
  BodyId body;     // the beacon, where there is one
  State truth;     // barycentric
  State estimate;
  Mat6 covariance = Mat6::Zero();  // of position and velocity, m, m/s
  double nees = 0.0;               // of the 6 states

  // image only
  bool attitude_found = false;
  bool attitude_wrong = false;  // found, but off by more than 5 sigma and 60 arcsec
  bool by_prior = false;        // found where it was expected; otherwise lost in space
  bool planet_found = false;    // a spot was accepted as the planet
  bool planet_false = false;    // ... and it was not the planet (more than 3 px off)
  bool accepted = false;        // the filter took the measurement
  bool for_start = false;       // ... was not asked: the measurement is one of the batch that starts it
  Vec2 innovation_px = Vec2::Zero();
  Mat2 innovation_covariance_px2 = Mat2::Zero();
  double nis = 0.0;
  Vec2 planet_error_px = Vec2::Zero();  // measured minus true pixel, as the onboard software sees it
  Vec2 planet_sigma_px = Vec2::Zero();
  double planet_repeating_px = 0.0;        // what it is told to be off by in all images of the window, an axis
  Vec3 attitude_error_rad = Vec3::Zero();  // camera axes
  Vec3 attitude_sigma_rad = Vec3::Zero();
  Vec3 attitude_repeating_rad = Vec3::Zero();  // the part of it that comes again with the same stars
  int stars_matched = 0;
  int spots = 0;
  double centroid_error_sum2_px2 = 0.0;  // over matched stars, both axes
  int centroid_error_count = 0;          // axes summed
  AttitudeRecord attitude;               // of a spacecraft with a gyro
};

struct StageTimes {  // milliseconds; sums over `count`
  double render = 0.0, centroid = 0.0, identify = 0.0, planets = 0.0, propagate = 0.0, update = 0.0;
};

// A frame kept for the report, with what the onboard software made of it.
struct KeptFrame {
  Epoch epoch;
  BodyId beacon;
  ImageU16 pixels;
  struct Mark {
    Pixel pixel;
    std::string label;  // "HIP 32349", "mars", ""
    std::string kind;   // "star", "planet", "predicted", "spot"
    double radius_px = 6.0;
  };
  std::vector<Mark> marks;
};

struct BeaconChoice {
  int cycle = 0;
  Epoch epoch;
  BodyId first, second;
  double figure_of_merit_km = 0.0;
  struct Candidate {
    BodyId body;
    double v_mag = 0.0, sun_elongation_deg = 0.0, distance_km = 0.0;
    bool visible = false;
    std::string why_not;  // "Sun exclusion", "too faint", ...
  };
  std::vector<Candidate> candidates;
};

// How the mission came to its first state.
struct StartRecord {
  std::string from = "prior";  // or "survey"
  int cycle = 0;               // whose windows gave the state; of the prior: the first
  int surveys = 0;             // flown, and their pictures
  int pictures = 0;
  std::vector<BodyId> named;           // planets that the last survey found
  Vec3 survey_error_m = Vec3::Zero();  // of its place
  Mat3 survey_covariance_m2 = Mat3::Zero();
  Vec6 error = Vec6::Zero();  // of the first state, m, m/s
  Mat6 covariance = Mat6::Zero();
};

struct Records {
  StartRecord start;
  std::vector<Event> smoothed;  // by all images of the mission, without their rows; where that was asked for
  std::vector<Event> events;
  std::vector<KeptFrame> frames;
  std::vector<BeaconChoice> beacons;
  std::vector<double> image_ms;  // onboard time of each image
  StageTimes stage_ms_sum;
  // Heliocentric places of the planets 1..8 for the picture, evenly spaced from begin to end; index = NAIF barycentre.
  std::vector<Vec3> planet_tracks_m[9];
  Epoch begin;  // of the mission
  Epoch end;
  int cycles = 0;
  int images = 0;
  double duration_days = 0.0;
  double wall_s = 0.0;
  double peak_memory_mb = 0.0;
  std::string level;
  std::uint64_t seed = 1;
  std::uint64_t sample = 0;
  std::string version;
  std::string scenario_toml;  // resolved
};

}  // namespace astronav::loop
