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
// Half of what the light of a star, and of a saturated planet with its halo, covers.
constexpr double kStarReachPx = 9.0, kPlanetReachPx = 24.0;

IdentifySettings with_psf(IdentifySettings settings, const SensorModel& sensor) {
  settings.psf_sigma_px = sensor.psf_sigma_px;
  return settings;
}

}  // namespace

Vision::Vision(const VisionSettings& settings, const Intrinsics& camera, const SensorModel& sensor,
               const StarField& field, const PairIndex& index)
    : settings_(settings),
      psf_sigma_px_(sensor.psf_sigma_px),
      camera_(camera),
      middle_{0.5 * (camera.width_px - 1), 0.5 * (camera.height_px - 1)},
      finder_(settings.centroids, sensor, camera.width_px, camera.height_px),
      identifier_(field, index, camera, with_psf(settings.identify, sensor),
                  static_cast<std::size_t>(settings.centroids.max_centroids)),
      attention_(camera.width_px, camera.height_px),
      memory_(settings.max_planets) {
  const auto spots = static_cast<std::size_t>(settings.centroids.max_centroids);
  centroids_.resize(spots);
  stars_.resize(spots);
  is_star_.resize(spots);
  planets_.resize(settings.max_planets);
  guides_.resize(settings.guide_stars);
}

void Vision::attend_stars(const Mat3& R_CN, std::size_t most, double reach_px) {
  const std::size_t stars = identifier_.place(R_CN, std::span<Pixel>(guides_.data(), std::min(most, guides_.size())));
  for (std::size_t i = 0; i < stars; ++i) attention_.add(guides_[i], reach_px + kStarReachPx);
}

void Vision::attend_planets(const AttitudeSolution& attitude, std::span<const PlanetPrediction> predictions) {
  for (const PlanetPrediction& prediction : predictions) {
    const Result<PredictedPixel> planet = predict_pixel(prediction, attitude);
    if (!planet) continue;
    const double gate_px = std::sqrt(settings_.planets.gate_d2 * planet->covariance_px2.trace());
    attention_.add(planet->pixel, gate_px + kPlanetReachPx);
  }
}

// At first a glance at some stars, then a look at all guides and planets where these say they are.
Result<Identification> Vision::identify_within(ImageView<const std::uint16_t> frame, const Observer& observer,
                                               const Mat3& prior_R_CN, std::span<const PlanetPrediction> predictions) {
  const auto fail_within = [] { return fail(ErrorCode::no_match, "the whole frame must be looked at"); };
  identifier_.gather(observer, prior_R_CN, guides_.size());
  attention_.clear();
  attend_stars(prior_R_CN, settings_.first_guides, settings_.prior_radius_px);
  const auto some = finder_.glance(frame, attention_, centroids_, result_.level);
  if (!some) return fail_within();
  const auto rough = identifier_.track_within(std::span<const Centroid>(centroids_.data(), *some), attention_,
                                              prior_R_CN, settings_.prior_radius_px, stars_);
  if (!rough) return forward(rough);
  attention_.clear();
  attend_stars(rough->attitude.R_CN, guides_.size(), settings_.identify.match_px);
  attend_planets(rough->attitude, predictions);
  const auto spots = finder_.find_within(frame, attention_, result_.level, centroids_);
  if (!spots) return fail_within();
  centroided_ms_ = now_ms();
  result_.centroids = std::span<const Centroid>(centroids_.data(), *spots);
  auto known = identifier_.track_within(result_.centroids, attention_, rough->attitude.R_CN,
                                        2.0 * settings_.identify.match_px, stars_);
  if (!known) finder_.look_again();
  return known;
}

Result<Identification> Vision::identify_whole(ImageView<const std::uint16_t> frame, const Observer& observer,
                                              const std::optional<Mat3>& prior_R_CN) {
  const std::size_t spots = finder_.find(frame, centroids_, &result_.level);
  centroided_ms_ = now_ms();
  result_.centroids = std::span<const Centroid>(centroids_.data(), spots);
  if (prior_R_CN) {
    result_.source = AttitudeSource::prior;
    auto known = identifier_.track(result_.centroids, observer, *prior_R_CN, settings_.prior_radius_px, stars_);
    if (known) return known;
  }
  result_.source = AttitudeSource::lost_in_space;
  return identifier_.lost_in_space(result_.centroids, observer, stars_);
}

const FrameResult& Vision::process(ImageView<const std::uint16_t> frame, const Observer& observer,
                                   const std::optional<Mat3>& prior_R_CN,
                                   std::span<const PlanetPrediction> predictions) {
  ASTRONAV_CHECK_OP(predictions.size(), <=, planets_.size());
  const double begin = now_ms();
  result_ = FrameResult{};
  Result<Identification> known = fail(ErrorCode::no_match, "nothing is expected");
  if (prior_R_CN && settings_.guide_stars > 0) {
    result_.source = AttitudeSource::prior;
    known = identify_within(frame, observer, *prior_R_CN, predictions);
    result_.whole = !known;
  }
  if (!known) known = identify_whole(frame, observer, prior_R_CN);
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
  const std::size_t spots = result_.centroids.size();
  const double area_px = result_.whole ? 0.0 : attention_.area_px();
  for (std::size_t i = 0; i < spots; ++i)
    if (centroids_[i].kind != SpotKind::point && centroids_[i].kind != SpotKind::extended) is_star_[i] = 1;
  for (std::size_t i = 0; i < predictions.size(); ++i) {
    planets_[i] = PlanetMatch{};
    planets_[i].body = predictions[i].body;
    if (!known) continue;
    if (predictions[i].companion_flux_dn > 0.0 && !part_from_companion(frame, predictions[i])) continue;
    planets_[i] = find_planet(predictions[i], result_.attitude, result_.centroids,
                              std::span<const unsigned char>(is_star_.data(), spots), settings_.planets, area_px);
    if (planets_[i].found) planets_[i].found = stayed(planets_[i], observer.epoch);
    if (!planets_[i].found) continue;
    is_star_[planets_[i].centroid] = 1;
    Centroid& spot = centroids_[planets_[i].centroid];
    if (spot.saturated)
      spot.repeating_sigma_px = std::hypot(spot.repeating_sigma_px, repeating_of_disc(predictions[i]));
  }
  result_.planets = std::span<const PlanetMatch>(planets_.data(), predictions.size());
  const double done = now_ms();
  result_.time_ms = {centroided_ms_ - begin, identified - centroided_ms_, done - identified, done - begin};
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
