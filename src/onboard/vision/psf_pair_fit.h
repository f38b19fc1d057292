// SPDX-License-Identifier: Apache-2.0
// Two points of light whose wings run into each other, the second at a place relative to the first that is foretold
// (the Moon beside the Earth): one fit of both places and both fluxes. Saturated pixels are masked, and the numbers of
// the point-spread function, the offset and the fluxes are free with what is believed of them as a prior, so that the
// covariance holds what all of these may be wrong by (docs/theory/vision.md eq. 7a).
#pragma once

#include "onboard/vision/psf_fit.h"

namespace astronav::vision {

// What is foretold of them.
struct PairBelief {
  double first_flux_dn = 0.0, second_flux_dn = 0.0;
  Vec2 offset_px = Vec2::Zero();  // from the first to the second
  Mat2 offset_covariance_px2 = Mat2::Zero();
};

// The first's place and light. `guess` within about 2 px of it; the window is about the first and may hold of the
// second what it will. At most 40 iterations of some 0.1 ms; does not allocate.
PsfFit fit_psf_beside(ImageView<const std::uint16_t> image, const Window& window, Pixel guess, const LocalLevel& level,
                      const SensorModel& sensor, const LocalPsf& psf, const PairBelief& belief);

}  // namespace astronav::vision
