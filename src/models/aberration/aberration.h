// SPDX-License-Identifier: Apache-2.0
// Stellar aberration: the direction a moving observer sees.
#pragma once

#include "foundation/math/linear.h"

namespace astronav {

// Exact special relativity. `direction` is a unit vector at rest (N), `velocity_m_s` the observer's barycentric
// velocity (N); returns a unit vector (N). docs/theory/light-time-and-aberration.md eq. 3; agrees with eraAb without
// its gravitational term. Optional derivatives of the result by direction (along the sphere) and by velocity.
Vec3 aberrate(const Vec3& direction, const Vec3& velocity_m_s, Mat3* by_direction = nullptr,
              Mat3* by_velocity = nullptr);
// The inverse: from the apparent direction to the one at rest.
Vec3 unaberrate(const Vec3& apparent, const Vec3& velocity_m_s);

// First order in v/c, normalised: s + beta - s (s.beta) (eq. 4). Optional derivatives by direction and by velocity
// (before the normalisation, whose effect is of second order).
Vec3 aberrate_first_order(const Vec3& direction, const Vec3& velocity_m_s, Mat3* by_direction = nullptr,
                          Mat3* by_velocity = nullptr);

// Place and rate of a body relative to the observer (N, metres) as the moving observer sees them: the distance stays,
// the direction is aberrated, and the rate is that of this apparent place (eq. 5), for which the observer's
// acceleration counts.
struct ApparentMotion {
  Vec3 p_m;
  Vec3 v_m_s;
};
ApparentMotion aberrate_motion(const Vec3& p_m, const Vec3& v_m_s, const Vec3& observer_velocity_m_s,
                               const Vec3& observer_acceleration_m_s2);

}  // namespace astronav
