// SPDX-License-Identifier: Apache-2.0
#include "verification/loop/mission.h"

#include <algorithm>
#include <chrono>
#include <memory>
#include <optional>
#include <utility>

#include <fmt/format.h>
#include <sys/resource.h>

#include "foundation/math/random.h"
#include "foundation/math/statistics.h"
#include "onboard/executive/navigator.h"
#include "onboard/executive/timeline.h"
#include "verification/loop/awakening.h"
#include "verification/loop/belief.h"
#include "verification/loop/eyes.h"
#include "verification/loop/forecast.h"
#include "verification/loop/world.h"

namespace astronav::loop {
namespace {

using Clock = std::chrono::steady_clock;

double milliseconds_since(Clock::time_point start) {
  return std::chrono::duration<double, std::milli>(Clock::now() - start).count();
}

double peak_memory_mb() {
  struct rusage usage {};
  getrusage(RUSAGE_SELF, &usage);
  return static_cast<double>(usage.ru_maxrss) / 1024.0;
}

const char* name(Level level) {
  switch (level) {
    case Level::cov:
      return "cov";
    case Level::mil:
      return "mil";
    case Level::sil:
      return "sil";
  }
  return "";
}

// One mission in flight: the truth on one side, the navigator on the other, the records between them.
class Flight {
 public:
  Flight(const scenario::Scenario& scenario, const FlyOptions& options, World& world, const Camera& believed_camera)
      : scenario_(scenario), options_(options), world_(world), believed_camera_(believed_camera) {}

  Result<Records> fly();

 private:
  Result<void> start(const Epoch& epoch);
  Result<void> prepare_awakening(const navigation::FilterSettings& filter);
  Result<void> fly_cycle(int cycle);
  Result<BodyId> fly_windows(int cycle);
  Result<void> fly_window(int cycle, int window, BodyId beacon);
  Result<void> take_image(int cycle, int window, Epoch mid_exposure, BodyId beacon, double roll_rad);
  Result<void> coast(int cycle);

  Result<Event> event(EventKind kind, Epoch epoch, int cycle, int window, BodyId body) const;
  Result<void> record(EventKind kind, int cycle, int window, BodyId body);
  Result<void> record_beacons(int cycle, const navigation::BeaconSelection& selection, BodyId first, BodyId second);
  void record_orbits(Epoch begin, Epoch end);
  bool worth_keeping(const Event& image) const;
  // Where the onboard software wants the camera to look, dithered; and by how much it does not.
  Mat3 commanded_attitude(const Vec3& aim_N, double roll_rad, int image) const;
  Mat3 jitter(int image) const;
  double believed_mass_kg() const;
  executive::Maneuvers known_maneuvers();
  void progress(const executive::Timeline& timeline, int cycle, int window, int k, BodyId beacon) const;

  Result<void> measure(Event& event, const State& truth, const Mat3& R_CN, BodyId beacon);     // mil
  Result<void> photograph(Event& event, const State& truth, const Mat3& R_CN, BodyId beacon);  // sil
  Result<void> expect(Event& event, const State& truth, const Mat3& R_CN, BodyId beacon);      // cov
  void use(Event& event, const navigation::BeaconMeasurement& measurement);

  const scenario::Scenario& scenario_;
  const FlyOptions& options_;
  World& world_;
  const Camera& believed_camera_;
  std::vector<executive::ThrustCommand> commands_;
  std::vector<executive::Kick> kicks_;
  std::unique_ptr<Eyes> eyes_;
  std::unique_ptr<Forecast> forecast_;
  std::unique_ptr<executive::Navigator> navigator_;
  std::unique_ptr<executive::Timeline> timeline_;
  Mat3 commanded_R_CN_ = Mat3::Identity();  // for the next image
  std::unique_ptr<Awakening> awakening_;    // until there is a state, where none was told
  Records records_;
};

Result<Records> Flight::fly() {
  const auto started = Clock::now();
  const auto filter = filter_settings(scenario_, believed_camera_, options_.level, believed_mass_kg());
  if (!filter) return forward(filter);
  const auto cycle = cycle_settings(scenario_);
  if (!cycle) return forward(cycle);
  const Epoch begin = world_.trajectory().begin();
  const Epoch end = world_.trajectory().end();
  const Epoch first = begin + Duration::days(scenario_.conops.first_window_day);
  timeline_ = std::make_unique<executive::Timeline>(*cycle, first, end);
  if (timeline_->cycles() == 0) {
    return fail(ErrorCode::invalid_argument, "the trajectory spans {0} days: too short for a single navigation cycle",
                {(end - begin).days()}, "mission");
  }
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
  const executive::NavigatorSettings settings{
      *filter, beacon_settings(scenario_, believed_camera_),
      executive::BrightnessSettings{BandPhotometry(believed_camera_), believed_camera_.exposure_s,
                                    believed_camera_.detector.gain_e_dn},
      eyes_ ? eyes_->exposure_control() : nullptr, known_maneuvers()};
  navigator_ =
      std::make_unique<executive::Navigator>(settings, world_.onboard_ephemeris(), eyes_ ? &eyes_->vision() : nullptr);
  const bool from_nothing = scenario_.onboard.start.from == "survey" && options_.level != Level::cov;
  if (const auto ok = from_nothing ? prepare_awakening(*filter) : start(begin); !ok) return forward(ok);
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
  records_.cycles = cycles;
  records_.duration_days = (end - begin).days();
  records_.begin = begin;
  records_.end = end;
  record_orbits(begin, end);
  records_.level = name(options_.level);
  records_.seed = options_.seed;
  records_.sample = options_.sample;
  records_.version = ASTRONAV_VERSION;
  records_.scenario_toml = scenario::to_toml(
      scenario_,
      {.version = records_.version, .level = records_.level, .seed = options_.seed, .sample = options_.sample});
  records_.peak_memory_mb = peak_memory_mb();
  records_.wall_s = milliseconds_since(started) * 1e-3;
  if (options_.progress) options_.progress(1.0, "arrived");
  return std::move(records_);
}

double Flight::believed_mass_kg() const {
  return world_.thrust_plan().arcs.empty() ? kBelievedMassKg : world_.thrust_plan().mass_kg;
}

// The thrust as planned, and kicks as the onboard software hears of them.
executive::Maneuvers Flight::known_maneuvers() {
  for (const ThrustArc& arc : world_.thrust_plan().arcs)
    commands_.push_back({arc.begin, arc.end, {arc.force_n, arc.specific_impulse_s, arc.direction_N}});
  const scenario::OnboardFilter& belief = scenario_.onboard.filter;
  if (belief.knows_unloading) {
    RandomStream stream({.seed = options_.seed, .sample = options_.sample, .purpose = "reported kicks"});
    for (const dynamics::Kick& kick : world_.kicks()) {
      const double sigma_m_s = belief.unloading_error_relative * kick.delta_v_N_m_s.norm();
      const Vec3 error(stream.normal(0.0, sigma_m_s), stream.normal(0.0, sigma_m_s), stream.normal(0.0, sigma_m_s));
      kicks_.push_back({kick.begin, kick.delta_v_N_m_s + error, sigma_m_s});
    }
  }
  return {commands_, kicks_};
}

Result<void> Flight::start(const Epoch& epoch) {
  const auto truth = world_.truth_from_onboard_origin(epoch);
  if (!truth) return forward(truth);
  const scenario::OnboardFilter& belief = scenario_.onboard.filter;
  const double sigma_p = belief.initial_position_sigma_km * 1e3;
  const double sigma_v = belief.initial_velocity_sigma_km_s * 1e3;
  RandomStream stream({.seed = options_.seed, .sample = options_.sample, .purpose = "initial error"});
  navigation::InitialState initial;
  initial.epoch = epoch;
  initial.state = *truth;
  if (options_.level != Level::cov) {
    for (int i = 0; i < 3; ++i) initial.state.p_m[i] += stream.normal(0.0, sigma_p);
    for (int i = 0; i < 3; ++i) initial.state.v_m_s[i] += stream.normal(0.0, sigma_v);
  }
  initial.covariance.diagonal() << Vec3::Constant(sigma_p * sigma_p), Vec3::Constant(sigma_v * sigma_v);
  initial.mass_kg = believed_mass_kg();
  records_.start.error << initial.state.p_m - truth->p_m, initial.state.v_m_s - truth->v_m_s;
  records_.start.covariance = initial.covariance;
  return navigator_->start(initial);
}

Result<void> Flight::prepare_awakening(const navigation::FilterSettings& filter) {
  records_.start.from = "survey";
  auto awakening =
      Awakening::create(scenario_, options_, world_, believed_camera_, eyes_.get(), *timeline_,
                        cold_start_settings(scenario_, filter, believed_mass_kg(), timeline_->images_per_window()));
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
    if (const auto ok = navigator_->coast_to(timeline_->window_end(cycle, 1)); !ok) return ok;
  }
  if (const auto ok = record(EventKind::cycle_end, cycle, 1, *last); !ok) return ok;
  return cycle + 1 < timeline_->cycles() ? coast(cycle) : Result<void>{};
}

// The beacon of the second.
Result<BodyId> Flight::fly_windows(int cycle) {
  if (const auto ok = navigator_->coast_to(timeline_->window_begin(cycle, 0)); !ok) return forward(ok);
  const auto selection = navigator_->select();
  if (!selection) return forward(selection);
  BodyId beacons[2];
  if (selection->pair_count > 0) {
    beacons[0] = selection->pairs()[0].first;
    beacons[1] = selection->pairs()[0].second;
  } else if (const auto* single = selection->best_single()) {
    beacons[0] = beacons[1] = single->body;
  }
  if (const auto ok = record_beacons(cycle, *selection, beacons[0], beacons[1]); !ok) return forward(ok);
  for (int window = 0; window < 2; ++window) {
    if (beacons[window] != BodyId{}) {
      if (const auto ok = fly_window(cycle, window, beacons[window]); !ok) return forward(ok);
    }
    if (const auto ok = navigator_->coast_to(timeline_->window_end(cycle, window)); !ok) return forward(ok);
    if (const auto ok = record(EventKind::window_end, cycle, window, beacons[window]); !ok) return forward(ok);
  }
  return beacons[1];
}

Result<void> Flight::coast(int cycle) {
  const Epoch end = timeline_->coast_end(cycle);
  for (Epoch t = timeline_->window_end(cycle, 1) + Duration::days(1.0); t < end; t = t + Duration::days(1.0)) {
    if (const auto ok = navigator_->coast_to(t); !ok) return ok;
    if (const auto ok = record(EventKind::coast_sample, cycle, 1, BodyId{}); !ok) return ok;
  }
  if (const auto ok = navigator_->coast_to(end); !ok) return ok;
  return record(EventKind::coast_end, cycle, 1, BodyId{});
}

Result<void> Flight::fly_window(int cycle, int window, BodyId beacon) {
  RandomStream stream({.seed = options_.seed,
                       .sample = options_.sample,
                       .image = static_cast<std::uint64_t>(2 * cycle + window),
                       .purpose = "roll of a window"});
  const double roll = options_.level == Level::cov ? 0.0 : stream.uniform(0.0, 2.0 * kPi);
  const Epoch first = timeline_->image_epoch(cycle, window, 0);
  if (const auto ok = navigator_->prepare_window(beacon, onboard_clock(scenario_, first)); !ok) return ok;
  if (forecast_) {
    const auto truth = world_.trajectory().state(first);
    if (!truth) return forward(truth);
    if (const auto ok = forecast_->prepare_window(beacon, first, *truth); !ok) return ok;
  }
  for (int k = 0; k < timeline_->images_per_window(); ++k) {
    progress(*timeline_, cycle, window, k, beacon);
    if (const auto ok = take_image(cycle, window, timeline_->image_epoch(cycle, window, k), beacon, roll); !ok)
      return ok;
  }
  return {};
}

Result<void> Flight::take_image(int cycle, int window, Epoch mid_exposure, BodyId beacon, double roll_rad) {
  const auto truth = world_.trajectory().state(mid_exposure);
  if (!truth) return forward(truth);
  const auto before = Clock::now();
  const auto aim = navigator_->aim(beacon, onboard_clock(scenario_, mid_exposure));
  records_.stage_ms_sum.propagate += milliseconds_since(before);
  if (!aim) return forward(aim);
  commanded_R_CN_ = commanded_attitude(*aim, roll_rad, records_.images);
  const Mat3 R_CN = jitter(records_.images) * commanded_R_CN_;
  Event image;
  image.kind = EventKind::image;
  image.epoch = mid_exposure;
  image.cycle = cycle;
  image.window = window;
  image.body = beacon;
  image.image = records_.images++;
  const auto done = options_.level == Level::cov   ? expect(image, *truth, R_CN, beacon)
                    : options_.level == Level::mil ? measure(image, *truth, R_CN, beacon)
                                                   : photograph(image, *truth, R_CN, beacon);
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

Result<void> Flight::measure(Event& image, const State& truth, const Mat3& R_CN, BodyId beacon) {
  const auto planet = world_.planet(beacon, image.epoch, truth);
  if (!planet) return forward(planet);
  const auto pixel = project(believed_camera_.intrinsics, R_CN * planet->direction_N);
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
  navigation::BeaconMeasurement m;
  m.body = beacon;
  m.mid_exposure = onboard_clock(scenario_, image.epoch);
  m.pixel = {pixel->u + noise.x(), pixel->v + noise.y()};
  m.pixel_covariance_px2 = std::max(sigma_px * sigma_px, floor_px * floor_px) * Mat2::Identity();
  m.R_CN = awakening_ ? attitude_among_stars(R_CN, truth.v_m_s, navigator_->filter().state().v_m_s) : R_CN;
  use(image, m);
  image.planet_error_px = noise;
  return {};
}

Result<void> Flight::expect(Event& image, const State& truth, const Mat3& R_CN, BodyId beacon) {
  const auto m = forecast_->measure(beacon, image.epoch, truth, R_CN);
  if (!m) return forward(m);
  use(image, *m);
  image.attitude_sigma_rad = m->attitude_covariance_rad2.diagonal().cwiseSqrt();
  image.stars_matched = forecast_->window().stars;
  return {};
}

void Flight::use(Event& image, const navigation::BeaconMeasurement& m) {
  if (awakening_) {
    awakening_->add(image, m, navigator_->filter().state().v_m_s);
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
}

Result<void> Flight::photograph(Event& image, const State& truth, const Mat3& R_CN, BodyId beacon) {
  const StreamId noise{.seed = options_.seed,
                       .sample = options_.sample,
                       .image = static_cast<std::uint64_t>(image.image),
                       .purpose = "frame"};
  const std::optional<Mat3> commanded =
      scenario_.onboard.vision.prior_attitude ? std::optional<Mat3>(commanded_R_CN_) : std::nullopt;
  return eyes_->photograph(image, onboard_clock(scenario_, image.epoch), truth, R_CN, commanded, beacon, noise,
                           *navigator_, records_, worth_keeping(image),
                           awakening_ ? &awakening_->cold_start() : nullptr);
}

// Pictures for the report: from the middle of windows spread over the mission, first and second beacon in turn.
bool Flight::worth_keeping(const Event& image) const {
  const int kept = static_cast<int>(records_.frames.size());
  if (kept >= options_.keep_frames) return false;
  const int cycle = kept * timeline_->cycles() / options_.keep_frames;
  const int in_window = image.image % timeline_->images_per_window();
  return image.cycle >= cycle && image.window == kept % 2 && in_window == timeline_->images_per_window() / 2;
}

Mat3 Flight::commanded_attitude(const Vec3& aim_N, double roll_rad, int image) const {
  RandomStream stream({.seed = options_.seed,
                       .sample = options_.sample,
                       .image = static_cast<std::uint64_t>(image),
                       .purpose = "pointing"});
  const double sigma = scenario_.conops.dither_px * believed_camera_.intrinsics.plate_scale_rad_px();
  const Vec3 offset(stream.normal(0.0, sigma), stream.normal(0.0, sigma), 0.0);
  const RaDec at = radec_from_direction(aim_N);
  return rotation_exp(offset) * R_CN_from_pointing({at.ra_rad, at.dec_rad, roll_rad});
}

Mat3 Flight::jitter(int image) const {
  RandomStream stream({.seed = options_.seed,
                       .sample = options_.sample,
                       .image = static_cast<std::uint64_t>(image),
                       .purpose = "jitter"});
  const double sigma = scenario_.truth.pointing.jitter_arcsec * kArcsecond;
  return rotation_exp({stream.normal(0.0, sigma), stream.normal(0.0, sigma), stream.normal(0.0, sigma)});
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

Result<void> Flight::record(EventKind kind, int cycle, int window, BodyId body) {
  auto e = event(kind, navigator_->filter().epoch(), cycle, window, body);
  if (!e) return forward(e);
  records_.events.push_back(std::move(*e));
  return {};
}

Result<void> Flight::record_beacons(int cycle, const navigation::BeaconSelection& selection, BodyId first,
                                    BodyId second) {
  BeaconChoice choice;
  choice.cycle = cycle;
  choice.epoch = timeline_->window_begin(cycle, 0);
  choice.first = first;
  choice.second = second;
  if (selection.pair_count > 0) choice.figure_of_merit_km = selection.pairs()[0].figure_of_merit_m * 1e-3;
  for (const navigation::BeaconCandidate& c : selection.candidates()) {
    choice.candidates.push_back({.body = c.body,
                                 .v_mag = c.v_magnitude,
                                 .sun_elongation_deg = c.sun_elongation_rad / kDegree,
                                 .distance_km = c.distance_m * 1e-3,
                                 .visible = c.usable(),
                                 .why_not = c.usable() ? "" : navigation::name(c.verdict)});
  }
  records_.beacons.push_back(std::move(choice));
  return {};
}

void Flight::record_orbits(Epoch begin, Epoch end) {
  for (int planet = 1; planet <= 8; ++planet) {
    for (int i = 0; i <= 150; ++i) {
      const Epoch t = begin + Duration::seconds((end - begin).seconds() * i / 150.0);
      const auto place = world_.ephemeris().state(BodyId{planet}, body::sun, t);
      if (place) records_.planet_tracks_m[planet].push_back(place->p_m);
    }
  }
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
