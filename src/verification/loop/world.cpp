// SPDX-License-Identifier: Apache-2.0
#include "verification/loop/world.h"

#include <array>
#include <filesystem>
#include <string>
#include <utility>
#include <vector>

#include "foundation/math/random.h"
#include "models/oem/oem.h"
#include "simulator/dynamics/forces.h"
#include "simulator/dynamics/propagation.h"
#include "simulator/trajectory/flown.h"
#include "simulator/transfer/ballistic.h"

namespace astronav::loop {
namespace {

Result<MappedFile> open_or_default(const std::string& name, const char* shipped) {
  return MappedFile::open(name.empty() ? home_directory() / "data" / shipped : std::filesystem::path(name));
}

Result<dynamics::ForceSettings> true_forces(const scenario::TruthDynamics& truth) {
  dynamics::ForceSettings settings;
  settings.bodies = {body::sun};
  for (const std::string& text : truth.bodies) {
    Result<BodyId> id = parse_body(text);
    if (!id) return forward(id, "truth.dynamics.bodies");
    // Systems go by their barycentres, except the Earth and the Moon, which are near enough to matter apart.
    if (*id != body::earth && *id != body::moon && barycenter_of(*id)) id = *barycenter_of(*id);
    if (*id != body::sun) settings.bodies.push_back(*id);
  }
  settings.relativity = truth.relativity;
  settings.srp_cr_area_over_mass_m2_kg = truth.area_to_mass_cr_m2_kg;
  settings.srp_scale = 1.0 + truth.srp_scale_error;
  return settings;
}

// Where planets stand, beside what is believed of it.
std::vector<Ephemeris::Displacement> draw_displacements(const scenario::Scenario& s, std::uint64_t seed,
                                                        std::uint64_t sample) {
  const scenario::OnboardEphemeris& km = s.onboard.ephemeris;
  const std::array<std::pair<BodyId, double>, 7> systems{{{body::mercury_barycenter, km.mercury_km},
                                                          {body::venus_barycenter, km.venus_km},
                                                          {body::earth_moon_barycenter, km.earth_km},
                                                          {body::mars_barycenter, km.mars_km},
                                                          {body::jupiter_barycenter, km.jupiter_km},
                                                          {body::saturn_barycenter, km.saturn_km},
                                                          {body::uranus_barycenter, km.uranus_km}}};
  std::vector<Ephemeris::Displacement> out;
  RandomStream stream({.seed = seed, .sample = sample, .purpose = "places of planets"});
  for (const auto& [system, sigma_km] : systems) {
    const double sigma_m = s.truth.ephemeris.error_scale * sigma_km * 1e3;
    const double along_m = stream.normal(0.0, sigma_m), across_m = stream.normal(0.0, sigma_m);
    out.push_back({system, along_m, across_m});
  }
  return out;
}

// What the ground planned.
Result<trajectory::FlightPlan> planned_transfer(const scenario::Scenario& s, const Ephemeris& ephemeris,
                                                const dynamics::ForceSettings& forces) {
  const Result<BodyId> from = parse_body(s.mission.from);
  if (!from) return forward(from, "mission.from");
  const Result<BodyId> to = parse_body(s.mission.to);
  if (!to) return forward(to, "mission.to");
  transfer::BallisticSettings settings;
  settings.forces = forces;
  settings.forces.srp_scale = 1.0;
  const auto design =
      transfer::design_ballistic(ephemeris, *from, *to, s.mission.departure, Duration::days(s.mission.days), settings);
  if (!design) return forward(design, "mission");
  return trajectory::FlightPlan{design->begin, design->end, design->initial};
}

Result<trajectory::FlightPlan> planned_thrust(const scenario::Mission& mission,
                                              const trajectory::Trajectory& designed) {
  const auto file = MappedFile::open(mission.thrust_plan);
  if (!file) return forward(file);
  auto thrust = parse_thrust_plan(file->text(), file->path().string());
  if (!thrust) return forward(thrust);
  return trajectory::plan_along(designed, std::move(*thrust));
}

Result<trajectory::TrajectoryPtr> read_trajectory(const scenario::Mission& mission, const MappedFile& file,
                                                  const MappedFile& kernel, const Ephemeris& ephemeris) {
  const std::string where = file.path().string();
  if (file.text().substr(0, 7) == "DAF/SPK") {
    // Alone first, so that a broken file is told by its own name and bytes.
    if (const auto alone = Ephemeris::open(file.bytes()); !alone) return forward(alone, where);
    const std::array<std::span<const std::byte>, 2> kernels{kernel.bytes(), file.bytes()};
    const auto joined = Ephemeris::open(kernels);
    if (!joined) return forward(joined, where);
    const auto id = parse_body(mission.trajectory_body);
    if (!id) return forward(id, "mission.trajectory_body");
    return trajectory::from_ephemeris(*joined, *id);
  }
  const auto oem = parse_oem(file.text(), where);
  if (!oem) return forward(oem, where);
  return trajectory::from_oem(*oem, &ephemeris);
}

}  // namespace

// What is told, in any direction; `flown` is what becomes of it.
std::optional<dynamics::Kick> World::plan_correction(const trajectory::FlightPlan& plan, std::uint64_t seed,
                                                     std::uint64_t sample, dynamics::Kick& flown) const {
  const double size = upsets_.maneuver_m_s;
  const Epoch begin = plan.begin + Duration::days(upsets_.maneuver_day);
  if (!(size > 0.0) || begin >= plan.end) return std::nullopt;
  RandomStream stream({.seed = seed, .sample = sample, .purpose = "maneuver"});
  const auto draw = [&]() -> Vec3 { return {stream.normal(), stream.normal(), stream.normal()}; };
  const dynamics::Kick told{begin, size * draw().normalized()};
  flown = {begin, told.delta_v_N_m_s};
  if (upsets_.maneuver_errs) flown.delta_v_N_m_s += upsets_.maneuver_error_relative * size * draw();
  return told;
}

Result<void> World::fly(const scenario::Scenario& s, const trajectory::FlightPlan& plan,
                        const dynamics::ForceSettings& forces, std::uint64_t seed, std::uint64_t sample) {
  const scenario::TruthUnloading& unloading = s.truth.unloading;
  dynamics::Kick flown;
  correction_ = plan_correction(plan, seed, sample, flown);
  trajectory::Disturbances disturbances{.unmodelled = {.sigma_m_s2 = s.truth.dynamics.unmodelled_acceleration_m_s2,
                                                       .tau = Duration::days(s.truth.dynamics.unmodelled_tau_days)},
                                        .thrust = {.magnitude_sigma = s.truth.thrust.magnitude_sigma,
                                                   .pointing_sigma_rad = s.truth.thrust.pointing_sigma_deg * kDegree,
                                                   .tau = Duration::days(s.truth.thrust.tau_days)},
                                        .unloading = unloading.on,
                                        .kicks = {.smallest_m_s = unloading.smallest_mm_s * 1e-3,
                                                  .largest_m_s = unloading.largest_mm_s * 1e-3,
                                                  .shortest_pause = Duration::days(unloading.shortest_pause_days),
                                                  .longest_pause = Duration::days(unloading.longest_pause_days)}};
  if (correction_) disturbances.corrections.push_back(flown);
  auto flight = trajectory::fly(ephemeris_, forces, plan, disturbances, seed, sample);
  if (!flight) return forward(flight, "truth");
  thrust_plan_ = plan.thrust;
  kicks_ = flight->forces.events().kicks.list();
  if (correction_) std::erase_if(kicks_, [&](const dynamics::Kick& kick) { return kick.begin == flown.begin; });
  trajectory_ = trajectory::from_arc(std::move(flight->arc));
  return {};
}

Result<std::unique_ptr<World>> World::create(const scenario::Scenario& s, std::uint64_t seed, std::uint64_t sample) {
  std::unique_ptr<World> world(new World);
  world->upsets_ = s.truth.upsets;
  world->clock_offset_s_ = 1e-3 * s.truth.clock.offset_ms;
  auto kernel = open_or_default(s.data.ephemeris_file, "de405_2000_2050.bsp");
  if (!kernel) return forward(kernel);
  world->ephemeris_file_ = std::move(*kernel);
  auto ephemeris = Ephemeris::open(world->ephemeris_file_.bytes());
  if (!ephemeris) return forward(ephemeris, world->ephemeris_file_.path().string());
  world->onboard_ephemeris_ = world->ephemeris_ = std::move(*ephemeris);
  if (!s.data.truth_ephemeris_file.empty()) {
    auto truth = MappedFile::open(s.data.truth_ephemeris_file);
    if (!truth) return forward(truth);
    world->truth_ephemeris_file_ = std::move(*truth);
    auto opened = Ephemeris::open(world->truth_ephemeris_file_.bytes());
    if (!opened) return forward(opened, world->truth_ephemeris_file_.path().string());
    world->ephemeris_ = std::move(*opened);
  } else if (s.truth.ephemeris.error_scale > 0.0) {
    world->ephemeris_ = world->onboard_ephemeris_.displaced(draw_displacements(s, seed, sample));
  }

  auto stars = open_or_default(s.data.catalogue_file, "hipparcos.stars");
  if (!stars) return forward(stars);
  world->catalogue_file_ = std::move(*stars);
  auto catalogue = StarCatalogue::open(world->catalogue_file_.bytes());
  if (!catalogue) return forward(catalogue, world->catalogue_file_.path().string());
  world->catalogue_ = std::move(*catalogue);

  const bool with_thrust = !s.mission.thrust_plan.empty();
  if (!s.mission.trajectory_file.empty()) {
    auto file = MappedFile::open(s.mission.trajectory_file);
    if (!file) return forward(file);
    world->trajectory_file_ = std::move(*file);
    const MappedFile& planets = world->has_own_ephemeris() ? world->truth_ephemeris_file_ : world->ephemeris_file_;
    auto read = read_trajectory(s.mission, world->trajectory_file_, planets, world->ephemeris_);
    if (!read) return forward(read);
    world->trajectory_ = std::move(*read);
  } else if (with_thrust) {
    return fail(ErrorCode::invalid_argument, "a thrust plan needs the state that it begins from: trajectory_file", {},
                "mission.thrust_plan");
  }
  if (world->trajectory_ && !with_thrust && s.truth.unloading.on) {
    return fail(
        ErrorCode::invalid_argument,
        "the trajectory of mission.trajectory_file is flown as it is, and thrusters' kicks cannot be added to it", {},
        "truth.unloading.on");
  }
  if (world->trajectory_ && !with_thrust && s.truth.upsets.maneuver_m_s > 0.0) {
    return fail(ErrorCode::invalid_argument,
                "the trajectory of mission.trajectory_file is flown as it is, and no correction can be added to it", {},
                "truth.upsets.maneuver_m_s");
  }
  if (!world->trajectory_ || with_thrust) {
    const auto forces = true_forces(s.truth.dynamics);
    if (!forces) return forward(forces);
    const auto plan =
        with_thrust ? planned_thrust(s.mission, *world->trajectory_) : planned_transfer(s, world->ephemeris_, *forces);
    if (!plan) return forward(plan);
    if (const auto flown = world->fly(s, *plan, *forces, seed, sample); !flown) return forward(flown);
  }

  auto camera = scenario::truth_camera(s);
  if (!camera) return forward(camera);
  world->camera_ = std::move(*camera);
  world->detector_seed_ = RandomStream({.seed = seed, .sample = sample, .purpose = "detector"}).next();
  world->band_ = std::make_unique<BandPhotometry>(world->camera_);
  world->sky_ = std::make_unique<sky::Sky>(world->ephemeris_, world->catalogue_);
  world->sky_settings_.max_v_mag = s.sky.max_v_mag;
  world->sky_settings_.companion_share = s.sky.companion_share;
  world->sky_settings_.companion_seed = RandomStream({.seed = seed, .sample = sample, .purpose = "companions"}).next();
  world->sky_settings_.centre_of_light = s.truth.photocentre.on;
  const scenario::TruthPhotocentre& light = s.truth.photocentre;
  world->sky_settings_.centre_of_light_scale = light.scale;
  world->sky_settings_.minnaert = light.minnaert;
  world->sky_settings_.own_laws = {{body::mercury, light.mercury}, {body::venus, light.venus},
                                   {body::earth, light.earth},     {body::mars, light.mars},
                                   {body::jupiter, light.jupiter}, {body::saturn, light.saturn}};
  return world;
}

const render::Renderer& World::renderer(Epoch epoch) {
  const bool storm = within(upsets_.storm_day, upsets_.storm_days, epoch);
  std::unique_ptr<render::Renderer>& renderer = storm ? renderer_in_storm_ : renderer_;
  if (!renderer) {
    Camera camera = camera_;
    if (storm) camera.detector.cosmic_rays_cm2_s = upsets_.storm_protons_cm2_s;
    renderer = std::make_unique<render::Renderer>(camera, detector_seed_);
  }
  return *renderer;
}

bool World::within(double begin_day, double days, Epoch epoch) const {
  const double now = (epoch - trajectory_->begin()).days();
  return now >= begin_day && now < begin_day + days;
}

bool World::is_safe(Epoch epoch) const {
  return within(upsets_.safe_mode_day, upsets_.safe_mode_days, epoch);
}

Epoch World::onboard_clock(Epoch epoch) const {
  const bool stepped = (epoch - trajectory_->begin()).days() >= upsets_.clock_step_day;
  return epoch + Duration::seconds(clock_offset_s_ + (stepped ? 1e-3 * upsets_.clock_step_ms : 0.0));
}

Result<State> World::truth_from_onboard_origin(Epoch epoch) const {
  auto truth = trajectory_->state(epoch);
  if (!truth || !has_own_ephemeris()) return truth;
  const auto really = ephemeris_.state(body::sun, body::solar_system_barycenter, epoch);
  const auto onboard = onboard_ephemeris_.state(body::sun, body::solar_system_barycenter, epoch);
  if (!really) return forward(really, "data.truth_ephemeris_file");
  if (!onboard) return forward(onboard);
  truth->p_m += onboard->p_m - really->p_m;
  truth->v_m_s += onboard->v_m_s - really->v_m_s;
  return truth;
}

Result<std::vector<sky::SkySource>> World::planets(Epoch epoch, const State& spacecraft_O, const Vec3& direction_N,
                                                   double radius_rad) const {
  sky::SkySettings no_stars = sky_settings_;
  no_stars.max_v_mag = -30.0;
  return sky_->look(epoch, spacecraft_O, direction_N, radius_rad, *band_, no_stars);
}

Result<sky::SkySource> World::planet(BodyId body, Epoch epoch, const State& spacecraft_O) const {
  const Result<BodyId> known = ephemeris_.resolve(body);
  if (!known) return forward(known);
  const auto state = ephemeris_.state(*known, body::solar_system_barycenter, epoch);
  if (!state) return forward(state);
  const auto seen = planets(epoch, spacecraft_O, (state->p_m - spacecraft_O.p_m).normalized(), 2.0 * kDegree);
  if (!seen) return forward(seen);
  for (const sky::SkySource& source : *seen) {
    if (source.kind == sky::SourceKind::planet && source.id == body.value) return source;
  }
  return fail(ErrorCode::not_found, "the sky has no {s}", {}, {}, body_name(body));
}

}  // namespace astronav::loop
