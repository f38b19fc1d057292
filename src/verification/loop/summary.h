// SPDX-License-Identifier: Apache-2.0
// Summary: the figures of one run, or of several runs pooled, as summary.json holds them.
//
// Errors are estimate minus truth, in ICRF axes. "Steady" is from the fourth navigation cycle on, read when the second
// tracking window of a cycle ends; "end of coast" is read where the long propagation ends. A figure that a run cannot
// have (vision without images, steady state of a short mission) is NaN, and null in JSON. docs/theory/statistics.md.
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "foundation/base/error.h"
#include "foundation/math/statistics.h"
#include "verification/loop/records.h"

namespace astronav::loop {

inline constexpr int kFirstSteadyCycle = 3;  // counted from 0

struct ErrorFigures {
  double final_rss = 0.0;                      // at the last instant of its kind
  double steady_rms_rss = 0.0;                 // rms of the length of the error vector
  std::array<double, 3> steady_3sigma_axis{};  // 3 x rms about zero
  std::array<double, 3> formal_3sigma_axis{};  // 3 x rms of the filter's own sigma
  double worst_axis() const { return std::max({steady_3sigma_axis[0], steady_3sigma_axis[1], steady_3sigma_axis[2]}); }
  double worst_formal_axis() const {
    return std::max({formal_3sigma_axis[0], formal_3sigma_axis[1], formal_3sigma_axis[2]});
  }
};

struct ErrorSummary : ErrorFigures {
  ErrorFigures end_of_coast;
};

struct VisionSummary {
  double attitude_success_rate = 0.0;  // found and right, over all images
  double planet_success_rate = 0.0;
  int false_planets = 0;
  double centroid_error_px_1sigma = 0.0;      // stars, per axis
  double planet_error_px_1sigma = 0.0;        // per axis
  double attitude_cross_arcsec_1sigma = 0.0;  // per axis
  double attitude_roll_arcsec_1sigma = 0.0;
};

// The attitude filter of a spacecraft with a gyro: what it foretold of images before they were looked at. Per axis, 1
// sigma; NaN without a gyro.
struct AttitudeFilterSummary {
  double by_prior_rate = 0.0;  // attitudes found where they were foretold, over all images; without a gyro: by command
  double cross_arcsec_1sigma = 0.0, roll_arcsec_1sigma = 0.0;            // from image to image of a window
  double slew_cross_arcsec_1sigma = 0.0, slew_roll_arcsec_1sigma = 0.0;  // at the end of the slew between two windows
  double nees_mean = 0.0;                                                // 3 degrees of freedom, all that was foretold
  Band nees_band_95;      // images counted as independent: what two share, the gyro's bias, soon is little
  double nis_mean = 0.0;  // 3 degrees of freedom, accepted attitudes
  Band nis_band_95;
  double bias_error_deg_h_1sigma = 0.0;  // of the gyro, after the last image of each cycle
  int restarts = 0;
  // What the figures rest on.
  int foretold = 0, slews = 0, accepted = 0, biases = 0;
};

// How the mission came to its first state; lengths of vectors, 1 sigma. NaN where there was no survey.
struct StartSummary {
  std::string from = "prior";
  int cycle = 1;    // counted from 1; pooled: the last of all
  int surveys = 0;  // flown, and their pictures
  int pictures = 0;
  std::vector<std::string> planets;  // that the survey named; pooled: in any of the runs
  double survey_error_km = 0.0, survey_sigma_km = 0.0;
  double position_error_km = 0.0, position_sigma_km = 0.0;  // of the first state
  double velocity_error_m_s = 0.0, velocity_sigma_m_s = 0.0;
};

struct Summary {
  StartSummary start;
  std::string level;
  std::string version;
  std::uint64_t seed = 1;
  std::uint64_t sample = 0;
  int runs = 1;  // how many were pooled
  int cycles = 0;
  int images = 0;
  double duration_days = 0.0;

  ErrorSummary position_error_km;
  ErrorSummary velocity_error_m_s;

  double nees_mean = 0.0;  // 6 states, steady
  Band nees_band_95;
  double nis_mean = 0.0;  // 2 degrees of freedom, all accepted measurements
  Band nis_band_95;

  VisionSummary vision;
  AttitudeFilterSummary attitude_filter;

  double image_ms_median = 0.0;
  double image_ms_p99 = 0.0;
  StageTimes stage_ms;  // means per image
  double peak_memory_mb = 0.0;
  double wall_s = 0.0;

  // What the figures rest on, so that runs can be pooled without their records.
  int steady_count = 0;
  int coast_count = 0;
  double nees_effective_count = 0.0;  // independent windows worth
  int nis_count = 0;
  int edited_count = 0;  // planets found but not taken by the filter
  int centroid_count = 0;
  int planet_count = 0;
  int attitude_count = 0;
};

Summary summarize(const Records& records);

// The same mission as the ground knows it afterwards: the events of Records::smoothed. Its figures of errors and NEES
// are those of the smoothed states; NEES has no band (each knows the same images).
Records afterwards(const Records& records);

// From what days are counted: the mission's begin, or its first event where that was not said.
Epoch day_zero(const Records& records);

// Pools runs: mean squares weighted by their counts, medians of times. Needs one run at least.
Summary pool(std::span<const Summary> runs);

// Number of independent NEES values (6 states) that the steady windows of a run are worth. If the filter's covariance
// is right, its errors are correlated from window to window by (I - K H) Phi = P+ (P-)^-1 Phi, and two NEES values by
// 2 |P_k^-1/2 C_kj P_j^-1/2|^2; both follow from the covariances that the filter reports and the Sun's gravity along
// the way. The mean NEES then has the spread of a chi-square of 6 x this number of degrees of freedom.
double effective_windows(const Records& records);

// summary.json, and back.
std::string to_json(const Summary& summary, int indent = 2);
Result<Summary> summary_from_json(std::string_view json, std::string_view name_for_errors);

// What a person reads at the end of a run: a few lines.
std::string to_text(const Summary& summary);
// The same in one paragraph of plain words.
std::string in_words(const Summary& summary);

}  // namespace astronav::loop
