// SPDX-License-Identifier: Apache-2.0
// The thrust that the engine really gives when it follows a plan, and the mass that is left (docs/theory/dynamics.md).
#pragma once

#include <vector>

#include "foundation/base/error.h"
#include "foundation/math/random.h"
#include "models/oem/thrust_plan.h"
#include "simulator/dynamics/unmodelled.h"

namespace astronav::dynamics {

// First-order Gauss-Markov errors of execution: of the magnitude, relative, and of the direction, on two axes.
struct ThrustErrors {
  double magnitude_sigma = 0.0;
  double pointing_sigma_rad = 0.0;  // per axis
  Duration tau = Duration::days(1.0);
  Duration grid = Duration::days(0.125);  // between the drawn values they are linear
};

class ThrustHistory {
 public:
  ThrustHistory() = default;  // no engine
  // `begin` to `end` is the span that errors are drawn for; a longer one begins with the same errors.
  // invalid_argument: a plan that cannot be flown, sigmas below zero, times not above it.
  static Result<ThrustHistory> fly(ThrustPlan plan, const ThrustErrors& errors, Epoch begin, Epoch end,
                                   RandomStream& stream);
  static Result<ThrustHistory> as_planned(ThrustPlan plan);

  bool active() const { return !plan_.arcs.empty(); }
  const ThrustPlan& plan() const { return plan_; }
  Vec3 force_N_n(Epoch epoch) const;  // in newton, on the axes N
  // The engine's flow follows the force that it really gives. With no engine: zero.
  double mass_kg(Epoch epoch) const;
  // The next epoch on the way from `epoch` to `limit` at which the force jumps or its slope does.
  Epoch next_knot(Epoch epoch, Epoch limit) const;

 private:
  struct MassAt {
    Epoch epoch;
    double mass_kg = 0.0;
  };
  double magnitude_n(const ThrustArc& arc, Epoch epoch) const;
  double burnt_kg(const ThrustArc& arc, Epoch from, Epoch to) const;  // both between two knots

  ThrustPlan plan_;
  ThrustErrors errors_;
  UnmodelledAcceleration unit_errors_;  // of sigma 1: magnitude and two angles, to be scaled
  std::vector<Epoch> knots_;            // where arcs begin and end
  std::vector<MassAt> masses_;          // at these and the knots of the errors inside arcs
};

}  // namespace astronav::dynamics
