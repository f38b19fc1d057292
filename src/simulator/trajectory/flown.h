// SPDX-License-Identifier: Apache-2.0
// What becomes of a plan: one flight of the spacecraft under the true forces, with all that is drawn for it.
#pragma once

#include <cstdint>
#include <vector>

#include "foundation/base/error.h"
#include "foundation/time/epoch.h"
#include "models/ephemeris/ephemeris.h"
#include "models/oem/thrust_plan.h"
#include "simulator/dynamics/propagation.h"
#include "simulator/trajectory/trajectory.h"

namespace astronav::trajectory {

struct FlightPlan {
  Epoch begin, end;
  State initial;           // at `begin`, barycentric, N
  ThrustPlan thrust = {};  // without arcs: a ballistic cruise
};

// As designed: from the trajectory's first state to its end.
Result<FlightPlan> plan_along(const Trajectory& designed, ThrustPlan thrust = {});

// All off by default.
struct Disturbances {
  dynamics::UnmodelledSettings unmodelled = {};
  dynamics::ThrustErrors thrust = {};
  bool unloading = false;  // of momentum, by kicks
  dynamics::KickSettings kicks = {};
  // Beside them: as flown, ascending. A drawn kick that one of these overlaps does not happen.
  std::vector<dynamics::Kick> corrections = {};
};

struct Flight {
  dynamics::ForceModel forces;  // its events() are what was drawn: kicks, thrust, unmodelled acceleration
  dynamics::Arc arc;            // begin to end
};

// The draws depend on seed and sample alone (streams "unmodelled acceleration", "thrust errors" and "kicks"), each on
// its own: switching one off leaves the others as they are. Errors are those of the parts.
Result<Flight> fly(const Ephemeris& ephemeris, const dynamics::ForceSettings& forces, const FlightPlan& plan,
                   const Disturbances& disturbances, std::uint64_t seed, std::uint64_t sample);

}  // namespace astronav::trajectory
