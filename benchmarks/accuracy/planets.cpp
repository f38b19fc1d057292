// SPDX-License-Identifier: Apache-2.0
// Planets in rendered frames, predicted from a place in space that is wrong: how often the right spot is named, how
// often a wrong one, and how far the planet's pixel is from the truth (the figure 4 of the EXTREMA image-processing
// paper). One JSON object a line. Options: [frames] [prior 3 sigma, km] [attitude] [cases]: with a prior attitude, off
// by 200 arcsec an axis (1 sigma); with what stood about each body that was not found or found wrongly.
#include <map>

#include <fmt/format.h>

#include "benchmarks/accuracy/arguments.h"
#include "benchmarks/accuracy/rendered_sky.h"
#include "foundation/math/statistics.h"
#include "models/photometry/photometry.h"

namespace astronav::accuracy {
namespace {

constexpr BodyId kAsteroid{2000004};  // an invented one: V 6.5 at a random place in the field
constexpr double kSunExclusion = 35.0 * kDegree;
constexpr double kLargestRadiusPx = 2.0;
constexpr double kRightPx = 1.0;
constexpr double kStarBlendPx = 5.0;
constexpr double kBrightStarBlendPx = 10.0;   // brighter than the body
constexpr double kStarsOnBoard = 9.0;         // V; 4.6 MB, and the frames show stars to V 10
constexpr double kBrightnessErrorMag = 0.15;  // of what onboard expects

struct Tally {
  int shown = 0, right = 0, wrong = 0, not_found = 0, in_company = 0;
  // With a star; not in the others. The Earth and the Moon count as shown wherever they stand.
  int blended = 0, blended_right = 0, blended_wrong = 0;
  std::vector<double> error_px;  // both axes
  double chi2 = 0.0, blended_chi2 = 0.0;
};

struct Visitor {
  RenderedSky world;
  Onboard onboard;
  vision::Vision eyes;
  RandomStream random{StreamId{.seed = 6, .purpose = "planets"}};
  RandomStream priors{StreamId{.seed = 6, .purpose = "prior attitudes"}};  // of their own: the same frames without them
  bool with_attitude = false, with_cases = false;

  Visitor()
      : onboard(world.catalogue, world.believed.intrinsics, kStarsOnBoard, Epoch::tdb_seconds(27.0 * 365.25 * 86400.0)),
        eyes(one_by_one(), world.believed.intrinsics, vision::SensorModel::from(world.believed), onboard.field,
             onboard.index) {}

  // The frames are of different years: where a body was in the last one is of no use.
  static vision::VisionSettings one_by_one() {
    vision::VisionSettings settings;
    settings.planets.memory_s = 0.0;
    return settings;
  }
  Vec3 anywhere() { return Vec3(random.normal(), random.normal(), random.normal()); }

  // Between 0.6 and 2 au from the Sun, near the ecliptic, at the speed of an ellipse.
  State spacecraft() {
    const double r = random.uniform(0.6, 2.0) * kAstronomicalUnit, angle = random.uniform(0.0, 2.0 * kPi);
    const double tilt = 23.44 * kDegree, speed = 29.78e3 * std::sqrt(kAstronomicalUnit / r);
    Mat3 equator;
    equator << 1, 0, 0, 0, std::cos(tilt), -std::sin(tilt), 0, std::sin(tilt), std::cos(tilt);
    State s;
    s.p_m = equator * Vec3(r * std::cos(angle), r * std::sin(angle), random.normal(0.0, 0.03) * r);
    s.v_m_s = speed * (equator * Vec3(-std::sin(angle), std::cos(angle), random.normal(0.0, 0.03))) + 1e3 * anywhere();
    return s;
  }

  std::vector<sky::SkySource> bodies(Epoch epoch, const State& from, const Vec3& axis, double radius) {
    sky::SkySettings settings;
    settings.max_v_mag = -30.0;
    std::vector<sky::SkySource> seen = world.sky.look(epoch, from, axis, radius, world.band, settings).value();
    std::erase_if(seen, [](const sky::SkySource& s) { return s.kind != sky::SourceKind::planet; });
    return seen;
  }

  // One frame with at least one body that can be measured. False where there is none to be seen from here.
  bool visit(double prior_3sigma_km, std::map<std::int64_t, Tally>& tallies) {
    const Epoch epoch = Epoch::tdb_seconds(random.uniform(25.0, 35.0) * 365.25 * 86400.0);
    const State truth = spacecraft();
    const Vec3 sunward = (-truth.p_m).normalized();
    const std::vector<sky::SkySource> all = bodies(epoch, truth, -sunward, kPi - kSunExclusion);
    const auto worth = [&](const sky::SkySource& s) {
      return s.v_mag < 6.5 && s.angular_radius_rad * world.believed.intrinsics.fx_px < kLargestRadiusPx &&
             angle_between(s.direction_N, sunward) > kSunExclusion;
    };
    std::vector<sky::SkySource> targets;
    for (const sky::SkySource& s : all)
      if (worth(s)) targets.push_back(s);
    if (targets.empty()) return false;
    const sky::SkySource& target =
        targets[static_cast<std::size_t>(random.uniform() * static_cast<double>(targets.size()))];
    // The target somewhere in the frame, 40 px or more from its edges.
    const Pixel place{random.uniform(40.0, 983.0), random.uniform(40.0, 983.0)};
    const Vec3 in_camera = *unproject(world.truth.intrinsics, place);
    const Mat3 spin = rotation_exp(in_camera * random.uniform(0.0, 2.0 * kPi));
    const Mat3 R_CN = spin * Eigen::Quaterniond::FromTwoVectors(target.direction_N, in_camera).toRotationMatrix();
    sky::SkySource asteroid = target;
    asteroid.kind = sky::SourceKind::small_body;
    asteroid.id = kAsteroid.value;
    asteroid.v_mag = 6.5;
    asteroid.flux = world.band.flux(6.5, 0.72);
    asteroid.angular_radius_rad = 0.0;
    asteroid.direction_N = R_CN.transpose() * *unproject(world.truth.intrinsics,
                                                         {random.uniform(40.0, 983.0), random.uniform(40.0, 983.0)});
    world.extra = {asteroid};
    world.shoot(epoch, truth, R_CN, world.believed.exposure_s, random);

    // What the navigation believes, and what it predicts.
    const double sigma_m = prior_3sigma_km * 1e3 / 3.0;
    State believed = truth;
    believed.p_m += sigma_m * anywhere();
    believed.v_m_s += 10.0 * anywhere();
    std::vector<sky::SkySource> expected =
        bodies(epoch, believed, R_CN.row(2).transpose(), world.believed.intrinsics.half_diagonal_rad());
    std::vector<vision::PlanetPrediction> predictions;
    for (const sky::SkySource& s : expected) {
      if (s.v_mag > 6.5) continue;
      predictions.push_back(
          prediction(s, (place_of(BodyId{static_cast<int>(s.id)}, epoch) - believed.p_m).norm(), sigma_m));
      for (const sky::SkySource& other : expected) {
        if (!is_earth_and_moon(s.id, other.id)) continue;
        predictions.back().companion_direction_N = other.direction_N;
        predictions.back().companion_flux_dn = predicted_flux(other);
      }
    }
    const double two_au = 2.0 * kAstronomicalUnit;
    predictions.push_back(prediction(asteroid, two_au, 0.0));
    predictions.back().direction_N = (asteroid.direction_N + sigma_m / two_au * anywhere()).normalized();
    predictions.back().direction_covariance = across(predictions.back().direction_N, sigma_m / two_au);
    const vision::Observer observer{.epoch = epoch, .p_O_N = believed.p_m, .v_O_N = believed.v_m_s};
    std::optional<Mat3> prior;
    if (with_attitude)
      prior = rotation_exp(200.0 * kArcsecond * Vec3(priors.normal(), priors.normal(), priors.normal())) * R_CN;
    const vision::FrameResult& seen = eyes.process(world.frame, observer, prior, predictions);
    for (std::size_t i = 0; i < predictions.size(); ++i)
      judge(seen, i, predictions, tallies[predictions[i].body.value]);
    return true;
  }

  static bool is_earth_and_moon(std::int64_t a, std::int64_t b) {
    return (a == body::earth.value && b == body::moon.value) || (a == body::moon.value && b == body::earth.value);
  }
  Vec3 place_of(BodyId id, Epoch epoch) const {
    return world.ephemeris.state(world.ephemeris.resolve(id).value(), body::solar_system_barycenter, epoch).value().p_m;
  }
  static Mat3 across(const Vec3& direction, double sigma) {
    return (Mat3::Identity() - direction * direction.transpose()) * sigma * sigma;
  }
  double predicted_flux(const sky::SkySource& s) {
    return s.flux.electrons_per_s * world.believed.exposure_s / world.believed.detector.gain_e_dn *
           std::pow(10.0, 0.4 * random.normal(0.0, kBrightnessErrorMag));
  }
  vision::PlanetPrediction prediction(const sky::SkySource& s, double distance_m, double sigma_m) {
    vision::PlanetPrediction p;
    p.body = BodyId{static_cast<std::int32_t>(s.id)};
    p.direction_N = s.direction_N;
    p.direction_covariance = across(s.direction_N, sigma_m / distance_m);
    p.v_mag = s.v_mag;
    p.expected_flux_dn = predicted_flux(s);
    p.angular_radius_rad = s.angular_radius_rad;
    return p;
  }

  // A star in the spot, or running into it, that has a thirtieth of its light or more.
  bool is_blended(const render::RenderedSource& body) const {
    for (const render::RenderedSource& s : world.sources) {
      if (s.source.kind != sky::SourceKind::star || s.electrons < body.electrons / 30.0) continue;
      const double reach = s.electrons > body.electrons ? kBrightStarBlendPx : kStarBlendPx;
      if ((s.pixel.vec() - body.pixel.vec()).norm() < reach) return true;
    }
    return false;
  }

  void judge(const vision::FrameResult& seen, std::size_t i, const std::vector<vision::PlanetPrediction>& predictions,
             Tally& tally) {
    const BodyId id = predictions[i].body;
    const render::RenderedSource* shown = nullptr;
    for (const render::RenderedSource& s : world.sources)
      if (s.source.kind != sky::SourceKind::star && s.source.id == id.value) shown = &s;
    const bool found = seen.source != vision::AttitudeSource::none && seen.planets[i].found;
    const bool measurable = shown != nullptr && shown->pixel.u > 8 && shown->pixel.v > 8 && shown->pixel.u < 1015 &&
                            shown->pixel.v < 1015 && shown->radius_px < kLargestRadiusPx;
    if (!measurable) {
      tally.wrong += found && (shown == nullptr);
      return;
    }
    const vision::Centroid* spot = found ? &seen.centroids[seen.planets[i].centroid] : nullptr;
    const bool right = found && (spot->pixel.vec() - shown->pixel.vec()).norm() < kRightPx;
    const bool blended = is_blended(*shown);
    if (!right && with_cases) tell_case(seen, predictions[i], seen.planets[i], *shown, blended);
    if (blended) {
      ++tally.blended;
      tally.blended_right += right;
      tally.blended_wrong += found && !right;
      if (right) tally.blended_chi2 += chi2_of(*spot, *shown);
      return;
    }
    ++tally.shown;
    tally.in_company += predictions.size() > 2;
    if (!found) {
      ++tally.not_found;
      return;
    }
    if (!right) {
      ++tally.wrong;
      return;
    }
    ++tally.right;
    const Vec2 error = spot->pixel.vec() - shown->pixel.vec();
    tally.error_px.push_back(error.x());
    tally.error_px.push_back(error.y());
    tally.chi2 += chi2_of(*spot, *shown);
  }

  static double chi2_of(const vision::Centroid& spot, const render::RenderedSource& shown) {
    const Vec2 error = spot.pixel.vec() - shown.pixel.vec();
    return error.dot(spot.whole_covariance_px2().inverse() * error);
  }

  // What stands near the body, and which spots are there; offsets from where it is.
  void tell_case(const vision::FrameResult& seen, const vision::PlanetPrediction& asked,
                 const vision::PlanetMatch& match, const render::RenderedSource& shown, bool blended) const {
    constexpr double kNearPx = 20.0, kFaintest = 0.01;
    const double gain = world.believed.detector.gain_e_dn;
    const auto off = [&](Pixel at) { return fmt::format("{:.2f} {:.2f}", at.u - shown.pixel.u, at.v - shown.pixel.v); };
    fmt::print("{}{}: {}, {:.0f} DN (told {:.0f}) at {:.0f} {:.0f}, foretold off {}, probability {:.5f}\n",
               match.found ? "wrong" : "not found", blended ? ", blended" : "", shown.source.id, shown.electrons / gain,
               asked.expected_flux_dn, shown.pixel.u, shown.pixel.v, off(match.predicted), match.probability);
    for (const render::RenderedSource& s : world.sources) {
      if (&s != &shown && (s.pixel.vec() - shown.pixel.vec()).norm() < kNearPx &&
          s.electrons > kFaintest * shown.electrons)
        fmt::print("  {} {}, V {:.2f}, {:.0f} DN, off {}\n", s.source.kind == sky::SourceKind::star ? "star" : "body",
                   s.source.id, s.source.v_mag, s.electrons / gain, off(s.pixel));
    }
    for (const vision::Centroid& c : seen.centroids) {
      if ((c.pixel.vec() - shown.pixel.vec()).norm() < kNearPx)
        fmt::print("  spot, {:.0f} DN, off {}, sigma {:.3f}{}\n", c.flux_dn, off(c.pixel),
                   std::sqrt(c.covariance_px2(0, 0)), c.saturated ? ", saturated" : "");
    }
  }
};

void print(const std::string& name, double prior_km, const Tally& t) {
  std::vector<double> sizes;
  for (const double e : t.error_px) sizes.push_back(std::abs(e));
  if (t.shown + t.blended == 0) return;
  fmt::print(
      "{{\"benchmark\": \"planets\", \"prior_3sigma_km\": {:.0f}, \"body\": \"{}\", \"shown\": {}, \"with_others\": "
      "{}, "
      "\"right\": {}, \"right_share\": {:.5f}, \"wrong\": {}, \"not_found\": {}, "
      "\"blended\": {}, \"blended_right\": {}, \"blended_wrong\": {}, "
      "\"blended_chi2_over_2\": {:.3f}, \"error_px_3rms\": {:.4f}, "
      "\"error_px_median\": {:.4f}, \"error_px_99.73\": {:.4f}, \"chi2_over_2\": {:.3f}}}\n",
      prior_km, name, t.shown, t.in_company, t.right, static_cast<double>(t.right) / std::max(t.shown, 1), t.wrong,
      t.not_found, t.blended, t.blended_right, t.blended_wrong,
      t.blended_right > 0 ? t.blended_chi2 / (2.0 * t.blended_right) : 0.0, t.right > 0 ? 3.0 * rms(t.error_px) : 0.0,
      t.right > 0 ? median(sizes) : 0.0, t.right > 0 ? quantile(sizes, 0.9973) : 0.0,
      t.right > 0 ? t.chi2 / (2.0 * t.right) : 0.0);
  std::fflush(stdout);
}

}  // namespace
}  // namespace astronav::accuracy

int main(int argc, char** argv) {
  using namespace astronav::accuracy;
  using astronav::BodyId;
  const int frames = count_of(argc, argv, 1, "frames", 2000);
  std::vector<double> priors{100e3, 1000e3};
  if (argc > 2) priors = {std::atof(argv[2])};
  for (const double prior_km : priors) {
    Visitor visitor;
    for (int i = 3; i < argc; ++i) {
      visitor.with_attitude |= std::string_view(argv[i]) == "attitude";
      visitor.with_cases |= std::string_view(argv[i]) == "cases";
    }
    std::map<std::int64_t, Tally> tallies;
    for (int k = 0; k < frames;) k += visitor.visit(prior_km, tallies);
    Tally all;
    for (const auto& [id, t] : tallies) {
      const std::string_view name = astronav::body_name(BodyId{static_cast<std::int32_t>(id)});
      print(name.empty() ? "asteroid" : std::string(name), prior_km, t);
      all.shown += t.shown;
      all.right += t.right;
      all.wrong += t.wrong;
      all.not_found += t.not_found;
      all.in_company += t.in_company;
      all.blended += t.blended;
      all.blended_right += t.blended_right;
      all.blended_wrong += t.blended_wrong;
      all.chi2 += t.chi2;
      all.blended_chi2 += t.blended_chi2;
      all.error_px.insert(all.error_px.end(), t.error_px.begin(), t.error_px.end());
    }
    print("all", prior_km, all);
  }
  return 0;
}
