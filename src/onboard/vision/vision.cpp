// SPDX-License-Identifier: Apache-2.0
#include "onboard/vision/vision.h"

#include <algorithm>
#include <cmath>

#include "foundation/base/clock.h"

namespace astronav::vision {
namespace {

// A saturated spot may hold more light than it tells, but not less.
bool as_bright(const Centroid& spot, const PlanetPrediction& prediction) {
  if (!(prediction.expected_flux_dn > 0.0)) return true;
  const double brighter = std::log10(std::max(spot.flux_dn, 1e-3) / prediction.expected_flux_dn);
  return brighter < 0.8 && (spot.saturated || brighter > -1.0);  // 2 and 2.5 mag
}

constexpr double kSteadyPx = 0.1;  // no spot is asked to be steadier

IdentifySettings with_psf(IdentifySettings settings, const SensorModel& sensor) {
  settings.psf_sigma_px = sensor.psf_sigma_px;
  return settings;
}

}  // namespace

Vision::Vision(const VisionSettings& settings, const Intrinsics& camera, const SensorModel& sensor,
               const StarField& field, const PairIndex& index)
    : settings_(settings),
      psf_sigma_px_(sensor.psf_sigma_px),
      finder_(settings.centroids, sensor, camera.width_px, camera.height_px),
      identifier_(field, index, camera, with_psf(settings.identify, sensor),
                  static_cast<std::size_t>(settings.centroids.max_centroids)),
      memory_(settings.max_planets) {
  const auto spots = static_cast<std::size_t>(settings.centroids.max_centroids);
  centroids_.resize(spots);
  stars_.resize(spots);
  is_star_.resize(spots);
  planets_.resize(settings.max_planets);
}

const FrameResult& Vision::process(ImageView<const std::uint16_t> frame, const Observer& observer,
                                   const std::optional<Mat3>& prior_R_CN,
                                   std::span<const PlanetPrediction> predictions) {
  ASTRONAV_CHECK_OP(predictions.size(), <=, planets_.size());
  const double begin = now_ms();
  result_ = FrameResult{};
  const std::size_t spots = finder_.find(frame, centroids_, &result_.level);
  result_.centroids = std::span<const Centroid>(centroids_.data(), spots);
  const double centroided = now_ms();

  Result<Identification> known = fail(ErrorCode::no_match, "no prior attitude");
  if (prior_R_CN)
    known = identifier_.track(result_.centroids, observer, *prior_R_CN, settings_.prior_radius_px, stars_);
  result_.source = AttitudeSource::prior;
  if (!known) {
    known = identifier_.lost_in_space(result_.centroids, observer, stars_);
    result_.source = AttitudeSource::lost_in_space;
  }
  if (known) {
    result_.attitude = known->attitude;
    result_.stars = std::span<const MatchedStar>(stars_.data(), known->matched);
    result_.hypotheses = known->hypotheses;
  } else {
    result_.source = AttitudeSource::none;
  }
  const double identified = now_ms();

  std::fill(is_star_.begin(), is_star_.end(), static_cast<unsigned char>(0));
  if (known) std::copy(identifier_.on_star().begin(), identifier_.on_star().end(), is_star_.begin());
  // Nor is a planet a hot pixel, a proton or a streak; a near one may well be wider than a point.
  for (std::size_t i = 0; i < spots; ++i)
    if (centroids_[i].kind != SpotKind::point && centroids_[i].kind != SpotKind::extended) is_star_[i] = 1;
  for (std::size_t i = 0; i < predictions.size(); ++i) {
    planets_[i] = PlanetMatch{};
    planets_[i].body = predictions[i].body;
    if (!known) continue;
    if (predictions[i].companion_flux_dn > 0.0 && !part_from_companion(frame, predictions[i])) continue;
    planets_[i] = find_planet(predictions[i], result_.attitude, result_.centroids,
                              std::span<const unsigned char>(is_star_.data(), spots), settings_.planets);
    if (planets_[i].found) planets_[i].found = stayed(planets_[i], observer.epoch);
    if (!planets_[i].found) continue;
    is_star_[planets_[i].centroid] = 1;
    Centroid& spot = centroids_[planets_[i].centroid];
    if (spot.saturated)
      spot.repeating_sigma_px = std::hypot(spot.repeating_sigma_px, repeating_of_disc(predictions[i]));
  }
  result_.planets = std::span<const PlanetMatch>(planets_.data(), predictions.size());
  const double done = now_ms();
  result_.time_ms = {centroided - begin, identified - centroided, done - identified, done - begin};
  return result_;
}

// Where the spot lies among the stars, against the last frame that showed the body.
bool Vision::stayed(const PlanetMatch& match, Epoch epoch) {
  const Centroid& spot = centroids_[match.centroid];
  const AttitudeSolution& attitude = result_.attitude;
  const Result<Vec3> direction_C = unproject(attitude.intrinsics, spot.pixel);
  if (!direction_C) return false;
  const double centroid = std::hypot(std::sqrt(0.5 * spot.covariance_px2.trace()), spot.repeating_sigma_px);
  const double sigma = std::hypot(std::max(centroid, kSteadyPx) * attitude.intrinsics.plate_scale_rad_px(),
                                  std::sqrt(attitude.covariance_rad2.trace()));
  return memory_.agrees(match.body, attitude.R_CN.transpose() * *direction_C, sigma, epoch, settings_.planets);
}

// A disc lit from one side is skew: its third cumulant along the Sun's direction is up to 0.013 R^3 (Lambert). At x
// from the centre a Gaussian's wing then seems shifted by 0.013 R^3 x^2 / (6 sigma^4); the wings of a saturated spot
// are seen at 3 to 4 sigma.
double Vision::repeating_of_disc(const PlanetPrediction& prediction) const {
  constexpr double kShift = 0.013 * 3.5 * 3.5 / 6.0;
  const double radius_px = prediction.angular_radius_rad * result_.attitude.intrinsics.fx_px;
  return kShift * radius_px * radius_px * radius_px / (psf_sigma_px_ * psf_sigma_px_);
}

// The spot nearest to the prediction that may be it is measured again with the companion's light taken away: blended,
// it would be off by more than its covariance says, and be refused.
bool Vision::part_from_companion(ImageView<const std::uint16_t> frame, const PlanetPrediction& prediction) {
  constexpr double kNearPx = 4.0;        // a blended centroid lies this near to the planet
  constexpr double kCompanionPx = 20.0;  // beyond it the light does not reach a fit's window
  const Result<PredictedPixel> planet = predict_pixel(prediction, result_.attitude);
  const Result<Pixel> companion =
      project(result_.attitude.intrinsics, result_.attitude.R_CN * prediction.companion_direction_N);
  if (!planet || !companion) return true;
  const Companion beside{companion->vec() - planet->pixel.vec(), prediction.companion_flux_dn};
  const double apart_px = beside.offset_px.norm();
  const double sigma_px = std::sqrt(planet->covariance_px2.trace());
  const bool brighter = prediction.expected_flux_dn > prediction.companion_flux_dn;
  std::size_t chosen = result_.centroids.size();
  double least = std::max(kNearPx, 3.0 * sigma_px);
  for (std::size_t i = 0; i < result_.centroids.size(); ++i) {
    if (is_star_[i] || !as_bright(result_.centroids[i], prediction)) continue;
    const double distance = (result_.centroids[i].pixel.vec() - planet->pixel.vec()).norm();
    if (distance >= least) continue;
    chosen = i;
    if (brighter) break;  // the brightest spot comes first
    least = distance;
  }
  if (chosen == result_.centroids.size()) return true;
  // Two round spots that touch are together at least this long.
  if (apart_px > kCompanionPx) return 2.0 * std::sqrt(centroids_[chosen].pixels / kPi) < apart_px;
  const Pixel guess = sigma_px < 1.0 ? planet->pixel : centroids_[chosen].pixel;
  return finder_.measure_beside(frame, result_.level, guess, beside, centroids_[chosen]);
}

}  // namespace astronav::vision
