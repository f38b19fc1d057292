// SPDX-License-Identifier: Apache-2.0
// What made a region of light: a point of light, or something that is none (docs/theory/vision.md). Internal to this
// folder.
#pragma once

#include "onboard/vision/psf_model.h"
#include "onboard/vision/regions.h"
#include "onboard/vision/types.h"

namespace astronav::vision {

// Light in a region's box and a margin of one pixel: centre and second moments, and how far noise may move these.
struct Moments {
  double flux = 0.0;
  Vec2 centre = Vec2::Zero();
  Mat2 second = Mat2::Zero();
  double second_sigma = 0.0;  // of an entry on the diagonal
  double sharpest = 0.0;      // share of the brightest pixel in the 3 x 3 about it
  double sharpest_sigma = 0.0;
  double middle = 0.0;  // light of the pixel at the centre over the brightest
  Pixel peak;           // the brightest pixel
  double peak_over_noise = 0.0;
};
template <typename T>
Moments moments_of(ImageView<const T> image, const Region& region, const LocalLevel& level, const SensorModel& sensor);

// Second moment of a star's light along one axis, pixels' area included.
double spot_variance_px2(const LocalPsf& psf);

// `motion_px2`: what the second moments of all stars of the frame have in common beyond the point-spread function.
SpotKind kind_of(const Region& region, const Moments& moments, const LocalPsf& psf, const Mat2& motion_px2);

// Rows and columns of a saturated spot's core, where its overflow runs along columns: the widest rows and their width.
template <typename T>
Window core_of_bloomed(ImageView<const T> image, const Window& saturated_box, double saturation_dn);

}  // namespace astronav::vision
