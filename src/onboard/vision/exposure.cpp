// SPDX-License-Identifier: Apache-2.0
#include "onboard/vision/exposure.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "onboard/vision/psf_fit.h"
#include "onboard/vision/psf_profile.h"
#include "onboard/vision/star_memory.h"

namespace astronav::vision {
namespace {

constexpr int kSide = kMaxFitWindow + 1;                                     // of the picture of one spot
constexpr Pixel kPlace{0.5 * (kSide - 1) + 0.25, 0.5 * (kSide - 1) + 0.25};  // between a pixel's middle and its corner
constexpr double kMagStep = 0.5;                                             // stars are forecast in classes of so much
constexpr double kBrightestClass = -2.0;

using SpotPicture = std::array<float, static_cast<std::size_t>(kSide) * kSide>;

// The light of one point, full pixels cut off; no noise.
void draw(const SensorModel& sensor, const LocalPsf& psf, double flux_dn, SpotPicture& picture) {
  const auto& shape = psf.value;
  const double core = flux_dn / (1.0 + shape[LocalPsf::halo_share]);
  const std::array<double, 3> light{core, core * shape[LocalPsf::halo_share] * (1.0 - shape[LocalPsf::outer_share]),
                                    core * shape[LocalPsf::halo_share] * shape[LocalPsf::outer_share]};
  const std::array<double, 3> width{shape[LocalPsf::width], shape[LocalPsf::halo_width],
                                    LocalPsf::kOuterWidth * shape[LocalPsf::halo_width]};
  picture.fill(0.0f);
  for (std::size_t k = 0; k < light.size(); ++k) {
    const double u = kPlace.u + (k > 0 ? shape[LocalPsf::halo_u] : 0.0);
    const double v = kPlace.v + (k > 0 ? shape[LocalPsf::halo_v] : 0.0);
    std::array<double, kSide> along{}, down{};
    for (int i = 0; i < kSide; ++i) {
      const auto share = [&](double center) {
        return kNormal((i + 0.5 - center) / width[k]).cumulative - kNormal((i - 0.5 - center) / width[k]).cumulative;
      };
      along[static_cast<std::size_t>(i)] = share(u);
      down[static_cast<std::size_t>(i)] = share(v);
    }
    for (std::size_t j = 0; j < kSide; ++j)
      for (std::size_t i = 0; i < kSide; ++i)
        picture[j * kSide + i] += static_cast<float>(light[k] * down[j] * along[i]);
  }
  for (float& pixel : picture) pixel = std::min(pixel, static_cast<float>(sensor.saturation_dn));
}

}  // namespace

SpotForecast forecast_spot(const SensorModel& sensor, const LocalPsf& psf, double flux_dn, double noise_dn) {
  SpotForecast out;
  SpotPicture picture;
  draw(sensor, psf, flux_dn, picture);
  // A saturated core is as wide as it is high: the middle row tells.
  constexpr int kMiddle = kSide / 2;
  int core = 0;
  for (int i = 0; i < kSide; ++i) {
    if (static_cast<double>(picture[static_cast<std::size_t>(kMiddle * kSide + i)]) >= sensor.saturation_dn)
      core = std::max(core, std::abs(i - kMiddle));
  }
  out.peak_dn = static_cast<double>(picture[static_cast<std::size_t>(kMiddle * kSide + kMiddle)]);
  out.saturated = out.peak_dn >= sensor.saturation_dn;
  const Window full{kMiddle - core, kMiddle - core, kMiddle + core, kMiddle + core};
  const int reach = out.saturated ? core + reach_about_full_px(full, psf) : psf.reach_px();
  if (2 * reach + 1 > kMaxFitWindow) return out;
  const Window window{kMiddle - reach, kMiddle - reach, kMiddle + reach, kMiddle + reach};
  const LocalLevel level{.at = kPlace, .noise_dn = noise_dn};
  const ImageView<const float> image(picture.data(), kSide, kSide);
  const PsfFit fit = fit_psf(image, window, kPlace, level, sensor, psf);
  if (!fit.converged) return out;
  out.measured = true;
  out.sigma_px = std::sqrt(0.5 * fit.noise_px2.trace());
  out.repeating_px = fit.saturated ? repeating_sigma(fit) : fit.repeating_sigma_px;
  return out;
}

ExposureSettings ExposureSettings::of(const Camera& camera, double v0_e_s) {
  const Detector& d = camera.detector;
  ExposureSettings out;
  out.longest_s = camera.exposure_s;
  out.shortest_s = camera.exposure_s / 64.0;
  out.star_dn_s = v0_e_s / d.gain_e_dn;
  out.sky_dn_s = (d.background_e_s_px + d.dark_current_e_s * dark_factor(d)) / d.gain_e_dn;
  return out;
}

ExposureControl::ExposureControl(const ExposureSettings& settings, const SensorModel& sensor, const Intrinsics& camera,
                                 const StarField& field)
    : settings_(settings),
      sensor_(sensor),
      field_(&field),
      radius_rad_(std::sqrt(camera.field_of_view_horizontal_rad() * camera.field_of_view_vertical_rad() / kPi)) {}

ExposureControl::Census ExposureControl::stars_around(const Vec3& direction_N) const {
  Census count{};
  std::array<std::uint32_t, 4096> stars;
  const std::size_t seen = field_->cone(direction_N, radius_rad_, stars);
  for (std::size_t i = 0; i < seen; ++i) {
    const double at = (static_cast<double>(field_->stars()[stars[i]].v_mag) - kBrightestClass) / kMagStep;
    ++count[static_cast<std::size_t>(std::clamp(at, 0.0, kMagClasses - 1.0))];
  }
  return count;
}

ExposureForecast ExposureControl::forecast(const ExpectedPlanet& planet, const LocalPsf& psf, double exposure_s) const {
  return forecast(stars_around(planet.direction_N), planet, psf, exposure_s);
}

ExposureForecast ExposureControl::forecast(const Census& count, const ExpectedPlanet& planet, const LocalPsf& psf,
                                           double exposure_s) const {
  const double read_dn = sensor_.read_noise_e / sensor_.gain_e_dn;
  constexpr double kQuantisation = 1.0 / 12.0;
  const double noise_dn =
      std::sqrt(read_dn * read_dn + kQuantisation + settings_.sky_dn_s * exposure_s / sensor_.gain_e_dn);
  ExposureForecast out;
  out.exposure_s = exposure_s;
  // A full Lambert disc has <x^2> = R^2 / 5: its spot is that of a wider point.
  LocalPsf of_planet = psf.of_body();
  of_planet.value[LocalPsf::width] = std::hypot(psf.sigma_px(), planet.radius_px / std::sqrt(5.0));
  out.planet = forecast_spot(sensor_, of_planet, planet.dn_s * exposure_s, noise_dn);

  double information = 0.0, shared = 0.0;
  for (std::size_t k = 0; k < count.size(); ++k) {
    if (count[k] == 0) continue;
    const double v_mag = kBrightestClass + (static_cast<double>(k) + 0.5) * kMagStep;
    const double flux_dn = settings_.star_dn_s * std::pow(10.0, -0.4 * v_mag) * exposure_s;
    const SpotForecast star = forecast_spot(sensor_, psf, flux_dn, noise_dn);
    if (star.peak_dn < settings_.threshold_sigma * noise_dn) break;
    if (!star.measured) continue;
    const int measured = std::min(count[k], settings_.most_stars - out.stars);
    out.stars += measured;
    const double alone2 = star.sigma_px * star.sigma_px + star.repeating_px * star.repeating_px;
    // In the middle of the window, if its images are the first that show this star. Doubles will hardly count.
    const double seen = 0.5 * settings_.images / alone2;
    const double itself2 = StarMemory::expected_px2(seen, 2.0 / seen);
    const double weight = 1.0 / (alone2 + itself2), singles = (1.0 - StarMemory::kDoubleShare) * measured;
    information += singles * weight;
    shared += singles * weight * weight * itself2;
  }
  out.attitude_px = information > 0.0 ? 1.0 / std::sqrt(information) : 1e3;
  out.attitude_repeating_px = information > 0.0 ? std::sqrt(shared) / information : 0.0;
  const double repeating2 = out.attitude_repeating_px * out.attitude_repeating_px;
  const double once = out.planet.sigma_px * out.planet.sigma_px + out.attitude_px * out.attitude_px - repeating2;
  out.window_px = std::sqrt(out.planet.repeating_px * out.planet.repeating_px + repeating2 + once / settings_.images);
  return out;
}

ExposureForecast ExposureControl::choose(const ExpectedPlanet& planet, const LocalPsf& psf) const {
  const Census stars = stars_around(planet.direction_N);
  ExposureForecast best = forecast(stars, planet, psf, settings_.longest_s);
  const auto serves = [&](const ExposureForecast& f) { return f.planet.measured && f.stars >= settings_.least_stars; };
  constexpr double kHalfStop = 0.70710678118654752;
  for (double t = settings_.longest_s * kHalfStop; t >= settings_.shortest_s; t *= kHalfStop) {
    const ExposureForecast shorter = forecast(stars, planet, psf, t);
    if (!serves(shorter)) continue;
    if (!serves(best) || shorter.window_px < best.window_px) best = shorter;
  }
  return best;
}

}  // namespace astronav::vision
