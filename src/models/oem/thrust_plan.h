// SPDX-License-Identifier: Apache-2.0
// A thrust plan: what the engine of a low-thrust spacecraft is told to do, as truth and filter both follow it.
//
// Arcs of constant force, specific impulse and inertial direction; between them the spacecraft coasts. As text a CSV
// table, one arc a line (docs/formats.md, "Thrust plans").
#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "foundation/base/error.h"
#include "foundation/math/linear.h"
#include "foundation/time/epoch.h"

namespace astronav {

inline constexpr double kStandardGravity = 9.80665;  // m/s^2, what specific impulses are counted in

struct ThrustArc {
  Epoch begin;
  Epoch end;  // not part of the arc
  double force_n = 0.0;
  double specific_impulse_s = 0.0;
  Vec3 direction_N = Vec3::UnitX();
  double mass_flow_kg_s() const { return force_n / (specific_impulse_s * kStandardGravity); }
};

struct ThrustPlan {
  double mass_kg = 0.0;         // when the first arc begins
  std::vector<ThrustArc> arcs;  // ascending; one may begin where the one before it ends

  // The arc that an epoch is in; null while coasting.
  const ThrustArc* at(Epoch epoch) const;
  // When the thrust changes next after `epoch`; `limit` where it does not before that.
  Epoch next_change(Epoch epoch, Epoch limit) const;
  double mass_at_kg(Epoch epoch) const;
  // Of the rocket equation, over the whole plan.
  double delta_v_m_s() const;
};

// invalid_argument: a mass, force or impulse not above zero, arcs that overlap or end before they begin, a direction
// that is no unit vector, more propellant than mass.
Result<void> check(const ThrustPlan& plan);

// corrupt_data at "name:line". Directions are normalised; the masses must agree with the flow to 1e-6.
Result<ThrustPlan> parse_thrust_plan(std::string_view text, std::string_view name_for_errors);
std::string to_text(const ThrustPlan& plan);

}  // namespace astronav
