// SPDX-License-Identifier: Apache-2.0
// Briefing: what the onboard software is told of this flight before it begins: the mass, the thrust as planned, kicks
// as it will hear of them, and a first state with its error.
#pragma once

#include <vector>

#include "foundation/base/error.h"
#include "onboard/executive/maneuvers.h"
#include "onboard/navigation/filter.h"
#include "verification/loop/mission.h"
#include "verification/loop/world.h"
#include "verification/scenario/scenario.h"

namespace astronav::loop {

class Briefing {
 public:
  Briefing(const scenario::Scenario& scenario, const FlyOptions& options, const World& world);
  Briefing(const Briefing&) = delete;
  Briefing& operator=(const Briefing&) = delete;

  double mass_kg() const;
  // Valid as long as the briefing.
  executive::Maneuvers maneuvers() const { return {commands_, kicks_}; }
  // Off by what its covariance says; by nothing in a covariance analysis.
  Result<navigation::InitialState> first_state(Epoch epoch) const;

 private:
  void hear_of_kicks(double error_relative);

  const scenario::Scenario& scenario_;
  const FlyOptions& options_;
  const World& world_;
  std::vector<executive::ThrustCommand> commands_;
  std::vector<executive::Kick> kicks_;
};

}  // namespace astronav::loop
