// SPDX-License-Identifier: Apache-2.0
// astronav trajectory fly: what becomes of a plan under the true forces, with errors drawn from a seed.
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "cli/answers.h"
#include "cli/inputs.h"
#include "cli/outputs.h"
#include "cli/trajectory_design.h"
#include "cli/validators.h"
#include "foundation/files/mapped_file.h"
#include "simulator/trajectory/flown.h"
#include "simulator/trajectory/trajectory.h"

namespace astronav::cli {
namespace {

using Json = nlohmann::ordered_json;

struct FlyOptions {
  std::string cruise;
  double days = 0.0;
  std::string plan;
  double acceleration_m_s2 = 0.0;
  double thrust_percent = 0.0;
  double thrust_deg = 0.0;
  bool kicks = false;
  double cr_area_mass = 0.026;
  double srp_scale = 1.0;
  std::uint64_t seed = 1;
  std::string step = "6h";
  std::string out;
  std::vector<std::string> kernels;
  bool json = false;
};

Result<trajectory::FlightPlan> plan_of(const FlyOptions& options, const trajectory::Trajectory& planned) {
  auto plan = trajectory::plan_along(planned);
  if (!plan) return forward(plan, options.cruise);
  if (options.days > 0.0) plan->end = plan->begin + Duration::days(options.days);
  if (!options.plan.empty()) {
    const auto file = MappedFile::open(options.plan);
    if (!file) return forward(file, options.plan);
    auto thrust = parse_thrust_plan(file->text(), options.plan);
    if (!thrust) return forward(thrust);
    plan->thrust = std::move(*thrust);
  }
  return plan;
}

Result<int> run_fly(const FlyOptions& options) {
  const auto step = parse_duration(options.step);
  if (!step) return forward(step, "--step");
  const auto kernels = open_kernels(options.kernels);
  if (!kernels) return forward(kernels);
  if (const auto ok = check_writable({options.out}); !ok) return forward(ok);
  const auto file = MappedFile::open(options.cruise);
  if (!file) return forward(file, options.cruise);
  const auto cruise = parse_oem(file->text(), options.cruise);
  if (!cruise) return forward(cruise);
  const auto planned = trajectory::from_oem(*cruise, &(*kernels)->ephemeris);
  if (!planned) return forward(planned, options.cruise);
  const auto plan = plan_of(options, **planned);
  if (!plan) return forward(plan);

  dynamics::ForceSettings forces;
  forces.srp_cr_area_over_mass_m2_kg = options.cr_area_mass;
  forces.srp_scale = options.srp_scale;
  trajectory::Disturbances disturbances;
  disturbances.unmodelled.sigma_m_s2 = options.acceleration_m_s2;
  disturbances.thrust.magnitude_sigma = options.thrust_percent * 1e-2;
  disturbances.thrust.pointing_sigma_rad = options.thrust_deg * kDegree;
  disturbances.unloading = options.kicks;
  const auto flight = trajectory::fly((*kernels)->ephemeris, forces, *plan, disturbances, options.seed, 0);
  if (!flight) return forward(flight);
  const std::size_t kicks = flight->forces.events().kicks.list().size();
  const double mass_kg = plan->thrust.arcs.empty() ? 0.0 : flight->forces.mass_kg(plan->end);
  if (!options.out.empty()) {
    auto oem = cruise_message(flight->arc, plan->begin, plan->end, *step);
    if (!oem) return forward(oem);
    oem->object_name = cruise->object_name;
    oem->object_id = cruise->object_id;
    if (const auto written = write_oem(options.out, std::move(*oem)); !written) return forward(written);
  }
  // How far from what was planned, where the plan reaches that far.
  const auto there = (*planned)->state(plan->end);
  const State last = flight->arc.at(plan->end).value();
  const double off_km = there ? (last.p_m - there->p_m).norm() * 1e-3 : 0.0;
  if (options.json) {
    fmt::print("{}\n", Json{{"begin_tdb", tdb(plan->begin)},
                            {"end_tdb", tdb(plan->end)},
                            {"seed", options.seed},
                            {"kicks", kicks},
                            {"mass_kg", mass_kg > 0.0 ? Json(mass_kg) : Json(nullptr)},
                            {"off_plan_km", there ? Json(off_km) : Json(nullptr)},
                            {"position_km", xyz(last.p_m, 1e3)},
                            {"velocity_km_s", xyz(last.v_m_s, 1e3)},
                            {"out", path_or_null(options.out)}}
                           .dump());
    return 0;
  }
  fmt::print("flown from {} to {} TDB, seed {}\n", tdb(plan->begin), tdb(plan->end), options.seed);
  if (there) fmt::print("{:.3f} km from the place that was planned for then\n", off_km);
  if (mass_kg > 0.0) fmt::print("{:.4f} kg are left\n", mass_kg);
  if (options.kicks) fmt::print("{} kicks\n", kicks);
  if (!options.out.empty()) fmt::print("written to {}\n", options.out);
  return 0;
}

}  // namespace

void add_trajectory_fly(CLI::App& trajectory, Invocation& invocation) {
  auto o = std::make_shared<FlyOptions>();
  CLI::App* app = trajectory.add_subcommand("fly", "what becomes of a planned cruise under the true forces");
  app->footer(
      "Example:\n  astronav trajectory fly c.oem --plan c.csv --thrust-percent 0.5 --thrust-deg 0.3 --out f.oem");
  app->add_option("cruise", o->cruise, "OEM that was planned: its first state is flown")->required();
  app->add_option("--plan", o->plan, "thrust plan (CSV)");
  app->add_option("--days", o->days, "default: as long as the OEM")->check(number_within(1e-3, 1e5));
  app->add_option("--acceleration", o->acceleration_m_s2, "unmodelled, 1 sigma per axis, m/s2 (5 days correlated)")
      ->capture_default_str()
      ->check(number_within(0.0, 1e-3));
  app->add_option("--thrust-percent", o->thrust_percent, "error of the thrust's size, 1 sigma")
      ->capture_default_str()
      ->check(number_within(0.0, 50.0));
  app->add_option("--thrust-deg", o->thrust_deg, "error of its direction, 1 sigma per axis")
      ->capture_default_str()
      ->check(number_within(0.0, 30.0));
  app->add_flag("--kicks", o->kicks, "momentum unloading: 2 to 13 mm/s every 1 to 5 days");
  app->add_option("--cr-area-mass", o->cr_area_mass, "CR A/m, m2/kg")
      ->capture_default_str()
      ->check(number_within(0.0, 100.0));
  app->add_option("--srp-scale", o->srp_scale, "of solar pressure")
      ->capture_default_str()
      ->check(number_within(0.0, 100.0));
  app->add_option("--seed", o->seed, "of everything random")->capture_default_str()->check(seed_number());
  app->add_option("--out", o->out, "OEM to write");
  app->add_option("--step", o->step, "between its states")->capture_default_str();
  app->add_option("--kernel", o->kernels, "SPK files in place of DE405; later ones take precedence");
  app->add_flag("--json", o->json, "one JSON object");
  app->callback([o, &invocation] { invocation.action = [o] { return run_fly(*o); }; });
}

}  // namespace astronav::cli
