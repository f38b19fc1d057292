// SPDX-License-Identifier: Apache-2.0
// Figures of the filter, the data, a whole mission, and memory; and what all figures share.
#include <array>
#include <vector>

#include <fmt/format.h>

#include "cli/bench.h"
#include "cli/bench_timing.h"
#include "foundation/math/rotation.h"
#include "onboard/navigation/filter.h"
#include "verification/loop/belief.h"
#include "verification/loop/mission.h"

namespace astronav::cli::bench {
namespace {

constexpr const char* kMission = "earth-mars-ballistic";
constexpr std::uint64_t kSeed = 1;

// The filter as the default mission starts it, but halfway.
Result<navigation::Filter> filter_halfway(const Bench& bench) {
  const auto settings = loop::filter_settings(bench.scenario, bench.believed, loop::Level::sil);
  if (!settings) return forward(settings);
  const scenario::OnboardFilter& belief = bench.scenario.onboard.filter;
  const double sigma_p = belief.initial_position_sigma_km * 1e3, sigma_v = belief.initial_velocity_sigma_km_s * 1e3;
  navigation::InitialState initial;
  initial.epoch = bench.epoch;
  initial.state = bench.observer_O;
  initial.covariance.diagonal() << Vec3::Constant(sigma_p * sigma_p), Vec3::Constant(sigma_v * sigma_v);
  initial.mass_kg = loop::kBelievedMassKg;
  navigation::Filter filter(*settings, bench.world->ephemeris());
  if (const auto ok = filter.initialise(initial); !ok) return forward(ok);
  return filter;
}

// A planet seen where the filter expects it, at the centre of the image.
Result<navigation::BeaconMeasurement> look_at(const navigation::Filter& filter, BodyId body, const Intrinsics& camera) {
  const auto expected = filter.predict_direction(body);
  if (!expected) return forward(expected);
  const RaDec at = radec_from_direction(expected->direction_N);
  navigation::BeaconMeasurement m;
  m.body = body;
  m.mid_exposure = filter.epoch();
  m.pixel = {camera.cx_px, camera.cy_px};
  m.pixel_covariance_px2 = 0.05 * 0.05 * Mat2::Identity();
  m.R_CN = R_CN_from_pointing({at.ra_rad, at.dec_rad, 0.0});
  m.attitude_covariance_rad2 = 1e-11 * Mat3::Identity();
  return m;
}

}  // namespace

Result<Bench> Bench::create() {
  const auto draft = scenario::Draft::read(kMission);
  if (!draft) return forward(draft);
  auto scenario = draft->resolve(kSeed);
  if (!scenario) return forward(scenario);
  Bench bench;
  bench.scenario = std::move(*scenario);
  // Frames of single figures have the stars that they had in all versions; the mission has its own sky.
  scenario::Scenario frames = bench.scenario;
  frames.sky.max_v_mag = 8.0;
  auto world = loop::World::create(frames, kSeed, 0);
  if (!world) return forward(world);
  bench.world = std::move(*world);
  auto camera = scenario::onboard_camera(bench.scenario);
  if (!camera) return forward(camera);
  bench.believed = std::move(*camera);
  const trajectory::Trajectory& trajectory = bench.world->trajectory();
  bench.epoch = trajectory.begin() + Duration::seconds(0.5 * (trajectory.end() - trajectory.begin()).seconds());
  const auto state = trajectory.state(bench.epoch);
  if (!state) return forward(state);
  bench.observer_O = *state;
  return bench;
}

Result<Figure> filter_update_us(Bench& bench) {
  const auto start = filter_halfway(bench);
  if (!start) return forward(start);
  const auto m = look_at(*start, body::mars, bench.believed.intrinsics);
  if (!m) return forward(m);
  // As many in a row as a window has; copying the filter back is a small share of that.
  constexpr int kInWindow = 36;
  navigation::Filter filter = *start;
  int updates = 0, taken = 0;
  const Timing timing = measure([&] {
    if (updates++ % kInWindow == 0) filter = *start;
    taken += filter.update(*m).accepted;
  });
  if (taken != updates)
    return fail(ErrorCode::internal, "the filter took {0} of {1} perfect sights", {double(taken), double(updates)});
  return Figure{timing.median_s() * 1e6, "us", "one planet's pixel into all states; " + spread(timing, 1e6, "us")};
}

Result<Figure> propagate_10d_ms(Bench& bench) {
  const auto start = filter_halfway(bench);
  if (!start) return forward(start);
  Result<void> ok;
  const Timing timing = measure([&] {
    navigation::Filter filter = *start;
    if (auto done = filter.propagate_to(bench.epoch + Duration::days(10.0)); !done) ok = done;
  });
  if (!ok) return forward(ok);
  return Figure{timing.median_s() * 1e3, "ms",
                "state and covariance over ten days' coast; " + spread(timing, 1e3, "ms")};
}

Result<Figure> ephemeris_states_per_s(Bench& bench) {
  const Ephemeris& ephemeris = bench.world->ephemeris();
  constexpr std::array bodies{
      body::mercury,           body::venus, body::earth, body::moon, body::mars_barycenter, body::jupiter_barycenter,
      body::saturn_barycenter, body::sun};
  const auto span = ephemeris.span(body::sun);
  if (!span) return forward(span);
  RandomStream random({.seed = kSeed, .purpose = "bench epochs"});
  std::vector<Epoch> epochs(4096);
  for (Epoch& epoch : epochs)
    epoch = span->begin + Duration::seconds(random.uniform(0.0, (span->end - span->begin).seconds()));
  Result<void> ok;
  std::size_t k = 0;
  const Timing timing = measure([&] {
    const auto state =
        ephemeris.state(bodies[k % bodies.size()], body::solar_system_barycenter, epochs[k % epochs.size()]);
    ++k;
    if (!state) ok = forward(state);
    keep(state);
  });
  if (!ok) return forward(ok);
  return Figure{
      1.0 / timing.median_s(), "1/s",
      "eight bodies in turn about the barycentre, random epochs of fifty years; " + spread(timing, 1e9, "ns a state")};
}

Result<Figure> cone_search_us(Bench& bench) {
  const StarCatalogue& catalogue = bench.world->catalogue();
  RandomStream random({.seed = kSeed, .purpose = "bench cones"});
  std::vector<Vec3> centers(1024);
  for (Vec3& center : centers) center = Vec3(random.normal(), random.normal(), random.normal()).normalized();
  std::vector<std::uint32_t> out(20000);
  std::size_t k = 0, found = 0;
  const Timing timing =
      measure([&] { found += catalogue.cone(centers[k++ % centers.size()], 14.1 * kDegree, 7.0, out); });
  return Figure{timing.median_s() * 1e6, "us",
                fmt::format("radius 14.1 degrees, V 7, random centres, {:.0f} stars each; {}",
                            static_cast<double>(found) / static_cast<double>(k), spread(timing, 1e6, "us"))};
}

// Once only: it takes as long as all the others together.
Result<Figure> mission_s(Bench& bench) {
  loop::FlyOptions options;
  options.level = loop::Level::sil;
  options.seed = kSeed;
  options.progress = bench.progress;
  const double before = seconds_now(), processor_before = processor_seconds_now();
  const auto records = loop::fly(bench.scenario, options);
  if (!records) return forward(records);
  const double wall = seconds_now() - before;
  return Figure{
      wall, "s",
      fmt::format("{}, sil, seed {}, one run: {:.0f} days, {} images; processor time {:.4g} s", kMission, kSeed,
                  records->duration_days, records->images, processor_seconds_now() - processor_before)};
}

Result<Figure> onboard_memory_mb(Bench& bench) {
  const auto eyes = OnboardEyes::create(bench);
  if (!eyes) return forward(eyes);
  const OnboardEyes& e = **eyes;
  const auto megabytes = [](std::size_t bytes) { return static_cast<double>(bytes) * 1e-6; };
  const std::size_t filter = sizeof(navigation::Filter);
  const std::size_t frame =
      sizeof(std::uint16_t) * bench.believed.intrinsics.width_px * bench.believed.intrinsics.height_px;
  return Figure{
      megabytes(e.field_size + e.neighbours_size + e.index_size + e.vision_size + filter), "MB",
      fmt::format("heap in use: star field {:.3g}, fainter neighbours {:.3g}, pair index {:.3g}, vision {:.3g}, filter "
                  "{:.3g}; without the frame ({:.3g}), mapped files and code",
                  megabytes(e.field_size), megabytes(e.neighbours_size), megabytes(e.index_size),
                  megabytes(e.vision_size), megabytes(filter), megabytes(frame))};
}

}  // namespace astronav::cli::bench
