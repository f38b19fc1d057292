// SPDX-License-Identifier: Apache-2.0
// Stellar aberration: the direction a moving observer sees.
#pragma once

#include <array>
#include <cmath>

#include "foundation/math/linear.h"

namespace astronav {

// Exact special relativity. `direction` is a unit vector at rest (N), `velocity_m_s` the observer's barycentric
// velocity (N); returns a unit vector (N). docs/theory/light-time-and-aberration.md eq. 3; agrees with eraAb without
// its gravitational term. Optional derivatives of the result by direction (along the sphere) and by velocity.
Vec3 aberrate(const Vec3& direction, const Vec3& velocity_m_s, Mat3* by_direction = nullptr,
              Mat3* by_velocity = nullptr);
// The inverse: from the apparent direction to the one at rest.
Vec3 unaberrate(const Vec3& apparent, const Vec3& velocity_m_s);

// The same for many directions at one velocity: what they share is computed once.
class Aberration {
 public:
  explicit Aberration(const Vec3& velocity_m_s)
      : beta_(velocity_m_s / kLightSpeed), b_(std::sqrt(1.0 - beta_.squaredNorm())), g_(1.0 / (1.0 + b_)) {}
  // Of a vector of any length along the direction, given and returned by its components; the result is a unit vector.
  // One direction (Real = double) or several side by side (an Eigen::Array).
  template <typename Real>
  std::array<Real, 3> apparent(const Real& x, const Real& y, const Real& z) const {
    using std::sqrt;
    const Real length = sqrt(x * x + y * y + z * z);
    const Real along = x * beta_.x() + y * beta_.y() + z * beta_.z();
    const Real scale = 1.0 / (length + along);
    const Real forward = length + g_ * along;
    return {(b_ * x + forward * beta_.x()) * scale, (b_ * y + forward * beta_.y()) * scale,
            (b_ * z + forward * beta_.z()) * scale};
  }

 private:
  static constexpr double kLightSpeed = 299792458.0;  // m/s
  Vec3 beta_;
  double b_;  // 1 / gamma
  double g_;
};

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
