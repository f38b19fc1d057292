// SPDX-License-Identifier: Apache-2.0
// From the state of spacecraft and planet to a pixel: light time, aberration, centre of light, attitude, projection,
// each with its derivative. Closed form, no iteration. docs/theory/navigation.md section 3.
#pragma once

#include "foundation/base/error.h"
#include "models/camera/camera.h"
#include "models/ephemeris/ephemeris.h"

namespace astronav::navigation {

struct SightSettings {
  bool light_time = true;
  bool aberration = true;
  bool centre_of_light = true;         // where the lit part of a sphere has its centroid, instead of its centre
  double centre_of_light_scale = 1.0;  // 1 is Lambert's law
};

// Shift of the centre of light from the centre towards the Sun, in radii, for a Lambert sphere at phase angle (rad).
double lambert_shift(double phase_angle_rad);

struct Sight {
  Vec3 direction_N;             // apparent, unit
  Vec3 p_body_from_observer_N;  // centre of the body at emission minus observer at reception, m
  double distance_m = 0.0;      // at emission
  double light_time_s = 0.0;
  Vec3 shift_N = Vec3::Zero();  // of the centre of light on the sky, rad (before aberration)
  Mat3 by_position;             // of the direction by the observer's position, 1/m
  Mat3 by_velocity;             // ... and velocity, s/m
};

// `body` is the geometric barycentric state at the epoch of the observer (not retarded), p_sun_O_N the Sun's place
// then. The body's acceleration is what the Sun pulls, and what is given beside it. radius_m is used for the centre of
// light only.
Sight apparent_sight(const State& observer, const State& body, const Vec3& p_sun_O_N, double radius_m,
                     const SightSettings& settings, const Vec3& other_acceleration_m_s2 = Vec3::Zero());

struct PixelPrediction {
  Vec2 pixel;
  Mat23 by_position;                      // px/m
  Mat23 by_velocity;                      // px s/m
  Mat23 by_direction;                     // px, by the apparent direction's components in N
  Mat23 by_attitude;                      // px/rad: theta of R_CN_true = exp(-[theta]x) R_CN, so +J [p_C]x
  Eigen::Matrix<double, 2, 4> by_camera;  // by xi_c: relative focal length, k1, bias u, bias v
  Sight sight;
};

// xi_c as in state.h. out_of_range where the camera cannot see the direction.
Result<PixelPrediction> predict_pixel(const Sight& sight, const Mat3& R_CN, const Intrinsics& camera,
                                      const Eigen::Vector4d& xi_c);

}  // namespace astronav::navigation
