// SPDX-License-Identifier: Apache-2.0
// The ecliptic and equinox of J2000, as SPICE's frame ECLIPJ2000 and JPL Horizons have them.
#pragma once

#include <cmath>

#include "foundation/math/linear.h"

namespace astronav {

inline constexpr double kObliquityJ2000 = 84381.448 * kArcsecond;  // IAU 1976

// The pole of the ecliptic on the side of the north, on the axes N.
inline const Vec3& ecliptic_north_N() {
  static const Vec3 north(0.0, -std::sin(kObliquityJ2000), std::cos(kObliquityJ2000));
  return north;
}

}  // namespace astronav
