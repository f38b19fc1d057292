// SPDX-License-Identifier: Apache-2.0
#include "verification/opensky/solver_fit.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "foundation/math/rotation.h"
#include "foundation/math/statistics.h"
#include "verification/opensky/calibrate_adjust.h"
#include "verification/opensky/calibrate_stars.h"

namespace astronav::opensky {
namespace {

constexpr double kGoodRms = 0.5;  // px an axis: more than that is the lens
constexpr std::size_t kStarsForLens = 15;
constexpr std::array<LensFreedom, 7> kLenses{{{.radial = 1},
                                              {.radial = 1, .aspect = true},
                                              {.centre = true, .radial = 1},
                                              {.radial = 1, .tangential = true},
                                              {.centre = true, .radial = 2},
                                              {.centre = true, .radial = 1, .aspect = true},
                                              {.centre = true, .radial = 1, .tangential = true}}};
// Where they leave little.
constexpr std::array<LensFreedom, 8> kStraightLenses{
    {{},
     {.radial = 1},
     {.radial = 1, .aspect = true},
     {.radial = 1, .tangential = true},
     {.centre = true, .radial = 1},
     {.centre = true, .radial = 2},
     {.centre = true, .radial = 2, .tangential = true},
     {.centre = true, .radial = 2, .tangential = true, .aspect = true}}};
constexpr int kFolds = 5;
constexpr double kGate = 4.0;                // typical scatters an axis
constexpr double kMedianOfRayleigh = 1.177;  // median distance over the scatter of an axis
constexpr int kTurns = 3;

// What is held stays at what is usual.
Intrinsics start_of(Intrinsics camera, const LensFreedom& lens) {
  if (!lens.centre) {
    camera.cx_px = 0.5 * (camera.width_px - 1);
    camera.cy_px = 0.5 * (camera.height_px - 1);
  }
  if (!lens.aspect) camera.fy_px = camera.fx_px;
  if (lens.radial < 1) camera.distortion.k1 = 0.0;
  if (lens.radial < 2) camera.distortion.k2 = 0.0;
  if (!lens.tangential) camera.distortion.p1 = camera.distortion.p2 = 0.0;
  return camera;
}

Result<vision::AttitudeFit> fit_attitude_and_lens(std::span<vision::StarSight> sights, const NamedStars& named,
                                                  vision::AttitudeOptions options) {
  if (!named.lens_is_known) {
    options.freedom.focal_length = sights.size() >= 4;
    options.freedom.k1 = sights.size() >= 10;
    options.freedom.tangential = sights.size() >= 20;
  }
  return vision::fit_attitude(sights, named.R_CN, named.camera, options);
}

Result<FinalFit> fit_simply(const StarCatalogue& catalogue, const NamedStars& named,
                            std::span<const vision::Centroid> spots, const SeenFrom& from) {
  std::vector<vision::StarSight> sights;
  std::vector<NamedStars::Name> names = named.names;
  for (const NamedStars::Name& name : names) {
    vision::StarSight& sight = sights.emplace_back();
    sight.pixel = spots[name.spot].pixel;
    sight.covariance_px2 = spots[name.spot].covariance_px2;
    sight.direction_N =
        apparent_direction(catalogue.star(name.catalogue_index), from.epoch, from.observer, from.refraction);
  }
  vision::AttitudeOptions options;
  options.extra_sigma_px = named.extra_sigma_px;
  options.gate_sigma = 6.0;
  auto fitted = fit_attitude_and_lens(sights, named, options);
  // Few wrong names among few stars bend the lens to themselves: the gate closes to what most stars say.
  for (int pass = 0; fitted && pass < 3 && sights.size() > 6; ++pass) {
    std::vector<double> off;
    for (const vision::StarSight& sight : sights) off.push_back(sight.residual_px.norm());
    const double typical = median(off) / kMedianOfRayleigh;
    const double gate_px = kGate * std::hypot(typical, 0.1);
    std::vector<vision::StarSight> kept;
    std::vector<NamedStars::Name> kept_names;
    for (std::size_t i = 0; i < sights.size(); ++i) {
      if (off[i] > gate_px) continue;
      kept.push_back(sights[i]);
      kept_names.push_back(names[i]);
    }
    if (kept.size() == sights.size() || kept.size() < 5) break;
    sights = std::move(kept);
    names = std::move(kept_names);
    fitted = fit_attitude_and_lens(sights, named, options);
  }
  if (!fitted) return forward(fitted);
  FinalFit out;
  out.attitude.R_CN = fitted->R_CN;
  out.attitude.covariance_rad2 = fitted->covariance_rad2;
  out.attitude.intrinsics = fitted->camera;
  out.attitude.residual_rms_px = fitted->residual_rms_px;
  for (std::size_t i = 0; i < sights.size(); ++i) {
    if (!sights[i].used) continue;
    const NamedStars::Name& name = names[i];
    out.stars.push_back({.catalogue_index = name.catalogue_index,
                         .id = catalogue.star(name.catalogue_index).id,
                         .centroid = name.spot,
                         .residual_px = sights[i].residual_px});
  }
  return out;
}

struct Observed {
  std::vector<StarObservation> observations;
  std::vector<NamedStars::Name> names;
  double faintest = 0.0;  // V
};
Observed observe(const StarCatalogue& catalogue, const FinalFit& first, std::span<const vision::Centroid> spots,
                 const SeenFrom& from) {
  Observed out;
  for (const vision::MatchedStar& m : first.stars) {
    const Star star = catalogue.star(m.catalogue_index);
    out.faintest = std::max(out.faintest, static_cast<double>(star.v_mag));
    const vision::Centroid& spot = spots[m.centroid];
    out.observations.push_back(
        {0, spot.pixel, spot.covariance_px2, apparent_direction(star, from.epoch, from.observer, from.refraction)});
    out.names.push_back({m.catalogue_index, m.centroid});
  }
  return out;
}

// Errors of attitude and camera move the direction d of the picture's middle by theta x d + s, where s is what the
// camera's error moves: J_d s + J_i dp = 0, s at right angles to d. Told as the turn theta + d x s.
Mat3 center_covariance(const Intrinsics& camera, const PlateCovariance& plate) {
  const auto middle = unproject(camera, {0.5 * (camera.width_px - 1), 0.5 * (camera.height_px - 1)});
  Mat23 by_direction;
  IntrinsicsJacobian by_intrinsics;
  if (!middle || !project(camera, *middle, &by_direction, &by_intrinsics)) return plate.topLeftCorner<3, 3>();
  Mat3 axes;  // right, down, into the picture
  axes.row(2) = middle->transpose();
  axes.row(0) = (Vec3::UnitX() - *middle * middle->x()).normalized().transpose();
  axes.row(1) = axes.row(2).cross(axes.row(0));
  const Eigen::Matrix<double, 3, 2> across = axes.topRows<2>().transpose();
  Eigen::Matrix<double, 3, 12> turn;
  turn.leftCols<3>().setIdentity();
  turn.rightCols<9>() = -cross_matrix(*middle) * across * Mat2(by_direction * across).inverse() * by_intrinsics;
  turn = axes * turn;
  return turn * plate * turn.transpose();
}

FinalFit told(const StarCatalogue& catalogue, const Adjustment& fitted, std::span<const NamedStars::Name> names) {
  FinalFit out;
  out.attitude.R_CN = fitted.R_CN[0];
  out.attitude.intrinsics = fitted.camera;
  out.attitude.residual_rms_px = fitted.rms_px / std::sqrt(2.0);
  for (std::size_t i = 0; i < fitted.used.size(); ++i) {
    if (!fitted.used[i]) continue;
    out.stars.push_back({.catalogue_index = names[i].catalogue_index,
                         .id = catalogue.star(names[i].catalogue_index).id,
                         .centroid = names[i].spot,
                         .residual_px = fitted.residuals_px[i]});
  }
  out.attitude.covariance_rad2 = fitted.attitude_covariance_rad2[0];
  out.center_covariance_rad2 = center_covariance(fitted.camera, fitted.plate_covariance);
  return out;
}

// In turns: the lens that foretells held-out stars best, and the stars that it makes sure.
Result<FinalFit> fit_lens(const StarCatalogue& catalogue, const FinalFit& first,
                          std::span<const vision::Centroid> spots, const SeenFrom& from) {
  auto [observations, names, faintest] = observe(catalogue, first, spots, from);
  const std::vector<SkyStar> sky = apparent_stars(catalogue, faintest, from.epoch, from.observer, from.refraction);
  Mat3 R_CN = first.attitude.R_CN;
  Intrinsics camera = first.attitude.intrinsics;
  Result<Adjustment> best = fail(ErrorCode::not_converged, "no lens fits the stars");
  double net_px = std::max(3.0, 0.004 * camera.width_px);
  for (int turn = 0; turn < kTurns; ++turn) {
    const auto rich = adjust(observations, {&R_CN, 1}, camera, kLenses.back());
    if (!rich) break;
    double least = 1e300;
    std::optional<LensFreedom> chosen;
    for (const LensFreedom& lens : kLenses) {
      const auto tried = cross_validate(observations, {&R_CN, 1}, start_of(camera, lens), lens, rich->scatter, kFolds);
      if (!tried || tried->mean_surprise >= least) continue;
      least = tried->mean_surprise;
      chosen = lens;
    }
    if (!chosen) break;
    auto fitted = adjust(observations, {&R_CN, 1}, start_of(camera, *chosen), *chosen);
    if (!fitted) break;
    R_CN = fitted->R_CN[0];
    camera = fitted->camera;
    net_px = std::clamp(3.5 * fitted->rms_px, 1.0, net_px);
    best = std::move(fitted);
    if (turn + 1 == kTurns) break;
    std::vector<StarObservation> more;
    std::vector<NamedStars::Name> more_names;
    for (const StarMatch& m : match_stars(sky, spots, {}, camera, R_CN, {.radius_px = net_px, .blend_px = net_px})) {
      const vision::Centroid& spot = spots[m.spot];
      more.push_back({0, spot.pixel, spot.covariance_px2, sky[m.star].direction_N});
      more_names.push_back({sky[m.star].index, static_cast<std::uint32_t>(m.spot)});
    }
    if (more.size() < kStarsForLens) break;
    observations = std::move(more);
    names = std::move(more_names);
  }
  if (!best) return forward(best);
  return told(catalogue, *best, names);
}

// Of lenses that leave little the one with the least Bayesian information criterion (Schwarz 1978), all judged by the
// scatter that the richest leaves.
LensFreedom lens_by_bic(std::span<const StarObservation> stars, const FinalFit& first) {
  const auto fit = [&](const LensFreedom& lens, const AdjustOptions& options) {
    return adjust(stars, {&first.attitude.R_CN, 1}, start_of(first.attitude.intrinsics, lens), lens, options);
  };
  const auto rich = fit(kStraightLenses.back(), {.gate_sigma = 6.0, .scatter = {}, .passes = 2});
  if (!rich) return kStraightLenses.front();
  LensFreedom best;
  double least = 1e300;
  for (const LensFreedom& lens : kStraightLenses) {
    const auto fitted = fit(lens, {.gate_sigma = 1e3, .scatter = rich->scatter, .passes = 1});
    if (!fitted) continue;
    double sum = lens.count() * std::log(2.0 * static_cast<double>(stars.size()));
    for (std::size_t i = 0; i < stars.size(); ++i) {
      const Vec2& off = fitted->residuals_px[i];
      if (rich->used[i]) sum += off.dot(rich->scatter.covariance(stars[i].covariance_px2).inverse() * off);
    }
    if (sum >= least) continue;
    least = sum;
    best = lens;
  }
  return best;
}

// The last word of the simple fit: weights and covariance from how far the stars lie off.
Result<FinalFit> weigh(const StarCatalogue& catalogue, const NamedStars& named, const FinalFit& first,
                       std::span<const vision::Centroid> spots, const SeenFrom& from) {
  const Observed seen = observe(catalogue, first, spots, from);
  const std::size_t n = seen.observations.size();
  LensFreedom lens{.focal = false};
  if (!named.lens_is_known) {
    lens.focal = n >= 4;
    lens.radial = n >= 10 ? 1 : 0;
    lens.tangential = n >= 20;
  }
  Intrinsics start = first.attitude.intrinsics;
  if (!named.lens_is_known && !named.shape_is_known && n >= kStarsForLens) {
    lens = lens_by_bic(seen.observations, first);
    start = start_of(start, lens);
  }
  const int freedom = 2 * static_cast<int>(n) - 3 - lens.count();
  AdjustOptions options;
  options.gate_sigma = 6.0;
  options.passes = 2;
  auto fitted = adjust(seen.observations, {&first.attitude.R_CN, 1}, start, lens, options);
  if (fitted && freedom < kFreedomThatTells) {
    const double found_px = fitted->scatter.extra_sigma_px;
    options.scatter = Scatter{.scale = 1.0, .extra_sigma_px = std::max(named.extra_sigma_px, found_px)};
    fitted = adjust(seen.observations, {&first.attitude.R_CN, 1}, start, lens, options);
  }
  if (!fitted) return forward(fitted);
  FinalFit out = told(catalogue, *fitted, seen.names);
  if (!options.scatter) {
    // A scatter that is itself found from so many residuals: Student's, not Gauss's.
    const double larger = freedom / (freedom - 2.0);
    out.attitude.covariance_rad2 *= larger;
    out.center_covariance_rad2 *= larger;
  }
  return out;
}

}  // namespace

Result<FinalFit> fit_named_stars(const StarCatalogue& catalogue, const NamedStars& named,
                                 std::span<const vision::Centroid> spots, const SeenFrom& from) {
  auto out = fit_simply(catalogue, named, spots, from);
  if (!out) return out;
  const bool bent = !named.lens_is_known && out->attitude.residual_rms_px > kGoodRms;
  Result<FinalFit> better = fail(ErrorCode::not_converged, "the stars are too few for a lens");
  if (bent && out->stars.size() >= kStarsForLens) better = fit_lens(catalogue, *out, spots, from);
  if (!better) better = weigh(catalogue, named, *out, spots, from);
  if (!better) return better;
  out = std::move(better);
  out->attitude.mirrored = named.mirrored;
  out->attitude.chance_probability = named.chance_probability;
  out->attitude.matched = static_cast<int>(out->stars.size());
  return out;
}

}  // namespace astronav::opensky
