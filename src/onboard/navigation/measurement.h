// SPDX-License-Identifier: Apache-2.0
// BeaconMeasurement: all that the filter is ever told about an image.
#pragma once

#include <optional>

#include "foundation/math/linear.h"
#include "foundation/time/epoch.h"
#include "models/camera/camera.h"
#include "models/ephemeris/bodies.h"

namespace astronav::navigation {

struct BeaconMeasurement {
  BodyId body;
  Epoch mid_exposure;
  Pixel pixel;                // centre of light on the detector
  Mat2 pixel_covariance_px2;  // of the centroid alone
  // What repeats from image to image of a window, per axis, 1 sigma: not averaged by more images (a saturated spot's
  // wings that are not as believed). The filter carries it in its line-of-sight bias, as the window's first image tells
  // it; what a later one tells beyond that is noise of its own (a proton in the spot).
  double repeating_sigma_px = 0.0;
  Mat3 R_CN = Mat3::Identity();  // attitude from the stars of the same frame
  // By which velocity (barycentric, N) those stars were aberrated; without it: by the true one.
  std::optional<Vec3> v_stars_m_s{};
  // Of the attitude error theta (rad, camera axes): R_CN_true = exp(-[theta]x) R_CN.
  Mat3 attitude_covariance_rad2 = Mat3::Zero();
  // Its share that repeats from image to image of a window, as the stars do; carried as above.
  Mat3 attitude_repeating_rad2 = Mat3::Zero();
  // Correlation of centroid and attitude error, E[e_pixel theta'] (px rad); zero where the planet's pixel took no part
  // in the attitude.
  Eigen::Matrix<double, 2, 3> pixel_attitude_covariance = Eigen::Matrix<double, 2, 3>::Zero();
};

}  // namespace astronav::navigation
