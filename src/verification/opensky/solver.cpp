// SPDX-License-Identifier: Apache-2.0
#include "verification/opensky/solver.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "foundation/base/clock.h"
#include "verification/opensky/calibrate_fisheye.h"
#include "verification/opensky/rough.h"

namespace astronav::opensky {
namespace {

constexpr std::size_t kJudgedSpots = 120;  // the most certain
constexpr FieldRange kAnyField{4.0 * kDegree, 62.0 * kDegree};
constexpr double kTrust = 1.001;  // of a camera's focal length that is believed
constexpr double kDoubt = 1.03;   // where it is not
constexpr double kAllSkyMag = 7.0;
constexpr std::size_t kLeastStars = 3;    // of which an attitude is told
constexpr double kPlanetRadiusPx = 10.0;  // spots nearer to a planet are not taken for stars

Result<void> check(const SolveRequest& request, int width, int height) {
  if (request.field && !(request.field->min_rad > 0.0 && request.field->min_rad <= request.field->max_rad &&
                         request.field->max_rad < 170.0 * kDegree))
    return fail(ErrorCode::invalid_argument, "a field of view from {0} to {1} degrees; 0 < MIN <= MAX < 170",
                {request.field->min_rad / kDegree, request.field->max_rad / kDegree});
  if (request.camera && (request.camera->width_px != width || request.camera->height_px != height))
    return fail(ErrorCode::invalid_argument, "the picture has {0} x {1} pixels, the camera {2} x {3}",
                {static_cast<double>(width), static_cast<double>(height), static_cast<double>(request.camera->width_px),
                 static_cast<double>(request.camera->height_px)});
  return {};
}

std::vector<SkyPlanet> planets_of(const SolveRequest& request) {
  if (!request.ephemeris || !request.epoch || !request.observer) return {};
  return apparent_planets(*request.ephemeris, *request.epoch, *request.observer, request.refraction);
}

}  // namespace

Pointing center_pointing(const Solution& s) {
  const Intrinsics& camera = s.attitude.intrinsics;
  const Pixel middle{0.5 * (s.width - 1), 0.5 * (s.height - 1)};
  const auto center = unproject(camera, middle), above = unproject(camera, {middle.u, middle.v - 1.0});
  if (!center || !above) return pointing_from_R_CN(s.attitude.R_CN);
  const Vec3 c = s.attitude.R_CN.transpose() * *center, a = s.attitude.R_CN.transpose() * *above;
  const EastNorth axes = east_north(c);
  const RaDec place = radec_from_direction(c);
  double roll = std::atan2(a.dot(axes.east), a.dot(axes.north));
  if (roll < 0.0) roll += 2.0 * kPi;
  return {place.ra_rad, place.dec_rad, roll};
}

Solver::Solver(const StarCatalogue& catalogue, double max_v_mag)
    : catalogue_(catalogue),
      field_(vision::StarField::build(catalogue, max_v_mag, assumed_epoch())),
      blind_(std::make_unique<BlindSearch>(field_)) {}

Result<Solver::Known> Solver::identify_blind(std::span<const vision::Centroid> spots, const SolveRequest& request,
                                             const SeenFrom& from, int width, int height) {
  vision::Observer observer;
  observer.epoch = from.epoch;
  if (from.observer) {
    observer.p_O_N = from.observer->p_m;
    observer.v_O_N = from.observer->v_m_s;
  }
  BlindSettings settings;
  settings.near = request.near;
  settings.match_px = std::max(1.5, 0.002 * width);
  const auto judged = spots.first(std::min(spots.size(), kJudgedSpots));
  Known out;
  Result<BlindSolution> found = fail(ErrorCode::no_match, "no field of view tried");
  if (request.camera) {
    settings.camera = request.camera;
    const double fov = request.camera->field_of_view_horizontal_rad();
    found = blind_->search(judged, width, height, {fov / kTrust, fov * kTrust}, observer, settings);
    out.stars.lens_is_known = found.has_value();
    out.stars.shape_is_known = true;
    if (!found) {
      settings.focal_is_known = false;
      found = blind_->search(judged, width, height, {fov / kDoubt, fov * kDoubt}, observer, settings);
    }
  } else {
    found = blind_->search(judged, width, height, request.field.value_or(kAnyField), observer, settings);
  }
  if (!found) return forward(found);
  for (const vision::MatchedStar& star : found->stars) out.stars.names.push_back({star.catalogue_index, star.centroid});
  const vision::AttitudeSolution& attitude = found->identification.attitude;
  out.stars.R_CN = attitude.R_CN;
  out.stars.camera = attitude.intrinsics;
  out.stars.mirrored = found->mirrored;
  out.stars.extra_sigma_px = found->extra_sigma_px;
  out.stars.chance_probability = attitude.chance_probability;
  out.lists_ms = found->lists_ms;
  return out;
}

Result<Solver::Known> Solver::identify_roughly(std::span<const vision::Centroid> spots, const SolveRequest& request,
                                               const SeenFrom& from) {
  const auto sky = apparent_stars(catalogue_, kAllSkyMag, from.epoch, from.observer, from.refraction);
  const auto look = look_near(spots, *request.camera, sky, planets_of(request), *request.near);
  if (!look) return forward(look);
  Known out;
  for (const StarMatch& m : look->stars)
    out.stars.names.push_back({sky[m.star].index, static_cast<std::uint32_t>(m.spot)});
  out.stars.R_CN = look->R_CN;
  out.stars.camera = *request.camera;
  out.stars.lens_is_known = true;
  out.stars.mirrored = look->mirrored;
  out.stars.chance_probability = look->chance_probability;
  return out;
}

// The first look is by a lens of its own; then the camera's takes over, with narrowing nets.
Result<Solver::Known> Solver::identify_all_sky(std::span<const vision::Centroid> spots, const SolveRequest& request,
                                               const SeenFrom& from) {
  const Intrinsics& camera = *request.camera;
  const auto sky = apparent_stars(catalogue_, kAllSkyMag, from.epoch, from.observer, from.refraction);
  // find_fisheye() speaks of equidistant lenses that put 90 degrees at the same place.
  const auto side = project(camera, Vec3::UnitX());
  const double focal = side ? (side->u - camera.cx_px) / (0.5 * kPi) : camera.fx_px;
  const auto look =
      find_fisheye(spots, sky, camera.width_px, camera.height_px, focal / kDoubt, focal * kDoubt, request.near);
  if (!look) return forward(look);
  Known out;
  out.stars.camera = camera;
  out.stars.lens_is_known = true;
  out.stars.mirrored = look->mirrored;
  out.stars.R_CN = look->R_CN;
  out.stars.chance_probability = look->chance_probability;
  std::vector<vision::Centroid> seen(spots.begin(), spots.end());
  if (look->mirrored) turn_round(seen, camera.width_px);
  const std::vector<SkyPlanet> planets = planets_of(request);
  for (const double net_px : {0.015 * camera.fx_px, 4.0, 2.0, 1.5, 1.5}) {
    std::vector<char> closed(seen.size(), 0);
    for (const SkyPlanet& planet : planets) {
      const auto place = project(camera, out.stars.R_CN * planet.direction_N);
      for (std::size_t s = 0; place && s < seen.size(); ++s)
        closed[s] |= (seen[s].pixel.vec() - place->vec()).norm() < kPlanetRadiusPx;
    }
    out.stars.names.clear();
    const MatchSettings settings{.radius_px = net_px, .blend_px = std::max(3.0, net_px)};
    for (const StarMatch& m : match_stars(sky, seen, closed, camera, out.stars.R_CN, settings))
      out.stars.names.push_back({sky[m.star].index, static_cast<std::uint32_t>(m.spot)});
    const auto fitted = fit_named_stars(catalogue_, out.stars, seen, from);
    if (!fitted) return fail(ErrorCode::no_match, "the stars that are recognised are not where this camera puts them");
    out.stars.R_CN = fitted->attitude.R_CN;
  }
  return out;
}

Result<Solver::Known> Solver::identify(std::vector<vision::Centroid>& spots, const SolveRequest& request,
                                       const SeenFrom& from, int width, int height) {
  const bool all_sky = request.camera && request.camera->model == ProjectionModel::fisheye;
  auto known = all_sky ? identify_all_sky(spots, request, from) : identify_blind(spots, request, from, width, height);
  if (!known && known.error().code == ErrorCode::no_match && !all_sky && request.camera && request.near) {
    auto roughly = identify_roughly(spots, request, from);
    if (roughly) known = std::move(roughly);
  }
  if (known && known->stars.mirrored) turn_round(spots, width);
  return known;
}

Result<Solution> Solver::solve(const Picture& picture, const SolveRequest& request) {
  const int width = picture.pixels.width(), height = picture.pixels.height();
  if (const auto checked = check(request, width, height); !checked) return forward(checked);
  Solution solution;
  solution.width = width;
  solution.height = height;
  solution.epoch = request.epoch.value_or(assumed_epoch());
  solution.epoch_assumed = !request.epoch.has_value();
  solution.aberration_corrected = request.observer.has_value();
  solution.refraction_corrected = request.refraction.has_value();
  const SeenFrom from{solution.epoch, request.observer, request.refraction};

  const double begin = now_ms();
  const bool all_sky = request.camera && request.camera->model == ProjectionModel::fisheye;
  std::vector<vision::Centroid> spots = find_spots(picture, all_sky ? SpotSettings::all_sky() : SpotSettings{}).spots;
  solution.detected = spots.size();
  const double detected = now_ms();
  const auto known = identify(spots, request, from, width, height);
  if (!known) return forward(known);
  solution.mirrored = known->stars.mirrored;
  const double identified = now_ms();
  const auto fitted = fit_named_stars(catalogue_, known->stars, spots, from);
  if (!fitted) return fail(ErrorCode::no_match, "stars are recognised, but fix no attitude");
  if (fitted->stars.size() < kLeastStars)
    return fail(ErrorCode::no_match, "{0} stars are left when the attitude is fitted: too few to be sure",
                {static_cast<double>(fitted->stars.size())});
  if (request.refraction && fitted->attitude.R_CN.row(2).dot(request.refraction->zenith_N()) < 0.0)
    return fail(ErrorCode::no_match,
                "the stars are recognised, but stand below the observer's horizon then: are --epoch and --observer "
                "right?");
  solution.attitude = fitted->attitude;
  solution.center_covariance_rad2 = fitted->center_covariance_rad2;
  const double fixed = now_ms();

  std::vector<unsigned char> taken(spots.size(), 0);
  for (const vision::MatchedStar& star : fitted->stars) {
    taken[star.centroid] = 1;
    solution.stars.push_back({star, spots[star.centroid], catalogue_.star(star.catalogue_index).v_mag});
  }
  solution.planets = find_planets(planets_of(request), solution.attitude, spots, solution.stars, taken);
  for (std::size_t i = 0; i < spots.size(); ++i) {
    if (!taken[i]) solution.unknown.push_back(spots[i]);
  }
  if (solution.mirrored) {
    // Pixels are told as in the picture.
    const auto turn = [&](Pixel& p) { p.u = width - 1 - p.u; };
    for (SolvedStar& star : solution.stars) {
      turn(star.spot.pixel);
      star.match.residual_px.x() *= -1.0;
    }
    for (SolvedPlanet& planet : solution.planets) {
      turn(planet.spot.pixel);
      turn(planet.predicted);
    }
    for (vision::Centroid& spot : solution.unknown) turn(spot.pixel);
  }
  const double done = now_ms();
  solution.time_ms = {detected - begin,   known->lists_ms, identified - detected - known->lists_ms,
                      fixed - identified, done - fixed,    done - begin};
  return solution;
}

}  // namespace astronav::opensky
