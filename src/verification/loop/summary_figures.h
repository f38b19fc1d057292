// SPDX-License-Identifier: Apache-2.0
// Between the files of Summary: what each of them needs.
#pragma once

#include <cmath>
#include <limits>

#include "verification/loop/summary.h"

namespace astronav::loop {

inline constexpr double kNoFigure = std::numeric_limits<double>::quiet_NaN();

inline double ratio(double a, double b) {
  return b > 0.0 ? a / b : kNoFigure;
}
inline double root_mean(double sum2, double count) {
  return count > 0.0 ? std::sqrt(sum2 / count) : kNoFigure;
}

inline Band mean_band(double degrees, double count) {
  return count > 0.0 ? chi_square_mean_band(0.95, degrees, count) : Band{kNoFigure, kNoFigure};
}

// The figures of a start, by their names in summary.json.
struct StartFigure {
  const char* name;
  double StartSummary::*value;
};
inline constexpr StartFigure kStartFigures[] = {{"survey_error_km", &StartSummary::survey_error_km},
                                                {"survey_sigma_km", &StartSummary::survey_sigma_km},
                                                {"position_error_km", &StartSummary::position_error_km},
                                                {"position_sigma_km", &StartSummary::position_sigma_km},
                                                {"velocity_error_m_s", &StartSummary::velocity_error_m_s},
                                                {"velocity_sigma_m_s", &StartSummary::velocity_sigma_m_s}};

}  // namespace astronav::loop
