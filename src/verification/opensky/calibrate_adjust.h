// SPDX-License-Identifier: Apache-2.0
// Bundle adjustment: one camera and one attitude a picture from stars that are known by name (docs/theory/camera.md
// eq. 8 to 12), with Ceres Solver; one picture alone without it.
#pragma once

#include <array>
#include <optional>
#include <span>
#include <string_view>
#include <vector>

#include "foundation/base/error.h"
#include "models/camera/camera.h"

namespace astronav::opensky {

struct StarObservation {
  int frame = 0;
  Pixel pixel;                             // as a camera that is not mirrored sees it
  Mat2 covariance_px2 = Mat2::Identity();  // of the pixel, as the image processing believes
  Vec3 direction_N = Vec3::UnitZ();        // apparent
};

// Which of the nine parameters are solved for; the others keep the values they start with. fx and fy go together where
// the aspect is held.
struct LensFreedom {
  bool centre = false;
  int radial = 0;  // k1; k1 and k2; k1 to k3
  bool tangential = false;
  bool aspect = false;
  bool focal = true;  // only of one picture may nothing be free
  int count() const { return (focal ? 1 : 0) + (centre ? 2 : 0) + radial + (tangential ? 2 : 0) + (aspect ? 1 : 0); }
  // In the order of IntrinsicsJacobian.
  std::array<bool, 9> free() const;
};
inline constexpr std::array<std::string_view, 9> kIntrinsicsNames{"fx_px", "fy_px", "cx_px", "cy_px", "k1",
                                                                  "k2",    "k3",    "p1",    "p2"};
std::array<double, 9> intrinsics_values(const Intrinsics& camera);

// How far stars really scatter: the covariance of a centroid = scale^2 (what the image processing believes) + extra^2.
struct Scatter {
  double scale = 1.0;
  double extra_sigma_px = 0.1;  // an axis
  Mat2 covariance(const Mat2& believed) const {
    return scale * scale * believed + extra_sigma_px * extra_sigma_px * Mat2::Identity();
  }
};

using IntrinsicsCovariance = Eigen::Matrix<double, 9, 9>;
// Of theta (3, as below) and the nine parameters.
using PlateCovariance = Eigen::Matrix<double, 12, 12>;

struct Adjustment {
  Intrinsics camera;
  IntrinsicsCovariance covariance = IntrinsicsCovariance::Zero();  // zero where a parameter is held
  std::vector<Mat3> R_CN;
  std::vector<Mat3> attitude_covariance_rad2;                  // of theta with R_true = exp(-[theta]x) R
  PlateCovariance plate_covariance = PlateCovariance::Zero();  // of one picture alone; zero where there are more
  std::vector<Vec2> residuals_px;  // measured less predicted, of every observation; huge where none falls
  std::vector<bool> used;
  Scatter scatter;
  double rms_px = 0.0;  // of the stars used, both axes together: sqrt(mean(du2 + dv2))
};

struct AdjustOptions {
  double gate_sigma = 4.0;         // what is farther off is left out
  std::optional<Scatter> scatter;  // found from the residuals where it is not given
  int passes = 5;                  // of gating and weighing
};

// not_converged where too few stars are left or the camera cannot be told from them.
Result<Adjustment> adjust(std::span<const StarObservation> observations, std::span<const Mat3> first_R_CN,
                          const Intrinsics& first, const LensFreedom& freedom, const AdjustOptions& options = {});

// Mean, over held-out stars, of their squared residuals over what was expected, and of those in pixels.
struct CrossValidation {
  LensFreedom freedom;
  double held_out_rms_px = 0.0;  // both axes together
  std::vector<double> surprise;  // of each observation, when held out: r' C^-1 r, at most 50
  double mean_surprise = 0.0;
};
// `folds` times all but one part of the stars are fitted and the rest predicted. The parts are drawn by a stream of
// their own: the same stars, the same parts.
Result<CrossValidation> cross_validate(std::span<const StarObservation> observations, std::span<const Mat3> first_R_CN,
                                       const Intrinsics& first, const LensFreedom& freedom, const Scatter& scatter,
                                       int folds);

}  // namespace astronav::opensky
