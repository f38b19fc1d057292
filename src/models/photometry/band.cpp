// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include "models/photometry/photometry.h"

namespace astronav {
namespace {

constexpr double kPlanck = 6.62607015e-34;      // J s
constexpr double kBoltzmann = 1.380649e-23;     // J/K
constexpr double kZeroMagnitudeFlux = 3.63e-2;  // W/m2/m = 3.63e-9 erg/s/cm2/Angstrom (Bessell, Castelli & Plez 1998)
constexpr double kSolarColour = 0.65;
constexpr double kBluest = -0.4;
constexpr double kReddest = 3.0;

// V of Bessell 1990 (PASP 102, 1181, table 2): photon response from 470 nm in steps of 10 nm.
constexpr double kVBandFirst = 470e-9;
constexpr double kVBandStep = 10e-9;
constexpr double kVBand[] = {0.000, 0.030, 0.163, 0.458, 0.780, 0.967, 1.000, 0.973, 0.898, 0.792, 0.684, 0.574,
                             0.461, 0.359, 0.270, 0.197, 0.135, 0.081, 0.045, 0.025, 0.017, 0.013, 0.009, 0.000};

// Spectral shape of a blackbody, in W/m2/m but for a constant factor.
double blackbody(double wavelength_m, double temperature_k) {
  const double x = kPlanck * kSpeedOfLight / (wavelength_m * kBoltzmann * temperature_k);
  return std::pow(wavelength_m * 1e6, -5.0) / std::expm1(x);
}

// The factor that makes the blackbody's mean over V, weighted by photons, the flux of V = 0.
double scale_to_zero_magnitude(double temperature_k) {
  double weighted = 0.0;
  double weight = 0.0;
  double wavelength = kVBandFirst;
  for (const double response : kVBand) {
    weighted += response * wavelength * blackbody(wavelength, temperature_k);
    weight += response * wavelength;
    wavelength += kVBandStep;
  }
  return kZeroMagnitudeFlux * weight / weighted;
}

double interpolate(const std::vector<BandPoint>& curve, double wavelength_m) {
  const auto above = std::find_if(curve.begin(), curve.end(),
                                  [&](const BandPoint& point) { return point.wavelength_m >= wavelength_m; });
  if (above == curve.end()) return 0.0;
  if (above == curve.begin()) return above->wavelength_m == wavelength_m ? above->value : 0.0;
  const auto& below = *(above - 1);
  const double t = (wavelength_m - below.wavelength_m) / (above->wavelength_m - below.wavelength_m);
  return below.value + t * (above->value - below.value);
}

double colour_of(int index, int count) {
  return kBluest + (kReddest - kBluest) * index / (count - 1);
}

}  // namespace

double ballesteros_temperature(double b_v) {
  return 4600.0 * (1.0 / (0.92 * b_v + 1.7) + 1.0 / (0.92 * b_v + 0.62));
}

BandPhotometry::BandPhotometry(const Camera& camera) {
  const auto& transmission = camera.optics.transmission;
  const auto& efficiency = camera.detector.quantum_efficiency;
  log_electrons_.fill(-std::numeric_limits<double>::infinity());
  log_irradiance_.fill(-std::numeric_limits<double>::infinity());
  if (transmission.empty() || efficiency.empty()) return;  // sees nothing

  const double begin = std::max(transmission.front().wavelength_m, efficiency.front().wavelength_m);
  const double end = std::min(transmission.back().wavelength_m, efficiency.back().wavelength_m);
  if (!(end > begin)) return;
  std::array<double, kColours> temperature;
  for (int k = 0; k < kColours; ++k) temperature[k] = ballesteros_temperature(colour_of(k, kColours));

  // Mid-point rule: 2 nm in a band of 500 nm.
  constexpr int kSteps = 250;
  const double step = (end - begin) / kSteps;
  std::array<double, kColours> photons{};
  std::array<double, kColours> energy{};
  for (int i = 0; i < kSteps; ++i) {
    const double wavelength = begin + (i + 0.5) * step;
    const double response = interpolate(transmission, wavelength) * interpolate(efficiency, wavelength) * wavelength /
                            (kPlanck * kSpeedOfLight);
    for (int k = 0; k < kColours; ++k) {
      const double flux = blackbody(wavelength, temperature[k]) * step;
      energy[k] += flux;
      photons[k] += flux * response;
    }
  }
  const double pupil = 0.25 * kPi * camera.optics.pupil_diameter_m * camera.optics.pupil_diameter_m;
  for (int k = 0; k < kColours; ++k) {
    const double scale = scale_to_zero_magnitude(temperature[k]);
    log_electrons_[k] = std::log(photons[k] * scale * pupil);
    log_irradiance_[k] = std::log(energy[k] * scale);
  }
}

BandFlux BandPhotometry::flux(double v_mag, double b_v, double /*v_i*/) const {
  const double colour = std::isnan(b_v) ? kSolarColour : std::clamp(b_v, kBluest, kReddest);
  const double x = (colour - kBluest) / (kReddest - kBluest) * (kColours - 1);
  const int k = std::min(static_cast<int>(x), kColours - 2);
  const double t = x - k;
  const double log_v = -0.4 * std::log(10.0) * v_mag;
  const auto at = [&](const std::array<double, kColours>& table) {
    return std::exp(log_v + (1.0 - t) * table[k] + t * table[k + 1]);
  };
  if (log_electrons_[0] == -std::numeric_limits<double>::infinity()) return {};
  return {.electrons_per_s = at(log_electrons_), .irradiance_w_m2 = at(log_irradiance_)};
}

double BandPhotometry::v_magnitude(double electrons_per_s, double b_v, double v_i) const {
  return -2.5 * std::log10(electrons_per_s / flux(0.0, b_v, v_i).electrons_per_s);
}

}  // namespace astronav
