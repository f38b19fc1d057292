// SPDX-License-Identifier: Apache-2.0
// Photometry: magnitude laws of planets and asteroids, and from V and colour to photons in a camera's band.
#pragma once

#include "foundation/base/error.h"
#include "foundation/math/linear.h"
#include "foundation/time/epoch.h"
#include "models/camera/camera.h"
#include "models/ephemeris/bodies.h"

namespace astronav {

// What a magnitude law needs to know. Vectors in N, metres.
struct Illumination {
  Vec3 p_body_from_sun_N;       // heliocentric place of the body (light leaving it)
  Vec3 p_body_from_observer_N;  // as the observer sees it, light time applied
  Epoch epoch;                  // when the light left the body
};
double phase_angle(const Illumination& geometry);  // rad, Sun-body-observer

// Apparent V magnitude of a planet (Mallama & Hilton 2018) or the Moon. not_found for other bodies.
Result<double> planet_v_magnitude(BodyId body, const Illumination& geometry);
// H, G law (Bowell et al. 1989).
double asteroid_v_magnitude(double h, double g, const Illumination& geometry);
// B-V of sunlight as each planet reflects it (Mallama et al. 2017); 0.65 (the Sun's) where not known.
double planet_b_v(BodyId body);

// Photon and energy rates at the pupil, in the band of a camera.
struct BandFlux {
  double electrons_per_s = 0.0;   // photo-electrons: pupil area x transmission x quantum efficiency included
  double irradiance_w_m2 = 0.0;   // in the band, at the pupil, before the optics
};
// Flux of a source of magnitude V and colour B-V seen by a camera: a blackbody at the colour's temperature (Ballesteros
// 2012) scaled to V. docs/theory/photometry.md.
class BandPhotometry {
 public:
  explicit BandPhotometry(const Camera& camera);
  BandFlux flux(double v_mag, double b_v) const;
  // The camera's own magnitude: v such that flux(v, 0.65 solar) equals the electrons. For gating by brightness.
  double v_magnitude(double electrons_per_s, double b_v) const;

 private:
  // Tabulated over B-V once; interpolated.
  static constexpr int kColours = 64;
  double log_electrons_[kColours];
  double log_irradiance_[kColours];
};

}  // namespace astronav
