// SPDX-License-Identifier: Apache-2.0
// What the onboard software knows of its own thrusters: commanded arcs of thrust, and kicks that were reported.
#pragma once

#include <span>

#include "foundation/time/epoch.h"
#include "onboard/navigation/process.h"

namespace astronav::executive {

// Ascending, one after the other; between them the spacecraft coasts.
struct ThrustCommand {
  Epoch begin;
  Epoch end;
  navigation::Thrust thrust;
};

// A short push (momentum unloading, a correction): what it changed the velocity by, as measured or commanded.
struct Kick {
  Epoch epoch;
  Vec3 delta_v_N_m_s = Vec3::Zero();
  double sigma_m_s = 0.0;  // of each component, 1 sigma
};

// Both ascending; what they point at must outlive the navigator.
struct Maneuvers {
  std::span<const ThrustCommand> thrust;
  std::span<const Kick> kicks;
};

}  // namespace astronav::executive
