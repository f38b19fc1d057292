// SPDX-License-Identifier: Apache-2.0
#include "models/photometry/small_bodies.h"

#include <algorithm>
#include <array>
#include <cmath>

namespace astronav {
namespace {

constexpr double kNone = std::numeric_limits<double>::quiet_NaN();

constexpr SmallBody asteroid(std::int32_t number, double h, double g, double radius_km, double b_v) {
  return {{2'000'000 + number}, {h, g, kNone}, radius_km * 1e3, b_v};
}

// H, G, radius and B-V after JPL's Small-Body Database, IAU Circular 1991 values of G, and for the dwarf planets the
// papers on their occultations and colours; H to about 0.1 mag (docs/data.md).
constexpr std::array kKnown = std::to_array<SmallBody>({
    asteroid(1, 3.34, 0.12, 469.7, 0.713),         // Ceres
    asteroid(2, 4.13, 0.11, 256.5, 0.635),         // Pallas
    asteroid(3, 5.33, 0.32, 123.3, 0.824),         // Juno
    asteroid(4, 3.20, 0.32, 262.7, 0.782),         // Vesta
    asteroid(6, 5.71, 0.24, 92.6, 0.822),          // Hebe
    asteroid(7, 5.51, 0.15, 99.9, 0.855),          // Iris
    asteroid(8, 6.49, 0.28, 73.5, 0.885),          // Flora
    asteroid(9, 6.28, 0.17, 95.0, 0.858),          // Metis
    asteroid(10, 5.43, 0.15, 203.6, 0.696),        // Hygiea
    asteroid(15, 5.28, 0.23, 115.8, 0.839),        // Eunomia
    asteroid(16, 5.90, 0.20, 113.0, 0.729),        // Psyche
    asteroid(21, 7.35, 0.11, 49.0, 0.686),         // Lutetia
    asteroid(29, 5.85, 0.20, 94.8, 0.838),         // Amphitrite
    asteroid(243, 9.94, 0.15, 15.7, 0.802),        // Ida
    asteroid(253, 10.20, 0.15, 26.4, 0.720),       // Mathilde
    asteroid(433, 10.40, 0.46, 8.42, 0.921),       // Eros
    asteroid(511, 6.22, 0.16, 135.2, 0.712),       // Davida
    asteroid(704, 5.94, -0.02, 153.2, 0.640),      // Interamnia
    asteroid(951, 11.46, 0.15, 6.1, 0.870),        // Gaspra
    asteroid(2867, 12.90, 0.40, 2.6, 0.800),       // Steins
    asteroid(25143, 19.20, 0.15, 0.165, 0.850),    // Itokawa
    asteroid(65803, 18.16, 0.15, 0.39, 0.790),     // Didymos
    asteroid(99942, 19.70, 0.15, 0.17, 0.830),     // Apophis
    asteroid(101955, 20.20, 0.15, 0.245, 0.640),   // Bennu
    asteroid(162173, 19.30, 0.15, 0.448, 0.660),   // Ryugu
    asteroid(50000, 2.40, 0.15, 555.0, 0.940),     // Quaoar
    asteroid(90377, 1.50, 0.15, 500.0, 1.200),     // Sedna
    asteroid(90482, 2.20, 0.15, 458.0, 0.670),     // Orcus
    asteroid(136108, 0.20, 0.15, 797.0, 0.640),    // Haumea
    asteroid(136199, -1.10, 0.15, 1163.0, 0.780),  // Eris
    asteroid(136472, -0.10, 0.15, 715.0, 0.840),   // Makemake
});

// Cubic in each interval from values and slopes at the nodes, phase angles in rad.
struct Node {
  double at_deg, value, slope;
};

// Muinonen et al. 2010 (Icarus 209, 542), section 2: the nodes and the slopes at the first and the last; the slopes
// between are those of the cubic spline through them.
constexpr std::array kPhi1 = std::to_array<Node>({{7.5, 7.5e-1, -1.90985932},
                                                  {30, 3.3486016e-1, -5.54634324e-1},
                                                  {60, 1.3410560e-1, -2.44045986e-1},
                                                  {90, 5.1104756e-2, -9.49804381e-2},
                                                  {120, 2.1465687e-2, -2.14114236e-2},
                                                  {150, 3.6396989e-3, -9.1328612e-2}});
constexpr std::array kPhi2 = std::to_array<Node>({{7.5, 9.25e-1, -5.72957795e-1},
                                                  {30, 6.2884169e-1, -7.67053671e-1},
                                                  {60, 3.1755495e-1, -4.56657890e-1},
                                                  {90, 1.2716367e-1, -2.80718090e-1},
                                                  {120, 2.2373903e-2, -1.11732569e-1},
                                                  {150, 1.6505689e-4, -8.6573138e-8}});
constexpr std::array kPhi3 = std::to_array<Node>({{0.0, 1.0, -1.0630097e-1},
                                                  {0.3, 8.3381185e-1, -4.11804395e1},
                                                  {1.0, 5.7735424e-1, -1.03669147e1},
                                                  {2.0, 4.2144772e-1, -7.57846149},
                                                  {4.0, 2.3174230e-1, -3.69609502},
                                                  {8.0, 1.0348178e-1, -7.86056516e-1},
                                                  {12.0, 6.1733473e-2, -4.65270118e-1},
                                                  {20.0, 1.6107006e-2, -2.04595448e-1},
                                                  {30.0, 0.0, 0.0}});

// Carried on in straight lines outside the nodes, and never below 0.
double spline(std::span<const Node> nodes, double phase_rad) {
  const double deg = phase_rad / kDegree;
  if (deg <= nodes.front().at_deg)
    return nodes.front().value + nodes.front().slope * (deg - nodes.front().at_deg) * kDegree;
  if (deg >= nodes.back().at_deg)
    return std::max(nodes.back().value + nodes.back().slope * (deg - nodes.back().at_deg) * kDegree, 0.0);
  std::size_t i = 1;
  while (deg > nodes[i].at_deg) ++i;
  const Node& a = nodes[i - 1];
  const Node& b = nodes[i];
  const double h = (b.at_deg - a.at_deg) * kDegree;
  const double t = (deg - a.at_deg) * kDegree / h;
  const double s = 1.0 - t;
  return a.value * s * s * (1.0 + 2.0 * t) + b.value * t * t * (1.0 + 2.0 * s) +
         h * s * t * (a.slope * s - b.slope * t);
}

}  // namespace

std::span<const SmallBody> known_small_bodies() {
  return kKnown;
}

const SmallBody* known_small_body(BodyId id) {
  const BodyId short_number = asteroid_number(id) ? BodyId{2'000'000 + *asteroid_number(id)} : id;
  const auto found =
      std::find_if(kKnown.begin(), kKnown.end(), [&](const SmallBody& b) { return b.id == short_number; });
  return found == kKnown.end() ? nullptr : &*found;
}

PhaseBasis phase_basis(double phase_angle_rad) {
  return {spline(kPhi1, phase_angle_rad), spline(kPhi2, phase_angle_rad), spline(kPhi3, phase_angle_rad)};
}

double small_body_v_magnitude(const PhaseLaw& law, const Illumination& geometry) {
  if (std::isnan(law.g2)) return asteroid_v_magnitude(law.h, law.g1, geometry);
  const PhaseBasis phi = phase_basis(phase_angle(geometry));
  const PhaseGeometry p = phase_geometry(geometry);
  return law.h + 5.0 * std::log10(p.r_au * p.delta_au) -
         2.5 * std::log10(law.g1 * phi.phi1 + law.g2 * phi.phi2 + (1.0 - law.g1 - law.g2) * phi.phi3);
}

}  // namespace astronav
