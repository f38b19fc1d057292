// SPDX-License-Identifier: Apache-2.0
// Photometry: magnitude laws of planets and asteroids, and from V and colour to photons in a camera's band.
// Nothing here allocates or throws.
#pragma once

#include <array>
#include <limits>

#include "foundation/base/error.h"
#include "foundation/math/linear.h"
#include "foundation/time/epoch.h"
#include "models/camera/camera.h"
#include "models/ephemeris/bodies.h"
#include "models/photometry/planet_magnitudes.h"

namespace astronav {

// What a magnitude law needs to know. Vectors in N, metres.
struct Illumination {
  Vec3 p_body_from_sun_N;       // heliocentric place of the body (light leaving it)
  Vec3 p_body_from_observer_N;  // as the observer sees it, light time applied
  Epoch epoch;                  // when the light left the body
};
double phase_angle(const Illumination& geometry);  // rad, Sun-body-observer
PhaseGeometry phase_geometry(const Illumination& geometry);

// Apparent V magnitude of a planet (Mallama & Hilton 2018; by its own or its barycentre's number), Pluto or the Moon.
// Asteroids and the other dwarf planets: small_bodies.h.
// not_found for other bodies, invalid_argument for a body at the place of Sun or observer.
Result<double> planet_v_magnitude(BodyId body, const Illumination& geometry);
// H, G law (Bowell et al. 1989).
double asteroid_v_magnitude(double h, double g, const Illumination& geometry);
// B-V of a planet or the Moon (Harris 1961, as in Allen 1973); 0.65 (the Sun's) where not known.
double planet_b_v(BodyId body);

// Where observer and Sun stand over a planet: planetocentric latitudes, and longitudes positive to the west, in
// degrees; poles and rotation of IAU 2015 (pck00011.tpc). For Mars, Saturn and Uranus; not_found otherwise.
struct SubPoints {
  double observer_latitude_deg = 0.0;
  double observer_longitude_deg = 0.0;
  double sun_latitude_deg = 0.0;
  double sun_longitude_deg = 0.0;
};
Result<SubPoints> sub_points(BodyId body, const Illumination& geometry);

// Effective temperature of a star of colour B-V in kelvin (Ballesteros 2012, eq. 14).
double ballesteros_temperature(double b_v);

// Photon and energy rates at the pupil, in the band of a camera.
struct BandFlux {
  double electrons_per_s = 0.0;  // photo-electrons: pupil area x transmission x quantum efficiency included
  double irradiance_w_m2 = 0.0;  // between the ends of the camera's band, at the pupil, before the optics
};
// A colour that is not known.
inline constexpr double kUnknownColour = std::numeric_limits<double>::quiet_NaN();
// V-I (Cousins) that goes with B-V: the mean of the bright stars of Hipparcos, whose red ones are giants; and of dwarfs
// of the main sequence, which are redder from B-V 1.3 on. docs/theory/photometry.md.
double usual_v_i(double b_v);
double dwarf_v_i(double b_v);

// Flux of a source of magnitude V seen by a camera. The spectrum is that of a dwarf of the same V-I: a blackbody bent
// so that it has the published colours from B to J (docs/theory/photometry.md). Where V-I is not known, usual_v_i(B-V)
// stands for it. Colours beyond the ends of the tables count as the ends, B-V that is not known as the Sun's.
class BandPhotometry {
 public:
  explicit BandPhotometry(const Camera& camera);
  BandFlux flux(double v_mag, double b_v, double v_i = kUnknownColour) const;
  // The camera's own magnitude: v such that flux(v, b_v, v_i) gives these electrons. For gating by brightness.
  double v_magnitude(double electrons_per_s, double b_v, double v_i = kUnknownColour) const;

 private:
  // Of V = 0, tabulated over V-I and over B-V once; interpolated.
  static constexpr int kColours = 256;
  using Table = std::array<BandFlux, kColours>;
  Table by_v_i_{};
  Table by_b_v_{};
};

}  // namespace astronav
