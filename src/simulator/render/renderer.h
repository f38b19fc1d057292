// SPDX-License-Identifier: Apache-2.0
// Renderer: sources on the detector to electrons to DN, the digital twin of a camera.
#pragma once

#include <cstdint>
#include <memory>
#include <span>
#include <string_view>
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

// What is drawn; everything that the camera's file can describe, unless switched off.
struct Effects {
  bool shot = true;  // Poisson statistics; off: the expected electrons themselves
  bool dark = true;  // dark current at all
  bool read = true;
  bool photo_nonuniformity = true;
  bool dark_nonuniformity = true;
  bool hot_pixels = true;
  bool cosmic_rays = true;
  bool full_well = true;
  bool blooming = true;
  bool quantisation = true;    // clipping at 2^bits - 1; DN are whole numbers either way
  bool frame_transfer = true;  // smear of the columns
  bool vignetting = true;
  bool stray_light = true;
  bool background = true;
  bool psf_aberrations = true;  // off: a plain Gaussian core
  bool motion = true;           // smear by angular rates, rolling shutter
  bool discs = true;            // off: every body is a point at its centre of light

  // The expected frame: no random draw, no fixed pattern.
  static Effects expected();
  bool operator==(const Effects&) const = default;
};
// Names of the switches ("shot", "dark", ...), and the switch of a name. nullptr where there is none such.
std::span<const std::string_view> effect_names();
bool* effect(Effects& effects, std::string_view name);

// One exposure, beside what the sky shows.
struct Exposure {
  double duration_s = 0.0;
  // Inertial angular rate of the camera, in its axes; constant. Pixels of sources are those at mid-exposure.
  Vec3 rate_C_rad_s = Vec3::Zero();
  // From observer to Sun, in C, metres: for stray light; zero where there is no Sun.
  Vec3 sun_C_m = Vec3::Zero();
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
  void electrons(std::span<const RenderedSource> sources, const Exposure& exposure, ImageF& out,
                 const Effects& effects = {}) const;
  // One frame in DN. The noise depends on `noise` (seed, sample, image) alone.
  void frame(std::span<const RenderedSource> sources, const Exposure& exposure, const StreamId& noise, ImageU16& out,
             const Effects& effects = {}) const;

  const Camera& camera() const { return camera_; }

 private:
  struct Background;  // the tables for one exposure
  struct BackgroundCache;
  std::shared_ptr<const Background> background(double exposure_s, const Effects& effects) const;

  Camera camera_;
  Image<float> prnu_;  // relative deviation of each pixel
  Image<float> dsnu_;
  std::shared_ptr<BackgroundCache> cache_;
};

}  // namespace astronav::render
