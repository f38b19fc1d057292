// SPDX-License-Identifier: Apache-2.0
// Solar radiation pressure on a spacecraft of flat plates: a box, its wings, a dish (docs/theory/dynamics.md eq. 3a).
//
// Plates neither shadow nor heat one another. Body frame B; the attitude says where it points.
#pragma once

#include <functional>
#include <optional>
#include <span>
#include <vector>

#include "foundation/base/error.h"
#include "foundation/math/linear.h"
#include "foundation/time/epoch.h"

namespace astronav::dynamics {

// Radiation pressure at 1 AU, N/m^2 (solar constant over the speed of light, for a surface that absorbs).
inline constexpr double kSolarPressureAtOneAu = 4.56e-6;

struct Plate {
  double area_m2 = 0.0;
  Vec3 normal_B = Vec3::UnitX();  // outwards; light from behind does nothing
  double specular = 0.0;          // share of the light that is mirrored
  double diffuse = 0.0;           // share that is scattered after Lambert; the rest is absorbed
  // A solar array on this axis: it turns until it faces the Sun as well as it can, and normal_B does not matter.
  std::optional<Vec3> hinge_B = std::nullopt;
};

// A box with its edges along the body axes, and arrays of a total area that turn about `hinge_B`.
std::vector<Plate> box_wing(const Vec3& edges_m, double box_specular, double box_diffuse, double wing_area_m2,
                            const Vec3& hinge_B, double wing_specular, double wing_diffuse);

// invalid_argument: an area below zero, a direction that is no unit vector, shares below zero or above one in sum.
Result<void> check_plates(std::span<const Plate> plates);

// Force in units of the pressure at the spacecraft, m^2, in B; `to_sun_B` is a unit vector. A sphere that absorbs all
// would give -area to_sun.
Vec3 pressure_area(std::span<const Plate> plates, const Vec3& to_sun_B);

// R_BN at an epoch, of the unit vector towards the Sun (N).
using Attitude = std::function<Mat3(Epoch, const Vec3& to_sun_N)>;

Attitude fixed_attitude(const Mat3& R_BN);
// `axis_B` points at the Sun, `second_B` as near to the ICRF pole as that leaves it. Both unit vectors, not in line.
Attitude sun_pointing(const Vec3& axis_B, const Vec3& second_B);

}  // namespace astronav::dynamics
