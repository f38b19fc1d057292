// SPDX-License-Identifier: Apache-2.0
#include <memory>
#include <string>
#include <vector>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "cli/answers.h"
#include "cli/command.h"
#include "cli/commands.h"
#include "cli/mission_inputs.h"
#include "cli/validators.h"
#include "foundation/math/rotation.h"
#include "onboard/executive/timeline.h"
#include "onboard/navigation/beacons.h"
#include "onboard/navigation/filter.h"
#include "verification/loop/belief.h"
#include "verification/loop/world.h"
#include "verification/scenario/scenario.h"

namespace astronav::cli {
namespace {

using navigation::BeaconCandidate;
using navigation::BeaconPair;
using navigation::BeaconSelection;
using navigation::BeaconVerdict;
using Json = nlohmann::ordered_json;

struct Options {
  std::string scenario = "earth-mars-ballistic";
  std::vector<std::string> set;
  std::uint64_t seed = 1;
  std::string mode;  // empty: as the scenario says
  bool json = false;
};

struct Cycle {
  int number;
  Epoch epoch;
  double day;  // since departure
  BeaconSelection selection;
};

char symbol(const BeaconCandidate& c, const BeaconPair* best) {
  if (best && c.body == best->first) return '1';
  if (best && c.body == best->second) return '2';
  switch (c.verdict) {
    case BeaconVerdict::usable:
      return 'o';
    case BeaconVerdict::sun_exclusion:
      return 's';
    case BeaconVerdict::too_faint:
      return 'f';
    case BeaconVerdict::too_large:
      return 'l';
    case BeaconVerdict::blended:
      return 'c';
    case BeaconVerdict::no_ephemeris:
      return '?';
  }
  return ' ';
}

// "mercury: Sun exclusion (21.3 deg)"
std::string reason(const BeaconCandidate& c) {
  const std::string text = fmt::format("{}: {}", body_name(c.body), navigation::name(c.verdict));
  switch (c.verdict) {
    case BeaconVerdict::sun_exclusion:
      return fmt::format("{} ({:.1f} deg)", text, c.sun_elongation_rad / kDegree);
    case BeaconVerdict::too_faint:
      return fmt::format("{} (V {:.1f})", text, c.v_magnitude);
    case BeaconVerdict::too_large:
      return fmt::format("{} ({:.0f} arcsec)", text, c.angular_diameter_rad / kArcsecond);
    case BeaconVerdict::blended:
      return fmt::format("{} ({}, {:.0f} arcsec)", text, body_name(c.nearest), c.nearest_rad / kArcsecond);
    default:
      return text;
  }
}

const BeaconPair* best_of(const BeaconSelection& selection) {
  return selection.pair_count > 0 ? &selection.pairs().front() : nullptr;
}

Json to_json(const Cycle& cycle) {
  const BeaconPair* best = best_of(cycle.selection);
  Json candidates = Json::array();
  for (const BeaconCandidate& c : cycle.selection.candidates()) {
    candidates.push_back({{"body", body_name(c.body)},
                          {"usable", c.usable()},
                          {"reason", navigation::name(c.verdict)},
                          {"magnitude_v", c.v_magnitude},
                          {"sun_elongation_deg", c.sun_elongation_rad / kDegree},
                          {"distance_km", c.distance_m * 1e-3},
                          {"phase_angle_deg", c.phase_angle_rad / kDegree},
                          {"angular_diameter_arcsec", c.angular_diameter_rad / kArcsecond},
                          {"nearest_arcsec", c.nearest_rad / kArcsecond}});
  }
  return {{"cycle", cycle.number},
          {"epoch_tdb", tdb(cycle.epoch)},
          {"day", cycle.day},
          {"first", best ? Json(body_name(best->first)) : Json(nullptr)},
          {"second", best ? Json(body_name(best->second)) : Json(nullptr)},
          {"separation_deg", best ? Json(best->separation_rad / kDegree) : Json(nullptr)},
          {"figure_of_merit_km", best ? Json(best->figure_of_merit_m * 1e-3) : Json(nullptr)},
          {"filter_merit_km", best ? Json(best->filter_merit_m * 1e-3) : Json(nullptr)},
          {"slew_s", best ? Json(best->slew_s) : Json(nullptr)},
          {"candidates", candidates}};
}

void print_table(const std::vector<Cycle>& cycles) {
  fmt::print("{:>5} {:>6}  {:<10} {:<17} {:>8} {:>6} {:>9} {:>9}  left out\n", "cycle", "day", "date", "beacons",
             "apart", "slew", "merit", "filter");
  for (const Cycle& cycle : cycles) {
    std::string left_out;
    for (const BeaconCandidate& c : cycle.selection.candidates()) {
      if (!c.usable()) left_out += (left_out.empty() ? "" : ", ") + reason(c);
    }
    const BeaconPair* best = best_of(cycle.selection);
    const BeaconCandidate* single = cycle.selection.best_single();
    const std::string names = best ? fmt::format("{}, {}", body_name(best->first), body_name(best->second))
                                   : (single ? std::string(body_name(single->body)) : std::string("none"));
    fmt::print("{:>5} {:>6.1f}  {:<10} {:<17} {:>8} {:>6} {:>9} {:>9}  {}\n", cycle.number + 1, cycle.day,
               cycle.epoch.iso(TimeScale::tdb, 0, false).substr(0, 10), names,
               best ? fmt::format("{:.1f} deg", best->separation_rad / kDegree) : "-",
               best ? fmt::format("{:.0f} s", best->slew_s) : "-",
               best ? fmt::format("{:.0f} km", best->figure_of_merit_m * 1e-3) : "-",
               best ? fmt::format("{:.0f} km", best->filter_merit_m * 1e-3) : "-", left_out);
  }
}

void print_plot(const std::vector<Cycle>& cycles) {
  fmt::print(
      "\nOne column a cycle: 1 2 tracked, o usable, s near the Sun, f faint, l large, c close to another body\n");
  const auto& first = cycles.front().selection;
  for (int row = 0; row < first.candidate_count; ++row) {
    std::string line;
    for (const Cycle& cycle : cycles) line += symbol(cycle.selection.all[row], best_of(cycle.selection));
    fmt::print("{:>9} {}\n", body_name(first.all[row].body), line);
  }
}

// The filter that would fly along, for its covariance alone: one sight a window, as good as the merits assume, and no
// innovation ever.
class Companion {
 public:
  static Result<std::unique_ptr<Companion>> start(const scenario::Scenario& scenario, const Camera& camera,
                                                  const loop::World& world, double sight_sigma_rad) {
    const auto settings = loop::filter_settings(scenario, camera, loop::Level::mil);
    if (!settings) return forward(settings);
    std::unique_ptr<Companion> out(new Companion(*settings, world.ephemeris(), sight_sigma_rad));
    const Epoch begin = world.trajectory().begin();
    const auto state = world.trajectory().state(begin);
    if (!state) return forward(state);
    navigation::InitialState initial{.epoch = begin, .state = *state, .mass_kg = loop::kBelievedMassKg};
    const auto& belief = scenario.onboard.filter;
    for (int axis = 0; axis < 6; ++axis) {
      const double sigma = axis < 3 ? belief.initial_position_sigma_km * 1e3 : belief.initial_velocity_sigma_km_s * 1e3;
      initial.covariance(axis, axis) = sigma * sigma;
    }
    if (const auto started = out->filter_.initialise(initial); !started) return forward(started);
    return out;
  }

  Result<Mat6> covariance_at(Epoch epoch) {
    if (const auto moved = filter_.propagate_to(epoch); !moved) return forward(moved);
    return filter_.covariance_pv();
  }
  void see(BodyId body, Epoch epoch) {
    if (!filter_.propagate_to(epoch)) return;
    const auto direction = filter_.predict_direction(body);
    if (!direction) return;
    const Intrinsics& camera = filter_.settings().camera;
    const RaDec aim = radec_from_direction(direction->direction_N);
    navigation::BeaconMeasurement m;
    m.body = body;
    m.mid_exposure = epoch;
    m.R_CN = R_CN_from_pointing({aim.ra_rad, aim.dec_rad, 0.0});
    m.pixel = {camera.cx_px, camera.cy_px};
    const double sigma_px = sight_sigma_rad_ * camera.fx_px;
    m.pixel_covariance_px2 = Mat2::Identity() * sigma_px * sigma_px;
    filter_.update(m);
  }

 private:
  Companion(const navigation::FilterSettings& settings, const Ephemeris& ephemeris, double sight_sigma_rad)
      : filter_(settings, ephemeris), sight_sigma_rad_(sight_sigma_rad) {}
  navigation::Filter filter_;
  double sight_sigma_rad_;
};

Result<int> run(const Options& options) {
  const auto draft = read_draft(options.scenario, options.set);
  if (!draft) return forward(draft);
  auto scenario = draft->resolve(options.seed);
  if (!scenario) return forward(scenario);
  const auto camera = scenario::onboard_camera(*scenario);
  if (!camera) return forward(camera);
  const auto world = loop::World::create(*scenario, options.seed, 0);
  if (!world) return forward(world);
  const auto cycle_settings = loop::cycle_settings(*scenario);
  if (!cycle_settings) return forward(cycle_settings);
  if (!options.mode.empty()) scenario->onboard.beacons.merit = options.mode;
  const navigation::BeaconSettings settings = loop::beacon_settings(*scenario, *camera);
  const auto companion = Companion::start(*scenario, *camera, **world, settings.sight_sigma_rad);
  if (!companion) return forward(companion);

  const trajectory::Trajectory& trajectory = (*world)->trajectory();
  const Epoch first_window = trajectory.begin() + Duration::days(scenario->conops.first_window_day);
  const executive::Timeline timeline(*cycle_settings, first_window, trajectory.end());
  std::vector<Cycle> cycles;
  for (int i = 0; i < timeline.cycles(); ++i) {
    const Epoch epoch = timeline.window_begin(i, 0);
    const auto state = trajectory.state(epoch);
    if (!state) return forward(state);
    const auto covariance = (*companion)->covariance_at(epoch);
    if (!covariance) return forward(covariance);
    const auto selection = navigation::select_beacons((*world)->ephemeris(), *state, epoch, settings, &*covariance);
    if (!selection) return forward(selection);
    const BeaconPair* pair = best_of(*selection);
    const BeaconCandidate* single = selection->best_single();
    for (int window = 0; window < 2; ++window) {
      const Duration half = Duration::nanoseconds(cycle_settings->tracking.nanoseconds() / 2);
      if (pair != nullptr)
        (*companion)->see(window == 0 ? pair->first : pair->second, timeline.window_begin(i, window) + half);
      else if (single != nullptr && window == 0)
        (*companion)->see(single->body, timeline.window_begin(i, window) + half);
    }
    cycles.push_back({i, epoch, (epoch - scenario->mission.departure).days(), *selection});
    if (options.json) fmt::print("{}\n", to_json(cycles.back()).dump());
  }
  if (cycles.empty())
    return fail(ErrorCode::out_of_range, "the trajectory of {0} days has no room for one navigation cycle",
                {(trajectory.end() - trajectory.begin()).days()}, options.scenario);
  if (!options.json) {
    fmt::print(
        "Beacons of {} (Sun exclusion {:.0f} deg, V to {:.1f}; merit: sigma of a fix by {:.0f} arcsec sights,\n  "
        "filter: of the filter after them)\n",
        scenario->mission.name, settings.sun_exclusion_rad / kDegree, settings.v_magnitude_limit,
        settings.sight_sigma_rad / kArcsecond);
    print_table(cycles);
    print_plot(cycles);
  }
  return 0;
}

}  // namespace

void add_beacons(CLI::App& app, Invocation& invocation) {
  auto options = std::make_shared<Options>();
  CLI::App* sub = app.add_subcommand("beacons", "which planets to track when, and why");
  sub->footer("Example:\n  astronav beacons earth-mars-ballistic --set conops.sun_exclusion_deg=20");
  sub->add_option("scenario", options->scenario, "TOML file, or the name of one in scenarios/")->capture_default_str();
  sub->add_option("--set", options->set, "key=value, any key of the scenario; may be repeated")
      ->allow_extra_args(false);
  sub->add_option("--seed", options->seed, "for scenarios with distributions")
      ->check(seed_number())
      ->capture_default_str();
  sub->add_option("--mode", options->mode, "onboard.beacons.merit: by two sights alone, or by what the filter has then")
      ->check(CLI::IsMember({"static", "filter"}));
  sub->add_flag("--json", options->json, "one JSON object a navigation cycle");
  sub->callback([options, &invocation] { invocation.action = [options] { return run(*options); }; });
}

}  // namespace astronav::cli
