// SPDX-License-Identifier: Apache-2.0
// Triangulation: a place from two or more lines of sight of one moment, with its covariance.
//
// What stands across a sight i is B_i'(R_i - r), two numbers, with the variance rho_i^2 B_i' C_i B_i + e_i^2 I: the
// farther the beacon, the less its direction tells. Weighted by that, the linear problem gives the least-variance
// estimate; distances come from the round before (docs/theory/fix.md eq. 1 to 3; iteratively reweighted direct linear
// transform, of the same accuracy as LOST: Henry & Christian 2023, J. Guid. Control Dyn. 46(1)). Barycentric, N, SI.
// No heap, bounded loops.
//
// Sights that cross nowhere give no place but an error (no_match), whose subject is the reason: "parallel", "behind",
// "apart".
#pragma once

#include <span>

#include "foundation/base/error.h"
#include "foundation/time/epoch.h"
#include "models/ephemeris/ephemeris.h"

namespace astronav::navigation {

// Two axes across a unit vector.
using Axes2 = Eigen::Matrix<double, 3, 2>;
Axes2 axes_across(const Vec3& direction);

struct LineOfSight {
  Vec3 direction_N = Vec3::UnitZ();     // towards the beacon, free of aberration
  Mat3 covariance_rad2 = Mat3::Zero();  // of the direction; what it says along the direction does not count
  Vec3 p_beacon_O_N = Vec3::Zero();     // where the light came from
  double beacon_sigma_m = 0.0;          // of that place, per axis
};

struct Triangulation {
  Vec3 p_O_N = Vec3::Zero();
  Mat3 covariance_m2 = Mat3::Zero();
  double chi2 = 0.0;
  int degrees_of_freedom = 0;  // 2 n - 3
};

struct TriangulationSettings {
  // Sights are parallel where the place's worst axis is less certain than this share of the way to the nearest beacon:
  // then neither place nor covariance mean anything.
  double most_sigma_share = 0.1;
  // Sights whose chi-square is exceeded by chance less often than this do not belong together.
  double least_probability = 1e-6;
};

// invalid_argument: fewer than two sights, or one that is not finite or has no variance.
Result<Triangulation> triangulate(std::span<const LineOfSight> sights, const TriangulationSettings& settings = {});

// The same with planets, light time and the observer's velocity counted. Directions are apparent; with the velocity of
// the observer zero they are those among stars that were not aberrated either.
struct BodySight {
  BodyId body;
  Vec3 direction_N = Vec3::UnitZ();
  Mat3 covariance_rad2 = Mat3::Zero();
  double ephemeris_sigma_m = 0.0;
};
inline constexpr std::size_t kMaxBodySights = 16;
Result<Triangulation> triangulate(const Ephemeris& ephemeris, Epoch epoch, const Vec3& v_observer_O_N,
                                  std::span<const BodySight> sights, const TriangulationSettings& settings = {});

}  // namespace astronav::navigation
