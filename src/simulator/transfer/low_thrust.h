// SPDX-License-Identifier: Apache-2.0
// Design of a low-thrust transfer between two planets in the full force model, with coasts for navigation.
//
// The launcher gives a v-infinity of at most so much, in the best direction; arcs of constant thrust do the rest; at
// the arrival the spacecraft stands at the aim point beside the planet with a v-infinity of at most so much. Thrust
// arcs fill the cruise but for the navigation windows, a few to a cycle, each with its own direction and level.
// Beginning with Lambert's ballistic transfer, the two v-infinities are brought to their limits step by step; at each
// step the flight is linearised and steered anew (steering.h), until it arrives (docs/theory/dynamics.md, "Low
// thrust").
#pragma once

#include "foundation/base/error.h"
#include "foundation/time/epoch.h"
#include "models/ephemeris/ephemeris.h"
#include "models/oem/thrust_plan.h"
#include "simulator/dynamics/propagation.h"
#include "simulator/transfer/lambert.h"

namespace astronav::transfer {

struct LowThrustSettings {
  double mass_kg = 22.0;
  double force_n = 1.9e-3;  // at most
  double specific_impulse_s = 3000.0;
  double v_infinity_departure_m_s = 2000.0;  // at most
  double v_infinity_arrival_m_s = 1500.0;    // at most
  // 1: least energy, smooth levels of thrust; towards 0: least propellant, full thrust or none.
  double smoothing = 0.02;
  int arcs_per_cycle = 4;
  // No thrust from first_coast + k cycle on, for `coast`: two windows and the slew between them, with five minutes more
  // on either side.
  Duration cycle = Duration::days(10.0);
  Duration first_coast = Duration::seconds(86400.0 - 300.0);
  Duration coast = Duration::seconds(155.0 * 60.0);
  Duration coast_out = Duration::days(3.0);  // the cruise ends, and with it the thrust, so long before the arrival
  double departure_distance_m = 1e9;         // from the planet: where the cruise begins, at the departure epoch
  double miss_distance_m = 0.0;              // as in BallisticSettings
  double position_tolerance_m = 1e3;         // at the aim point
  dynamics::ForceSettings forces = {};
  dynamics::PropagationSettings propagation = {};
};

struct LowThrustDesign {
  Epoch begin, end;  // of the cruise
  Epoch arrival;
  State initial;  // at `begin`, barycentric, N
  ThrustPlan plan;
  dynamics::Arc arc;  // begin to arrival, under settings.forces and the plan
  LambertLeg lambert;
  double miss_distance_m = 0.0;
  Vec3 v_infinity_departure_m_s = Vec3::Zero();
  Vec3 v_infinity_arrival_m_s = Vec3::Zero();  // osculating at the arrival epoch, N
  double closest_approach_m = 0.0;             // osculating at the arrival epoch
  double aim_error_m = 0.0;
  double propellant_kg = 0.0;
  double thrust_share = 0.0;  // of the cruise's time
  int flights = 0;            // integrated on the way
};

// not_converged where the engine is too weak or the two planets too far apart for less than one revolution;
// invalid_argument, not_found, out_of_range as for their parts.
Result<LowThrustDesign> design_low_thrust(const Ephemeris& ephemeris, BodyId from, BodyId to, Epoch departure,
                                          Duration duration, const LowThrustSettings& settings = {});

}  // namespace astronav::transfer
