// SPDX-License-Identifier: Apache-2.0
#include "verification/opensky/solver.h"

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>

#include "foundation/math/statistics.h"
#include "models/aberration/aberration.h"
#include "models/photometry/photometry.h"
#include "onboard/vision/planets.h"

namespace astronav::opensky {
namespace {

constexpr std::size_t kJudgedSpots = 120;  // the most certain
constexpr double kLargestRms = 1.5;        // px
constexpr double kWideField = 18.0 * kDegree;

double now_ms() {
  return std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

Epoch j2025() {
  return Epoch::tdb_seconds(25.0 * 365.25 * 86400.0);
}

// Most cameras first.
constexpr std::array<std::array<double, 2>, 8> kLadder{
    {{9.0, 13.0}, {13.0, 19.0}, {6.2, 9.0}, {19.0, 27.0}, {4.0, 6.2}, {27.0, 38.0}, {38.0, 50.0}, {50.0, 62.0}}};

}  // namespace

Solver::Solver(const StarCatalogue& catalogue, double max_v_mag)
    : catalogue_(catalogue),
      max_v_mag_(max_v_mag),
      field_(vision::StarField::build(catalogue, max_v_mag, j2025())),
      blind_(std::make_unique<BlindSearch>(field_)) {}

Result<BlindSolution> Solver::identify(std::span<const vision::Centroid> spots, int width, int height,
                                       const SolveRequest& request, const vision::Observer& observer) {
  BlindSettings settings;
  settings.near = request.near;
  settings.match_px = std::max(1.5, 0.002 * width);
  const std::span<const vision::Centroid> judged = spots.first(std::min(spots.size(), kJudgedSpots));
  // First as if the lens drew straight lines; then, for wide fields, as if it did not.
  const auto search = [&](double min_rad, double max_rad) {
    auto found = blind_->search(judged, width, height, min_rad, max_rad, observer, settings);
    if (found || max_rad < kWideField) return found;
    BlindSettings bent = settings;
    bent.tolerance = 0.015;
    bent.confirm_hits = 6;
    bent.judged_spots = 40;
    return blind_->search(judged, width, height, min_rad, max_rad, observer, bent);
  };
  if (request.camera) {
    const double fov = request.camera->field_of_view_horizontal_rad();
    return search(0.97 * fov, 1.03 * fov);
  }
  if (request.field) return search(request.field->min_rad, request.field->max_rad);
  Result<BlindSolution> found = fail(ErrorCode::no_match, "no field of view tried");
  for (const auto& rung : kLadder) {
    settings.max_chance = 1e-8 / static_cast<double>(kLadder.size());
    found = search(rung[0] * kDegree, rung[1] * kDegree);
    if (found) break;
  }
  return found;
}

void Solver::find_planets(const Picture& picture, const SolveRequest& request, std::span<const vision::Centroid> spots,
                          const BlindSolution& known, Solution& solution) {
  std::vector<unsigned char> taken(spots.size(), 0);
  for (const vision::MatchedStar& star : known.stars) taken[star.centroid] = 1;
  if (!request.ephemeris || !request.epoch || !request.observer) return;
  // The picture's magnitude scale, from its stars.
  std::vector<double> zero_points;
  for (const SolvedStar& star : solution.stars)
    if (!star.spot.saturated) zero_points.push_back(star.v_mag + 2.5 * std::log10(star.spot.flux_dn));
  const double zero_point = zero_points.empty() ? 0.0 : median(zero_points);
  for (const BodyId body : {body::mercury, body::venus, body::earth, body::mars, body::jupiter, body::saturn,
                            body::uranus, body::neptune}) {
    const auto seen = light_time(*request.ephemeris, body, *request.observer, *request.epoch);
    if (!seen || seen->relative.p_m.norm() < 1e8) continue;
    vision::PlanetPrediction prediction;
    prediction.body = body;
    prediction.direction_N = aberrate(seen->relative.p_m.normalized(), request.observer->v_m_s);
    // Moons, phase and the distortion that the stars leave over.
    const double sigma = std::hypot(3.0 * kArcsecond, 0.7 / solution.attitude.intrinsics.fx_px);
    prediction.direction_covariance = Mat3::Identity() * sigma * sigma;
    const auto from_sun =
        request.ephemeris->state(body, body::sun, *request.epoch - Duration::seconds(seen->light_time_s));
    if (from_sun) {
      const auto magnitude = planet_v_magnitude(body, {from_sun->p_m, seen->relative.p_m, *request.epoch});
      if (magnitude && std::isfinite(*magnitude)) {
        prediction.v_mag = *magnitude;
        if (!zero_points.empty()) prediction.expected_flux_dn = std::pow(10.0, 0.4 * (zero_point - *magnitude));
      }
    }
    vision::PlanetSettings settings;
    settings.brightness_sigma_mag = 1.0;
    settings.brightness_gate_mag = 3.0;
    const vision::PlanetMatch match = vision::find_planet(prediction, solution.attitude, spots, taken, settings);
    if (!match.found) continue;
    taken[match.centroid] = 1;
    SolvedPlanet planet;
    planet.body = body;
    planet.spot = spots[match.centroid];
    planet.predicted = match.predicted;
    planet.mahalanobis = match.mahalanobis;
    planet.v_mag_predicted = prediction.v_mag;
    planet.v_mag_measured = zero_point - 2.5 * std::log10(planet.spot.flux_dn);
    solution.planets.push_back(planet);
  }
  (void)picture;
}

Result<Solution> Solver::solve(const Picture& picture, const SolveRequest& request) {
  const int width = picture.pixels.width(), height = picture.pixels.height();
  if (request.field && !(request.field->min_rad > 0.0 && request.field->min_rad <= request.field->max_rad &&
                         request.field->max_rad < 170.0 * kDegree))
    return fail(ErrorCode::invalid_argument, "a field of view from {0} to {1} degrees; 0 < MIN <= MAX < 170",
                {request.field->min_rad / kDegree, request.field->max_rad / kDegree});
  if (request.camera && request.camera->model != ProjectionModel::pinhole)
    return fail(ErrorCode::unsupported,
                "pictures of a fisheye are not solved yet; `calibrate camera --fisheye` finds where they look");
  if (request.camera && (request.camera->width_px != width || request.camera->height_px != height))
    return fail(ErrorCode::invalid_argument, "the picture has {0} x {1} pixels, the camera {2} x {3}",
                {static_cast<double>(width), static_cast<double>(height), static_cast<double>(request.camera->width_px),
                 static_cast<double>(request.camera->height_px)});
  Solution solution;
  solution.width = width;
  solution.height = height;
  const double begin = now_ms();
  Spots found = find_spots(picture);
  solution.detected = found.spots.size();
  const double detected = now_ms();

  vision::Observer observer;
  observer.epoch = request.epoch.value_or(j2025());
  if (request.observer) {
    observer.p_O_N = request.observer->p_m;
    observer.v_O_N = request.observer->v_m_s;
  }
  solution.epoch = observer.epoch;
  solution.epoch_assumed = !request.epoch.has_value();
  solution.aberration_corrected = request.observer.has_value();

  std::vector<vision::Centroid> spots = found.spots;
  Result<BlindSolution> known = identify(spots, width, height, request, observer);
  if (!known && known.error().code == ErrorCode::no_match) {
    for (vision::Centroid& spot : spots) spot.pixel.u = width - 1 - spot.pixel.u;
    const Result<BlindSolution> other = identify(spots, width, height, request, observer);
    if (other) {
      known = other;
      solution.mirrored = true;
    }
  }
  const double identified = now_ms();
  if (!known) return forward(known);
  // The model explains the lens, or the roll is not worth telling.
  if (known->identification.attitude.residual_rms_px > kLargestRms)
    return fail(ErrorCode::no_match,
                "stars are recognised, but the lens distorts them by {0} px rms more than k1, p1 and p2 explain",
                {known->identification.attitude.residual_rms_px});
  solution.attitude = known->identification.attitude;
  solution.attitude.mirrored = solution.mirrored;
  const auto as_in_picture = [&](Pixel p) {
    if (solution.mirrored) p.u = width - 1 - p.u;
    return p;
  };
  std::vector<char> named(spots.size(), 0);
  for (const vision::MatchedStar& match : known->stars) {
    SolvedStar star{match, spots[match.centroid], catalogue_.star(match.catalogue_index).v_mag};
    star.spot.pixel = as_in_picture(star.spot.pixel);
    solution.stars.push_back(star);
    named[match.centroid] = 1;
  }
  find_planets(picture, request, spots, *known, solution);
  for (SolvedPlanet& planet : solution.planets) {
    for (std::size_t i = 0; i < spots.size(); ++i)
      if (spots[i].pixel.u == planet.spot.pixel.u && spots[i].pixel.v == planet.spot.pixel.v) named[i] = 1;
    planet.spot.pixel = as_in_picture(planet.spot.pixel);
    planet.predicted = as_in_picture(planet.predicted);
  }
  for (std::size_t i = 0; i < spots.size(); ++i) {
    if (named[i]) continue;
    solution.unknown.push_back(spots[i]);
    solution.unknown.back().pixel = as_in_picture(spots[i].pixel);
  }
  const double done = now_ms();
  solution.time_ms = {detected - begin, identified - detected - known->refine_ms, known->refine_ms, done - identified,
                      done - begin};
  return solution;
}

}  // namespace astronav::opensky
