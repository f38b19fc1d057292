// SPDX-License-Identifier: Apache-2.0
// Light of point sources on pixels: Gaussians integrated over each pixel (docs/theory/rendering.md eq. 1-3). Internal.
#pragma once

#include <vector>

#include "foundation/image/image.h"
#include "models/camera/camera.h"

namespace astronav::render {

struct Window {
  int u_begin = 0, u_end = 0, v_begin = 0, v_end = 0;  // half open; empty where begin >= end
  bool empty() const { return u_begin >= u_end || v_begin >= v_end; }
};

// Room for the two arrays of a source, kept between sources.
struct Scratch {
  std::vector<float> columns;
  std::vector<float> rows;
};

// Adds one Gaussian of `electrons` at `centre` and returns the window it touched.
Window add_gaussian(ImageView<float> image, Pixel centre, double sigma_px, double electrons, Scratch& scratch);

// Width of the core at a pixel.
double core_sigma(const Camera& camera, Pixel at);

// Core and halo of one source; up to two windows.
struct Windows {
  Window core;
  Window halo;
};
Windows add_source(ImageView<float> image, const Camera& camera, Pixel at, double electrons, Scratch& scratch);

}  // namespace astronav::render
