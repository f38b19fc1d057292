// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cmath>
#include <limits>
#include <span>
#include <vector>

#include "models/photometry/photometry.h"

namespace astronav {
namespace {

constexpr double kPlanck = 6.62607015e-34;   // J s
constexpr double kBoltzmann = 1.380649e-23;  // J/K
constexpr double kSolarColour = 0.65;

// ---- Passbands: photon responses, from the first wavelength in steps, and the flux of magnitude 0 ----

struct Band {
  double first_m;
  double step_m;
  std::span<const double> response;
  double zero_magnitude_flux;  // W/m2/m
};

// Bessell 1990 (PASP 102, 1181, table 2), in steps of 10 nm; of his R beyond 750 nm, which he gives every 50 nm, the
// values between.
constexpr double kB[] = {0.000, 0.030, 0.134, 0.567, 0.920, 0.978, 1.000, 0.978, 0.935, 0.853, 0.740,
                         0.640, 0.536, 0.424, 0.325, 0.235, 0.150, 0.095, 0.043, 0.009, 0.000};
constexpr double kV[] = {0.000, 0.030, 0.163, 0.458, 0.780, 0.967, 1.000, 0.973, 0.898, 0.792, 0.684, 0.574,
                         0.461, 0.359, 0.270, 0.197, 0.135, 0.081, 0.045, 0.025, 0.017, 0.013, 0.009, 0.000};
constexpr double kR[] = {0.000, 0.230, 0.740, 0.910, 0.980, 1.000, 0.980, 0.960, 0.930, 0.900, 0.860, 0.810,
                         0.780, 0.720, 0.670, 0.610, 0.560, 0.510, 0.460, 0.400, 0.350, 0.308, 0.266, 0.224,
                         0.182, 0.140, 0.118, 0.096, 0.074, 0.052, 0.030, 0.024, 0.018, 0.012, 0.006, 0.000};
constexpr double kI[] = {0.000, 0.024, 0.232, 0.555, 0.785, 0.910, 0.965, 0.985, 0.990, 0.995, 1.000, 1.000,
                         0.990, 0.980, 0.950, 0.910, 0.860, 0.750, 0.560, 0.330, 0.150, 0.030, 0.000};
// 2MASS J: 1.10 to 1.36 um in steps of 20 nm, its shape in broad strokes.
constexpr double kJ[] = {0.0, 0.28, 0.56, 0.85, 1.0, 0.99, 0.97, 0.96, 0.95, 0.93, 0.92, 0.90, 0.45, 0.0};

// Fluxes of magnitude 0: Bessell, Castelli & Plez 1998 (A&A 333, 231, table A2), for J Cohen et al. 2003.
enum : std::size_t { kBlue, kVisual, kRed, kInfrared, kJay, kBands };
constexpr std::array<Band, kBands> kPassbands{{{360e-9, 10e-9, kB, 6.32e-2},
                                               {470e-9, 10e-9, kV, 3.631e-2},
                                               {550e-9, 10e-9, kR, 2.177e-2},
                                               {700e-9, 10e-9, kI, 1.126e-2},
                                               {1100e-9, 20e-9, kJ, 3.13e-3}}};

// ---- The spectra of dwarfs by V-I ----

// Colours of the main sequence: Pecaut & Mamajek 2013 (ApJS 208, 9, table 5, with the author's revisions to 2024);
// V-J = (V-Ks) - (J-H) - (H-Ks).
struct Colours {
  double v_i, b_v, v_r, v_j;
};
constexpr std::array kDwarfs = std::to_array<Colours>({
    {-0.325, -0.278, -0.115, -0.667},  // B1
    {-0.192, -0.178, -0.080, -0.373},  // B3
    {-0.108, -0.109, -0.048, -0.190},  // B8
    {0.004, 0.000, 0.001, 0.045},      // A0
    {0.186, 0.160, 0.089, 0.333},      // A5
    {0.339, 0.295, 0.166, 0.593},      // F0
    {0.506, 0.440, 0.252, 0.852},      // F5
    {0.713, 0.650, 0.363, 1.198},      // G2
    {0.853, 0.816, 0.443, 1.475},      // K0
    {1.030, 0.990, 0.560, 1.750},      // K3
    {1.182, 1.090, 0.635, 2.038},      // K4
    {1.420, 1.240, 0.759, 2.331},      // K6
    {1.766, 1.420, 0.889, 2.833},      // M0
    {2.005, 1.485, 0.956, 3.164},      // M1
    {2.173, 1.505, 1.001, 3.396},      // M2
    {2.420, 1.530, 1.079, 3.769},      // M3
    {2.680, 1.600, 1.178, 4.173},      // M3.5
    {3.073, 1.690, 1.345, 4.785},      // M4.5
    {3.278, 1.830, 1.446, 5.058},      // M5
    {3.664, 1.940, 1.656, 5.583},      // M5.5
    {4.100, 2.010, 1.950, 6.143},      // M6
    {4.500, 2.120, 2.180, 6.997},      // M7
});

// Medians of the 9,925 stars of the Hipparcos catalogue with V <= 6.6 and a colour (fields H37 and H40), and beyond
// B-V 2.1 carbon stars by and large.
struct Relation {
  double b_v, v_i;
};
constexpr std::array kUsual = std::to_array<Relation>({{-0.40, -0.42},
                                                       {-0.20, -0.20},
                                                       {0.00, 0.02},
                                                       {0.20, 0.22},
                                                       {0.40, 0.465},
                                                       {0.60, 0.665},
                                                       {0.80, 0.845},
                                                       {1.00, 0.98},
                                                       {1.20, 1.16},
                                                       {1.40, 1.38},
                                                       {1.50, 1.54},
                                                       {1.62, 1.88},
                                                       {1.80, 2.07},
                                                       {2.10, 2.31},
                                                       {3.00, 2.90}});

// Spectral shape of a blackbody, in W/m2/m but for a constant factor.
double blackbody(double wavelength_m, double temperature_k) {
  const double x = kPlanck * kSpeedOfLight / (wavelength_m * kBoltzmann * temperature_k);
  return std::pow(wavelength_m * 1e6, -5.0) / std::expm1(x);
}

// A blackbody times the exponential of straight lines between the middles of the bands.
struct Spectrum {
  static constexpr std::array<double, kBands> kMiddle{440e-9, 550e-9, 640e-9, 790e-9, 1235e-9};
  double temperature_k = 0.0;
  std::array<double, kBands> bend{};  // natural logarithm, at the middles; the ends hold beyond them

  double bent(double wavelength_m) const {
    if (wavelength_m <= kMiddle.front()) return bend.front();
    for (std::size_t k = 1; k < kBands; ++k) {
      if (wavelength_m > kMiddle[k]) continue;
      const double t = (wavelength_m - kMiddle[k - 1]) / (kMiddle[k] - kMiddle[k - 1]);
      return (1.0 - t) * bend[k - 1] + t * bend[k];
    }
    return bend.back();
  }
  double flux(double wavelength_m) const {
    return blackbody(wavelength_m, temperature_k) * std::exp(bent(wavelength_m));
  }
  // Mean over a band, weighted by photons.
  double mean(const Band& band) const {
    double weighted = 0.0, weight = 0.0;
    double wavelength = band.first_m;
    for (const double response : band.response) {
      weighted += response * wavelength * flux(wavelength);
      weight += response * wavelength;
      wavelength += band.step_m;
    }
    return weighted / weight;
  }
};

// The spectrum of V = 0 with these colours, by correcting each middle by what its band is off.
Spectrum spectrum_of(const Colours& colours) {
  const double magnitudes[kBands] = {colours.b_v, 0.0, -colours.v_r, -colours.v_i, -colours.v_j};
  Spectrum out{.temperature_k = ballesteros_temperature(colours.b_v)};
  constexpr int kRounds = 12;  // 1e-4 mag is left after five
  for (int round = 0; round < kRounds; ++round) {
    for (std::size_t b = 0; b < kBands; ++b) {
      const double wanted = kPassbands[b].zero_magnitude_flux * std::pow(10.0, -0.4 * magnitudes[b]);
      out.bend[b] += std::log(wanted / out.mean(kPassbands[b]));
    }
  }
  return out;
}

// Made once in a program: no camera changes them.
const std::array<Spectrum, kDwarfs.size()>& spectra() {
  static const auto all = [] {
    std::array<Spectrum, kDwarfs.size()> out;
    for (std::size_t i = 0; i < out.size(); ++i) out[i] = spectrum_of(kDwarfs[i]);
    return out;
  }();
  return all;
}

// ---- Interpolation ----

double interpolate(const std::vector<BandPoint>& curve, double wavelength_m) {
  const auto above = std::find_if(curve.begin(), curve.end(),
                                  [&](const BandPoint& point) { return point.wavelength_m >= wavelength_m; });
  if (above == curve.end()) return 0.0;
  if (above == curve.begin()) return above->wavelength_m == wavelength_m ? above->value : 0.0;
  const auto& below = *(above - 1);
  const double t = (wavelength_m - below.wavelength_m) / (above->wavelength_m - below.wavelength_m);
  return below.value + t * (above->value - below.value);
}

// Smooth and without overshoot (Fritsch & Butland 1984); the ends hold beyond them.
template <std::size_t N>
double smooth(const std::array<double, N>& x, const std::array<double, N>& y, double at) {
  if (at <= x.front()) return y.front();
  if (at >= x.back()) return y.back();
  const auto chord = [&](std::size_t i) { return (y[i + 1] - y[i]) / (x[i + 1] - x[i]); };
  const auto slope = [&](std::size_t i) {
    if (i == 0) return chord(0);
    if (i == N - 1) return chord(N - 2);
    const double a = chord(i - 1), b = chord(i);
    if (a * b <= 0.0) return 0.0;
    const double left = x[i] - x[i - 1], right = x[i + 1] - x[i];
    return 3.0 * (left + right) / ((2.0 * right + left) / a + (right + 2.0 * left) / b);
  };
  std::size_t i = 0;
  while (at > x[i + 1]) ++i;
  const double h = x[i + 1] - x[i], t = (at - x[i]) / h, s = 1.0 - t;
  return y[i] * s * s * (1.0 + 2.0 * t) + y[i + 1] * t * t * (1.0 + 2.0 * s) +
         h * s * t * (slope(i) * s - slope(i + 1) * t);
}

template <std::size_t N, typename Row>
std::array<double, N> column(const std::array<Row, N>& rows, double Row::*field) {
  std::array<double, N> out;
  for (std::size_t i = 0; i < N; ++i) out[i] = rows[i].*field;
  return out;
}

// The colours of a table's entries.
constexpr double kFirstVI = kDwarfs.front().v_i, kLastVI = kDwarfs.back().v_i;
constexpr double kFirstBV = kUsual.front().b_v, kLastBV = kUsual.back().b_v;

}  // namespace

double ballesteros_temperature(double b_v) {
  return 4600.0 * (1.0 / (0.92 * b_v + 1.7) + 1.0 / (0.92 * b_v + 0.62));
}

double usual_v_i(double b_v) {
  static const auto x = column(kUsual, &Relation::b_v), y = column(kUsual, &Relation::v_i);
  return smooth(x, y, b_v);
}

double dwarf_v_i(double b_v) {
  static const auto x = column(kDwarfs, &Colours::b_v), y = column(kDwarfs, &Colours::v_i);
  return smooth(x, y, b_v);
}

BandPhotometry::BandPhotometry(const Camera& camera) {
  const auto& transmission = camera.optics.transmission;
  const auto& efficiency = camera.detector.quantum_efficiency;
  if (transmission.empty() || efficiency.empty()) return;  // sees nothing
  const double begin = std::max(transmission.front().wavelength_m, efficiency.front().wavelength_m);
  const double end = std::min(transmission.back().wavelength_m, efficiency.back().wavelength_m);
  if (!(end > begin)) return;

  // Mid-point rule: 2 nm in a band of 500 nm.
  constexpr int kSteps = 250;
  const double step = (end - begin) / kSteps;
  const double pupil = 0.25 * kPi * camera.optics.pupil_diameter_m * camera.optics.pupil_diameter_m;
  std::array<double, kSteps> wavelength, weight;
  for (int i = 0; i < kSteps; ++i) {
    wavelength[i] = begin + (i + 0.5) * step;
    weight[i] = interpolate(transmission, wavelength[i]) * interpolate(efficiency, wavelength[i]) * wavelength[i] /
                (kPlanck * kSpeedOfLight) * pupil;
  }
  std::array<double, kDwarfs.size()> log_electrons, log_irradiance;
  for (std::size_t k = 0; k < kDwarfs.size(); ++k) {
    double electrons = 0.0, irradiance = 0.0;
    for (int i = 0; i < kSteps; ++i) {
      const double flux = spectra()[k].flux(wavelength[i]) * step;
      irradiance += flux;
      electrons += flux * weight[i];
    }
    if (!(electrons > 0.0)) return;  // curves that are zero throughout
    log_electrons[k] = std::log(electrons);
    log_irradiance[k] = std::log(irradiance);
  }
  const auto at = [&, v_i = column(kDwarfs, &Colours::v_i)](double colour) {
    return BandFlux{std::exp(smooth(v_i, log_electrons, colour)), std::exp(smooth(v_i, log_irradiance, colour))};
  };
  for (int k = 0; k < kColours; ++k) {
    const double t = k / (kColours - 1.0);
    by_v_i_[k] = at(kFirstVI + t * (kLastVI - kFirstVI));
    by_b_v_[k] = at(usual_v_i(kFirstBV + t * (kLastBV - kFirstBV)));
  }
}

BandFlux BandPhotometry::flux(double v_mag, double b_v, double v_i) const {
  const bool known = !std::isnan(v_i);
  const Table& table = known ? by_v_i_ : by_b_v_;
  const double colour = known ? v_i : (std::isnan(b_v) ? kSolarColour : b_v);
  const double first = known ? kFirstVI : kFirstBV, last = known ? kLastVI : kLastBV;
  const double x = (std::clamp(colour, first, last) - first) * ((kColours - 1) / (last - first));
  const int k = std::min(static_cast<int>(x), kColours - 2);
  const double t = x - k;
  const double scale = std::exp(-0.4 * 2.302585092994046 * v_mag);
  return {.electrons_per_s = scale * ((1.0 - t) * table[k].electrons_per_s + t * table[k + 1].electrons_per_s),
          .irradiance_w_m2 = scale * ((1.0 - t) * table[k].irradiance_w_m2 + t * table[k + 1].irradiance_w_m2)};
}

double BandPhotometry::v_magnitude(double electrons_per_s, double b_v, double v_i) const {
  return -2.5 * std::log10(electrons_per_s / flux(0.0, b_v, v_i).electrons_per_s);
}

}  // namespace astronav
