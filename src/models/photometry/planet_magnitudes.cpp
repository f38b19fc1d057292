// SPDX-License-Identifier: Apache-2.0
#include "models/photometry/planet_magnitudes.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "foundation/math/linear.h"

namespace astronav {
namespace {

double distance_term(const PhaseGeometry& g) {
  return 5.0 * std::log10(g.r_au * g.delta_au);
}

// Coefficients from the constant upwards.
template <std::size_t N>
constexpr double polynomial(double x, const double (&c)[N]) {
  double sum = 0.0;
  for (std::size_t k = N; k-- > 0;) sum = sum * x + c[k];
  return sum;
}

// The two tables of the paper for Mars: by rotation (effective longitude) and by season (Ls), every 10 degrees.
using DecadeTable = std::array<double, 36>;
constexpr DecadeTable kMarsRotation{0.036,  0.045,  0.038,  0.023,  0.015,  0.011,  0.000,  -0.012, -0.018,
                                    -0.036, -0.044, -0.059, -0.060, -0.055, -0.043, -0.041, -0.041, -0.036,
                                    -0.036, -0.018, -0.038, -0.011, 0.002,  0.004,  0.018,  0.019,  0.035,
                                    0.050,  0.035,  0.027,  0.037,  0.048,  0.025,  0.022,  0.024,  0.034};
constexpr DecadeTable kMarsSeason{-0.029, -0.017, -0.014, -0.006, -0.018, -0.020, -0.014, -0.030, -0.008,
                                  -0.040, -0.024, -0.037, -0.036, -0.032, 0.010,  0.010,  -0.001, 0.044,
                                  0.025,  -0.004, -0.016, -0.008, 0.029,  -0.054, -0.033, 0.055,  0.017,
                                  0.052,  0.006,  0.087,  0.006,  0.064,  0.030,  0.019,  -0.030, -0.017};

// Periodic five-point interpolation about the entry below, as the authors do it (Stirling's formula, to fourth
// differences).
double interpolate(const DecadeTable& table, double degrees) {
  const double x = degrees / 10.0;
  const double below = std::floor(x);
  const double p = x - below;
  const int size = static_cast<int>(table.size());
  const int centre = static_cast<int>(below - size * std::floor(below / size));
  const auto at = [&](int offset) { return table[static_cast<std::size_t>((centre + offset + size) % size)]; };
  const double odd1 = 0.5 * (at(1) - at(-1));
  const double even2 = at(1) - 2.0 * at(0) + at(-1);
  const double odd3 = 0.5 * (at(2) - 2.0 * at(1) + 2.0 * at(-1) - at(-2));
  const double even4 = at(2) - 4.0 * at(1) + 6.0 * at(0) - 4.0 * at(-1) + at(-2);
  return at(0) + p * odd1 + p * p / 2.0 * even2 + p * (p * p - 1.0) / 6.0 * odd3 + p * p * (p * p - 1.0) / 24.0 * even4;
}

}  // namespace

double mercury_v_magnitude(const PhaseGeometry& g) {
  return distance_term(g) +
         polynomial(g.phase_deg, {-0.613, 6.3280e-02, -1.6336e-03, 3.3644e-05, -3.4265e-07, 1.6893e-09, -3.0334e-12});
}

double venus_v_magnitude(const PhaseGeometry& g) {
  if (g.phase_deg < 163.7) {
    return distance_term(g) + polynomial(g.phase_deg, {-4.384, -1.044e-03, 3.687e-04, -2.814e-06, 8.938e-09});
  }
  return distance_term(g) + polynomial(g.phase_deg, {236.05828, -2.81914, 8.39034e-03});
}

double earth_v_magnitude(const PhaseGeometry& g) {
  return distance_term(g) + polynomial(g.phase_deg, {-3.99, -1.060e-03, 2.054e-04});
}

double mars_v_magnitude(const PhaseGeometry& g, double effective_longitude_deg, double solar_longitude_deg) {
  const double phase = g.phase_deg <= 50.0 ? polynomial(g.phase_deg, {-1.601, 0.02267, -0.0001302})
                                           : polynomial(g.phase_deg, {-0.367, -0.02573, 0.0003445});
  return distance_term(g) + phase + interpolate(kMarsRotation, effective_longitude_deg) +
         interpolate(kMarsSeason, solar_longitude_deg);
}

double jupiter_v_magnitude(const PhaseGeometry& g) {
  if (g.phase_deg <= 12.0) return distance_term(g) + polynomial(g.phase_deg, {-9.395, -3.7e-04, 6.16e-04});
  const double light = polynomial(g.phase_deg / 180.0, {1.0, -1.507, -0.363, -0.062, 2.809, -1.876});
  return distance_term(g) - 9.428 - 2.5 * std::log10(light);
}

double saturn_v_magnitude(const PhaseGeometry& g, double ring_latitude_deg) {
  const double sin_b = std::sin(std::abs(ring_latitude_deg) * kDegree);
  return distance_term(g) - 8.914 - 1.825 * sin_b + 0.026 * g.phase_deg - 0.378 * sin_b * std::exp(-2.25 * g.phase_deg);
}

double saturn_globe_v_magnitude(const PhaseGeometry& g) {
  if (g.phase_deg <= 6.5) return distance_term(g) + polynomial(g.phase_deg, {-8.95, -3.7e-4, 6.16e-4});
  return distance_term(g) + polynomial(g.phase_deg, {-8.94, 2.446e-4, 2.672e-4, -1.506e-6, 4.767e-9});
}

double uranus_v_magnitude(const PhaseGeometry& g, double effective_latitude_deg) {
  const double beyond_earth = g.phase_deg > 3.1 ? polynomial(g.phase_deg, {0.0, 6.587e-3, 1.045e-4}) : 0.0;
  return distance_term(g) - 7.110 - 0.00084 * effective_latitude_deg + beyond_earth;
}

double neptune_v_magnitude(const PhaseGeometry& g, double year) {
  const double beyond_earth = g.phase_deg > 1.9 ? polynomial(g.phase_deg, {0.0, 7.944e-3, 9.617e-5}) : 0.0;
  return distance_term(g) + std::clamp(-6.89 - 0.0054 * (year - 1980.0), -7.00, -6.89) + beyond_earth;
}

double pluto_v_magnitude(const PhaseGeometry& g) {
  return distance_term(g) - 1.00 + 0.04 * g.phase_deg;
}

double moon_v_magnitude(const PhaseGeometry& g) {
  return distance_term(g) + polynomial(g.phase_deg, {0.23, 0.026, 0.0, 0.0, 4e-9});
}

double mars_effective_longitude_deg(double sub_observer_deg, double sub_solar_deg) {
  const double mean = 0.5 * (sub_observer_deg + sub_solar_deg);
  return std::abs(sub_observer_deg - sub_solar_deg) > 180.0 ? mean + 180.0 : mean;
}

double saturn_ring_latitude_deg(double sub_observer_deg, double sub_solar_deg) {
  return std::sqrt(std::max(sub_observer_deg * sub_solar_deg, 0.0));
}

double uranus_effective_latitude_deg(double sub_observer_deg, double sub_solar_deg) {
  return 0.5 * (std::abs(sub_observer_deg) + std::abs(sub_solar_deg));
}

double planetographic_latitude_deg(double planetocentric_deg, double equatorial_over_polar_radius) {
  const double ratio2 = equatorial_over_polar_radius * equatorial_over_polar_radius;
  const double b = planetocentric_deg * kDegree;
  return std::atan2(ratio2 * std::sin(b), std::cos(b)) / kDegree;
}

double planetocentric_latitude_deg(double planetographic_deg, double equatorial_over_polar_radius) {
  return planetographic_latitude_deg(planetographic_deg, 1.0 / equatorial_over_polar_radius);
}

}  // namespace astronav
