// SPDX-License-Identifier: Apache-2.0
// Stellar aberration: the direction a moving observer sees.
#pragma once

#include "foundation/math/linear.h"

namespace astronav {

// Exact special relativity. `direction` is a unit vector at rest (N), `velocity_m_s` the observer's barycentric velocity
// (N); returns a unit vector (N). docs/theory/light-time-and-aberration.md eq. 3b; agrees with eraAb without its
// gravitational term.
Vec3 aberrate(const Vec3& direction, const Vec3& velocity_m_s);
// The inverse: from the apparent direction to the one at rest.
Vec3 unaberrate(const Vec3& apparent, const Vec3& velocity_m_s);

// First order in v/c, normalised: s + beta - s (s.beta). Optional derivatives by direction and by velocity (before the
// normalisation, whose effect is of second order).
Vec3 aberrate_first_order(const Vec3& direction, const Vec3& velocity_m_s, Mat3* by_direction = nullptr,
                          Mat3* by_velocity = nullptr);

}  // namespace astronav
