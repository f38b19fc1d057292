// SPDX-License-Identifier: Apache-2.0
#include "onboard/vision/attitude.h"

#include <algorithm>
#include <cmath>

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <Eigen/LU>
#include <Eigen/SVD>

#include "foundation/base/check.h"
#include "foundation/math/rotation.h"

namespace astronav::vision {
namespace {

constexpr int kMaxParameters = 7;
// With three parameters, the usual case, all sizes are known to the compiler.
template <int N>
struct Sizes {
  static constexpr int kMax = N == Eigen::Dynamic ? kMaxParameters : N;
  using Jacobian = Eigen::Matrix<double, 2, N, 0, 2, kMax>;
  using Normal = Eigen::Matrix<double, N, N, 0, kMax, kMax>;
  using Parameters = Eigen::Matrix<double, N, 1, 0, kMax, 1>;
};

// Columns of IntrinsicsJacobian.
enum { kFx, kFy, kCx, kCy, kK1, kK2, kK3, kP1, kP2 };

template <int N>
Result<AttitudeFit> fit_with(std::span<StarSight> sights, const Mat3& first_R_CN, const Intrinsics& camera,
                             const AttitudeOptions& options);

// The mean of so many squares of unit variance, where chance would seldom make it as large; else 1: raised whenever it
// is above 1, a covariance is 6 % too large on the average with forty stars.
double unlike_chance(double mean_square, double count) {
  constexpr double kSeldom = 2.0;  // sigmas
  return mean_square > 1.0 + kSeldom * std::sqrt(2.0 / count) ? mean_square : 1.0;
}

}  // namespace

Result<Mat3> attitude_from_directions(std::span<const Vec3> directions_C, std::span<const Vec3> directions_N) {
  ASTRONAV_CHECK_OP(directions_C.size(), ==, directions_N.size());
  Mat3 profile = Mat3::Zero();
  for (std::size_t i = 0; i < directions_C.size(); ++i) profile += directions_C[i] * directions_N[i].transpose();
  const Eigen::JacobiSVD<Mat3> svd(profile, Eigen::ComputeFullU | Eigen::ComputeFullV);
  if (!(svd.singularValues()(1) > 1e-12 * svd.singularValues()(0)))
    return fail(ErrorCode::not_converged, "the directions do not fix an attitude");
  const double sign = svd.matrixU().determinant() * svd.matrixV().determinant();
  return Mat3(svd.matrixU() * Vec3(1.0, 1.0, sign).asDiagonal() * svd.matrixV().transpose());
}

Result<AttitudeFit> fit_attitude(std::span<StarSight> sights, const Mat3& first_R_CN, const Intrinsics& camera,
                                 const AttitudeOptions& options) {
  return options.freedom.count() == 0 ? fit_with<3>(sights, first_R_CN, camera, options)
                                      : fit_with<Eigen::Dynamic>(sights, first_R_CN, camera, options);
}

namespace {

template <int N>
Result<AttitudeFit> fit_with(std::span<StarSight> sights, const Mat3& first_R_CN, const Intrinsics& camera,
                             const AttitudeOptions& options) {
  using Normal = typename Sizes<N>::Normal;
  const CameraFreedom& freedom = options.freedom;
  const int n = 3 + freedom.count();
  AttitudeFit fit;
  fit.R_CN = first_R_CN;
  fit.camera = camera;
  Normal information(n, n), shared(n, n);
  typename Sizes<N>::Parameters gradient(n);
  bool settled = false;
  for (int iteration = 0; iteration <= options.max_iterations; ++iteration) {
    information.setZero();
    shared.setZero();
    gradient.setZero();
    int used = 0;
    double chi2 = 0.0, sum2 = 0.0, pulls = 0.0, pulled2 = 0.0;
    for (StarSight& sight : sights) {
      const Vec3 direction_C = fit.R_CN * sight.direction_N;
      Mat23 by_direction;
      IntrinsicsJacobian by_camera;
      const Result<Pixel> predicted = project(fit.camera, direction_C, &by_direction, N == 3 ? nullptr : &by_camera);
      sight.used = false;
      if (!predicted) continue;
      sight.residual_px = sight.pixel.vec() - predicted->vec();
      Mat2 covariance = sight.covariance_px2;
      const double extra_px2 = options.extra_px2(sight);
      covariance.diagonal().array() += extra_px2;
      const Mat2 weight = covariance.inverse();
      const double d2 = sight.residual_px.dot(weight * sight.residual_px);
      // The first two steps take all that came in: the start may be some pixels off.
      if (iteration >= 2 && d2 > options.gate_sigma * options.gate_sigma) continue;
      sight.used = true;
      ++used;
      typename Sizes<N>::Jacobian jacobian(2, n);
      jacobian.template leftCols<3>() = by_direction * cross_matrix(direction_C);  // eq. 10
      if constexpr (N != 3) {
        int column = 3;
        if (freedom.focal_length) jacobian.col(column++) = by_camera.col(kFx) + by_camera.col(kFy);
        if (freedom.k1) jacobian.col(column++) = by_camera.col(kK1);
        if (freedom.tangential) {
          jacobian.col(column++) = by_camera.col(kP1);
          jacobian.col(column++) = by_camera.col(kP2);
        }
      }
      const double pull = star_pull(std::sqrt(d2), options.gate_sigma, iteration < 2);
      const Eigen::Matrix<double, N, 2, 0, Sizes<N>::kMax, 2> weighted = pull * jacobian.transpose() * weight;
      information.noalias() += weighted * jacobian;
      shared.noalias() += options.lasting_px2(sight) * (weighted * weighted.transpose());
      gradient.noalias() += weighted * sight.residual_px;
      chi2 += d2;
      pulls += pull;
      pulled2 += pull * pull * d2;
      sum2 += sight.residual_px.squaredNorm();
    }
    if (2 * used < n + 1)
      return fail(ErrorCode::not_converged, "{0} stars are too few for {1} parameters",
                  {static_cast<double>(used), static_cast<double>(n)});
    fit.used = used;
    fit.residual_rms_px = std::sqrt(sum2 / (2.0 * used));
    fit.chi2_per_dof = chi2 / (2.0 * used - n);
    const Eigen::LDLT<Normal> ldlt(information);
    if (ldlt.info() != Eigen::Success || !ldlt.isPositive())
      return fail(ErrorCode::not_converged, "the stars do not fix the attitude");
    if (settled || iteration == options.max_iterations) {
      const Normal covariance = ldlt.solve(Normal::Identity(n, n));
      const double larger = used >= kStarsThatTell ? unlike_chance(pulled2 / (2.0 * pulls), 2.0 * pulls) : 1.0;
      fit.covariance_rad2 = larger * covariance.template topLeftCorner<3, 3>();
      fit.repeating_rad2 = larger * Normal(covariance * shared * covariance).template topLeftCorner<3, 3>();
      if (!fit.covariance_rad2.allFinite()) return fail(ErrorCode::not_converged, "the stars do not fix the attitude");
      return fit;
    }
    const typename Sizes<N>::Parameters step = ldlt.solve(gradient);
    if (!step.allFinite()) return fail(ErrorCode::not_converged, "the stars do not fix the attitude");
    const Vec3 theta = step.template head<3>();
    fit.R_CN = rotation_exp(-theta) * fit.R_CN;
    if constexpr (N != 3) {
      int column = 3;
      if (freedom.focal_length) {
        // fx and fy change by the same amount: square pixels stay square.
        fit.camera.fx_px += step(column);
        fit.camera.fy_px += step(column);
        ++column;
      }
      if (freedom.k1) fit.camera.distortion.k1 += step(column++);
      if (freedom.tangential) {
        fit.camera.distortion.p1 += step(column++);
        fit.camera.distortion.p2 += step(column++);
      }
    }
    if (!(fit.camera.fx_px > 0.0)) return fail(ErrorCode::not_converged, "the focal length ran away");
    // 0.1 milliarcsecond; at least one step with the gate at work.
    settled = iteration >= 2 && theta.norm() < 5e-10;
  }
  return fail(ErrorCode::internal, "unreachable");
}

}  // namespace
}  // namespace astronav::vision
