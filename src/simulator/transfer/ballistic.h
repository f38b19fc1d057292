// SPDX-License-Identifier: Apache-2.0
// Design of a ballistic transfer between two planets in the full force model.
//
// The spacecraft leaves a hyperbola's pericentre above the departure body at the departure epoch; the three components
// of that hyperbola's v-infinity are corrected (Newton, from the Lambert leg; where that fails, by way of a solution
// without the arrival body's gravity) until the integrated trajectory stands at the aim point at the arrival epoch:
// beside the arrival body, across the arrival v-infinity and in the plane of the transfer, away from the Sun, at the
// miss distance. See docs/theory/dynamics.md, "Ballistic transfers".
#pragma once

#include "foundation/base/error.h"
#include "foundation/time/epoch.h"
#include "models/ephemeris/ephemeris.h"
#include "simulator/dynamics/propagation.h"
#include "simulator/transfer/lambert.h"

namespace astronav::transfer {

struct BallisticSettings {
  double departure_altitude_m = 300e3;  // of the pericentre
  // From the arrival body's centre to the aim point; 0: a fifth of the radius of its sphere of influence (Mars 108,000
  // to 130,000 km). There it bends the path by a few degrees only, so that the arc stays well conditioned.
  double miss_distance_m = 0.0;
  // The cruise runs from `begin` = departure + coast_in to `end` = arrival - coast_out: about the time to the edge of
  // the planets' spheres of influence.
  Duration coast_in = Duration::days(3.0);
  Duration coast_out = Duration::days(3.0);
  double position_tolerance_m = 1e3;  // at the aim point
  dynamics::ForceSettings forces = {};
  dynamics::PropagationSettings propagation = {};
};

struct BallisticDesign {
  Epoch departure, arrival;
  Epoch begin, end;   // of the cruise
  State initial;      // at `begin`, barycentric, N: the cruise in one state
  dynamics::Arc arc;  // begin to arrival, under settings.forces
  LambertLeg lambert;
  double miss_distance_m = 0.0;                  // of the aim point
  Vec3 v_infinity_departure_m_s = Vec3::Zero();  // of the hyperbola at departure, N
  Vec3 v_infinity_arrival_m_s = Vec3::Zero();    // osculating at the arrival epoch, N
  double c3_m2_s2 = 0.0;
  double closest_approach_m = 0.0;  // to the arrival body's centre, osculating at the arrival epoch
  double aim_error_m = 0.0;
  int iterations = 0;
};

// not_converged where no trajectory reaches the aim point; invalid_argument, not_found, out_of_range as for their
// parts.
Result<BallisticDesign> design_ballistic(const Ephemeris& ephemeris, BodyId from, BodyId to, Epoch departure,
                                         Duration duration, const BallisticSettings& settings = {});

}  // namespace astronav::transfer
