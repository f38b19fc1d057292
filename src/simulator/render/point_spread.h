// SPDX-License-Identifier: Apache-2.0
// Light of sources on pixels: core, coma, halo or a measured kernel, discs, and motion during the exposure
// (docs/theory/rendering.md eq. 1-3 and 8-11). Internal to this folder.
#pragma once

#include <vector>

#include "foundation/image/image.h"
#include "models/camera/camera.h"
#include "simulator/render/renderer.h"

namespace astronav::render {

struct Window {
  int u_begin = 0, u_end = 0, v_begin = 0, v_end = 0;  // half open; empty where begin >= end
  bool empty() const { return u_begin >= u_end || v_begin >= v_end; }
};

// The picture that sources are painted on, with what the painting needs; made once and used again.
struct Sheet {
  ImageF light;                     // electrons
  std::vector<Window> windows;      // where there is any; they may overlap
  std::vector<double> column_sums;  // of `light`, kept while painting

  // All dark, of that size.
  void prepare(int width, int height);
  // Says where there is light; a window that holds the last one, or lies in it, is not another.
  void touch(const Window& window);

  std::vector<float> columns, rows, strip;  // scratch
};

// Asks for the memory that a source at this place will need.
void prefetch(const Sheet& sheet, Pixel at);

// Width of the core at a pixel.
double core_sigma(const Camera& camera, Pixel at);

// A disc lit from one side, sampled: intensities (sum 1) on a square grid of `cells` x `cells` over -1..1 (in radii),
// by Lambert's law. `sunward` is a unit vector in the picture; the Sun is at the phase angle from the observer.
struct LitDisc {
  int cells = 0;
  std::vector<float> intensity;     // row-major
  Vec2 photocentre = Vec2::Zero();  // radii
};
LitDisc lambert_disc(int cells, double phase_angle_rad, const Vec2& sunward);

class Painter {
 public:
  Painter(const Camera& camera, const Effects& effects);
  // Adds a source's light, as far as it brings 0.1 electrons a pixel, and at least 4 sigma of the core.
  void add(const RenderedSource& source, Sheet& sheet) const;
  // Adds light to single pixels (a proton's track), outside of the point-spread function.
  static void add_light(int u, int v, double electrons, Sheet& sheet);

 private:
  void add_at(const RenderedSource& source, Pixel at, double electrons, Sheet& sheet) const;
  void add_shape(const RenderedSource& source, const LitDisc* disc, Pixel at, double sigma_px, double reach,
                 double electrons, Sheet& sheet) const;
  void add_core(const RenderedSource& source, const LitDisc* disc, Pixel at, double electrons, Sheet& sheet) const;
  void add_kernel(Pixel at, double electrons, Sheet& sheet) const;

  const Camera* camera_;
  bool aberrations_;
  bool motion_;
  bool discs_;
  double half_diagonal_px_;
};

}  // namespace astronav::render
