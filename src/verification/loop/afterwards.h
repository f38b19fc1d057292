// SPDX-License-Identifier: Apache-2.0
// Afterwards: the ground, which hears of all sights when the mission is over, and says where the spacecraft was.
#pragma once

#include <optional>
#include <vector>

#include "foundation/base/error.h"
#include "models/ephemeris/ephemeris.h"
#include "onboard/executive/maneuvers.h"
#include "onboard/executive/navigator.h"
#include "verification/loop/records.h"

namespace astronav::loop {

class Afterwards final : public executive::SightListener {
 public:
  // A record of the smoother takes 45 kB.
  static constexpr int kMostSights = 20000;

  // Both must outlive it.
  Afterwards(const Ephemeris& ephemeris, const executive::Maneuvers& maneuvers)
      : ephemeris_(ephemeris), maneuvers_(maneuvers) {}

  // What was before is forgotten: the filter has just begun, or flown its beginning anew.
  void begin(const navigation::Filter& filter);
  void saw(const navigation::BeaconMeasurement& measurement) override;
  // A smoothed state is wanted of this event, at which the filter stood at `label` of its own clock.
  void note(const Event& event, Epoch label);

  // All sights once more, forwards and backwards (navigation.md section 6).
  Result<std::vector<Event>> look_back() const;

 private:
  struct Step {
    Epoch label;
    std::optional<navigation::BeaconMeasurement> sight;
    std::optional<Event> point;
  };
  const Ephemeris& ephemeris_;
  executive::Maneuvers maneuvers_;
  std::optional<navigation::Filter> begin_;
  std::vector<Step> steps_;
};

}  // namespace astronav::loop
