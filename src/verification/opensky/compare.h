// SPDX-License-Identifier: Apache-2.0
// Compare: a real picture of the sky held against the rendering of the same sky (docs/real-sky.md).
//
// What the camera is (plate, distortion, point-spread function, zero point, colour, vignetting, noise) is fitted on the
// picture; the rendering is the simulator's: Sky, place_sources, Renderer. Stars are judged by a camera that was fitted
// without them: they are dealt into two halves, and each half is judged by the fit of the other.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "foundation/base/error.h"
#include "foundation/image/image.h"
#include "foundation/raster/raster.h"
#include "models/camera/camera.h"
#include "models/ephemeris/ephemeris.h"
#include "models/photometry/photometry.h"
#include "models/stars/catalogue.h"

namespace astronav::opensky {

// A star that the catalogue lacks, or that somebody wants to see by name. One within 5 arcsec of a catalogue's star at
// J2000 takes its place.
struct NamedStar {
  std::string name;
  Star star;
  double v_i = kUnknownColour;
};

struct CompareRequest {
  const Ephemeris* ephemeris = nullptr;
  const StarCatalogue* catalogue = nullptr;
  Epoch epoch;
  State observer;
  bool observer_known = false;  // otherwise neither aberration nor planets
  bool aberration = true;       // false: the plate is from stars that were not aberrated either

  // Where the camera looks, from a solution or a header. `camera` brings curves and detector; its projection does not
  // count.
  Intrinsics plate;
  Mat3 R_CN = Mat3::Identity();
  bool mirrored = false;  // the plate is that of the picture with its columns reversed
  bool fit_plate = true;  // false: plate and zero point are taken as they are
  Camera camera;
  bool camera_known = false;  // its curves, gain and read noise are; otherwise the picture tells noise and colour
  double exposure_s = 1.0;

  double max_v_mag = 13.0;
  double least_snr = 10.0;  // of a star that counts, expected from the catalogue
  std::vector<NamedStar> named;
};

struct ComparedStar {
  std::int64_t id = 0;
  std::string name;  // of named stars
  double v_mag = 0.0, b_v = 0.0;
  Pixel predicted, measured;  // as in the picture
  double expected_e = 0.0, measured_e = 0.0;
  double aperture_share = 1.0;  // of named stars: of their light within 4 px, which is what is measured
  double snr = 0.0;             // expected
  double sigma_px = 0.0;        // of the measured place, one axis
  bool saturated = false;
  bool crowded = false;  // another catalogue star within 4 px that shines at least a tenth as bright
  bool found = false;    // its light was found within 2 px
  bool counts = false;   // for place and brightness: S/N, neither saturated nor crowded, whole window in the picture
  double residual_px() const { return (measured.vec() - predicted.vec()).norm(); }
  double residual_mag() const;  // measured minus predicted
};

// Over 15 x 15 pixels around every star of at least `least_snr` whose window is in the picture and not saturated.
struct WindowFigures {
  std::size_t windows = 0;
  double rmse_dn = 0.0;
  double noise_dn = 0.0;             // root mean square of the expected sigma
  double rmse_over_noise = 0.0;      // root mean square of difference over sigma, pixel by pixel
  double starless_over_noise = 0.0;  // the same for a rendering without stars
  double ssim_loss = 0.0;            // 1 - SSIM, mean
  double starless_ssim_loss = 0.0;
  double ssim_loss_ratio() const { return starless_ssim_loss > 0.0 ? ssim_loss / starless_ssim_loss : 0.0; }
};

struct Comparison {
  Camera camera;  // fitted on all stars
  Mat3 R_CN = Mat3::Identity();
  bool mirrored = false;
  double exposure_s = 1.0;
  std::vector<ComparedStar> stars;  // all of the catalogue in the picture, bright first
  bool halves = false;              // whether there were stars enough to judge each without itself
  std::size_t counted = 0, lost = 0, crowded = 0, saturated = 0;   // of those with the S/N
  double geometric_rms_px = 0.0, geometric_median_px = 0.0;        // two-dimensional, of the stars that count
  double photometric_rms_mag = 0.0, photometric_median_mag = 0.0;  // about zero; median of the absolute value
  // The same with stars beyond 4 robust sigma left out, and how many those are.
  double clipped_geometric_rms_px = 0.0, clipped_photometric_rms_mag = 0.0;
  std::size_t clipped_places = 0, clipped_magnitudes = 0;
  // The same with the fit of all stars, themselves included.
  double own_geometric_rms_px = 0.0, own_photometric_rms_mag = 0.0;
  WindowFigures windows;            // each star by the camera that was fitted without it
  WindowFigures own_windows;        // by the camera that was fitted on all
  WindowFigures deep_windows;       // of every catalogue star, whatever its S/N; judged as `windows`
  double zero_point_mag = 0.0;      // V of a star of B-V 0.65 that gives 1 DN/s on the axis
  double colour_mag = 0.0;          // how much brighter a star of B-V 1.65 is seen than that zero point says
  double psf_sigma_px = 0.0;        // of the core, on the axis
  double psf_fwhm_px = 0.0;         // of core and halo together, before pixels
  double background_dn = 0.0;       // in the middle
  double background_scatter = 1.0;  // of the tiles about the smooth sky, over what their noise explains
  double noise_floor_dn = 0.0;      // at level 0
  double gain_e_dn = 0.0;
  ImageF rendering_dn;  // noise-free, by the camera fitted on all; as the picture lies
  ImageF difference_dn;
};

// no_match where fewer than 6 stars with the S/N are there to fit by.
Result<Comparison> compare(const Picture& picture, const CompareRequest& request);

}  // namespace astronav::opensky
