// SPDX-License-Identifier: Apache-2.0
// Where a point source lies, by a least-squares fit of the point-spread function (docs/theory/vision.md eq. 4 to 8).
//
// Two forms. An unsaturated spot: (u, v, flux) are free, and what is not known of the point-spread function is
// considered: it adds to the covariance what it may have moved the place by. A spot with saturated pixels: those are
// masked, so that the wings decide, and the six numbers of the point-spread function are free too, with what is
// believed of them as a prior.
// The weights are the variances that the model predicts for each pixel (read and background noise as measured in the
// frame, shot noise, photo-response non-uniformity), for saturated spots plus what no model of wings gets right.
#pragma once

#include "foundation/image/image.h"
#include "foundation/math/linear.h"
#include "onboard/vision/lit_disc.h"
#include "onboard/vision/psf_model.h"
#include "onboard/vision/psf_profile.h"

namespace astronav::vision {

struct PsfFit {
  bool converged = false;
  bool saturated = false;
  Pixel pixel;
  Mat2 covariance_px2 = Mat2::Identity();
  // Its two shares: this image's noise, and what comes from the point-spread function, of which the next image has the
  // same (1 sigma an axis).
  Mat2 noise_px2 = Mat2::Identity();
  double repeating_sigma_px = 0.0;
  double flux_dn = 0.0;
  double flux_sigma_dn = 0.0;
  double sigma_px = 0.0;  // the width, as believed or as found
  double chi2_per_dof = 0.0;
};

// Beside what the belief allows for: wings of no model's form. Windows of 36 images of Jupiter are off by 0.0001 px in
// flight, which the belief alone tells (docs/adr/0002).
inline double repeating_sigma(const PsfFit& fit) {
  constexpr double kLeast = 0.00005;
  return std::hypot(fit.repeating_sigma_px, kLeast);
}

// The part of the image that a fit looks at, inclusive; cut to the image by the caller.
struct Window {
  int u0 = 0, v0 = 0, u1 = 0, v1 = 0;
  int width() const { return u1 - u0 + 1; }
  int height() const { return v1 - v0 + 1; }
};

// How far beyond its full pixels a saturated spot's window reaches, so far as there is room: four pixels more than the
// wings of its core do. Within less, a halo narrower by a third and with most of its light outside passes for the true
// one, and whoever has come to believe in it stays there (docs/adr/0002).
int reach_about_full_px(const Window& full, const LocalPsf& psf);

// What lies under a spot: a plane, where columns are smeared something more for each, and the noise.
struct LocalLevel {
  Pixel at;
  double background_dn = 0.0;                 // there
  double slope_u_dn = 0.0, slope_v_dn = 0.0;  // a pixel
  double noise_dn = 0.0;
  const float* columns_dn = nullptr;  // by the image's column; nullptr: nothing

  double plane(int u, int v) const { return background_dn + slope_u_dn * (u - at.u) + slope_v_dn * (v - at.v); }
  double column(int u) const { return columns_dn != nullptr ? static_cast<double>(columns_dn[u]) : 0.0; }
  double under(int u, int v) const { return plane(u, v) + column(u); }
};

// `guess` within about 1 px (saturated: 2 px). Does not allocate; at most 100 iterations.
template <typename T>
PsfFit fit_psf(ImageView<const T> image, const Window& window, Pixel guess, const LocalLevel& level,
               const SensorModel& sensor, const LocalPsf& psf, PsfEvidence* evidence = nullptr);

// A saturated spot that is a small disc's: the place is its centre of light. What the disc has beyond a wider
// spot is taken off as the fit stands, until it stays (eq. 8d).
PsfFit fit_psf_of_disc(ImageView<const std::uint16_t> image, const Window& window, Pixel guess, const LocalLevel& level,
                       const SensorModel& sensor, const LocalPsf& psf, const LitDisc& disc,
                       PsfEvidence* evidence = nullptr);

// As believed before any frame, on an even background.
template <typename T>
PsfFit fit_psf(ImageView<const T> image, const Window& window, Pixel guess, double background_dn,
               double background_sigma_dn, const SensorModel& sensor);

// What the light in the window says of the point-spread function, about a fit that is done (of a smaller window, as a
// rule). False where the window holds something else too.
template <typename T>
bool psf_evidence(ImageView<const T> image, const Window& window, const PsfFit& fit, const LocalLevel& level,
                  const SensorModel& sensor, const LocalPsf& psf, PsfEvidence& evidence);

}  // namespace astronav::vision
