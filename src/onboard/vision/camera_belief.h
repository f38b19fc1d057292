// SPDX-License-Identifier: Apache-2.0
// What the flight software believes of its camera's geometry, and how it learns it in flight: every frame's stars say
// something of focal length, centre and distortion beside the attitude.
//
// Why it must: a focal length wrong by 0.1 % leaves half a pixel at the edge of a 20-degree field, and stars are not
// spread evenly. The attitude is then off by some hundredths of a pixel, the same in all images of a window
// (docs/theory/vision.md, Camera).
#pragma once

#include <optional>
#include <span>

#include "onboard/vision/attitude.h"
#include "onboard/vision/types.h"

namespace astronav::vision {

// What the camera's file may be wrong by, 1 sigma. Nothing: the camera is taken as told.
struct CameraSigmas {
  double focal_relative = 0.0;
  double centre_px = 0.0;  // per axis
  double k1 = 0.0;
  bool any() const { return focal_relative > 0.0 || centre_px > 0.0 || k1 > 0.0; }
};

// A Gaussian belief. Its parameters, as errors of the camera as told: relative focal length, centre (u, v: px), k1. A
// change of the centre carries with it the turn that leaves the middle of the picture where it is: what remains is the
// tilt of the perspective, of second order in the field, and not the turn, which no star can tell from the attitude.
class CameraBelief {
 public:
  CameraBelief(const Intrinsics& told, const CameraSigmas& sigmas);

  const Intrinsics& camera() const { return camera_; }
  bool learns() const { return learns_; }
  // Attitude and camera together, by weighted least squares over one frame's stars with the belief as prior; afterwards
  // the belief is what came out. In `attitude`: the first guess, and the answer with its covariance. Sights tell which
  // took part, and their residuals. False, and no more than its belief of the camera is added, where fewer than 20
  // stars take part or the answer contradicts the belief.
  bool learn(std::span<StarSight> sights, AttitudeSolution& attitude);

 private:
  static constexpr int kParameters = CameraErrors::kCount;
  using Vector = Eigen::Matrix<double, kParameters, 1>;
  using Matrix = Eigen::Matrix<double, kParameters, kParameters>;
  Intrinsics with(const Vector& errors) const;

  Intrinsics told_, camera_;
  bool learns_;
  Vector errors_ = Vector::Zero(), least_sigma_;
  Matrix covariance_;
};

// What attitude and camera add to the place of something that is seen at a pixel, among the stars: E[e e'] of the
// camera's share, and E[e theta'] (px rad), for a pixel that is carried over to the camera as told.
struct CameraShare {
  Mat2 covariance_px2 = Mat2::Zero();
  Mat23 with_attitude = Mat23::Zero();
};
CameraShare camera_share(const AttitudeSolution& attitude, const Vec3& direction_C);
// The pixel at which `told` would show what `attitude` saw at a pixel.
Result<Pixel> as_told(const AttitudeSolution& attitude, const Intrinsics& told, Pixel pixel);

}  // namespace astronav::vision
