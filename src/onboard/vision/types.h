// SPDX-License-Identifier: Apache-2.0
// What the image processing gives and takes: plain values, no heap.
#pragma once

#include <cstdint>

#include "foundation/math/linear.h"
#include "models/camera/camera.h"
#include "models/ephemeris/bodies.h"

namespace astronav::vision {

// What a spot of light looks like. Only points (a star, a planet, saturated ones and bloomed ones too) go on to
// identification.
enum class SpotKind : unsigned char {
  point,
  hot_pixel,   // sharper than any star, and in the last frame at the same pixel
  cosmic_ray,  // sharper than any star, or than it is long
  streak,      // something that moved among the stars
  column,      // one or two columns wide, and long
  extended,    // wider than the point-spread function in every direction
};

// A spot of light before anybody knows what it is.
struct Centroid {
  Pixel pixel;
  Mat2 covariance_px2 = Mat2::Identity();
  // What repeats from frame to frame, per axis, 1 sigma; beside the covariance.
  double repeating_sigma_px = 0.0;
  double flux_dn = 0.0;  // above the background
  double peak_dn = 0.0;  // above the background
  double snr = 0.0;
  int pixels = 0;  // in the connected region
  bool saturated = false;
  SpotKind kind = SpotKind::point;

  // Noise and what repeats: all of a single frame's error.
  Mat2 whole_covariance_px2() const {
    return covariance_px2 + repeating_sigma_px * repeating_sigma_px * Mat2::Identity();
  }
};

struct MatchedStar {
  std::uint32_t catalogue_index = 0;
  std::uint32_t id = 0;        // Hipparcos number
  std::uint32_t field = 0;     // index into the field of stars on board
  std::uint32_t centroid = 0;  // index into the centroids
  Vec2 residual_px = Vec2::Zero();
};

// Of the camera's geometry, where it is learned in flight (camera_belief.h): relative focal length, centre (px, with
// the turn that keeps the middle of the picture), k1.
struct CameraErrors {
  enum Parameter : int { focal, centre_u, centre_v, k1, kCount };
  Eigen::Matrix<double, kCount, kCount> covariance = Eigen::Matrix<double, kCount, kCount>::Zero();
  Eigen::Matrix<double, 3, kCount> with_attitude = Eigen::Matrix<double, 3, kCount>::Zero();  // E[theta c']
};

struct AttitudeSolution {
  Mat3 R_CN = Mat3::Identity();
  // Of the error theta (rad, camera axes): R_CN_true = exp(-[theta]x) R_CN.
  Mat3 covariance_rad2 = Mat3::Zero();
  // Its share that comes from the catalogue and the lens: the next image of the same stars has it again (eq. 11b).
  Mat3 repeating_rad2 = Mat3::Zero();
  Intrinsics intrinsics;  // as used, or as solved for
  CameraErrors camera;    // of `intrinsics`; zero where the camera is taken as told
  bool mirrored = false;
  double residual_rms_px = 0.0;
  double chance_probability = 1.0;
  int matched = 0;
};

// Where a planet should be, told by the navigation.
struct PlanetPrediction {
  BodyId body;
  Vec3 direction_N;                          // apparent unit vector (light time, aberration, centre of light)
  Mat3 direction_covariance = Mat3::Zero();  // of the unit vector, N
  double v_mag = 0.0;
  double expected_flux_dn = 0.0;  // 0: brightness is not used
  // A body beside it whose light may run into its spot (the Moon beside the Earth). Flux 0: none.
  Vec3 companion_direction_N = Vec3::Zero();
  double companion_flux_dn = 0.0;
  double angular_radius_rad = 0.0;  // of the body; 0: a point
  Vec3 sunward_N = Vec3::Zero();    // unit vector from the body to the Sun; zero: not known
  double law_of_light = 0.0;        // what its law of scattering may be wrong by, relative
};

struct PlanetMatch {
  BodyId body;
  std::uint32_t centroid = 0;
  Pixel predicted;
  double mahalanobis = 0.0;  // d^2 of the innovation
  double probability = 0.0;  // that this spot is the body, and not another spot or none
  bool found = false;
};

}  // namespace astronav::vision
