// SPDX-License-Identifier: Apache-2.0
#include "verification/loop/afterwards.h"

#include <algorithm>

#include "foundation/math/statistics.h"
#include "onboard/navigation/smoother.h"

namespace astronav::loop {

void Afterwards::begin(const navigation::Filter& filter) {
  begin_.emplace(filter);
  steps_.clear();
}

void Afterwards::saw(const navigation::BeaconMeasurement& measurement) {
  if (begin_) steps_.push_back({measurement.mid_exposure, measurement, {}});
}

void Afterwards::note(const Event& event, Epoch label) {
  if (!begin_) return;
  steps_.push_back({label, {}, event});
}

Result<std::vector<Event>> Afterwards::look_back() const {
  std::vector<Event> points;
  if (!begin_) return points;
  navigation::RecordedFilter flight(*begin_, ephemeris_);
  std::size_t thrust = 0, kick = executive::first_kick_after(maneuvers_, flight.epoch());
  for (const Step& step : steps_) {
    if (step.label > flight.epoch()) {
      if (const auto flown = executive::fly_with(maneuvers_, flight, thrust, kick, step.label); !flown)
        return forward(flown);
    }
    if (step.sight) (void)flight.update(*step.sight);
  }
  const auto smoothed = navigation::smooth(flight.records());
  if (!smoothed) return forward(smoothed);
  for (const Step& step : steps_) {
    if (!step.point) continue;
    // Of several at one epoch all say the same of position and velocity.
    const auto at = std::lower_bound(smoothed->begin(), smoothed->end(), step.label,
                                     [](const navigation::SmoothedState& s, Epoch e) { return s.epoch < e; });
    if (at == smoothed->end()) continue;
    Event point = *step.point;
    point.estimate = at->state();
    point.covariance = at->covariance_pv();
    Vec6 error;
    error << point.estimate.p_m - point.truth.p_m, point.estimate.v_m_s - point.truth.v_m_s;
    point.nees = normalised_square(error, point.covariance);
    points.push_back(point);
  }
  return points;
}

}  // namespace astronav::loop
