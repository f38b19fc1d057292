// SPDX-License-Identifier: Apache-2.0
// The part of Vision that names planets: discs, bodies and stars that run into each other, and which spot is whose.
#include <algorithm>
#include <array>
#include <cmath>

#include "foundation/math/rotation.h"
#include "onboard/vision/vision.h"

namespace astronav::vision {
namespace {

bool as_bright(double flux_dn, double expected_dn) {
  return std::abs(std::log10(std::max(flux_dn, 1e-3) / expected_dn)) < 1.0;  // 2.5 mag
}

Pixel pixel_at(const Vec2& at) {
  return {at.x(), at.y()};
}

constexpr double kSteadyPx = 0.1;  // no spot is asked to be steadier
// Bodies in one spot: it is off by so much, and more where they are apart; no offset is asked to be nearer to what was
// foretold.
constexpr double kBlendedPx = 4.0, kAstrayPx = 0.3;
constexpr double kAlonePx = 1.0;  // and a body alone in its spot
constexpr double kSurePx = 2.0;   // a prediction as good as this is a guess to start from
constexpr double kOwnSpotPx = 3.0,
                 kSameSpotPx = 0.5;  // from a body's fitted place to its own spot, and to a copy of it
// Light beside that of a star or of an unknown source is a body's where the frame tells it so well: five sigma.
constexpr double kPresentSnr = 5.0;
// Where it does not, and the others pull a spot by so much, no spot is believed.
constexpr double kPulledPx = 0.1;
// Beyond it the light of a body does not reach a fit's window, nor do two spots touch.
constexpr double kReachPx = 40.0;
// A told direction and a predicted one are the same body's.
constexpr double kSameRad = 1e-6;
constexpr double kBodyFluxSigma = 0.3;  // of the logarithm: phase laws and colours
// A star's light and place as the camera sees it: its colour is not known, nor is a companion that no catalogue has.
constexpr double kStarFluxSigma = 0.5, kStarPlacePx = 0.05;

// What a fit found beside other light, where about so much was looked for.
bool is_there(const Centroid& measured, double expected_dn) {
  return measured.snr > kPresentSnr && as_bright(measured.flux_dn, expected_dn);
}

}  // namespace

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

void Vision::name_planets(ImageView<const std::uint16_t> frame, const Observer& observer,
                          std::span<const PlanetPrediction> predictions) {
  list_bodies(predictions);
  for (const std::size_t index : by_light_) part(frame, observer, index);
  see_discs(frame, predictions.size());
  const double area_px = result_.whole ? 0.0 : attention_.area_px();
  for (std::size_t i = 0; i < predictions.size(); ++i) {
    if (bodies_[i].mixed) continue;
    // A spot that a neighbour's light was parted into is the neighbour's.
    const auto bar_others = [&](unsigned char barred) {
      for (std::size_t k = 0; k < predictions.size(); ++k)
        if (k != i && bodies_[k].spot != kNone && !planets_[k].found) is_star_[bodies_[k].spot] = barred;
    };
    bar_others(1);
    planets_[i] = find_planet(predictions[i], result_.attitude, result_.centroids,
                              std::span<const unsigned char>(is_star_.data(), result_.centroids.size()),
                              settings_.planets, area_px);
    bar_others(0);
    if (planets_[i].found && bodies_[i].spot == kNone)
      planets_[i].found = cleared_of_stars(frame, observer, bodies_[i], centroids_[planets_[i].centroid]);
    if (planets_[i].found) planets_[i].found = stayed(planets_[i], observer.epoch);
    if (!planets_[i].found) continue;
    is_star_[planets_[i].centroid] = 1;
    Centroid& spot = centroids_[planets_[i].centroid];
    if (!spot.saturated) continue;
    if (foretold_px(bodies_[i]) > kSurePx) see_as_disc(frame, bodies_[i], spot);
    spot.repeating_sigma_px = std::hypot(spot.repeating_sigma_px, repeating_of_disc(predictions[i], bodies_[i]));
  }
  for (std::size_t i = 0; i < predictions.size(); ++i) {
    const std::size_t other = bodies_[i].leans_on;
    if (other < predictions.size() && !planets_[other].found) planets_[i].found = false;
  }
}

// Where the spot lies among the stars, against the last frame that showed the body.
bool Vision::stayed(const PlanetMatch& match, Epoch epoch) {
  const Centroid& spot = centroids_[match.centroid];
  const AttitudeSolution& attitude = result_.attitude;
  const Result<Vec3> direction_C = unproject(attitude.intrinsics, spot.pixel);
  if (!direction_C) return false;
  const double centroid = std::sqrt(0.5 * spot.whole_covariance_px2().trace());
  const double sigma = std::hypot(std::max(centroid, kSteadyPx) * attitude.intrinsics.plate_scale_rad_px(),
                                  std::sqrt(attitude.covariance_rad2.trace()));
  return memory_.agrees(match.body, attitude.R_CN.transpose() * *direction_C, sigma, epoch, settings_.planets);
}

// A spot that saturates shows the wings, and those of a disc are skew: as a point's it would stand beside a narrow
// gate.
void Vision::see_as_disc(ImageView<const std::uint16_t> frame, const Body& body, Centroid& spot) {
  if (spot.saturated && body.spot == kNone && body.disc.radius_px > 0.0)
    finder_.measure_disc(frame, result_.level, body.disc, spot);
}

void Vision::see_discs(ImageView<const std::uint16_t> frame, std::size_t asked) {
  for (std::size_t b = 0; b < asked; ++b) {
    const Body& body = bodies_[b];
    if (!(body.flux_dn > 0.0) || foretold_px(body) > kSurePx) continue;
    for (std::size_t i = 0; i < result_.centroids.size(); ++i) {
      if (!is_star_[i] && (centroids_[i].pixel.vec() - body.at.vec()).norm() < kAlonePx + 3.0 * foretold_px(body))
        see_as_disc(frame, body, centroids_[i]);
    }
  }
}

// Where it is known from where the Sun shines, what is left is what no law of scattering gets right.
double Vision::repeating_of_disc(const PlanetPrediction& prediction, const Body& body) const {
  const double radius_px = prediction.angular_radius_rad * result_.attitude.intrinsics.fx_px;
  return body.disc.radius_px > 0.0 ? skew_of_known_disc_px(radius_px, psf_sigma_px_, prediction.law_of_light)
                                   : skew_of_disc_px(radius_px, psf_sigma_px_);
}

LitDisc Vision::disc_of(const PlanetPrediction& prediction) const {
  constexpr double kLeastRadiusPx = 0.1;  // its skewness moves the place by a micropixel
  const AttitudeSolution& attitude = result_.attitude;
  const double radius_px = prediction.angular_radius_rad * attitude.intrinsics.fx_px;
  const Vec3 sunward_C = attitude.R_CN * prediction.sunward_N, sight_C = attitude.R_CN * prediction.direction_N;
  Mat23 by_direction;
  if (radius_px < kLeastRadiusPx || sunward_C.isZero() || !project(attitude.intrinsics, sight_C, &by_direction))
    return {};
  const Vec2 sunward_px = by_direction * (sunward_C - sunward_C.dot(sight_C) * sight_C);
  if (!(sunward_px.norm() > 0.0)) return {.radius_px = radius_px};
  return {radius_px, sunward_px.normalized(), angle_between(sunward_C, Vec3(-sight_C))};
}

// The predictions in their order, then bodies that were told beside them and are not predicted themselves.
void Vision::list_bodies(std::span<const PlanetPrediction> predictions) {
  const AttitudeSolution& attitude = result_.attitude;
  bodies_.clear();
  for (const PlanetPrediction& prediction : predictions) {
    bodies_.emplace_back();
    const Result<PredictedPixel> place = predict_pixel(prediction, attitude);
    if (!place) continue;
    bodies_.back().at = place->pixel;
    bodies_.back().covariance_px2 = place->covariance_px2;
    bodies_.back().flux_dn = prediction.expected_flux_dn;
    bodies_.back().disc = disc_of(prediction);
  }
  for (std::size_t i = 0; i < predictions.size(); ++i) {
    const PlanetPrediction& prediction = predictions[i];
    if (!(bodies_[i].flux_dn > 0.0) || !(prediction.companion_flux_dn > 0.0)) continue;
    const Result<Pixel> beside = project(attitude.intrinsics, attitude.R_CN * prediction.companion_direction_N);
    if (!beside || (beside->vec() - bodies_[i].at.vec()).norm() > kReachPx) continue;
    std::size_t other = 0;
    while (other < predictions.size() &&
           (other == i || !(bodies_[other].flux_dn > 0.0) ||
            (predictions[other].direction_N - prediction.companion_direction_N).norm() > kSameRad))
      ++other;
    if (other == predictions.size()) {
      other = bodies_.size();
      bodies_.push_back({.at = *beside,
                         .covariance_px2 = bodies_[i].covariance_px2,
                         .flux_dn = prediction.companion_flux_dn,
                         .asked = false});
    }
    // An error of the spacecraft's place shrinks or turns the way from one to the other by what it turns the sight;
    // some of that way, for the Moon as long as 60 of the Earth's radii, may lie along the sight.
    constexpr double kOrbitRadii = 60.0;
    const double way_px = std::max((beside->vec() - bodies_[i].at.vec()).norm(),
                                   kOrbitRadii * prediction.angular_radius_rad * attitude.intrinsics.fx_px);
    bodies_[i].partner = other;
    bodies_[other].partner = i;
    const double sigma_px = way_px * std::sqrt(0.5 * prediction.direction_covariance.trace());
    for (const std::size_t body : {i, other})
      bodies_[body].offset_sigma_px = std::max(bodies_[body].offset_sigma_px, sigma_px);
  }
  by_light_.clear();
  for (std::size_t i = 0; i < bodies_.size(); ++i)
    if (bodies_[i].flux_dn > 0.0) by_light_.push_back(i);
  std::sort(by_light_.begin(), by_light_.end(),
            [this](std::size_t a, std::size_t b) { return bodies_[a].flux_dn > bodies_[b].flux_dn; });
}

// Bodies are told by each other's measured places, or else by what is foretold; stars by the catalogue, the attitude
// and the frame's own scale of brightness.
Vision::Company Vision::company_of(std::size_t index, const Observer& observer) {
  const Body& body = bodies_[index];
  Company company;
  const auto add_body = [&](std::size_t other) {
    const Body& beside = bodies_[other];
    const bool brighter = beside.flux_dn > body.flux_dn;
    if (other == index || (beside.at.vec() - body.at.vec()).norm() > kReachPx || company.count == kMostBeside) return;
    company.mixed |= brighter && beside.mixed;
    if (beside.mixed || (brighter && beside.spot == kNone)) return;
    if (brighter && (company.brightest == kNone || bodies_[company.brightest].flux_dn < beside.flux_dn))
      company.brightest = other;
    LightBeside& light = company.lights[company.count++];
    light = {.at_px = beside.at.vec(),
             .covariance_px2 = beside.covariance_px2,
             .flux_dn = beside.flux_dn,
             .flux_sigma = kBodyFluxSigma};
    if (beside.spot != kNone) {
      light.at_px = centroids_[beside.spot].pixel.vec();
      light.covariance_px2 = centroids_[beside.spot].whole_covariance_px2();
      light.flux_dn = centroids_[beside.spot].flux_dn;
    }
    if (other == body.partner) {
      light.at_px = beside.at.vec() - body.at.vec();
      light.from_body = true;
      light.covariance_px2 = Mat2::Identity() * body.offset_sigma_px * body.offset_sigma_px;
    }
  };
  if (body.partner != kNone) add_body(body.partner);
  for (const std::size_t other : by_light_)
    if (other != body.partner) add_body(other);
  company.bodies = company.count;
  add_stars(body, observer, company);
  return company;
}

// As many as there is room for of the stars whose light reaches the body's own, those first that give it most.
void Vision::add_stars(const Body& body, const Observer& observer, Company& company) {
  constexpr double kStarReachPx = 12.0;  // a star of V 2 in this camera, by its halo
  constexpr double kOfNoise = 0.3;       // in one pixel: some dozens add up
  constexpr double kOfBody = 0.003;      // what no form of the point-spread function gets right
  const double zero_point = identifier_.zero_point_mag();
  const AttitudeSolution& attitude = result_.attitude;
  const double sigma_px = foretold_px(body);
  if (!std::isfinite(zero_point) || sigma_px > kSurePx || attitude.mirrored) return;
  const Result<Vec3> direction_C = unproject(attitude.intrinsics, body.at);
  if (!direction_C) return;
  constexpr double kAberrationRad = 2e-4;  // 60 km/s
  const double reach_rad = kStarReachPx / attitude.intrinsics.fx_px + kAberrationRad;
  const std::size_t found = neighbours_->cone(attitude.R_CN.transpose() * *direction_C, reach_rad, near_);
  const ApparentPlaces places(*neighbours_, observer);
  const LocalPsf psf = finder_.psf().at(body.at);
  const double s2 = psf.sigma_px() * psf.sigma_px(), h2 = std::pow(psf.value[LocalPsf::halo_width], 2),
               halo = psf.value[LocalPsf::halo_share];
  const auto light_at = [&](double flux, double r) {
    return flux / (2.0 * kPi) * (std::exp(-0.5 * r * r / s2) / s2 + halo * std::exp(-0.5 * r * r / h2) / h2);
  };
  // What a fit will look at: beyond full pixels as far as about a point.
  const double full_px = std::sqrt(2.0 * s2 * std::log(std::max(1.0, light_at(body.flux_dn, 0.0) / saturation_dn_)));
  const int core = static_cast<int>(std::lround(full_px));
  const double reach_px = full_px + (core > 0 ? reach_about_full_px({-core, -core, core, core}, psf) : psf.reach_px());
  struct Ranked {
    double light;
    LightBeside star;
  };
  std::array<Ranked, kMostBeside> ranked{};
  std::size_t count = 0;
  const std::size_t room = kMostBeside - company.count;
  if (room == 0) return;
  for (std::size_t i = 0; i < found; ++i) {
    const FieldStar& entry = neighbours_->stars()[near_[i]];
    PlanetPrediction star;
    star.direction_N = places.of(entry);
    const Result<PredictedPixel> place = predict_pixel(star, attitude);
    if (!place) continue;
    const double flux = std::pow(10.0, 0.4 * (zero_point - entry.v_mag));
    const double apart = (place->pixel.vec() - body.at.vec()).norm();
    const double light = light_at(flux, std::max(0.0, apart - reach_px - sigma_px));
    if (light < kOfNoise * result_.level.noise_dn ||
        light < kOfBody * light_at(body.flux_dn, std::min(apart, reach_px)))
      continue;
    const double away = std::hypot(apart, sigma_px);
    company.pull_px =
        std::max(company.pull_px, flux / (flux + body.flux_dn) * away * std::exp(-away * away / (8.0 * s2)));
    if (count == room && light <= ranked[count - 1].light) continue;
    std::size_t n = count < room ? count++ : room - 1;
    for (; n > 0 && ranked[n - 1].light < light; --n) ranked[n] = ranked[n - 1];
    ranked[n] = {light,
                 {.at_px = place->pixel.vec(),
                  .covariance_px2 = Mat2(place->covariance_px2 + Mat2::Identity() * kStarPlacePx * kStarPlacePx),
                  .flux_dn = flux,
                  .flux_sigma = kStarFluxSigma}};
  }
  for (std::size_t n = 0; n < count; ++n) company.lights[company.count++] = ranked[n].star;
}

// Neither a star's nor another body's.
bool Vision::is_free(std::size_t spot, const Body& body) const {
  for (const Body& other : bodies_)
    if (&other != &body && other.spot == spot) return false;
  return !is_star_[spot];
}

// The first, and so the brightest, free spot about where the body is foretold; `alike`: that may hold its light.
std::size_t Vision::free_spot(const Body& body, double radius_px, bool alike) const {
  for (std::size_t i = 0; i < result_.centroids.size(); ++i) {
    if (!is_free(i, body) || (centroids_[i].pixel.vec() - body.at.vec()).norm() > radius_px) continue;
    if (!alike || centroids_[i].saturated || as_bright(centroids_[i].flux_dn, body.flux_dn)) return i;
  }
  return kNone;
}

// A body in one spot with others, or in their wings, is measured together with them: alone it would be off by more than
// its covariance says, and be refused. The brightest of them first.
void Vision::part(ImageView<const std::uint16_t> frame, const Observer& observer, std::size_t index) {
  Body& body = bodies_[index];
  const Company company = company_of(index, observer);
  body.mixed = company.mixed;
  if (body.mixed) return;
  const double sigma_px = foretold_px(body);
  const bool sure = sigma_px < kSurePx;
  // Alone it has a spot of its own, if that was not cut by the frame's edge, or set apart with another that it ran
  // into.
  if (company.count == 0 && (!sure || free_spot(body, kAlonePx + 3.0 * sigma_px, false) != kNone)) return;
  if (company.bodies > 0 && company.brightest == kNone && part_brightest(frame, body, company)) return;

  const bool by_partner = company.brightest != kNone && company.brightest == body.partner;
  std::array<Pixel, 2> guesses;
  std::size_t count = 0;
  if (sure && !by_partner) guesses[count++] = body.at;
  if (company.brightest != kNone) {
    const Body& bright = bodies_[company.brightest];
    guesses[count++] = pixel_at(centroids_[bright.spot].pixel.vec() + body.at.vec() - bright.at.vec());
  }
  Centroid measured;
  bool good = count > 0 && finder_.measure_beside(frame, result_.level, std::span(guesses).first(count), body.flux_dn,
                                                  body.disc, company.all(), measured);
  if (good && by_partner) {
    // It was foretold from there: a fit that ends elsewhere has gone astray.
    const double foretold_px = std::sqrt(2.0 * body.offset_sigma_px * body.offset_sigma_px +
                                         centroids_[bodies_[body.partner].spot].covariance_px2.trace());
    good = (measured.pixel.vec() - guesses[0].vec()).norm() < std::max(kAstrayPx, 4.0 * foretold_px);
  } else if (good) {
    const Vec2 off = measured.pixel.vec() - body.at.vec();
    const Mat2 covariance = body.covariance_px2 + measured.whole_covariance_px2();
    good = is_there(measured, body.flux_dn) && off.dot(covariance.inverse() * off) < settings_.planets.gate_d2;
  }
  if (good)
    keep(body, measured);
  else
    body.mixed = company.brightest != kNone || company.pull_px > kPulledPx;
  body.leans_on = company.brightest;
}

// The brightest of several bodies: the spot that it must have is of it, or of all, and then lies between them. False
// where there is none.
bool Vision::part_brightest(ImageView<const std::uint16_t> frame, Body& body, const Company& company) {
  const LightBeside& first = company.lights[0];
  const Vec2 offset = first.from_body ? first.at_px : Vec2(first.at_px - body.at.vec());
  const double sigma_px = foretold_px(body);
  const std::size_t chosen = free_spot(body, std::max(kBlendedPx, 0.5 * offset.norm()) + 3.0 * sigma_px, true);
  if (chosen == kNone) return false;
  std::array<Pixel, 5> guesses;
  std::size_t count = 0;
  if (sigma_px < kSurePx) guesses[count++] = body.at;
  for (const double share : {0.0, 0.3, 0.6, 1.0})
    guesses[count++] = pixel_at(centroids_[chosen].pixel.vec() - share * offset);
  Centroid measured = centroids_[chosen];
  body.mixed = !finder_.measure_beside(frame, result_.level, std::span(guesses).first(count), body.flux_dn, body.disc,
                                       company.all(), measured) ||
               !as_bright(measured.flux_dn, body.flux_dn);
  if (body.mixed) return true;
  centroids_[chosen] = measured;
  body.spot = chosen;
  if (!body.asked) is_star_[chosen] = 1;  // another planet
  return true;
}

// A body that was foretold too vaguely to be parted from stars beforehand stands where its spot is. False where they
// pull that and cannot be parted from it.
bool Vision::cleared_of_stars(ImageView<const std::uint16_t> frame, const Observer& observer, const Body& foretold,
                              Centroid& spot) {
  Body body = foretold;
  body.at = spot.pixel;
  body.covariance_px2 = spot.whole_covariance_px2();
  body.flux_dn = spot.flux_dn;
  Company company;
  add_stars(body, observer, company);
  if (company.count == 0) return true;
  Centroid measured = spot;
  if (!finder_.measure_beside(frame, result_.level, {&body.at, 1}, body.flux_dn, body.disc, company.all(), measured) ||
      !is_there(measured, body.flux_dn) || (measured.pixel.vec() - body.at.vec()).norm() > kSurePx)
    return company.pull_px <= kPulledPx;
  spot = measured;
  return true;
}

// A measured body takes its own spot's place, or is a new one; what else is there is the same light once more.
void Vision::keep(Body& body, Centroid measured) {
  std::size_t spot = result_.centroids.size();
  double nearest_px = kOwnSpotPx;
  for (std::size_t i = 0; i < result_.centroids.size(); ++i) {
    const double apart_px = (centroids_[i].pixel.vec() - measured.pixel.vec()).norm();
    if (!is_free(i, body) || apart_px >= nearest_px) continue;
    nearest_px = apart_px;
    spot = i;
  }
  for (std::size_t i = 0; i < result_.centroids.size(); ++i) {
    const double apart_px = (centroids_[i].pixel.vec() - measured.pixel.vec()).norm();
    if (i != spot && is_free(i, body) && apart_px < kSameSpotPx) is_star_[i] = 1;
  }
  if (spot == centroids_.size()) return;
  if (spot == result_.centroids.size()) {
    is_star_[spot] = 0;
    result_.centroids = std::span<const Centroid>(centroids_.data(), spot + 1);
  } else {
    measured.peak_dn = centroids_[spot].peak_dn;
    measured.pixels = centroids_[spot].pixels;
  }
  centroids_[spot] = measured;
  body.spot = spot;
}

}  // namespace astronav::vision
