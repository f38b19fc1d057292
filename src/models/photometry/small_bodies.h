// SPDX-License-Identifier: Apache-2.0
// Small bodies: asteroids and dwarf planets, the laws of their brightness, and a table of those that are known here.
#pragma once

#include <limits>
#include <span>

#include "models/ephemeris/bodies.h"
#include "models/photometry/photometry.h"

namespace astronav {

// Absolute magnitude and phase function: H-G (Bowell et al. 1989) while g2 is not a number, then `g1` is G; otherwise
// H-G1-G2 (Muinonen et al. 2010). docs/theory/photometry.md eq. 14 and 15.
struct PhaseLaw {
  double h = 15.0;
  double g1 = 0.15;
  double g2 = std::numeric_limits<double>::quiet_NaN();
};

struct SmallBody {
  BodyId id;  // NAIF number; of numbered asteroids 2000000 + number and 20000000 + number are the same body
  PhaseLaw law;
  double mean_radius_m = 0.0;  // 0: not known, a point
  double b_v = 0.72;           // a mean of asteroids
};

// Asteroids and dwarf planets known here, by any of their numbers; nullptr for others. Pluto is a planet here, as its
// law is not of this kind (planet_v_magnitude).
const SmallBody* known_small_body(BodyId id);
std::span<const SmallBody> known_small_bodies();

double small_body_v_magnitude(const PhaseLaw& law, const Illumination& geometry);

// The basis functions of H-G1-G2: phi_1 and phi_2 with wide, phi_3 with narrow phase angles; 1 at 0, and 0 from 150
// degrees (phi_1, phi_2) or 30 degrees (phi_3) on, by extrapolation. Phase angle in rad.
struct PhaseBasis {
  double phi1 = 1.0;
  double phi2 = 1.0;
  double phi3 = 1.0;
};
PhaseBasis phase_basis(double phase_angle_rad);

}  // namespace astronav
