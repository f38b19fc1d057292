// SPDX-License-Identifier: Apache-2.0
// Renderer: sources on the detector to electrons to DN, the digital twin of a camera.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "foundation/image/image.h"
#include "foundation/math/random.h"
#include "foundation/math/rotation.h"
#include "models/camera/camera.h"
#include "simulator/sky/sky.h"

namespace astronav::render {

struct RenderedSource {
  sky::SkySource source;
  Pixel pixel;             // exact projection through the truth's camera
  double electrons = 0.0;  // expected photo-electrons in the exposure
};

// Sources of a sky that fall on the detector (or within `margin_px` of it), with their pixels.
std::vector<RenderedSource> place_sources(std::span<const sky::SkySource> sky, const Camera& camera, const Mat3& R_CN,
                                          double exposure_s, double margin_px = 20.0);

struct NoiseSwitches {
  bool shot = true, dark = true, read = true, photo_nonuniformity = true, dark_nonuniformity = true, full_well = true,
       quantisation = true;
};

class Renderer {
 public:
  // The fixed-pattern maps (PRNU, DSNU) belong to one detector: they depend on `detector_seed` alone.
  Renderer(const Camera& camera, std::uint64_t detector_seed);

  // Expected electrons, no noise: PSF integrated over pixels, background and dark included where switched on.
  void electrons(std::span<const RenderedSource> sources, double exposure_s, ImageF& out) const;
  // One frame in DN. The noise depends on `noise` (seed, sample, image) alone.
  void frame(std::span<const RenderedSource> sources, double exposure_s, const StreamId& noise, ImageU16& out,
             const NoiseSwitches& switches = {}) const;

 private:
  Camera camera_;
  Image<float> prnu_;
  Image<float> dsnu_;
};

}  // namespace astronav::render
