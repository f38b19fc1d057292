// SPDX-License-Identifier: Apache-2.0
// Lambert's problem: the conic from one place to another in a given time (less than one revolution).
//
// Izzo, "Revisiting Lambert's problem", Celest. Mech. Dyn. Astr. 121 (2015): his variable x and time equations; the
// root is bracketed and found by TOMS 748, so that it always converges.
#pragma once

#include "foundation/base/error.h"
#include "foundation/math/linear.h"
#include "foundation/time/epoch.h"
#include "models/ephemeris/ephemeris.h"

namespace astronav::transfer {

struct LambertVelocities {
  Vec3 v1_m_s = Vec3::Zero();
  Vec3 v2_m_s = Vec3::Zero();
};

// Relative to the attracting body. Of the two ways round, the one whose angular momentum has a positive component along
// `pole` (prograde). invalid_argument: a time not above zero, a place at the centre, places in line with the centre (no
// plane is defined), or a transfer plane that contains the pole.
Result<LambertVelocities> lambert(const Vec3& p1_m, const Vec3& p2_m, double time_s, double gm_m3_s2,
                                  const Vec3& pole = Vec3::UnitZ());

// The heliocentric conic from one body to another.
struct LambertLeg {
  Epoch departure;
  Epoch arrival;
  Vec3 v_infinity_departure_m_s = Vec3::Zero();  // relative to the departure body, N
  Vec3 v_infinity_arrival_m_s = Vec3::Zero();    // relative to the arrival body, N
  double c3_m2_s2() const { return v_infinity_departure_m_s.squaredNorm(); }
};
// Prograde about the pole of the ecliptic.
Result<LambertLeg> lambert_leg(const Ephemeris& ephemeris, BodyId from, BodyId to, Epoch departure, Duration duration);

}  // namespace astronav::transfer
