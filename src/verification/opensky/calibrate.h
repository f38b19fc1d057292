// SPDX-License-Identifier: Apache-2.0
// calibrate_camera: focal length, centre and distortion of a camera from pictures of the sky alone.
//
// Each picture is solved blind, then stars and camera are improved in turns: what the camera of the last turn makes
// sure is taken in, and one adjustment moves camera and all attitudes. How many parameters the lens deserves is chosen
// by cross-validation: the fewest whose held-out stars lie as near as those of the best model, within one standard
// error (docs/theory/camera.md).
#pragma once

#include <limits>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "foundation/base/error.h"
#include "foundation/raster/raster.h"
#include "models/camera/camera.h"
#include "models/ephemeris/ephemeris.h"
#include "models/stars/catalogue.h"
#include "verification/opensky/calibrate_adjust.h"
#include "verification/opensky/solver.h"

namespace astronav::opensky {

struct CalibrationFrame {
  const Picture* picture = nullptr;
  std::optional<Epoch> epoch{};            // J2025.0 for proper motion where it is not given
  std::optional<State> observer{};         // barycentric; aberration is corrected where it is known
  std::optional<Refraction> refraction{};  // of an observer on the ground
  std::optional<Vec3> zenith_N{};  // of an observer on the ground: an all-sky camera looks up to within 30 degrees
};

struct CalibrationRequest {
  ProjectionModel model = ProjectionModel::pinhole;
  std::optional<FieldRange> field;  // horizontal; of a fisheye 140 to 230 degrees across the shorter side if not given
  std::optional<Near> near;         // where all pictures look; counts before the zenith
  const Ephemeris* ephemeris = nullptr;  // with epoch and observer: planets are kept out and foretold
  double max_v_mag = 10.0;
  int folds = 5;
};

struct CalibrationStar {
  std::uint32_t id = 0;
  double v_mag = 0.0;
  Pixel pixel;                      // as in the picture
  double sigma_px = 0.0;            // an axis, as the image processing believes
  Vec2 residual_px = Vec2::Zero();  // measured less predicted, as in the picture
};
// A planet is never used: its place is foretold by what the stars have told.
struct ForetoldPlanet {
  BodyId body;
  Pixel predicted;  // as in the picture
  double v_mag = 0.0;
  std::optional<Pixel> measured;  // the brightest spot within 5 pixels
};
struct CalibratedFrame {
  std::optional<Error> error;  // then it took no part, and nothing below is told
  Mat3 R_CN = Mat3::Identity();
  Mat3 covariance_rad2 = Mat3::Zero();
  std::size_t spots = 0;
  std::vector<CalibrationStar> stars;
  std::vector<ForetoldPlanet> planets;
  double rms_px = 0.0;
  // The same with a camera of its own; NaN of one picture, or few stars. Where it is much less, the pictures are not of
  // one camera, or not of one focus.
  double rms_alone_px = std::numeric_limits<double>::quiet_NaN();
  bool stands_apart() const { return rms_px > 1.3 * rms_alone_px; }
  bool aberration_corrected = false;
  bool refraction_corrected = false;
};

struct Calibration {
  Intrinsics camera;
  bool mirrored =
      false;            // the camera is that of the pictures with their columns turned round: u = width - 1 - u_picture
  LensFreedom freedom;  // what was solved for
  IntrinsicsCovariance covariance = IntrinsicsCovariance::Zero();  // zero where a parameter is held
  std::size_t stars = 0;
  double rms_px = 0.0;                  // both axes together, of the stars used
  double held_out_rms_px = 0.0;         // the same, of stars that were not
  Scatter scatter;                      // of the stars
  std::vector<CrossValidation> models;  // all that were tried
  std::vector<CalibratedFrame> frames;  // one a picture
  // Rough, from the pictures: what a camera file wants to know beside.
  double psf_sigma_px = 0.8;
  double background_dn = 0.0;
  double noise_dn = 0.0;
};

// All pictures of one size, from one camera. invalid_argument where they are not; no_match where none is recognised;
// not_converged where the stars do not determine even a focal length.
Result<Calibration> calibrate_camera(const StarCatalogue& catalogue, std::span<const CalibrationFrame> frames,
                                     const CalibrationRequest& request);

}  // namespace astronav::opensky
