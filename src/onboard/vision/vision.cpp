// SPDX-License-Identifier: Apache-2.0
#include "onboard/vision/vision.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "foundation/base/clock.h"

namespace astronav::vision {
namespace {

bool as_bright(double flux_dn, double expected_dn) {
  return std::abs(std::log10(std::max(flux_dn, 1e-3) / expected_dn)) < 1.0;  // 2.5 mag
}

constexpr double kSteadyPx = 0.1;  // no spot is asked to be steadier
// Two bodies: their common spot is off by so much, and more where they are apart; a prediction as good as this is a
// guess to start from; no offset is asked to be nearer to what was foretold; and from a body's fitted place to its own
// spot.
constexpr double kBlendedPx = 4.0, kSurePx = 2.0, kAstrayPx = 0.3, kOwnSpotPx = 3.0;
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
      geometry_(camera, settings.camera),
      attention_(camera.width_px, camera.height_px),
      memory_(settings.max_planets) {
  const auto spots = static_cast<std::size_t>(settings.centroids.max_centroids);
  centroids_.resize(spots + settings.max_planets);  // bodies in the wings of another have no spot of their own
  stars_.resize(spots);
  sights_.reserve(spots);
  is_star_.resize(centroids_.size());
  parts_.resize(settings.max_planets);
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
    if (geometry_.learns() && !result_.attitude.mirrored) learn_camera();
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
    name_planets(frame, observer.epoch, predictions);
  }
  result_.planets = std::span<const PlanetMatch>(planets_.data(), predictions.size());
  const double done = now_ms();
  result_.time_ms = {centroided_ms_ - begin, identified - centroided_ms_, done - identified, done - begin};
  return result_;
}

// The stars' directions are where the identification's own camera and attitude put them.
void Vision::learn_camera() {
  AttitudeSolution& attitude = result_.attitude;
  sights_.clear();
  for (const MatchedStar& star : result_.stars) {
    const Centroid& spot = centroids_[star.centroid];
    const Vec2 predicted = spot.pixel.vec() - star.residual_px;
    const Result<Vec3> direction_C = unproject(attitude.intrinsics, {predicted.x(), predicted.y()});
    if (!direction_C) return;
    sights_.push_back({spot.pixel, spot.covariance_px2, attitude.R_CN.transpose() * *direction_C});
  }
  if (!geometry_.learn(sights_, attitude)) return;
  identifier_.set_camera(geometry_.camera());
  for (std::size_t i = 0; i < sights_.size(); ++i) stars_[i].residual_px = sights_[i].residual_px;
}

// A disc that does not saturate is no point, and was set apart. Where a body of its size is foretold it is a spot
// again, at its centre of light: that is what the prediction is of.
void Vision::admit_discs(std::span<const PlanetPrediction> predictions) {
  constexpr double kLeastRadiusPx = 0.8;           // smaller ones are fitted as points
  constexpr double kLeastLit = 0.1, kMostLit = 2;  // of the disc's area, its blurred rim included
  std::size_t count = result_.centroids.size();
  for (const PlanetPrediction& prediction : predictions) {
    const double radius_px = prediction.angular_radius_rad * result_.attitude.intrinsics.fx_px;
    const Result<PredictedPixel> place = predict_pixel(prediction, result_.attitude);
    if (radius_px < kLeastRadiusPx || !place) continue;
    const double blurred_px = radius_px + 3.0 * psf_sigma_px_, area_px = kPi * blurred_px * blurred_px;
    for (const Centroid& other : finder_.others()) {
      if (other.kind != SpotKind::extended || other.saturated || count == centroids_.size()) continue;
      const Vec2 off = other.pixel.vec() - place->pixel.vec();
      const Mat2 covariance = place->covariance_px2 + other.covariance_px2;
      if (off.dot(covariance.inverse() * off) > settings_.planets.gate_d2) continue;
      if (other.pixels < kLeastLit * area_px || other.pixels > kMostLit * area_px) continue;
      is_star_[count] = 0;
      centroids_[count++] = other;
    }
  }
  result_.centroids = std::span<const Centroid>(centroids_.data(), count);
}

void Vision::name_planets(ImageView<const std::uint16_t> frame, Epoch epoch,
                          std::span<const PlanetPrediction> predictions) {
  for (std::size_t i = 0; i < predictions.size(); ++i) parts_[i] = {.neighbour = neighbour_of(predictions, i)};
  for (std::size_t i = 0; i < predictions.size(); ++i) {
    const std::optional<Neighbour>& neighbour = parts_[i].neighbour;
    if (!neighbour) continue;
    if (const std::size_t other = neighbour->prediction; other != kNone) {
      // A third body beside two takes no part; and of two the brighter one asks for both.
      const bool mutual = parts_[other].neighbour && parts_[other].neighbour->prediction == i;
      if (!mutual || neighbour->flux_dn > predictions[i].expected_flux_dn) continue;
    }
    part_from_neighbour(frame, predictions, i, *neighbour);
  }
  const double area_px = result_.whole ? 0.0 : attention_.area_px();
  for (std::size_t i = 0; i < predictions.size(); ++i) {
    if (parts_[i].mixed) continue;
    // A spot that a neighbour's light was parted into is the neighbour's.
    const auto bar_others = [&](unsigned char barred) {
      for (std::size_t k = 0; k < predictions.size(); ++k)
        if (k != i && parts_[k].spot != kNone && !planets_[k].found) is_star_[parts_[k].spot] = barred;
    };
    bar_others(1);
    planets_[i] = find_planet(predictions[i], result_.attitude, result_.centroids,
                              std::span<const unsigned char>(is_star_.data(), result_.centroids.size()),
                              settings_.planets, area_px);
    bar_others(0);
    if (planets_[i].found) planets_[i].found = stayed(planets_[i], epoch);
    if (!planets_[i].found) continue;
    is_star_[planets_[i].centroid] = 1;
    Centroid& spot = centroids_[planets_[i].centroid];
    if (spot.saturated)
      spot.repeating_sigma_px = std::hypot(spot.repeating_sigma_px, repeating_of_disc(predictions[i]));
  }
  for (std::size_t i = 0; i < predictions.size(); ++i) {
    if (parts_[i].leans_on != kNone && !planets_[parts_[i].leans_on].found) planets_[i].found = false;
  }
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

double Vision::repeating_of_disc(const PlanetPrediction& prediction) const {
  return skew_of_disc_px(prediction.angular_radius_rad * result_.attitude.intrinsics.fx_px, psf_sigma_px_);
}

// What stands beside a body, by what was told with it or by the other predictions.
std::optional<Vision::Neighbour> Vision::neighbour_of(std::span<const PlanetPrediction> predictions,
                                                      std::size_t index) const {
  // Beyond it the light does not reach a fit's window, nor do two spots touch.
  constexpr double kReachPx = 40.0;
  constexpr double kSameRad = 1e-6;
  const PlanetPrediction& body = predictions[index];
  const Result<PredictedPixel> place = predict_pixel(body, result_.attitude);
  if (!place || !(body.expected_flux_dn > 0.0)) return std::nullopt;
  std::optional<Neighbour> nearest;
  double least = kReachPx;
  if (body.companion_flux_dn > 0.0) {
    const Result<Pixel> beside =
        project(result_.attitude.intrinsics, result_.attitude.R_CN * body.companion_direction_N);
    if (!beside) return std::nullopt;
    const Vec2 offset = beside->vec() - place->pixel.vec();
    if (offset.norm() > kReachPx) return std::nullopt;
    // An error of the spacecraft's place shrinks or turns the way from one to the other by what it turns the sight;
    // some of that way, for the Moon as long as 60 of the Earth's radii, may lie along the sight.
    constexpr double kOrbitRadii = 60.0;
    const double way_px =
        std::max(offset.norm(), kOrbitRadii * body.angular_radius_rad * result_.attitude.intrinsics.fx_px);
    const double turned_px = way_px * std::sqrt(0.5 * body.direction_covariance.trace());
    nearest = Neighbour{*beside, offset, Mat2::Identity() * turned_px * turned_px, body.companion_flux_dn, kNone};
    least = 0.0;
  }
  for (std::size_t i = 0; i < predictions.size(); ++i) {
    if (i == index || !(predictions[i].expected_flux_dn > 0.0)) continue;
    if (body.companion_flux_dn > 0.0 && (predictions[i].direction_N - body.companion_direction_N).norm() < kSameRad) {
      nearest->prediction = i;
      continue;
    }
    const Result<PredictedPixel> other = predict_pixel(predictions[i], result_.attitude);
    if (!other) continue;
    const Vec2 offset = other->pixel.vec() - place->pixel.vec();
    if (offset.norm() >= least) continue;
    least = offset.norm();
    nearest = Neighbour{other->pixel, offset, Mat2(place->covariance_px2 + other->covariance_px2),
                        predictions[i].expected_flux_dn, i};
  }
  return nearest;
}

// Two bodies in one spot, or in each other's wings, are measured together: alone each would be off by more than its
// covariance says, and be refused. The brighter one first, in the spot that it must have; then the other, in its own
// spot or in a new one.
void Vision::part_from_neighbour(ImageView<const std::uint16_t> frame, std::span<const PlanetPrediction> predictions,
                                 std::size_t index, const Neighbour& neighbour) {
  const PlanetPrediction& body = predictions[index];
  const PredictedPixel place = *predict_pixel(body, result_.attitude);
  const bool brighter = body.expected_flux_dn >= neighbour.flux_dn;
  const std::size_t first = brighter ? index : kNone, second = brighter ? neighbour.prediction : index;
  PairBelief belief{.first_flux_dn = brighter ? body.expected_flux_dn : neighbour.flux_dn,
                    .second_flux_dn = brighter ? neighbour.flux_dn : body.expected_flux_dn,
                    .offset_px = brighter ? neighbour.offset_px : Vec2(-neighbour.offset_px),
                    .offset_covariance_px2 = neighbour.offset_covariance_px2};
  const Pixel expected = brighter ? place.pixel : neighbour.pixel;
  // A spot of both lies between them.
  const double sigma_px = std::sqrt(place.covariance_px2.trace());
  const double near_px = std::max(kBlendedPx, 0.5 * belief.offset_px.norm()) + 3.0 * sigma_px;
  std::size_t chosen = kNone;
  for (std::size_t i = 0; i < result_.centroids.size() && chosen == kNone; ++i) {
    if (is_star_[i] || (centroids_[i].pixel.vec() - expected.vec()).norm() > near_px) continue;
    if (centroids_[i].saturated || as_bright(centroids_[i].flux_dn, belief.first_flux_dn)) chosen = i;
  }
  if (chosen == kNone) return;
  const auto between = [&](double share) {
    const Vec2 at = centroids_[chosen].pixel.vec() - share * belief.offset_px;
    return Pixel{at.x(), at.y()};
  };
  const std::array<Pixel, 5> guesses{expected, between(0.0), between(0.3), between(0.6), between(1.0)};
  const std::span<const Pixel> tried = std::span<const Pixel>(guesses).subspan(sigma_px < kSurePx ? 0 : 1);
  if (!finder_.measure_beside(frame, result_.level, tried, belief, centroids_[chosen])) {
    parts_[index].mixed = true;
    if (second != kNone) parts_[second].mixed = true;
    return;
  }
  if (first == kNone)
    is_star_[chosen] = 1;  // another planet
  else
    parts_[first].spot = chosen;
  if (second == kNone) return;

  const Centroid& bright = centroids_[chosen];
  belief = {.first_flux_dn = belief.second_flux_dn,
            .second_flux_dn = bright.flux_dn,
            .offset_px = -belief.offset_px,
            .offset_covariance_px2 = belief.offset_covariance_px2};
  const Pixel guess{bright.pixel.u - belief.offset_px.x(), bright.pixel.v - belief.offset_px.y()};
  Centroid faint;
  // It was foretold from there: a fit that ends elsewhere has gone astray.
  const double foretold_px = std::sqrt(belief.offset_covariance_px2.trace() + bright.covariance_px2.trace());
  parts_[second].mixed = !finder_.measure_beside(frame, result_.level, {&guess, 1}, belief, faint) ||
                         (faint.pixel.vec() - guess.vec()).norm() > std::max(kAstrayPx, 4.0 * foretold_px);
  if (parts_[second].mixed) return;
  std::size_t own = result_.centroids.size();
  for (std::size_t i = 0; i < result_.centroids.size(); ++i) {
    if (i != chosen && !is_star_[i] && (centroids_[i].pixel.vec() - faint.pixel.vec()).norm() < kOwnSpotPx) own = i;
  }
  if (own == centroids_.size()) return;
  if (own == result_.centroids.size()) {
    is_star_[own] = 0;
    result_.centroids = std::span<const Centroid>(centroids_.data(), own + 1);
  } else {
    faint.peak_dn = centroids_[own].peak_dn;
    faint.pixels = centroids_[own].pixels;
  }
  centroids_[own] = faint;
  parts_[second].spot = own;
  parts_[second].leans_on = first;
}

}  // namespace astronav::vision
