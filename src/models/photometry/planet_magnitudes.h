// SPDX-License-Identifier: Apache-2.0
// The magnitude laws of Mallama & Hilton 2018 ("Computing apparent planetary magnitudes for the Astronomical Almanac",
// Astronomy and Computing 25, 10) as functions of what their tables hold. docs/theory/photometry.md eq. 1 to 13.
// planet_v_magnitude() in photometry.h finds these arguments from vectors. Degrees, because the laws are polynomials in
// degrees. Nothing here allocates or fails.
#pragma once

namespace astronav {

struct PhaseGeometry {
  double r_au = 1.0;       // Sun to body
  double delta_au = 1.0;   // observer to body
  double phase_deg = 0.0;  // Sun-body-observer, 0 to 180
};

double mercury_v_magnitude(const PhaseGeometry& g);
double venus_v_magnitude(const PhaseGeometry& g);
double earth_v_magnitude(const PhaseGeometry& g);
// `effective_longitude_deg` from mars_effective_longitude_deg(); `solar_longitude_deg` is Ls, the season: heliocentric
// ecliptic longitude minus 85.
double mars_v_magnitude(const PhaseGeometry& g, double effective_longitude_deg, double solar_longitude_deg);
double jupiter_v_magnitude(const PhaseGeometry& g);
// Globe and rings. `ring_latitude_deg` from saturn_ring_latitude_deg(). Beyond a phase angle of 6.5 degrees, where the
// published law ends, its phase term is carried on.
double saturn_v_magnitude(const PhaseGeometry& g, double ring_latitude_deg);
double saturn_globe_v_magnitude(const PhaseGeometry& g);
// `effective_latitude_deg` from uranus_effective_latitude_deg().
double uranus_v_magnitude(const PhaseGeometry& g, double effective_latitude_deg);
double neptune_v_magnitude(const PhaseGeometry& g, double year);
// Pluto with Charon, as in Harris 1961, and 0.04 mag a degree.
double pluto_v_magnitude(const PhaseGeometry& g);
// Allen 1973. No opposition surge.
double moon_v_magnitude(const PhaseGeometry& g);

// Mean of the longitudes (positive to the west) under observer and Sun, on the side where both are.
double mars_effective_longitude_deg(double sub_observer_deg, double sub_solar_deg);
// Geometric mean of the planetocentric latitudes of observer and Sun, 0 where they see different faces of the rings.
double saturn_ring_latitude_deg(double sub_observer_deg, double sub_solar_deg);
// Mean of the absolute planetographic latitudes of observer and Sun.
double uranus_effective_latitude_deg(double sub_observer_deg, double sub_solar_deg);

// tan(graphic) = (equatorial radius / polar radius)^2 tan(centric).
double planetographic_latitude_deg(double planetocentric_deg, double equatorial_over_polar_radius);
double planetocentric_latitude_deg(double planetographic_deg, double equatorial_over_polar_radius);
inline constexpr double kSaturnEquatorialOverPolarRadius = 60268.0 / 54364.0;  // IAU 2015
inline constexpr double kUranusEquatorialOverPolarRadius = 25559.0 / 24973.0;

}  // namespace astronav
