// SPDX-License-Identifier: Apache-2.0
// The states of the filter, in one place: their order, meaning, scales and the Gauss-Markov laws that drive them.
// Seventeen are the paper's; the others are variants that cost nothing where their sigma is zero.
//
//   0..2   p       position, barycentric, ICRF axes (N), m
//   3..5   v       velocity, N, m/s
//   6      m       mass, kg. A ballistic arc sees it only through solar pressure (CR A / m), so its uncertainty also
//                  stands for that of CR A
//   7..9   xi_a    unmodelled acceleration, N, m/s2
//   10..12 xi_T    thrust: relative error of magnitude; pointing angles towards e1 and e2 of the thrust frame, rad
//   13     xi_s    solar pressure: relative error of CR A/m, where the mass is something of its own (thrust)
// These move the spacecraft; the others are only seen by the camera, and age each by itself.
//   14..17 xi_c    camera: relative error of the focal length; error of k1; line-of-sight bias (u, v), px
//   18..25 xi_p    centre of light, one for each planet of FilterSettings::beacon_errors: relative error of its shift
//                  from the centre
//   26..41 xi_e    place, two for each of them: along its orbit and across the orbit's plane, m (ephemeris.h)
//   42     xi_t    the onboard clock less the true time, s: planets stand where they were so much earlier than its tags
//   say
// xi_p and xi_e are the same in every window: what is put into R or a window's bias instead averages out in the
// covariance and not in the truth.
//
// Why these four of the camera: with the attitude taken from the stars of the same frame, an error of cx, cy cancels to
// first order. What stays is scale and radial distortion, and whatever is constant while one beacon is tracked (star
// residuals, centroid S-curve, ephemeris and photocentre of the beacon): a bias that starts anew with every window.
// docs/theory/navigation.md section 2.
#pragma once

#include "foundation/math/linear.h"
#include "models/ephemeris/bodies.h"

namespace astronav::navigation {

inline constexpr int kBeaconBodies = 8;
inline constexpr int kDynamicStates = 14;
inline constexpr int kAgeingStates = 4 + 3 * kBeaconBodies + 1;
inline constexpr int kStates = kDynamicStates + kAgeingStates;
namespace index {
inline constexpr int position = 0, velocity = 3, mass = 6, acceleration = 7, thrust = 10, solar_pressure = 13;
inline constexpr int camera = 14, focal = 14, k1 = 15, bias = 16;
inline constexpr int photocentre = camera + 4, ephemeris = photocentre + kBeaconBodies;
inline constexpr int clock = ephemeris + 2 * kBeaconBodies;
}  // namespace index

using StateVector = Eigen::Matrix<double, kStates, 1>;
using StateMatrix = Eigen::Matrix<double, kStates, kStates>;

// First-order Gauss-Markov: xi' = -xi/tau + w, steady-state standard deviation sigma.
struct GaussMarkov {
  double sigma = 0.0;
  double tau_s = 1.0;
};

// The filter's own units: AU, the time in which a planet at 1 AU moves by one radian (58 days), kg, px. Everything
// inside Process and Filter is in these; the outside sees SI only.
namespace unit {
inline constexpr double length_m = kAstronomicalUnit;
inline constexpr double time_s = 5022642.891;  // sqrt(AU^3 / GM_sun); only a scale, so its last digits do not matter
inline constexpr double velocity_m_s = length_m / time_s;
inline constexpr double acceleration_m_s2 = velocity_m_s / time_s;
inline constexpr double gm_m3_s2 = length_m * length_m * acceleration_m_s2;
}  // namespace unit

// SI value of one unit of each state.
StateVector state_scales();

}  // namespace astronav::navigation
