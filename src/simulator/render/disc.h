// SPDX-License-Identifier: Apache-2.0
// Discs of bodies: a sphere lit from one side, sampled on a grid. Internal to this folder.
#pragma once

#include <vector>

#include "foundation/math/linear.h"

namespace astronav::render {

// A sphere lit by Minnaert's law, which is Lambert's with an exponent of 1 (docs/theory/rendering.md eq. 10). `sunward`
// is a unit vector in the picture; the Sun is at the phase angle from the observer.
struct Globe {
  double radius_px = 0.0;
  double phase_angle_rad = 0.0;
  Vec2 sunward = Vec2::Zero();
  double minnaert = 1.0;
};

// A rectangle in the picture, px from the disc's centre.
struct Part {
  double left = 0.0, right = 0.0, top = 0.0, bottom = 0.0;
};

// Light in square cells: shares of all the light of the disc.
struct LitDisc {
  int columns = 0;
  int rows = 0;
  double step_px = 0.0;
  double left_px = 0.0, top_px = 0.0;  // the middle of the first cell, from the disc's centre
  std::vector<float> light;            // row-major
  Vec2 photocentre_px = Vec2::Zero();  // from the disc's centre
  bool empty() const { return light.empty(); }
  double u_px(int column) const { return left_px + step_px * column; }
  double v_px(int row) const { return top_px + step_px * row; }
};

// All of the disc, `cells` along its diameter. Empty where no light can be seen: straight before the Sun.
LitDisc lit_disc(const Globe& globe, int cells);
// What of a large disc lies in a part of the picture, one cell a pixel: a disc that is wider than the detector costs no
// more than the detector. The light that it has in all is that of the closed form, which is Lambert's.
LitDisc lit_disc_part(const Globe& globe, const Part& part);

}  // namespace astronav::render
