// SPDX-License-Identifier: Apache-2.0
// Batch: sights of different moments, joined by the dynamics, give position and velocity without a filter and without
// much of a prior. What starts the filter from nothing: survey -> start_from_survey -> batch -> initial_state.
//
// Gauss-Newton on position, velocity, mass (that is CR A / m) and unmodelled acceleration at the first epoch, carried
// along by Process; the last two have priors, and so have, for each window (sights of one body in a row), a bias that
// all of it shares and a drift across it: they are eliminated window by window, so that what repeats is not averaged
// away (docs/theory/fix.md eq. 8 to 10). The acceleration is one that fades with its time constant and is not driven
// anew: an arc longer than that is refused. Sights far from the rest lose weight (Huber), then take no part.
// Barycentric, N, SI. No heap, bounded loops.
#pragma once

#include <optional>
#include <span>

#include "foundation/base/error.h"
#include "foundation/time/epoch.h"
#include "onboard/navigation/filter.h"
#include "onboard/navigation/process.h"
#include "onboard/navigation/survey.h"
#include "onboard/navigation/triangulation.h"

namespace astronav::navigation {

inline constexpr std::size_t kMaxBatchSights = 512;
inline constexpr std::size_t kMaxBatchWindows = 32;

struct BatchSight {
  Epoch epoch;
  BodySight sight;  // the direction is apparent, among stars that were aberrated by v_stars
  // Stars that were aberrated by another velocity than the true one turned the attitude as if the boresight had moved.
  Vec3 boresight_N = Vec3::UnitZ();
  Vec3 v_stars_m_s = Vec3::Zero();
};

struct BatchSettings {
  ProcessSettings process;
  SightSettings sight{.centre_of_light = false};
  double mass_kg = 25.0;
  double mass_sigma_kg = 2.5;                                           // 10 % of CR A / m
  GaussMarkov bias{.sigma = 0.3 * kArcsecond, .tau_s = 12.0 * 3600.0};  // of a window's sights, rad an axis
  Duration window_gap = Duration::seconds(900.0);
  double gate_probability = 0.9999;
  int max_iterations = 20;
};

struct BatchStart {
  Epoch epoch;  // not after the first sight
  State state;
  Mat6 covariance = Mat6::Zero();  // of position and velocity: a prior. Zero: none
};

struct BatchSolution {
  Epoch epoch;  // of the last sight
  State state;
  Mat6 covariance = Mat6::Zero();
  double chi2 = 0.0;
  int degrees_of_freedom = 0;
  int used = 0, rejected = 0;
  int iterations = 0;
};

// `sights` ascend in time. no_match with the subject "unobservable": position and velocity do not follow from the
// sights; not_converged; invalid_argument; errors of the ephemeris.
Result<BatchSolution> solve_batch(const Ephemeris& ephemeris, std::span<const BatchSight> sights,
                                  const BatchStart& start, const BatchSettings& settings = {});

// The place that a survey found, with the velocity of a circle, give or take 8 km/s an axis.
Result<BatchStart> start_from_survey(const Ephemeris& ephemeris, const SurveySolution& survey);
// The place where the mean sights of the first two windows of different bodies cross, with the velocity of a circle; no
// prior. no_match where they do not cross.
Result<BatchStart> start_from_sights(const Ephemeris& ephemeris, std::span<const BatchSight> sights);

// What the filter starts with.
InitialState initial_state(const BatchSolution& solution, const BatchSettings& settings);

}  // namespace astronav::navigation
