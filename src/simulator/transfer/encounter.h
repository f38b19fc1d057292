// SPDX-License-Identifier: Apache-2.0
// The meeting with a planet: osculating hyperbola, B-plane, and the error ellipse there.
#pragma once

#include <Eigen/Core>

#include "foundation/base/error.h"
#include "foundation/math/linear.h"
#include "foundation/time/epoch.h"
#include "models/ephemeris/ephemeris.h"
#include "simulator/dynamics/propagation.h"

namespace astronav::transfer {

// Unit vector of the part of `v` across `axis`; of `fallback` where v lies along it.
Vec3 across(const Vec3& v, const Vec3& axis, const Vec3& fallback);

// Laplace's sphere of influence at a distance from the Sun, m.
double sphere_of_influence(double distance_m, double gm_m3_s2, double sun_gm_m3_s2);

// Osculating hyperbola of a state relative to a body; for an ellipse v_infinity is zero.
struct Hyperbola {
  Vec3 v_infinity_in_m_s = Vec3::Zero();  // before the encounter
  double pericentre_m = 0.0;
};
Hyperbola osculating(const State& relative, double gm_m3_s2);

// The plane through the planet's centre across the incoming asymptote (Kizner 1961). S along the incoming v-infinity,
// T = S x pole in that plane, R = S x T; B from the centre to the asymptote.
struct BPlane {
  Mat3 R_BN = Mat3::Identity();  // rows S, T, R
  double b_t_m = 0.0;            // B.T
  double b_r_m = 0.0;            // B.R
  double v_infinity_m_s = 0.0;
  double time_to_pericentre_s = 0.0;  // from the epoch of the state; negative: it lies behind
};
// Of a state relative to the planet. invalid_argument for an ellipse, a radial path, or a v-infinity along the pole.
Result<BPlane> b_plane(const State& relative, double gm_m3_s2, const Vec3& pole = Vec3::UnitZ());

// Where the spacecraft will pass, and how well that is known: the covariance of a state (position, velocity; m, m/s)
// carried to the B-plane by the derivatives of B.T, B.R and the time of pericentre.
struct BPlaneError {
  BPlane at;
  Mat3 covariance = Mat3::Zero();  // of B.T, B.R (m) and the time of pericentre (s)
  double semi_major_m = 0.0;       // of the 1-sigma ellipse of (B.T, B.R)
  double semi_minor_m = 0.0;
  double angle_rad = 0.0;  // of the major axis, from T towards R, in (-pi/2, pi/2]
};
Result<BPlaneError> b_plane_error(const State& relative, const Mat6& covariance, double gm_m3_s2,
                                  const Vec3& pole = Vec3::UnitZ());

// When a barycentric state at `from` passes the planet, to a minute: the least distance before `until` under all
// forces. not_found where it only comes nearer or only goes away.
Result<Epoch> closest_approach(const dynamics::ForceModel& forces, const Ephemeris& ephemeris, BodyId planet,
                               Epoch from, const State& state, Epoch until);

// The error of a state far from the planet: barycentric, at `from`, carried to `to` (on the planet's approach) under
// all forces, and its covariance with the derivatives of that flight.
Result<BPlaneError> arrival_error(const dynamics::ForceModel& forces, const Ephemeris& ephemeris, BodyId planet,
                                  Epoch from, const State& state, const Mat6& covariance, Epoch to,
                                  const Vec3& pole = Vec3::UnitZ());

}  // namespace astronav::transfer
