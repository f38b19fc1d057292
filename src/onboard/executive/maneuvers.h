// SPDX-License-Identifier: Apache-2.0
// What the onboard software knows of its own thrusters: commanded arcs of thrust, and kicks that were reported.
#pragma once

#include <algorithm>
#include <cstddef>
#include <span>

#include "foundation/base/error.h"
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

// A filter (or what behaves like one) to an epoch, thrust and kicks on the way; `thrust` and `kick`: the next of each.
template <typename AnyFilter>
Result<void> fly_with(const Maneuvers& maneuvers, AnyFilter& filter, std::size_t& thrust, std::size_t& kick,
                      Epoch epoch) {
  const auto& [commands, kicks] = maneuvers;
  do {
    const Epoch now = filter.epoch();
    while (thrust < commands.size() && commands[thrust].end <= now) ++thrust;
    const bool more = thrust < commands.size();
    const bool firing = more && commands[thrust].begin <= now;
    filter.set_thrust(firing ? commands[thrust].thrust : navigation::Thrust{});
    for (; kick < kicks.size() && kicks[kick].epoch <= now; ++kick) {
      if (const auto ok = filter.kick(kicks[kick].delta_v_N_m_s, kicks[kick].sigma_m_s); !ok) return ok;
    }
    Epoch next = epoch;
    if (more) next = std::min(next, firing ? commands[thrust].end : commands[thrust].begin);
    if (kick < kicks.size()) next = std::min(next, kicks[kick].epoch);
    if (const auto ok = filter.propagate_to(next); !ok) return ok;
  } while (filter.epoch() < epoch);
  return {};
}
// The first kick that a filter at this epoch has not had.
inline std::size_t first_kick_after(const Maneuvers& maneuvers, Epoch epoch) {
  std::size_t kick = 0;
  while (kick < maneuvers.kicks.size() && maneuvers.kicks[kick].epoch < epoch) ++kick;
  return kick;
}

}  // namespace astronav::executive
