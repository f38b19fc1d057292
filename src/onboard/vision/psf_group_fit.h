// SPDX-License-Identifier: Apache-2.0
// A point of light into which others run that are foretold: the Moon beside the Earth, a star beside a planet. One fit
// of all places and fluxes. Saturated pixels are masked, and the numbers of the point-spread function, the places of
// the others and all fluxes are free with what is believed of them as a prior, so that the covariance holds what all of
// these may be wrong by (docs/theory/vision.md eq. 7a).
#pragma once

#include <span>

#include "onboard/vision/psf_fit.h"

namespace astronav::vision {

// Another point of light, as foretold.
struct LightBeside {
  // In the image, or from the body that is measured: two bodies are often known better by their distance than by place.
  Vec2 at_px = Vec2::Zero();
  bool from_body = false;
  Mat2 covariance_px2 = Mat2::Zero();
  double flux_dn = 0.0;
  double flux_sigma = 0.0;  // of its logarithm
};

inline constexpr std::size_t kMostBeside = 4;

// Place and light of a body, believed to have `flux_dn`, a point or a small disc, among at most kMostBeside others.
// `guess` within about 2 px of it; the window is about the body and may hold of the others what it will. The flux's
// sigma is of what the frame tells, without the belief. At most 40 iterations of some 0.1 ms; does not allocate.
PsfFit fit_psf_beside(ImageView<const std::uint16_t> image, const Window& window, Pixel guess, const LocalLevel& level,
                      const SensorModel& sensor, const LocalPsf& psf, double flux_dn, const LitDisc& disc,
                      std::span<const LightBeside> beside);

}  // namespace astronav::vision
