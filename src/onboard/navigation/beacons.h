// SPDX-License-Identifier: Apache-2.0
// Beacon selection: which two planets to track now, and why not the others.
//
// Two sights i with weight w_i = 1/((d_i s_i)^2 + e_i^2) and separation gamma fix a position with
//   tr P = 1/(w1 + w2) + (w1 + w2)/(w1 w2 sin^2 gamma)                       (docs/theory/navigation.md eq. 9)
// The pair with the least tr P among the usable beacons is best; or, where the filter's covariance is given, the one
// that leaves it the least trace of position after both updates (eq. 9b). A turn from one to the other that takes
// longer than there is time rules a pair out (eq. 9a). No heap.
#pragma once

#include <array>
#include <span>

#include "foundation/base/error.h"
#include "foundation/time/epoch.h"
#include "models/ephemeris/ephemeris.h"
#include "onboard/navigation/state.h"

namespace astronav::navigation {

inline constexpr int kMaxBeacons = 8;

// How fast the platform turns from rest to rest: speeding up, at most at the greatest rate, slowing down, settling.
struct Agility {
  double max_rate_rad_s = 0.5 * kDegree;
  double max_acceleration_rad_s2 = 0.02 * kDegree;
  double settle_s = 60.0;  // until the pointing is quiet enough for images
};
double slew_time_s(const Agility& agility, double angle_rad);

enum class BeaconMode : unsigned char {
  static_merit,  // the position that the two sights would give alone
  filter_merit,  // the filter's position after both; needs its covariance
};

struct BeaconSettings {
  std::array<BodyId, kMaxBeacons> candidates{body::mercury, body::venus,  body::earth, body::mars,
                                             body::jupiter, body::saturn, BodyId{},    BodyId{}};  // 0 ends the list
  double sun_exclusion_rad = 35.0 * kDegree;  // least angle between beacon and Sun
  double v_magnitude_limit = 6.0;
  double max_angular_diameter_rad = 300.0 * kArcsecond;
  // Another planet, or the Moon, nearer than this and less than `blend_magnitudes` fainter spoils the centroid.
  double min_separation_rad = 210.0 * kArcsecond;
  double blend_magnitudes = 6.0;
  double sight_sigma_rad = 1.0 * kArcsecond;            // of a whole window's line of sight
  std::array<double, kMaxBeacons> ephemeris_sigma_m{};  // per axis, in the order of the candidates
  BeaconMode mode = BeaconMode::static_merit;
  Agility agility;
  double slew_s = 1500.0;    // between the windows; a longer turn rules a pair out
  double window_s = 3600.0;  // of one beacon
};

enum class BeaconVerdict : unsigned char { usable, sun_exclusion, too_faint, too_large, blended, no_ephemeris };
// "usable", "Sun exclusion", "too faint", "too large", "close to another body", "not in the ephemeris".
const char* name(BeaconVerdict verdict);

struct BeaconCandidate {
  BodyId body;
  BeaconVerdict verdict = BeaconVerdict::no_ephemeris;
  bool usable() const { return verdict == BeaconVerdict::usable; }
  Vec3 direction_N = Vec3::Zero();  // apparent (light time, aberration)
  double v_magnitude = 0.0;
  double sun_elongation_rad = 0.0;
  double distance_m = 0.0;
  double phase_angle_rad = 0.0;
  double angular_diameter_rad = 0.0;
  double nearest_rad = 0.0;     // separation from the nearest body that could spoil it
  BodyId nearest;               // ... 0 where there is none
  double sigma_across_m = 0.0;  // 1/sqrt(w): position sigma across its line of sight
};

struct BeaconPair {
  BodyId first, second;  // the stronger one (larger w) first
  double separation_rad = 0.0;
  double figure_of_merit_m = 0.0;  // sqrt(tr P), 1 sigma
  double filter_merit_m = 0.0;     // the same of the filter's position after both; 0 without its covariance
  double slew_s = 0.0;             // from one to the other
};

struct BeaconSelection {
  std::array<BeaconCandidate, kMaxBeacons> all{};
  int candidate_count = 0;
  std::array<BeaconPair, kMaxBeacons*(kMaxBeacons - 1) / 2> ranked{};
  int pair_count = 0;
  // In the order of the settings; pairs best first. Not of a temporary, whose arrays would be gone.
  std::span<const BeaconCandidate> candidates() const& {
    return {all.data(), static_cast<std::size_t>(candidate_count)};
  }
  std::span<const BeaconPair> pairs() const& { return {ranked.data(), static_cast<std::size_t>(pair_count)}; }
  std::span<const BeaconCandidate> candidates() const&& = delete;
  std::span<const BeaconPair> pairs() const&& = delete;
  // The usable beacon with the least sigma_across_m, for when there is no pair; null where there is none.
  const BeaconCandidate* best_single() const&;
  const BeaconCandidate* best_single() const&& = delete;
};

// What is left of the filter's covariance (m, m/s) after a sight of each beacon, the second `gap_s` later:
// sqrt(tr P_rr). Free flight between; gravity and process noise do nothing in hours.
double filter_merit_m(const Mat6& covariance, const BeaconCandidate& first, const BeaconCandidate& second,
                      double gap_s);

// `observer` is barycentric, `covariance` the filter's of position and velocity, where there is one; BeaconMode
// filter_merit without it is invalid_argument. Bodies that the ephemeris lacks get that verdict; out_of_range only
// where the Sun is lacking.
Result<BeaconSelection> select_beacons(const Ephemeris& ephemeris, const State& observer, Epoch epoch,
                                       const BeaconSettings& settings, const Mat6* covariance = nullptr);

}  // namespace astronav::navigation
