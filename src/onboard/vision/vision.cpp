// SPDX-License-Identifier: Apache-2.0
#include "onboard/vision/vision.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "foundation/base/clock.h"

namespace astronav::vision {
namespace {

// Half of what the light of a star, and of a saturated planet with its halo, covers.
constexpr double kStarReachPx = 9.0, kPlanetReachPx = 24.0;

constexpr std::size_t kMostNearStars = 64;  // about one body

IdentifySettings with_psf(IdentifySettings settings, const SensorModel& sensor) {
  settings.psf_sigma_px = sensor.psf_sigma_px;
  return settings;
}

}  // namespace

Vision::Vision(const VisionSettings& settings, const Intrinsics& camera, const SensorModel& sensor,
               const StarField& field, const PairIndex& index)
    : settings_(settings),
      psf_sigma_px_(sensor.psf_sigma_px),
      saturation_dn_(sensor.saturation_dn),
      field_(field),
      camera_(camera),
      middle_{0.5 * (camera.width_px - 1), 0.5 * (camera.height_px - 1)},
      finder_(settings.centroids, sensor, camera.width_px, camera.height_px),
      identifier_(field, index, camera, with_psf(settings.identify, sensor),
                  static_cast<std::size_t>(settings.centroids.max_centroids)),
      geometry_(camera, settings.camera),
      star_memory_(field.stars().size()),
      attention_(camera.width_px, camera.height_px),
      memory_(settings.max_planets) {
  const auto spots = static_cast<std::size_t>(settings.centroids.max_centroids);
  centroids_.resize(spots + settings.max_planets);  // bodies in the wings of another have no spot of their own
  stars_.resize(spots);
  sights_.reserve(spots);
  is_star_.resize(centroids_.size());
  bodies_.reserve(2 * settings.max_planets);
  by_light_.reserve(bodies_.capacity());
  near_.resize(kMostNearStars);
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
    if (geometry_.learns() && !result_.attitude.mirrored) refine_attitude();
  } else {
    result_.source = AttitudeSource::none;
  }
  const double identified = now_ms();

  std::fill(is_star_.begin(), is_star_.end(), static_cast<unsigned char>(0));
  if (known) std::copy(identifier_.on_star().begin(), identifier_.on_star().end(), is_star_.begin());
  // Nor is a planet a hot pixel, a proton or a streak; a near one may well be wider than a point.
  for (std::size_t i = 0; i < result_.centroids.size(); ++i)
    if (centroids_[i].kind != SpotKind::point && centroids_[i].kind != SpotKind::extended) is_star_[i] = 1;
  for (std::size_t i = 0; i < predictions.size(); ++i) {
    planets_[i] = PlanetMatch{};
    planets_[i].body = predictions[i].body;
  }
  if (known) {
    admit_discs(predictions);
    name_planets(frame, observer, predictions);
  }
  result_.planets = std::span<const PlanetMatch>(planets_.data(), predictions.size());
  const double done = now_ms();
  result_.time_ms = {centroided_ms_ - begin, identified - centroided_ms_, done - identified, done - begin};
  return result_;
}

// Once more, with what is known of this camera and of these stars. Their directions are where the identification's own
// camera and attitude put them.
void Vision::refine_attitude() {
  AttitudeSolution& attitude = result_.attitude;
  sights_.clear();
  for (const MatchedStar& star : result_.stars) {
    const Centroid& spot = centroids_[star.centroid];
    const Vec2 predicted = spot.pixel.vec() - star.residual_px;
    const Result<Vec3> direction_C = unproject(attitude.intrinsics, {predicted.x(), predicted.y()});
    if (!direction_C) return;
    sights_.push_back({.pixel = spot.pixel,
                       .covariance_px2 = spot.whole_covariance_px2(),
                       .direction_N = attitude.R_CN.transpose() * *direction_C,
                       .extra_px2 = star_memory_.expected_px2(star.field),
                       .lasting_px2 = star_memory_.lasting_px2(star.field, 2.0 / spot.whole_covariance_px2().trace()),
                       .residual_px = star.residual_px});
  }
  if (!geometry_.learn(sights_, attitude)) return;
  identifier_.set_camera(geometry_.camera());
  for (std::size_t i = 0; i < sights_.size(); ++i) {
    stars_[i].residual_px = sights_[i].residual_px;
    star_memory_.learn(stars_[i].field, sights_[i], attitude.R_CN, attitude.intrinsics);
  }
}

}  // namespace astronav::vision
