// SPDX-License-Identifier: Apache-2.0
// A spacecraft between Earth and Mars that wakes up and knows the time and nothing else: a survey of the ecliptic, an
// hour on each of two planets, a batch, and from there on the filter; beside it the same filter that was told its place
// to 10,000 km and 0.1 km/s. The truth flies by the simulator's dynamics; sights are directions with noise, no images.
// Shared by benchmarks/accuracy/cold_start.cpp and tests/validation/cold_start_test.cpp.
#pragma once

#include <algorithm>
#include <cmath>
#include <optional>
#include <vector>

#include "foundation/math/random.h"
#include "foundation/math/rotation.h"
#include "models/aberration/aberration.h"
#include "models/photometry/photometry.h"
#include "onboard/navigation/batch.h"
#include "onboard/navigation/beacons.h"
#include "onboard/navigation/filter.h"
#include "simulator/dynamics/propagation.h"

namespace astronav::cold_start {

struct Level {
  double noise_rad = 0.07 * kArcsecond;  // of a sight, an axis
  double bias_rad = 0.0;                 // of a window, fading in twelve hours
};

inline constexpr int kCycles = 4;
inline constexpr double kCycleDays = 10.0;
inline constexpr double kFlightDays = kCycles * kCycleDays;
inline constexpr int kImages = 36;

// At the end of a cycle's second window.
struct Reading {
  Vec6 error = Vec6::Zero();
  Mat6 covariance = Mat6::Identity();
  double nees() const { return error.dot(covariance.inverse() * error); }
};
struct Outcome {
  bool started = false;
  const char* stopped_at = "";  // where there was no start
  int surveys = 0;
  bool wrong_names = false;  // a survey that was sure of a planet that is none, or another
  double survey_error_km = 0.0, survey_nees = 0.0;
  std::vector<Reading> cold;    // by cycle; the first is the batch's
  std::vector<Reading> primed;  // the same for the filter that had a prior
};

class Flight {
 public:
  // `truth`: where the spacecraft really is at `epoch`.
  Flight(const Ephemeris& ephemeris, Epoch epoch, const State& truth, const Level& level, std::uint64_t sample)
      : ephemeris_(ephemeris),
        level_(level),
        random_({.seed = 11, .sample = sample, .purpose = "cold start"}),
        arc_(fly(ephemeris, epoch, truth, random_)),
        camera_(Intrinsics::from_field_of_view(1024, 1024, 20 * kDegree)) {}

  Outcome run() {
    Outcome out;
    Epoch now = arc_.begin();
    std::optional<navigation::SurveySolution> place;
    for (; out.surveys < 3 && !place; ++out.surveys) place = look_around(now, out);
    out.stopped_at = "survey";
    if (!place) return out;
    out.survey_error_km = (place->p_O_N - state(place->epoch).p_m).norm() / 1e3;
    const Vec3 off = place->p_O_N - state(place->epoch).p_m;
    out.survey_nees = off.dot(place->covariance_m2.inverse() * off);

    const auto start = navigation::start_from_survey(ephemeris_, *place);
    if (!start) return out;
    out.stopped_at = "no pair of beacons";
    const std::vector<BodyId> pair = choose(start->state, now);
    if (pair.size() < 2) return out;
    std::vector<navigation::BatchSight> sights;
    std::vector<navigation::BeaconMeasurement> measurements;
    for (int window = 0; window < 2; ++window) {
      const BodyId body = pair[static_cast<std::size_t>(window)];
      for (const Seen& seen : track(body, now + Duration::seconds(5100.0 * window))) {
        sights.push_back(batch_sight(body, seen, start->state.v_m_s));
        measurements.push_back(measurement(body, seen));
      }
    }
    navigation::BatchSettings batch;
    batch.process = filter_settings().process;
    batch.bias = {.sigma = level_.bias_rad, .tau_s = kBiasTau};
    out.stopped_at = "batch";
    const auto solved = navigation::solve_batch(ephemeris_, sights, *start, batch);
    if (!solved) return out;
    out.stopped_at = "";
    out.started = true;
    out.cold.push_back(read(solved->state, solved->covariance, solved->epoch));

    navigation::Filter cold(filter_settings(), ephemeris_), primed(filter_settings(), ephemeris_);
    if (!cold.initialise(navigation::initial_state(*solved, batch))) return out;
    navigation::InitialState prior{.epoch = now, .state = state(now), .mass_kg = kMass, .mass_sigma_kg = 0.1 * kMass};
    for (int axis = 0; axis < 6; ++axis) {
      const double sigma = axis < 3 ? 1e7 / 3.0 : 1e2 / 3.0;  // told as 3 sigma
      prior.covariance(axis, axis) = sigma * sigma;
      (axis < 3 ? prior.state.p_m[axis] : prior.state.v_m_s[axis - 3]) += sigma * random_.normal();
    }
    if (!primed.initialise(prior)) return out;
    for (const auto& m : measurements) primed.update(m);
    out.primed.push_back(read(primed.state(), primed.covariance_pv(), primed.epoch()));
    for (int cycle = 1; cycle < kCycles; ++cycle) {
      const Epoch begin = now + Duration::days(kCycleDays * cycle);
      if (!cold.propagate_to(begin) || !primed.propagate_to(begin)) return out;
      // Either filter would choose the same; one pair for both makes them comparable.
      const std::vector<BodyId> next = choose(primed.state(), begin);
      for (std::size_t window = 0; window < next.size(); ++window) {
        for (const Seen& seen : track(next[window], begin + Duration::seconds(5100.0 * static_cast<double>(window)))) {
          cold.update(measurement(next[window], seen));
          primed.update(measurement(next[window], seen));
        }
      }
      out.cold.push_back(read(cold.state(), cold.covariance_pv(), cold.epoch()));
      out.primed.push_back(read(primed.state(), primed.covariance_pv(), primed.epoch()));
    }
    return out;
  }

 private:
  static constexpr double kMass = 25.0;
  static constexpr double kBiasTau = 12.0 * 3600.0;
  static constexpr double kSurveyNoise = 1.5 * kArcsecond;
  static constexpr double kLimit = 6.0;

  struct Seen {
    Epoch epoch;
    Vec3 direction_N;  // apparent, with noise
    Vec3 boresight_N;
  };

  static dynamics::Arc fly(const Ephemeris& ephemeris, Epoch epoch, const State& truth, RandomStream& random) {
    dynamics::ForceSettings forces;
    forces.srp_scale = 1.0 + 0.1 * random.normal();
    const Epoch end = epoch + Duration::days(kFlightDays);
    const auto unmodelled = dynamics::UnmodelledAcceleration::draw({.sigma_m_s2 = 1e-8}, epoch, end, random);
    const auto model = dynamics::ForceModel::create(ephemeris, forces, unmodelled.value());
    return dynamics::propagate(model.value(), truth, epoch, end).value();
  }

  State state(Epoch epoch) const { return arc_.at(epoch).value(); }
  Reading read(const State& believed, const Mat6& covariance, Epoch epoch) const {
    Reading r;
    const State truth = state(epoch);
    r.error << believed.p_m - truth.p_m, believed.v_m_s - truth.v_m_s;
    r.covariance = covariance;
    return r;
  }
  navigation::FilterSettings filter_settings() const {
    navigation::FilterSettings settings;
    settings.camera = camera_;
    settings.sight.centre_of_light = false;
    settings.focal.sigma = settings.k1.sigma = 0.0;
    settings.bias = {.sigma = level_.bias_rad * camera_.fx_px, .tau_s = kBiasTau};
    return settings;
  }
  // The best pair; one body where there is no pair.
  std::vector<BodyId> choose(const State& believed, Epoch epoch) const {
    const auto selection = navigation::select_beacons(ephemeris_, believed, epoch, {});
    if (!selection) return {};
    if (selection->pair_count > 0) return {selection->ranked[0].first, selection->ranked[0].second};
    if (const auto* single = selection->best_single()) return {single->body};
    return {};
  }

  // An image each 100 s for an hour, the pointing dithered by a degree.
  std::vector<Seen> track(BodyId body, Epoch begin) {
    std::vector<Seen> out;
    Vec3 bias = level_.bias_rad * Vec3(random_.normal(), random_.normal(), random_.normal());
    for (int k = 0; k < kImages; ++k) {
      const double keep = std::exp(-100.0 / kBiasTau);
      bias = keep * bias + level_.bias_rad * std::sqrt(1.0 - keep * keep) * normal3();
      Seen seen;
      seen.epoch = begin + Duration::seconds(50.0 + 100.0 * k);
      const State here = state(seen.epoch);
      const Vec3 exact =
          aberrate(light_time(ephemeris_, body, here, seen.epoch)->relative.p_m.normalized(), here.v_m_s);
      seen.direction_N = (exact + bias + level_.noise_rad * normal3()).normalized();
      seen.boresight_N = (exact + 0.5 * kDegree * normal3()).normalized();
      out.push_back(seen);
    }
    return out;
  }
  Vec3 normal3() {
    const double x = random_.normal(), y = random_.normal(), z = random_.normal();
    return {x, y, z};
  }
  // Stars that were aberrated by a velocity that is only believed turn the attitude, and all sights with it.
  navigation::BatchSight batch_sight(BodyId body, const Seen& seen, const Vec3& v_stars) const {
    const Vec3 v = state(seen.epoch).v_m_s;
    const Mat3 turned =
        Eigen::Quaterniond::FromTwoVectors(aberrate(seen.boresight_N, v), aberrate(seen.boresight_N, v_stars))
            .toRotationMatrix();
    navigation::BatchSight out;
    out.epoch = seen.epoch;
    out.sight.body = body;
    out.sight.direction_N = (turned * seen.direction_N).normalized();
    out.sight.covariance_rad2 = Mat3::Identity() * level_.noise_rad * level_.noise_rad;
    out.boresight_N = seen.boresight_N;
    out.v_stars_m_s = v_stars;
    return out;
  }
  // As pixels, by an attitude without error: the filter at the level "mil".
  navigation::BeaconMeasurement measurement(BodyId body, const Seen& seen) const {
    const RaDec aim = radec_from_direction(seen.boresight_N);
    navigation::BeaconMeasurement m;
    m.body = body;
    m.mid_exposure = seen.epoch;
    m.R_CN = R_CN_from_pointing({aim.ra_rad, aim.dec_rad, 0.3});
    m.pixel = project(camera_, m.R_CN * seen.direction_N).value();
    const double sigma_px = level_.noise_rad * camera_.fx_px;
    m.pixel_covariance_px2 = Mat2::Identity() * sigma_px * sigma_px;
    return m;
  }

  // Sixteen frames along the ecliptic, 90 s apart, from 40 degrees on one side of the Sun to 40 on the other; stars at
  // rest, as nobody knows the velocity; spots that are nothing. `now` moves on.
  std::optional<navigation::SurveySolution> look_around(Epoch& now, Outcome& out) {
    constexpr double kObliquity = 84381.448 * kArcsecond;
    const auto from_ecliptic = [](const Vec3& v) {
      return Vec3(v.x(), std::cos(kObliquity) * v.y() - std::sin(kObliquity) * v.z(),
                  std::sin(kObliquity) * v.y() + std::cos(kObliquity) * v.z());
    };
    const Vec3 to_sun = -state(now).p_m;
    const double sun_longitude =
        std::atan2(std::cos(kObliquity) * to_sun.y() + std::sin(kObliquity) * to_sun.z(), to_sun.x());
    std::vector<navigation::SurveyFrame> frames;
    std::vector<navigation::SurveySpot> spots;
    std::vector<BodyId> truth;
    const auto add = [&](navigation::SurveySpot spot, BodyId body) {
      spots.push_back(spot);
      truth.push_back(body);
    };
    for (double off = 40.0; off < 321.0; off += 18.0) {
      navigation::SurveyFrame frame;
      frame.epoch = now;
      frame.camera = camera_;
      frame.limit_v_mag = kLimit;
      const double at = sun_longitude + off * kDegree;
      const RaDec aim = radec_from_direction(from_ecliptic({std::cos(at), std::sin(at), 0.02 * random_.normal()}));
      frame.R_CN = R_CN_from_pointing({aim.ra_rad, aim.dec_rad, random_.uniform(0.0, 2.0 * kPi)});
      const State here = state(now);
      const Vec3 boresight = frame.R_CN.row(2).transpose();
      const Mat3 turned =
          Eigen::Quaterniond::FromTwoVectors(aberrate(boresight, here.v_m_s), boresight).toRotationMatrix();
      std::vector<std::pair<navigation::SurveySpot, BodyId>> seen;
      for (const BodyId id : {body::mercury, body::venus, body::earth, body::moon, body::mars, body::jupiter,
                              body::saturn, body::uranus}) {
        const BodyId known = ephemeris_.resolve(id).value();
        const auto sight = light_time(ephemeris_, known, here, now).value();
        const Epoch emitted = now - Duration::seconds(sight.light_time_s);
        const State from_sun = ephemeris_.state(known, body::sun, emitted).value();
        const double v_mag =
            planet_v_magnitude(id, {from_sun.p_m, sight.relative.p_m, emitted}).value() + 0.25 * random_.normal();
        const Vec3 direction = turned * aberrate(sight.relative.p_m.normalized(), here.v_m_s);
        const Vec3 in_camera = frame.R_CN * direction;
        if (!(in_camera.z() > 0.0) || v_mag > kLimit || random_.uniform() < 0.01) continue;
        const auto pixel = project(frame.camera, in_camera);
        if (!pixel || !frame.camera.contains(*pixel)) continue;
        seen.push_back({{.frame = frames.size(),
                         .direction_N = (direction + kSurveyNoise * normal3()).normalized(),
                         .sigma_rad = kSurveyNoise,
                         .v_mag = v_mag},
                        id});
      }
      // What is within 3 px of a brighter body is part of its spot.
      for (const auto& [spot, id] : seen)
        if (std::none_of(seen.begin(), seen.end(), [&](const auto& other) {
              return other.first.v_mag < spot.v_mag &&
                     angle_between(other.first.direction_N, spot.direction_N) < 3.0 * camera_.plate_scale_rad_px();
            }))
          add(spot, id);
      for (std::uint64_t k = random_.poisson(0.3); k > 0; --k)
        add({.frame = frames.size(),
             .direction_N = frame.R_CN.transpose() *
                            *unproject(camera_, {random_.uniform(4.0, 1019.0), random_.uniform(4.0, 1019.0)}),
             .sigma_rad = kSurveyNoise,
             .v_mag = random_.uniform(0.0, kLimit)},
            BodyId{});
      frames.push_back(frame);
      now = now + Duration::seconds(90.0);
    }
    std::vector<std::size_t> order(spots.size());
    for (std::size_t i = 0; i < order.size(); ++i) order[i] = i;
    std::sort(order.begin(), order.end(), [&](auto a, auto b) { return spots[a].v_mag < spots[b].v_mag; });
    order.resize(std::min(order.size(), navigation::kMaxSurveySpots));
    std::vector<navigation::SurveySpot> brightest;
    for (const std::size_t i : order) brightest.push_back(spots[i]);
    navigation::SurveySettings settings;
    settings.false_per_frame = 0.3;
    const auto found = navigation::survey(ephemeris_, frames, brightest, settings);
    if (!found) return std::nullopt;
    for (std::size_t k = 0; k < found->count; ++k)
      out.wrong_names |= truth[order[found->named[k].spot]] != found->named[k].body;
    return *found;
  }

  const Ephemeris& ephemeris_;
  Level level_;
  RandomStream random_;
  dynamics::Arc arc_;
  Intrinsics camera_;
};

// What many starts give, pooled.
struct Pool {
  int starts = 0, started = 0, wrong = 0;
  struct Axes {
    double position_km = 0.0, velocity_m_s = 0.0;  // 3 x rms, worst axis
    double formal_position_km = 0.0, formal_velocity = 0.0;
    double nees = 0.0;
  };
  std::vector<Axes> cold, primed;  // by cycle
  double survey_nees = 0.0, survey_error_km = 0.0;

  void add(const Outcome& outcome) {
    // One in 1e9 of a right answer's NEES lies beyond.
    constexpr double kConfidentlyWrong = 56.0;
    ++starts;
    bool wrong_now = outcome.wrong_names;
    for (const Reading& r : outcome.cold) wrong_now |= r.nees() > kConfidentlyWrong;
    wrong += wrong_now;
    if (!outcome.started || outcome.cold.size() != kCycles) return;
    ++started;
    survey_nees += outcome.survey_nees;
    survey_error_km += outcome.survey_error_km;
    outcomes_.push_back(outcome);
  }
  void finish() {
    survey_nees /= std::max(started, 1);
    survey_error_km /= std::max(started, 1);
    for (int cycle = 0; cycle < kCycles; ++cycle) {
      cold.push_back(axes(cycle, &Outcome::cold));
      primed.push_back(axes(cycle, &Outcome::primed));
    }
  }

 private:
  Axes axes(int cycle, std::vector<Reading> Outcome::*which) const {
    Vec6 square = Vec6::Zero(), formal = square;
    Axes out;
    for (const Outcome& outcome : outcomes_) {
      const Reading& r = (outcome.*which)[static_cast<std::size_t>(cycle)];
      square += r.error.cwiseAbs2() / started;
      formal += r.covariance.diagonal() / started;
      out.nees += r.nees() / started;
    }
    out.position_km = 3e-3 * std::sqrt(square.head<3>().maxCoeff());
    out.velocity_m_s = 3.0 * std::sqrt(square.tail<3>().maxCoeff());
    out.formal_position_km = 3e-3 * std::sqrt(formal.head<3>().maxCoeff());
    out.formal_velocity = 3.0 * std::sqrt(formal.tail<3>().maxCoeff());
    return out;
  }
  std::vector<Outcome> outcomes_;
};

}  // namespace astronav::cold_start
