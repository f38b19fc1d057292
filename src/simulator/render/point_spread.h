// SPDX-License-Identifier: Apache-2.0
// Light of sources on pixels: core, coma, halo or a measured kernel, discs, and motion during the exposure
// (docs/theory/rendering.md eq. 1-3 and 8-11). Internal to this folder.
#pragma once

#include <vector>

#include "foundation/image/image.h"
#include "models/camera/camera.h"
#include "simulator/render/disc.h"
#include "simulator/render/renderer.h"

namespace astronav::render {

struct Window {
  int u_begin = 0, u_end = 0, v_begin = 0, v_end = 0;  // half open; empty where begin >= end
  bool empty() const { return u_begin >= u_end || v_begin >= v_end; }
};

// The picture that sources are painted on, with what the painting needs; made once and used again.
struct Sheet {
  int width = 0, height = 0;
  ImageF light;                     // electrons; of that size unless nothing is painted
  std::vector<Window> windows;      // where there is any; they may overlap
  std::vector<double> column_sums;  // of `light`, kept while painting

  // All dark, of that size.
  void prepare(int wide, int high);
  // Says where there is light; a window that holds the last one, or lies in it, is not another, and windows that add up
  // to more than the picture become one.
  void touch(const Window& window);

  std::vector<float> columns, rows, strip;  // scratch

  // Nothing is painted, but the pixels (or what takes as long) are counted.
  bool counting = false;
  double work = 0.0;

 private:
  std::size_t touched_ = 0;  // pixels of the windows
};

// Asks for the memory that a source at this place will need.
void prefetch(const Sheet& sheet, Pixel at);

// Width of the core at a pixel.
double core_sigma(const Camera& camera, Pixel at);

class Painter {
 public:
  Painter(const Camera& camera, const Effects& effects);
  // Adds a source's light, as far as it brings 0.1 electrons a pixel, and at least 4 sigma of the core.
  void add(const RenderedSource& source, Sheet& sheet) const;

 private:
  // A source's disc for all of the places that it moves through. Empty: a point, or too large a disc for that.
  LitDisc whole_disc(const RenderedSource& source, Sheet& sheet) const;
  // What of a large disc is near the picture.
  LitDisc large_disc(const RenderedSource& source, Pixel at, Sheet& sheet) const;
  bool is_large(const RenderedSource& source) const;
  double cell_px(Pixel at) const;  // of a disc that is not large
  void add_at(const RenderedSource& source, const LitDisc* disc, Pixel at, double electrons, Sheet& sheet) const;
  void add_core(const LitDisc* disc, Pixel at, double electrons, Sheet& sheet) const;
  void add_kernel(const LitDisc* disc, Pixel at, double electrons, Sheet& sheet) const;

  const Camera* camera_;
  bool aberrations_;
  bool motion_;
  bool discs_;
  double half_diagonal_px_;
};

}  // namespace astronav::render
