// SPDX-License-Identifier: Apache-2.0
// Where a point source lies, by a least-squares fit of a pixel-integrated Gaussian (docs/theory/vision.md eq. 4 to 8).
//
// Two forms. An unsaturated spot: (u, v, flux) are free. A spot with saturated pixels: those are masked, so that the
// wings decide, and the width and the share and place of a wide halo are free too, each with a prior around what is
// believed.
// The weights are the variances that the model predicts for each pixel (read and background noise as measured in the
// frame, shot noise, photo-response non-uniformity) plus what the model itself may be wrong by; the covariance is the
// inverse of the information matrix, so it is the covariance of this very estimator.
#pragma once

#include "foundation/image/image.h"
#include "foundation/math/linear.h"
#include "models/camera/camera.h"

namespace astronav::vision {

// What the onboard software believes of detector and optics. DN where not said otherwise.
struct SensorModel {
  double gain_e_dn = 1.0;
  double read_noise_e = 0.0;
  double photo_nonuniformity = 0.0;  // PRNU, 1 sigma
  double saturation_dn = 65535.0;    // a pixel at or above this tells nothing but "bright"
  double psf_sigma_px = 0.8;
  // What the Gaussian may be wrong by, 1 sigma.
  double halo_fraction = 0.01;  // energy in a wide halo that nobody measured
  double halo_sigma_px = 3.0;
  double psf_sigma_relative = 0.08;   // of the width
  double psf_shape_relative = 0.003;  // of the light in a pixel, for saturated spots
  double halo_shape_relative = 0.12;  // of the halo's light in a pixel: a halo is no Gaussian
  double halo_offset_px = 0.2;        // of the halo's centre from the core's, each axis

  // Saturation: 95 % of the lower of full well and converter range, where clipping does not bite yet.
  static SensorModel from(const Camera& camera);
  // Variance of a pixel that holds `signal_dn` above a background with the noise `background_sigma_dn`.
  double pixel_variance_dn2(double signal_dn, double background_sigma_dn) const {
    const double signal = signal_dn > 0.0 ? signal_dn : 0.0;
    const double fixed_pattern = photo_nonuniformity * signal;
    return background_sigma_dn * background_sigma_dn + signal / gain_e_dn + fixed_pattern * fixed_pattern;
  }
};

struct PsfFit {
  bool converged = false;
  bool saturated = false;
  Pixel pixel;
  Mat2 covariance_px2 = Mat2::Identity();
  double flux_dn = 0.0;
  double flux_sigma_dn = 0.0;
  double sigma_px = 0.0;  // the width, as believed or as found
  double chi2_per_dof = 0.0;
};

// The part of the image that a fit looks at, inclusive; cut to the image by the caller.
struct Window {
  int u0 = 0, v0 = 0, u1 = 0, v1 = 0;
  int width() const { return u1 - u0 + 1; }
  int height() const { return v1 - v0 + 1; }
};
inline constexpr int kMaxFitWindow = 32;  // px, each way

// `guess` within about 1 px (saturated: 2 px). Does not allocate; at most 100 iterations.
template <typename T>
PsfFit fit_psf(ImageView<const T> image, const Window& window, Pixel guess, double background_dn,
               double background_sigma_dn, const SensorModel& sensor);

// Another body whose light falls into the window: its place relative to the spot, and its light. Not as a share of the
// spot's own flux: that of a saturated spot is known from its wings alone, to 20 %.
struct Companion {
  Vec2 offset_px = Vec2::Zero();
  double flux_dn = 0.0;
};

// The same beside a companion (the Moon beside the Earth): its light is taken away, and the fit repeated until both
// agree. Its flux is believed to 10 %; what that moves the place by is added to the covariance.
template <typename T>
PsfFit fit_psf_beside(ImageView<const T> image, const Window& window, Pixel guess, double background_dn,
                      double background_sigma_dn, const SensorModel& sensor, const Companion& companion);

}  // namespace astronav::vision
