// SPDX-License-Identifier: Apache-2.0
#include "onboard/vision/camera_belief.h"

#include <algorithm>
#include <cmath>

#include <Eigen/Cholesky>
#include <Eigen/LU>

#include "foundation/math/rotation.h"

namespace astronav::vision {
namespace {

enum { kFx, kFy, kCx, kCy, kK1 };  // columns of IntrinsicsJacobian

constexpr int kIterations = 5;
constexpr double kContradictionSigma = 6.0;
// A camera bends with temperature, and the same stars stand in the same places for an hour: no belief becomes firmer.
constexpr double kLeastFocal = 2e-6, kLeastCentrePx = 0.02, kLeastK1 = 2e-5;
constexpr double kExactly = 1e-12;  // sigma of what is not to be learned

Mat23 by_rotation(const Mat23& by_direction, const Vec3& direction_C) {
  return by_direction * cross_matrix(direction_C);
}

// The turn (rad, camera axes, 3 x 2) that undoes a shift of the centre by one pixel in the middle of the picture.
Eigen::Matrix<double, 3, 2> turn_by_centre(const Intrinsics& camera) {
  Eigen::Matrix<double, 3, 2> turn = Eigen::Matrix<double, 3, 2>::Zero();
  Mat23 by_direction;
  const Vec3 axis = Vec3::UnitZ();
  if (project(camera, axis, &by_direction))
    turn.topRows<2>() = -Mat2(by_rotation(by_direction, axis).leftCols<2>()).inverse();
  return turn;
}

// Of a pixel by the camera's errors, the turn that goes with them included.
Eigen::Matrix<double, 2, CameraErrors::kCount> by_errors(const Intrinsics& camera, const IntrinsicsJacobian& by_camera,
                                                         const Mat23& by_theta,
                                                         const Eigen::Matrix<double, 3, 2>& turn) {
  Eigen::Matrix<double, 2, CameraErrors::kCount> out;
  out.col(CameraErrors::focal) = by_camera.col(kFx) * camera.fx_px + by_camera.col(kFy) * camera.fy_px;
  out.col(CameraErrors::centre_u) = by_camera.col(kCx) + by_theta * turn.col(0);
  out.col(CameraErrors::centre_v) = by_camera.col(kCy) + by_theta * turn.col(1);
  out.col(CameraErrors::k1) = by_camera.col(kK1);
  return out;
}

}  // namespace

CameraBelief::CameraBelief(const Intrinsics& told, const CameraSigmas& sigmas)
    : told_(told), camera_(told), learns_(sigmas.any()) {
  Vector sigma;
  sigma << sigmas.focal_relative, sigmas.centre_px, sigmas.centre_px, sigmas.k1;
  least_sigma_ << kLeastFocal, kLeastCentrePx, kLeastCentrePx, kLeastK1;
  for (int i = 0; i < kParameters; ++i) {
    if (!(sigma[i] > 0.0)) least_sigma_[i] = 0.0;
    sigma[i] = std::max({sigma[i], least_sigma_[i], kExactly});
  }
  covariance_ = sigma.cwiseAbs2().asDiagonal();
}

Intrinsics CameraBelief::with(const Vector& errors) const {
  Intrinsics camera = told_;
  camera.fx_px *= 1.0 + errors[CameraErrors::focal];
  camera.fy_px *= 1.0 + errors[CameraErrors::focal];
  camera.cx_px += errors[CameraErrors::centre_u];
  camera.cy_px += errors[CameraErrors::centre_v];
  camera.distortion.k1 += errors[CameraErrors::k1];
  return camera;
}

bool CameraBelief::learn(std::span<StarSight> sights, AttitudeSolution& attitude) {
  constexpr int kAll = 3 + kParameters;
  constexpr AttitudeOptions options;  // noise and gate: those of the attitude alone
  using All = Eigen::Matrix<double, kAll, kAll>;
  attitude.camera = CameraErrors{};
  attitude.camera.covariance = covariance_;
  if (sights.size() < static_cast<std::size_t>(kStarsThatTell)) return false;
  const Matrix prior = covariance_.inverse();
  const Eigen::Matrix<double, 3, 2> turn = turn_by_centre(told_);
  // The guess was made with a camera of its own: its axes are carried over to the belief's.
  Vec2 shift(camera_.cx_px - attitude.intrinsics.cx_px, camera_.cy_px - attitude.intrinsics.cy_px);
  Mat3 R_CN = rotation_exp(-(turn * shift)) * attitude.R_CN;
  Vector errors = errors_;
  All covariance, repeating;
  for (int iteration = 0;; ++iteration) {
    const Intrinsics camera = with(errors);
    All information = All::Zero(), shared = All::Zero();
    Eigen::Matrix<double, kAll, 1> gradient = Eigen::Matrix<double, kAll, 1>::Zero();
    information.bottomRightCorner<kParameters, kParameters>() = prior;
    gradient.tail<kParameters>() = prior * (errors_ - errors);
    int used = 0;
    double pulls = 0.0, pulled2 = 0.0;
    for (StarSight& sight : sights) {
      const Vec3 direction_C = R_CN * sight.direction_N;
      Mat23 by_direction;
      IntrinsicsJacobian by_camera;
      const Result<Pixel> predicted = project(camera, direction_C, &by_direction, &by_camera);
      sight.used = false;
      if (!predicted) continue;
      sight.residual_px = sight.pixel.vec() - predicted->vec();
      const double extra_px2 = options.extra_px2(sight);
      const Mat2 weight = (sight.covariance_px2 + extra_px2 * Mat2::Identity()).inverse();
      const double d2 = sight.residual_px.dot(weight * sight.residual_px);
      // The first two steps take all, with a bounded pull: the camera may be half a pixel off at the edge.
      const bool rough = iteration < 2;
      if (!rough && d2 > options.gate_sigma * options.gate_sigma) continue;
      const double pull = star_pull(std::sqrt(d2), options.gate_sigma, rough);
      const Mat23 by_theta = by_rotation(by_direction, direction_C);
      Eigen::Matrix<double, 2, kAll> jacobian;
      jacobian << by_theta, by_errors(camera, by_camera, by_theta, turn);
      const Eigen::Matrix<double, kAll, 2> weighted = pull * jacobian.transpose() * weight;
      information.noalias() += weighted * jacobian;
      shared.noalias() += options.lasting_px2(sight) * (weighted * weighted.transpose());
      gradient.noalias() += weighted * sight.residual_px;
      sight.used = true;
      ++used;
      pulls += pull;
      pulled2 += pull * pull * d2;
    }
    if (used < kStarsThatTell) return false;
    const Eigen::LDLT<All> ldlt(information);
    if (ldlt.info() != Eigen::Success || !ldlt.isPositive()) return false;
    if (iteration == kIterations) {
      const double larger = std::max(1.0, pulled2 / (2.0 * pulls));
      const All inverse = ldlt.solve(All::Identity());
      covariance = larger * inverse;
      repeating = larger * inverse * shared * inverse;
      break;
    }
    const Eigen::Matrix<double, kAll, 1> step = ldlt.solve(gradient);
    if (!step.allFinite()) return false;
    errors += step.tail<kParameters>();
    R_CN =
        rotation_exp(-(step.head<3>() + turn * step.segment<2>(3 + static_cast<int>(CameraErrors::centre_u)))) * R_CN;
  }
  const Vector moved = errors - errors_;
  if (!(moved.dot(prior * moved) < kContradictionSigma * kContradictionSigma * kParameters)) return false;

  errors_ = errors;
  camera_ = with(errors);
  covariance_ = covariance.bottomRightCorner<kParameters, kParameters>();
  for (int k = 0; k < kParameters; ++k)
    covariance_(k, k) = std::max(covariance_(k, k), least_sigma_[k] * least_sigma_[k]);
  attitude.R_CN = R_CN;
  attitude.intrinsics = camera_;
  attitude.covariance_rad2 = covariance.topLeftCorner<3, 3>();
  attitude.repeating_rad2 = repeating.topLeftCorner<3, 3>();
  attitude.camera.covariance = covariance_;
  attitude.camera.with_attitude = covariance.topRightCorner<3, kParameters>();
  return true;
}

CameraShare camera_share(const AttitudeSolution& attitude, const Vec3& direction_C) {
  CameraShare out;
  if (attitude.camera.covariance.isZero(0.0)) return out;
  Mat23 by_direction;
  IntrinsicsJacobian by_camera;
  if (!project(attitude.intrinsics, direction_C, &by_direction, &by_camera)) return out;
  const auto by = by_errors(attitude.intrinsics, by_camera, by_rotation(by_direction, direction_C),
                            turn_by_centre(attitude.intrinsics));
  out.covariance_px2 = by * attitude.camera.covariance * by.transpose();
  out.with_attitude = by * attitude.camera.with_attitude.transpose();
  return out;
}

Result<Pixel> as_told(const AttitudeSolution& attitude, const Intrinsics& told, Pixel pixel) {
  const Result<Vec3> direction_C = unproject(attitude.intrinsics, pixel);
  if (!direction_C) return forward(direction_C);
  return project(told, *direction_C);
}

}  // namespace astronav::vision
