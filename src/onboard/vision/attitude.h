// SPDX-License-Identifier: Apache-2.0
// Attitude from matched stars: a first guess from directions, then least squares on pixels with every centroid's own
// covariance (docs/theory/vision.md eq. 10 to 12).
//
// Error convention: theta (rad, camera axes) with R_CN_true = exp(-[theta]x) R_CN. The covariance is the inverse of the
// normal matrix. Does not allocate.
#pragma once

#include <span>

#include "foundation/base/error.h"
#include "foundation/math/linear.h"
#include "models/camera/camera.h"

namespace astronav::vision {

struct StarSight {
  Pixel pixel;
  Mat2 covariance_px2 = Mat2::Identity();
  Vec3 direction_N;                 // apparent
  double extra_px2 = 0.0;           // what the star itself may be off by, an axis; 0: as AttitudeOptions say
  double lasting_px2 = 0.0;         // what the next images will have again of it; 0: all
  bool used = true;                 // in: take part; out: took part
  Vec2 residual_px = Vec2::Zero();  // out: measured minus predicted
};

// Davenport's problem solved through the SVD of the attitude profile matrix (Markley 1988). Directions in C and N in
// step; not_converged for fewer than two, or all in a line of sight.
Result<Mat3> attitude_from_directions(std::span<const Vec3> directions_C, std::span<const Vec3> directions_N);

// What is solved for beside the attitude.
struct CameraFreedom {
  bool focal_length = false;  // fx and fy together
  bool k1 = false;
  bool tangential = false;  // p1, p2
  int count() const { return (focal_length ? 1 : 0) + (k1 ? 1 : 0) + (tangential ? 2 : 0); }
};

struct AttitudeOptions {
  CameraFreedom freedom;
  // Added in quadrature to every centroid: what is wrong with camera and catalogue. The brightest stars are measured to
  // 0.002 px, but a fifth have companions that nobody listed, and a calibrated lens bends lines by some thousandths.
  double extra_sigma_px = 0.0035;
  double extra_px2(const StarSight& sight) const {
    return sight.extra_px2 > 0.0 ? sight.extra_px2 : extra_sigma_px * extra_sigma_px;
  }
  double lasting_px2(const StarSight& sight) const {
    return sight.lasting_px2 > 0.0 ? sight.lasting_px2 : extra_px2(sight);
  }
  double gate_sigma = 5.0;  // a star farther off than this (Mahalanobis) is left out, and tried again next time
  int max_iterations = 12;
};

// So many stars tell whether the covariances are true: where what is left is larger, that of the attitude grows with it
// (eq. 11a).
inline constexpr int kStarsThatTell = 20;

// How hard a star pulls that is off by so many sigmas. While the start is rough, far-off stars pull with a bounded
// force (Huber); later, the less the farther off: beyond 2.5 sigma lie double stars that the catalogue takes for single
// ones, and few others (4 %).
inline double star_pull(double sigmas, double gate_sigma, bool rough) {
  constexpr double kFullWeightSigma = 2.5;
  if (rough) return sigmas > gate_sigma ? gate_sigma / sigmas : 1.0;
  return sigmas > kFullWeightSigma ? kFullWeightSigma * kFullWeightSigma / (sigmas * sigmas) : 1.0;
}

struct AttitudeFit {
  Mat3 R_CN = Mat3::Identity();
  Mat3 covariance_rad2 = Mat3::Zero();  // the solved-for camera parameters are accounted for
  Mat3 repeating_rad2 = Mat3::Zero();   // its share that the same stars bring again
  Intrinsics camera;
  int used = 0;
  double residual_rms_px = 0.0;  // per axis, over the stars used
  double chi2_per_dof = 0.0;
};

// From a first attitude within some pixels of the truth. not_converged where too few stars are left (fewer than 2 plus
// half the extra parameters) or the normal matrix is singular.
Result<AttitudeFit> fit_attitude(std::span<StarSight> sights, const Mat3& first_R_CN, const Intrinsics& camera,
                                 const AttitudeOptions& options = {});

}  // namespace astronav::vision
