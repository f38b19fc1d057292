// SPDX-License-Identifier: Apache-2.0
#include "verification/loop/awakening.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include <Eigen/Geometry>
#include <fmt/format.h>

#include "foundation/math/random.h"
#include "foundation/math/rotation.h"
#include "models/aberration/aberration.h"

namespace astronav::loop {
namespace {

constexpr int kSurveysPerCycle = 2;
// Sights of a survey without pictures: a spot's centroid, and its magnitude by the stars beside it.
constexpr double kSurveySight = 1.5 * kArcsecond;
constexpr double kSurveyMagnitude = 0.2;

}  // namespace

Mat3 attitude_among_stars(const Mat3& R_CN, const Vec3& v_true_m_s, const Vec3& v_believed_m_s) {
  const Vec3 boresight = R_CN.row(2).transpose();
  return R_CN * Eigen::Quaterniond::FromTwoVectors(aberrate(boresight, v_believed_m_s), aberrate(boresight, v_true_m_s))
                    .toRotationMatrix();
}

Result<std::unique_ptr<Awakening>> Awakening::create(const scenario::Scenario& scenario, const FlyOptions& options,
                                                     World& world, const Camera& believed, Eyes* eyes,
                                                     const executive::Timeline& timeline,
                                                     const executive::ColdStartSettings& settings) {
  std::unique_ptr<Awakening> out(new Awakening(scenario, options, world, believed, eyes, timeline));
  out->start_ = std::make_unique<executive::ColdStart>(settings, world.onboard_ephemeris(),
                                                       eyes != nullptr ? &eyes->field() : nullptr);
  if (const auto ok = out->start_->begin_survey(Vec3::UnitX()); !ok) return forward(ok, "onboard.start.from");
  const Duration needed = out->start_->survey_duration() * kSurveysPerCycle;
  const Duration before = timeline.window_begin(0, 0) - world.trajectory().begin();
  if (before < needed)
    return fail(ErrorCode::invalid_argument, "{0} days before the first window are too few: surveys take {1}",
                {before.days(), needed.days()}, "conops.first_window_day");
  if (timeline.coast_end(0) - timeline.window_end(0, 1) < needed)
    return fail(ErrorCode::invalid_argument, "between two cycles there is no time for surveys of {0} days",
                {needed.days()}, "conops.cycle_days");
  return out;
}

Result<bool> Awakening::survey(int cycle, executive::Navigator& navigator, Records& records) {
  const Duration duration = start_->survey_duration();
  for (int attempt = 0; attempt < kSurveysPerCycle; ++attempt) {
    const Epoch begin = timeline_.window_begin(cycle, 0) - duration * (kSurveysPerCycle - attempt);
    if (const auto ok = look_around(begin, cycle, attempt, records); !ok) return forward(ok);
    const auto place = start_->locate();
    if (!place) {
      why_ = place.error();
      continue;
    }
    const auto truth = world_.truth_from_onboard_origin(place->epoch);
    if (!truth) return forward(truth);
    StartRecord& record = records.start;
    record.cycle = cycle;
    record.named.assign(start_->named().begin(), start_->named().end());
    record.survey_error_m = place->state.p_m - truth->p_m;
    record.survey_covariance_m2 = start_->place().covariance_m2;
    if (const auto ok = navigator.start(*place); !ok) return forward(ok);
    return true;
  }
  return false;
}

Result<void> Awakening::look_around(Epoch begin, int cycle, int attempt, Records& records) {
  const auto truth = world_.trajectory().state(begin);
  if (!truth) return forward(truth);
  RandomStream sensor({.seed = options_.seed,
                       .sample = options_.sample,
                       .image = static_cast<std::uint64_t>(kSurveysPerCycle * cycle + attempt),
                       .purpose = "sun sensor"});
  const double sigma = scenario_.truth.pointing.sun_sensor_deg * kDegree;
  const Vec3 off(sensor.normal(0.0, sigma), sensor.normal(0.0, sigma), sensor.normal(0.0, sigma));
  const Vec3 to_sun = rotation_exp(off) * world_.sky().sun_N_m(begin, *truth).normalized();
  if (const auto ok = start_->begin_survey(to_sun); !ok) return forward(ok, "onboard.start.from");
  ++records.start.surveys;
  for (int k = 0; k < start_->pictures(); ++k) {
    if (options_.progress) {
      options_.progress(static_cast<double>(cycle) / timeline_.cycles(),
                        fmt::format("cycle {} of {}, survey of the ecliptic, picture {} of {}", cycle + 1,
                                    timeline_.cycles(), k + 1, start_->pictures()));
    }
    const Epoch epoch = begin + start_->picture_period() * k;
    if (const auto ok = take_picture(epoch, cycle, records.start.pictures++, k, records); !ok) return ok;
  }
  return {};
}

Result<void> Awakening::take_picture(Epoch epoch, int cycle, int number, int picture, Records& records) {
  const auto truth = world_.trajectory().state(epoch);
  if (!truth) return forward(truth);
  const auto index = static_cast<std::uint64_t>(number);
  RandomStream pointing(
      {.seed = options_.seed, .sample = options_.sample, .image = index, .purpose = "survey pointing"});
  const double jitter = scenario_.truth.pointing.jitter_arcsec * kArcsecond;
  const Vec3 off(pointing.normal(0.0, jitter), pointing.normal(0.0, jitter), pointing.normal(0.0, jitter));
  const Mat3 R_CN = rotation_exp(off) * start_->picture_R_CN(picture);
  Event event;
  event.kind = EventKind::survey_image;
  event.epoch = epoch;
  event.cycle = cycle;
  event.image = number;
  const auto seen_from = world_.truth_from_onboard_origin(epoch);
  if (!seen_from) return forward(seen_from);
  event.truth = *seen_from;
  const Epoch clock = world_.onboard_clock(epoch);
  const StreamId noise{.seed = options_.seed, .sample = options_.sample, .image = index, .purpose = "survey frame"};
  const auto done = eyes_ != nullptr ? eyes_->survey(event, clock, *truth, R_CN, believed_.exposure_s, noise, *start_)
                                     : sight(event, clock, *truth, R_CN, noise);
  if (!done) return done;
  records.events.push_back(event);
  return {};
}

Result<void> Awakening::sight(Event& event, Epoch clock, const State& truth, const Mat3& R_CN, const StreamId& noise) {
  RandomStream random(noise);
  const Vec3 boresight = R_CN.row(2).transpose();
  const auto seen = world_.planets(event.epoch, truth, boresight, believed_.intrinsics.half_diagonal_rad());
  if (!seen) return forward(seen);
  const Mat3 R_believed = attitude_among_stars(R_CN, truth.v_m_s, Vec3::Zero());
  const double largest_rad = scenario_.conops.max_beacon_size_px * believed_.intrinsics.plate_scale_rad_px();
  std::vector<navigation::SurveySpot> spots;
  for (const sky::SkySource& source : *seen) {
    const auto pixel = project(believed_.intrinsics, R_CN * source.direction_N);
    if (source.kind != sky::SourceKind::planet || 2.0 * source.angular_radius_rad > largest_rad || !pixel ||
        !believed_.intrinsics.contains(*pixel))
      continue;
    const Vec3 error(random.normal(0.0, kSurveySight), random.normal(0.0, kSurveySight),
                     random.normal(0.0, kSurveySight));
    spots.push_back({.direction_N = (R_believed.transpose() * (R_CN * source.direction_N) + error).normalized(),
                     .sigma_rad = kSurveySight,
                     .v_mag = source.v_mag + random.normal(0.0, kSurveyMagnitude)});
  }
  start_->see_spots(R_believed, clock, spots);
  event.attitude_found = true;
  event.spots = static_cast<int>(spots.size());
  return {};
}

void Awakening::add(Event& image, const navigation::BeaconMeasurement& measurement) {
  image.for_start = image.attitude_found = image.planet_found = true;
  start_->add(measurement);
}

Result<bool> Awakening::finish(executive::Navigator& navigator, Records& records) {
  const auto state = start_->solve();
  if (!state) {
    why_ = state.error();
    return false;
  }
  const auto truth = world_.truth_from_onboard_origin(state->epoch);
  if (!truth) return forward(truth);
  records.start.error << state->state.p_m - truth->p_m, state->state.v_m_s - truth->v_m_s;
  records.start.covariance = state->covariance;
  if (const auto ok = navigator.start(*state); !ok) return forward(ok);
  return true;
}

}  // namespace astronav::loop
