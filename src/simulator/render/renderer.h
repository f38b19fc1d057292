// SPDX-License-Identifier: Apache-2.0
// Renderer: sources on the detector to electrons to DN, the digital twin of a camera.
#pragma once

#include <cstdint>
#include <memory>
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

// Sources of a sky that fall on the detector (or within `margin_px` of it), with their pixels, in the order of the sky.
std::vector<RenderedSource> place_sources(std::span<const sky::SkySource> sky, const Camera& camera, const Mat3& R_CN,
                                          double exposure_s, double margin_px = 20.0);

struct NoiseSwitches {
  bool shot = true;  // Poisson statistics; off: the expected electrons themselves
  bool dark = true;  // dark current at all
  bool read = true;
  bool photo_nonuniformity = true;
  bool dark_nonuniformity = true;
  bool full_well = true;
  bool quantisation = true;  // clipping at 2^bits - 1; DN are whole numbers either way

  // The expected frame: no random draw, no fixed pattern.
  static NoiseSwitches none() { return {false, true, false, false, false, true, true}; }
  bool operator==(const NoiseSwitches&) const = default;
};

// The chain of one pixel (docs/theory/rendering.md): expected electrons of light (1 + PRNU) and dark (1 + DSNU),
// Poisson, full well, Gaussian read noise, gain, bias, rounding, clipping.
//
// Pixels that a source touches (PSF window) are drawn one by one from exactly that law. All others are drawn from
// tables of it: their expected values are rounded to steps of 0.004 of the pixel's noise (bias at most 0.002 sigma, and
// fixed), the probabilities to 2^-32. Frames may be made by several threads with one Renderer.
class Renderer {
 public:
  // The fixed-pattern maps (PRNU, DSNU) belong to one detector: they depend on `detector_seed` alone.
  Renderer(const Camera& camera, std::uint64_t detector_seed);

  // Expected electrons, no noise, no fixed pattern: PSF integrated over pixels, background and dark included. A source
  // is drawn as far as it brings 0.1 electrons a pixel, and at least 4 sigma wide.
  void electrons(std::span<const RenderedSource> sources, double exposure_s, ImageF& out) const;
  // One frame in DN. The noise depends on `noise` (seed, sample, image) alone.
  void frame(std::span<const RenderedSource> sources, double exposure_s, const StreamId& noise, ImageU16& out,
             const NoiseSwitches& switches = {}) const;

  const Camera& camera() const { return camera_; }

 private:
  struct Background;  // the tables for one exposure
  struct BackgroundCache;
  std::shared_ptr<const Background> background(double exposure_s, const NoiseSwitches& switches) const;

  Camera camera_;
  Image<float> prnu_;  // relative deviation of each pixel
  Image<float> dsnu_;
  std::shared_ptr<BackgroundCache> cache_;
};

}  // namespace astronav::render
