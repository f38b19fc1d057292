// SPDX-License-Identifier: Apache-2.0
#include "verification/loop/mission.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <memory>
#include <optional>
#include <utility>

#include <fmt/format.h>

#include "foundation/math/random.h"
#include "foundation/math/statistics.h"
#include "onboard/executive/navigator.h"
#include "onboard/executive/timeline.h"
#include "verification/loop/afterwards.h"
#include "verification/loop/awakening.h"
#include "verification/loop/belief.h"
#include "verification/loop/briefing.h"
#include "verification/loop/eyes.h"
#include "verification/loop/forecast.h"
#include "verification/loop/logbook.h"
#include "verification/loop/pointing.h"
#include "verification/loop/world.h"

namespace astronav::loop {
namespace {

using Clock = std::chrono::steady_clock;

double milliseconds_since(Clock::time_point start) {
  return std::chrono::duration<double, std::milli>(Clock::now() - start).count();
}

// One mission in flight: the truth on one side, the navigator on the other, the records between them.
class Flight {
 public:
  Flight(const scenario::Scenario& scenario, const FlyOptions& options, World& world, const Camera& believed_camera)
      : scenario_(scenario),
        options_(options),
        world_(world),
        believed_camera_(believed_camera),
        briefing_(scenario, options, world) {}

  Result<Records> fly();

 private:
  Result<void> prepare();
  bool prior_serves() const;
  Result<void> start(const Epoch& epoch);
  Result<void> prepare_awakening(const navigation::FilterSettings& filter);
  Result<void> fly_cycle(int cycle);
  Result<BodyId> fly_windows(int cycle);
  Result<void> fly_window(int cycle, int window, BodyId beacon);
  Result<void> take_image(int cycle, int window, Epoch mid_exposure, BodyId beacon);
  Result<void> coast(int cycle);

  Result<Event> event(EventKind kind, Epoch epoch, int cycle, int window, BodyId body) const;
  Result<void> record(EventKind kind, int cycle, int window, BodyId body);
  Epoch clock(Epoch epoch) const;
  Result<void> coast_to(Epoch epoch);
  bool worth_keeping(const Event& image) const;
  void progress(const executive::Timeline& timeline, int cycle, int window, int k, BodyId beacon) const;

  Result<void> measure(Event& event, const State& truth, BodyId beacon);     // mil
  Result<void> photograph(Event& event, const State& truth, BodyId beacon);  // sil
  Result<void> expect(Event& event, const State& truth, BodyId beacon);      // cov
  void use(Event& event, const navigation::BeaconMeasurement& measurement);

  const scenario::Scenario& scenario_;
  const FlyOptions& options_;
  World& world_;
  const Camera& believed_camera_;
  Briefing briefing_;
  std::unique_ptr<Eyes> eyes_;
  std::unique_ptr<Forecast> forecast_;
  std::unique_ptr<executive::Navigator> navigator_;
  std::unique_ptr<executive::Timeline> timeline_;
  std::optional<Pointing> pointing_;
  std::unique_ptr<Awakening> awakening_;  // until there is a state, where none was told
  std::unique_ptr<Afterwards> afterwards_;
  Records records_;
  Epoch now_;  // true time, to which was coasted
};

Result<void> Flight::prepare() {
  const auto filter = filter_settings(scenario_, believed_camera_, options_.level, briefing_.mass_kg());
  if (!filter) return forward(filter);
  const auto cycle = cycle_settings(scenario_);
  if (!cycle) return forward(cycle);
  const Epoch begin = world_.trajectory().begin(), end = world_.trajectory().end();
  const Epoch first = begin + Duration::days(scenario_.conops.first_window_day);
  timeline_ = std::make_unique<executive::Timeline>(*cycle, first, end);
  if (timeline_->cycles() == 0) {
    return fail(ErrorCode::invalid_argument, "the trajectory spans {0} days: too short for a single navigation cycle",
                {(end - begin).days()}, "mission");
  }
  auto pointing = Pointing::create(scenario_, options_, world_, believed_camera_);
  if (!pointing) return forward(pointing);
  pointing_.emplace(std::move(*pointing));
  if (options_.level == Level::sil) {
    auto eyes = Eyes::create(scenario_, world_, believed_camera_, first);
    if (!eyes) return forward(eyes);
    eyes_ = std::move(*eyes);
  }
  if (options_.level == Level::cov) {
    auto forecast = Forecast::create(scenario_, world_, believed_camera_, first);
    if (!forecast) return forward(forecast);
    forecast_ = std::move(*forecast);
  }
  if (options_.smooth) {
    const int sights = timeline_->cycles() * 2 * timeline_->images_per_window();
    if (sights > Afterwards::kMostSights)
      return fail(ErrorCode::limit_exceeded, "{0} sights are too many to be smoothed; at most {1}",
                  {static_cast<double>(sights), Afterwards::kMostSights}, "conops.image_period_s");
    afterwards_ = std::make_unique<Afterwards>(world_.onboard_ephemeris(), briefing_.maneuvers());
  }
  const executive::NavigatorSettings settings{
      *filter,
      beacon_settings(scenario_, believed_camera_),
      executive::BrightnessSettings{BandPhotometry(believed_camera_), believed_camera_.exposure_s,
                                    believed_camera_.detector.gain_e_dn},
      eyes_ ? eyes_->exposure_control() : nullptr,
      briefing_.maneuvers(),
      stance_settings(scenario_),
      afterwards_.get()};
  navigator_ =
      std::make_unique<executive::Navigator>(settings, world_.onboard_ephemeris(), eyes_ ? &eyes_->vision() : nullptr);
  const bool from_nothing = scenario_.onboard.start.from == "survey" || !prior_serves();
  return from_nothing && options_.level != Level::cov ? prepare_awakening(*filter) : start(begin);
}

// A coast spreads the prior; told too loosely for the first window, it is of no use there. Beyond, one sight's update
// is not near enough to linear: of 24 missions that coasted from 0.1 km/s one was sure of a wrong place after 150 days
// (3.9 million km), 17 with images after 250.
bool Flight::prior_serves() const {
  constexpr double kMost3SigmaKm = 3.5e6;
  const scenario::OnboardFilter& told = scenario_.onboard.filter;
  const double seconds = (timeline_->window_begin(0, 0) - world_.trajectory().begin()).seconds();
  return 3.0 * std::hypot(told.initial_position_sigma_km, told.initial_velocity_sigma_km_s * seconds) < kMost3SigmaKm;
}

Result<Records> Flight::fly() {
  const auto started = Clock::now();
  if (const auto ok = prepare(); !ok) return forward(ok);
  const Epoch begin = world_.trajectory().begin();
  const int cycles =
      options_.most_cycles > 0 ? std::min(options_.most_cycles, timeline_->cycles()) : timeline_->cycles();
  for (int c = 0; c < cycles; ++c) {
    if (const auto ok = fly_cycle(c); !ok) return forward(ok);
  }
  if (awakening_) {
    const Error& why = awakening_->why();
    return fail(ErrorCode::no_match, "no start from nothing in {0} cycles; the last try: {s}",
                {static_cast<double>(cycles)}, "onboard.start.from", describe(why));
  }
  const auto is_sight = [](const Event& e) { return e.kind == EventKind::image; };
  if (options_.level != Level::cov && std::none_of(records_.events.begin(), records_.events.end(), is_sight)) {
    return fail(
        ErrorCode::no_match,
        "no beacon could be looked at in any of {0} cycles (Sun, size or limiting magnitude; `astronav beacons` "
        "says why)",
        {static_cast<double>(cycles)}, "conops");
  }
  if (afterwards_) {
    auto smoothed = afterwards_->look_back();
    if (!smoothed) return forward(smoothed);
    records_.smoothed = std::move(*smoothed);
  }
  records_.cycles = cycles;
  records_.begin = begin;
  records_.end = world_.trajectory().end();
  records_.duration_days = (records_.end - begin).days();
  record_orbits(world_.ephemeris(), records_);
  sign(scenario_, options_, records_);
  records_.wall_s = milliseconds_since(started) * 1e-3;
  if (options_.progress) options_.progress(1.0, "arrived");
  return std::move(records_);
}

Result<void> Flight::start(const Epoch& epoch) {
  const auto initial = briefing_.first_state(epoch);
  const auto truth = world_.truth_from_onboard_origin(epoch);
  if (!initial) return forward(initial);
  if (!truth) return forward(truth);
  records_.start.error << initial->state.p_m - truth->p_m, initial->state.v_m_s - truth->v_m_s;
  records_.start.covariance = initial->covariance;
  const auto started = navigator_->start(*initial);
  if (started && afterwards_) afterwards_->begin(navigator_->filter());
  return started;
}

Result<void> Flight::prepare_awakening(const navigation::FilterSettings& filter) {
  records_.start.from = "survey";
  auto awakening =
      Awakening::create(scenario_, options_, world_, believed_camera_, eyes_.get(), *timeline_,
                        cold_start_settings(scenario_, filter, briefing_.mass_kg(), timeline_->images_per_window()));
  if (!awakening) return forward(awakening);
  awakening_ = std::move(*awakening);
  return {};
}

// A cycle without a start leaves nothing behind but its pictures; the next one begins with another survey.
Result<void> Flight::fly_cycle(int cycle) {
  if (awakening_) {
    const auto found = awakening_->survey(cycle, *navigator_, records_);
    if (!found || !*found) return found ? Result<void>{} : forward(found);
  }
  const auto last = fly_windows(cycle);
  if (!last) return forward(last);
  if (awakening_) {
    const auto started = awakening_->finish(*navigator_, records_);
    if (!started || !*started) return started ? Result<void>{} : forward(started);
    awakening_.reset();
    if (afterwards_) afterwards_->begin(navigator_->filter());
    if (const auto ok = coast_to(timeline_->window_end(cycle, 1)); !ok) return ok;
  }
  const auto anew = navigator_->end_flight();
  if (!anew) return forward(anew);
  if (*anew && afterwards_) afterwards_->begin(navigator_->filter());
  if (const auto ok = record(EventKind::cycle_end, cycle, 1, *last); !ok) return ok;
  return cycle + 1 < timeline_->cycles() ? coast(cycle) : Result<void>{};
}

// The beacon of the second.
Result<BodyId> Flight::fly_windows(int cycle) {
  if (const auto ok = coast_to(timeline_->window_begin(cycle, 0)); !ok) return forward(ok);
  const auto selection = navigator_->select();
  if (!selection) return forward(selection);
  BodyId beacons[2];
  if (selection->pair_count > 0) {
    beacons[0] = selection->pairs()[0].first;
    beacons[1] = selection->pairs()[0].second;
  } else if (const auto* single = selection->best_single()) {
    beacons[0] = beacons[1] = single->body;
  }
  records_.beacons.push_back(
      beacon_choice(cycle, timeline_->window_begin(cycle, 0), *selection, beacons[0], beacons[1]));
  for (int window = 0; window < 2; ++window) {
    if (beacons[window] != BodyId{}) {
      if (const auto ok = fly_window(cycle, window, beacons[window]); !ok) return forward(ok);
    }
    if (const auto ok = coast_to(timeline_->window_end(cycle, window)); !ok) return forward(ok);
    if (const auto ok = record(EventKind::window_end, cycle, window, beacons[window]); !ok) return forward(ok);
  }
  return beacons[1];
}

Result<void> Flight::coast(int cycle) {
  const Epoch end = timeline_->coast_end(cycle);
  for (Epoch t = timeline_->window_end(cycle, 1) + Duration::days(1.0); t < end; t = t + Duration::days(1.0)) {
    if (const auto ok = coast_to(t); !ok) return ok;
    if (const auto ok = record(EventKind::coast_sample, cycle, 1, BodyId{}); !ok) return ok;
  }
  if (const auto ok = coast_to(end); !ok) return ok;
  return record(EventKind::coast_end, cycle, 1, BodyId{});
}

Result<void> Flight::fly_window(int cycle, int window, BodyId beacon) {
  pointing_->begin_window(cycle, window);
  const Epoch first = timeline_->image_epoch(cycle, window, 0);
  if (const auto ok = navigator_->prepare_window(beacon, clock(first)); !ok) return ok;
  if (forecast_) {
    const auto truth = world_.trajectory().state(first);
    if (!truth) return forward(truth);
    if (const auto ok = forecast_->prepare_window(beacon, first, *truth); !ok) return ok;
  }
  for (int k = 0; k < timeline_->images_per_window(); ++k) {
    progress(*timeline_, cycle, window, k, beacon);
    const Epoch epoch = timeline_->image_epoch(cycle, window, k);
    if (world_.is_safe(epoch)) continue;
    if (const auto ok = take_image(cycle, window, epoch, beacon); !ok) return ok;
  }
  return {};
}

Result<void> Flight::take_image(int cycle, int window, Epoch mid_exposure, BodyId beacon) {
  const auto truth = world_.trajectory().state(mid_exposure);
  if (!truth) return forward(truth);
  const auto before = Clock::now();
  const auto aim = navigator_->aim(beacon, clock(mid_exposure));
  records_.stage_ms_sum.propagate += milliseconds_since(before);
  if (!aim) return forward(aim);
  pointing_->point(*aim, mid_exposure, records_.images);
  Event image;
  image.kind = EventKind::image;
  image.epoch = mid_exposure;
  image.cycle = cycle;
  image.window = window;
  image.body = beacon;
  image.image = records_.images++;
  const auto done = options_.level == Level::cov   ? expect(image, *truth, beacon)
                    : options_.level == Level::mil ? measure(image, *truth, beacon)
                                                   : photograph(image, *truth, beacon);
  if (!done) return done;
  const auto after = event(EventKind::image, mid_exposure, cycle, window, beacon);
  if (!after) return forward(after);
  image.truth = after->truth;
  image.estimate = after->estimate;
  image.covariance = after->covariance;
  image.nees = after->nees;
  records_.events.push_back(image);
  return {};
}

Result<void> Flight::measure(Event& image, const State& truth, BodyId beacon) {
  const auto planet = world_.planet(beacon, image.epoch, truth);
  if (!planet) return forward(planet);
  const auto pixel = project(believed_camera_.intrinsics, pointing_->R_CN() * planet->direction_N);
  if (!pixel) return forward(pixel);
  // Noise as an angle on the sky, per axis. A perfect sight still needs a sigma to be weighed with.
  const double sigma_rad = scenario_.mil.line_of_sight_noise_arcsec * kArcsecond;
  const double sigma_px = sigma_rad * believed_camera_.intrinsics.fx_px;
  constexpr double floor_px = 1e-5;
  RandomStream stream({.seed = options_.seed,
                       .sample = options_.sample,
                       .image = static_cast<std::uint64_t>(image.image),
                       .purpose = "line of sight"});
  const scenario::Mil& mil = scenario_.mil;
  Vec2 noise(stream.normal(0.0, sigma_px), stream.normal(0.0, sigma_px));
  if (stream.uniform() < mil.outlier_share) noise *= mil.outlier_scale;
  if (mil.systematic_arcsec > 0.0) {
    RandomStream window({.seed = options_.seed,
                         .sample = options_.sample,
                         .image = static_cast<std::uint64_t>(2 * image.cycle + image.window),
                         .purpose = "systematic error of a window"});
    const double shared_px = mil.systematic_arcsec * kArcsecond / believed_camera_.intrinsics.plate_scale_rad_px();
    noise += Vec2(window.normal(0.0, shared_px), window.normal(0.0, shared_px));
  }
  navigation::BeaconMeasurement m;
  m.body = beacon;
  m.mid_exposure = world_.onboard_clock(image.epoch);
  m.pixel = {pixel->u + noise.x(), pixel->v + noise.y()};
  m.pixel_covariance_px2 = std::max(sigma_px * sigma_px, floor_px * floor_px) * Mat2::Identity();
  const Mat3& R_CN = pointing_->R_CN();
  m.R_CN = R_CN;
  if (awakening_) {
    m.v_stars_m_s = navigator_->filter().state().v_m_s;
    m.R_CN = attitude_among_stars(R_CN, truth.v_m_s, *m.v_stars_m_s);
  }
  use(image, m);
  image.planet_error_px = noise;
  return {};
}

Result<void> Flight::expect(Event& image, const State& truth, BodyId beacon) {
  const auto m = forecast_->measure(beacon, image.epoch, truth, pointing_->R_CN());
  if (!m) return forward(m);
  use(image, *m);
  image.attitude_sigma_rad = m->attitude_covariance_rad2.diagonal().cwiseSqrt();
  image.attitude_repeating_rad = m->attitude_repeating_rad2.diagonal().cwiseSqrt();
  image.stars_matched = forecast_->window().stars;
  return {};
}

void Flight::use(Event& image, const navigation::BeaconMeasurement& m) {
  if (awakening_) {
    awakening_->add(image, m);
    return;
  }
  const auto before = Clock::now();
  const navigation::UpdateResult update = navigator_->use(m);
  const double ms = milliseconds_since(before);
  records_.stage_ms_sum.update += ms;
  records_.image_ms.push_back(ms);
  image.attitude_found = true;
  image.planet_found = true;
  image.accepted = update.accepted;
  image.innovation_px = update.innovation_px;
  image.innovation_covariance_px2 = update.innovation_covariance_px2;
  image.nis = update.nis;
  image.planet_sigma_px = m.pixel_covariance_px2.diagonal().cwiseSqrt();
  image.planet_repeating_px = m.repeating_sigma_px;
}

Result<void> Flight::photograph(Event& image, const State& truth, BodyId beacon) {
  const StreamId noise{.seed = options_.seed,
                       .sample = options_.sample,
                       .image = static_cast<std::uint64_t>(image.image),
                       .purpose = "frame"};
  return eyes_->photograph(image, world_.onboard_clock(image.epoch), truth, *pointing_, beacon, noise, *navigator_,
                           records_, worth_keeping(image), awakening_ ? &awakening_->cold_start() : nullptr);
}

// Pictures for the report: from the middle of windows spread over the mission, first and second beacon in turn.
bool Flight::worth_keeping(const Event& image) const {
  const int kept = static_cast<int>(records_.frames.size());
  if (kept >= options_.keep_frames) return false;
  const int cycle = kept * timeline_->cycles() / options_.keep_frames;
  const int in_window = image.image % timeline_->images_per_window();
  return image.cycle >= cycle && image.window == kept % 2 && in_window == timeline_->images_per_window() / 2;
}

Result<Event> Flight::event(EventKind kind, Epoch epoch, int cycle, int window, BodyId body) const {
  const auto truth = world_.truth_from_onboard_origin(epoch);
  if (!truth) return forward(truth);
  Event e;
  e.kind = kind;
  e.epoch = epoch;
  e.cycle = cycle;
  e.window = window;
  e.body = body;
  e.truth = *truth;
  e.estimate = navigator_->filter().state();
  e.covariance = navigator_->filter().covariance_pv();
  Vec6 error;
  error << e.estimate.p_m - e.truth.p_m, e.estimate.v_m_s - e.truth.v_m_s;
  e.nees = normalised_square(error, e.covariance);
  return e;
}

// By its own clock, which may have been set back.
Epoch Flight::clock(Epoch epoch) const {
  return std::max(world_.onboard_clock(epoch), navigator_->filter().epoch());
}

Result<void> Flight::coast_to(Epoch epoch) {
  now_ = epoch;
  return navigator_->coast_to(clock(epoch));
}

Result<void> Flight::record(EventKind kind, int cycle, int window, BodyId body) {
  auto e = event(kind, now_, cycle, window, body);
  if (!e) return forward(e);
  if (afterwards_) afterwards_->note(*e, navigator_->filter().epoch());
  records_.events.push_back(std::move(*e));
  return {};
}

void Flight::progress(const executive::Timeline& timeline, int cycle, int window, int k, BodyId beacon) const {
  if (!options_.progress) return;
  const double per_cycle = 2.0 * timeline.images_per_window();
  const double done = (cycle + (window * timeline.images_per_window() + k) / per_cycle) / timeline.cycles();
  const Mat6 P = navigator_->filter().covariance_pv();
  options_.progress(
      done, fmt::format("cycle {} of {}, tracking {}, place known to {:.0f} km (3 sigma)", cycle + 1, timeline.cycles(),
                        body_name(beacon), 3.0 * std::sqrt(P.topLeftCorner<3, 3>().trace()) * 1e-3));
}

}  // namespace

Result<Records> fly(const scenario::Scenario& scenario, const FlyOptions& options) {
  const scenario::Scenario flown = options.level == Level::cov ? undisturbed(scenario) : scenario;
  auto world = World::create(flown, options.seed, options.sample);
  if (!world) return forward(world);
  const auto camera = scenario::onboard_camera(flown);
  if (!camera) return forward(camera);
  return Flight(flown, options, **world, *camera).fly();
}

}  // namespace astronav::loop
