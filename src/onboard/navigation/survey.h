// SPDX-License-Identifier: Apache-2.0
// Survey: where the spacecraft is, from a few frames of different parts of the sky, an epoch, and nothing else.
//
// Spots that are no catalogue stars may be planets, but which? Every pair of spots is held to be every pair of bodies.
// Two sights cross where the spacecraft would be, or pass each other; further spots, the brightness of all, and planets
// that should be seen from there but are not, decide. What is left is weighed against every other assignment and
// against chance, and the answer comes with a probability (docs/theory/vision.md eq. 15 to 17).
//
// Directions are those that stars without aberration give (the observer's velocity is not known): star and planet are
// shifted alike, and what differs across a field is part of the error budget. Light time is counted. Barycentric, N,
// SI. Does not allocate; the work is bounded by the number of spots and bodies.
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <span>

#include "foundation/base/error.h"
#include "foundation/math/linear.h"
#include "foundation/time/epoch.h"
#include "models/camera/camera.h"
#include "models/ephemeris/ephemeris.h"

namespace astronav::navigation {

struct SurveyFrame {
  Epoch epoch;  // mid-exposure
  Mat3 R_CN = Mat3::Identity();
  Intrinsics camera;
  double limit_v_mag = 6.0;  // fainter planets may well be missing
};

struct SurveySpot {
  std::size_t frame = 0;
  Vec3 direction_N = Vec3::UnitZ();
  double sigma_rad = 0.0;  // an axis: centroid and attitude
  double v_mag = 0.0;      // from the frame's stars
};

struct SurveySettings {
  double least_distance_au = 0.3;  // from the Sun
  double most_distance_au = 2.5;
  double most_height_au = 0.3;  // above and below the ecliptic
  // Along its way the spacecraft is taken to move on a circle, as the planets do, give or take this much.
  double velocity_sigma_m_s = 8e3;
  double speed_m_s = 40e3;       // at most, for what aberration does differently across a frame
  double v_mag_sigma = 0.4;      // of a planet: law, colour, light of a saturated spot
  double false_per_frame = 0.5;  // spots that are neither star nor planet
  double detection = 0.97;       // of a planet above the limit and clear of the frame's edge
  double sun_exclusion_rad = 20.0 * kDegree;
  double min_probability = 0.99;
};

struct SurveyNaming {
  std::size_t spot = 0;
  BodyId body;
};

inline constexpr std::size_t kMaxSurveySpots = 16;  // the brightest count
inline constexpr std::size_t kMaxSurveyFrames = 32;

struct SurveySolution {
  Epoch epoch;                        // of the first frame
  Vec3 p_O_N = Vec3::Zero();          // then
  Mat3 covariance_m2 = Mat3::Zero();  // the unknown velocity counted
  std::array<SurveyNaming, kMaxSurveySpots> named{};
  std::size_t count = 0;  // of spots named
  double chi2 = 0.0;      // of the sights; 2 count - 3 degrees of freedom
  double probability = 0.0;
  double runner_up = 0.0;  // probability of the next best naming
};

// Of a circle around the Sun in the plane of the ecliptic, the way the planets go; N, m/s.
Vec3 circular_velocity(const Vec3& p_from_sun_N, double gm_sun_m3_s2);

// no_match where no naming explains the spots, or several do about as well (then the error names both probabilities);
// invalid_argument for no frames, too many, or a spot of a frame that is not there.
Result<SurveySolution> survey(const Ephemeris& ephemeris, std::span<const SurveyFrame> frames,
                              std::span<const SurveySpot> spots, const SurveySettings& settings = {});

}  // namespace astronav::navigation
