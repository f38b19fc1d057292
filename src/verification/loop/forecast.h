// SPDX-License-Identifier: Apache-2.0
// Forecast: covariance analysis. What the eyes would measure, without pictures and without random numbers: the true
// place of a planet, with the covariance that the flight software would give it (docs/theory/statistics.md, section 7).
// A mission flown on it ends with the filter's bound, which a campaign of the same mission should meet.
#pragma once

#include <memory>
#include <optional>

#include "foundation/base/error.h"
#include "models/photometry/photometry.h"
#include "onboard/navigation/measurement.h"
#include "onboard/vision/exposure.h"
#include "onboard/vision/star_field.h"
#include "verification/loop/world.h"
#include "verification/scenario/scenario.h"

namespace astronav::loop {

// The same mission with nothing random and nothing wrong: no noise in the dynamics, no errors of engine, clock,
// pointing and camera. What the models of truth and filter differ by stays.
scenario::Scenario undisturbed(scenario::Scenario scenario);

class Forecast {
 public:
  static Result<std::unique_ptr<Forecast>> create(const scenario::Scenario& scenario, const World& world,
                                                  const Camera& believed, Epoch epoch);
  Forecast(const Forecast&) = delete;
  Forecast& operator=(const Forecast&) = delete;

  // What the next window will be worth: stars around the beacon, its light, the exposure where that is chosen.
  Result<void> prepare_window(BodyId beacon, Epoch epoch, const State& truth_O);
  // The measurement of one image of that window, mid-exposure by the onboard clock.
  Result<navigation::BeaconMeasurement> measure(BodyId beacon, Epoch epoch, const State& truth_O,
                                                const Mat3& R_CN) const;
  const vision::ExposureForecast& window() const { return window_; }

 private:
  Forecast(const World& world, const Camera& believed) : world_(world), believed_(believed), band_(believed) {}

  const World& world_;
  Camera believed_;
  BandPhotometry band_;
  vision::StarField field_;
  std::optional<vision::ExposureControl> control_;
  bool choose_exposure_ = false;
  vision::LocalPsf optics_;
  double law_of_light_ = 0.0;
  vision::ExposureForecast window_;
};

}  // namespace astronav::loop
