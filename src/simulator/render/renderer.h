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

struct DetectorPattern;

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

struct RenderedSource {
  sky::SkySource source;
  Pixel pixel;                     // exact projection through the truth's camera, in the middle of the exposure
  double electrons = 0.0;          // expected photo-electrons in the exposure, vignetting included
  Vec2 smear_px = Vec2::Zero();    // from where it is at the exposure's begin to where it is at its end,
  Vec2 bend_px = Vec2::Zero();     // and how far the middle of these two lies from `pixel`
  double radius_px = 0.0;          // of a body's disc
  Vec2 sunward_px = Vec2::Zero();  // unit vector in the picture
};

// Sources of a sky that fall on the detector (or within `margin_px` of it) in the middle of the exposure, in the order
// of the sky. With a rolling shutter every row has its own middle, and R_CN holds for the middle row.
std::vector<RenderedSource> place_sources(std::span<const sky::SkySource> sky, const Camera& camera, const Mat3& R_CN,
                                          const Exposure& exposure, double margin_px = 20.0,
                                          const Effects& effects = {});
// Of a camera that does not turn.
std::vector<RenderedSource> place_sources(std::span<const sky::SkySource> sky, const Camera& camera, const Mat3& R_CN,
                                          double exposure_s, double margin_px = 20.0);

// What painting these sources takes, in pixels added to (a few nanoseconds each): for refusing what would take too
// long.
double painting_work(std::span<const RenderedSource> sources, const Camera& camera, const Effects& effects);
// What following the protons that are expected takes, in the same unit.
double proton_work(const Camera& camera, double exposure_s);

// How late the time tag of a frame is, in seconds: the latency, and the jitter of this frame.
double time_tag_error_s(const Detector& detector, const StreamId& frame);

// The chain of one pixel (docs/theory/rendering.md): expected electrons of light (1 + PRNU) and dark (1 + DSNU), hot
// pixels, protons, Poisson, full well, blooming, Gaussian read noise, gain, bias, rounding, clipping.
//
// All pixels are drawn from tables of exactly that law: where no source shines, expected values are rounded to steps of
// 0.004 of the pixel's noise (a bias of at most 0.002 sigma, and fixed); under a source the expected value is kept and
// the variance is too large by at most 1e-4. Probabilities are right to 2^-22 of a table's slot. What is too bright for
// the tables, or holds a proton's charge, is drawn by itself. Frames may be made by several threads with one Renderer;
// the same name gives the same frame, whatever was made before and beside it.
class Renderer {
 public:
  // The fixed-pattern maps (PRNU, DSNU) belong to one detector: they depend on `detector_seed` alone.
  Renderer(const Camera& camera, std::uint64_t detector_seed);

  // Expected electrons, no noise, no fixed pattern, no full well: sources, diffuse light, dark current, smear.
  void electrons(std::span<const RenderedSource> sources, const Exposure& exposure, ImageF& out,
                 const Effects& effects = {}) const;
  // One frame in DN. The noise depends on `noise` (seed, sample, image) alone.
  void frame(std::span<const RenderedSource> sources, const Exposure& exposure, const StreamId& noise, ImageU16& out,
             const Effects& effects = {}) const;

  const Camera& camera() const { return camera_; }

 private:
  struct Background;  // what one exposure shows without sources
  struct Cache;
  std::shared_ptr<const Background> background(const Exposure& exposure, const Effects& effects) const;

  Camera camera_;
  std::shared_ptr<const DetectorPattern> pattern_;
  std::shared_ptr<Cache> cache_;
};

}  // namespace astronav::render
