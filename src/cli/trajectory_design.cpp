// SPDX-License-Identifier: Apache-2.0
#include "cli/trajectory_design.h"

#include <chrono>
#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include <fmt/chrono.h>
#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "cli/answers.h"
#include "cli/inputs.h"
#include "cli/outputs.h"
#include "cli/validators.h"
#include "foundation/files/mapped_file.h"
#include "simulator/trajectory/trajectory.h"
#include "simulator/transfer/ballistic.h"
#include "simulator/transfer/low_thrust.h"
#include "simulator/transfer/porkchop.h"

namespace astronav::cli {
namespace {

using Json = nlohmann::ordered_json;

// What every transfer is asked for.
struct TransferOptions {
  std::string from = "earth";
  std::string to = "mars";
  std::string departure;
  std::vector<std::string> kernels;
  bool json = false;
};

struct DesignOptions : TransferOptions {
  double days = 0.0;
  double miss_km = 0.0;
  double coast_in_days = 3.0;
  double coast_out_days = 3.0;
  std::string step = "6h";
  std::string out;
};

struct Ends {
  BodyId from, to;
  Epoch departure;
};
Result<Ends> parse_ends(const TransferOptions& options) {
  const auto from = parse_body(options.from);
  if (!from) return forward(from, "--from");
  const auto to = parse_body(options.to);
  if (!to) return forward(to, "--to");
  const auto departure = Epoch::parse(options.departure);
  if (!departure) return forward(departure, "--departure");
  return Ends{*from, *to, *departure};
}

// The cruise of a design as a message, named by its two ends.
Result<void> write_design(const std::string& path, const dynamics::Arc& arc, Epoch begin, Epoch end, Duration step,
                          const Ends& ends) {
  if (path.empty()) return {};
  auto oem = cruise_message(arc, begin, end, step);
  if (!oem) return forward(oem);
  oem->object_name = fmt::format("{} to {}", title(ends.from), title(ends.to));
  return write_oem(path, std::move(*oem));
}

Result<int> run_design(const DesignOptions& options) {
  const auto ends = parse_ends(options);
  if (!ends) return forward(ends);
  const auto& [from, to, departure] = *ends;
  const auto step = parse_duration(options.step);
  if (!step) return forward(step, "--step");
  const auto kernels = open_kernels(options.kernels);
  if (!kernels) return forward(kernels);

  if (const auto ok = check_writable({options.out}); !ok) return forward(ok);

  transfer::BallisticSettings settings;
  settings.miss_distance_m = options.miss_km * 1e3;
  settings.coast_in = Duration::days(options.coast_in_days);
  settings.coast_out = Duration::days(options.coast_out_days);
  auto design =
      transfer::design_ballistic((*kernels)->ephemeris, from, to, departure, Duration::days(options.days), settings);
  if (!design) return forward(design);
  if (const auto written = write_design(options.out, design->arc, design->begin, design->end, *step, *ends); !written)
    return forward(written);

  const double v_departure = design->v_infinity_departure_m_s.norm() * 1e-3;
  const double v_arrival = design->v_infinity_arrival_m_s.norm() * 1e-3;
  if (options.json) {
    fmt::print("{}\n", Json{{"from", title(from)},
                            {"to", title(to)},
                            {"departure_tdb", tdb(design->departure)},
                            {"arrival_tdb", tdb(design->arrival)},
                            {"duration_days", options.days},
                            {"c3_km2_s2", design->c3_m2_s2 * 1e-6},
                            {"v_infinity_departure_km_s", v_departure},
                            {"v_infinity_arrival_km_s", v_arrival},
                            {"closest_approach_km", design->closest_approach_m * 1e-3},
                            {"miss_distance_km", design->miss_distance_m * 1e-3},
                            {"aim_error_km", design->aim_error_m * 1e-3},
                            {"iterations", design->iterations},
                            {"begin_tdb", tdb(design->begin)},
                            {"end_tdb", tdb(design->end)},
                            {"position_km", xyz(design->initial.p_m, 1e3)},
                            {"velocity_km_s", xyz(design->initial.v_m_s, 1e3)},
                            {"out", path_or_null(options.out)}}
                           .dump());
    return 0;
  }
  const Vec3 p = design->initial.p_m * 1e-3, v = design->initial.v_m_s * 1e-3;
  fmt::print("{} to {}, ballistic, {:.3f} days\n", title(from), title(to), options.days);
  fmt::print("departure         {} TDB  v-infinity {:.4f} km/s, C3 {:.4f} km2/s2\n", tdb(design->departure),
             v_departure, design->c3_m2_s2 * 1e-6);
  fmt::print("arrival           {} TDB  v-infinity {:.4f} km/s, closest approach {:.0f} km\n", tdb(design->arrival),
             v_arrival, design->closest_approach_m * 1e-3);
  fmt::print("cruise            {} to {} TDB\n", tdb(design->begin), tdb(design->end));
  fmt::print("at its beginning  {:.6f} {:.6f} {:.6f} km\n                  {:.9f} {:.9f} {:.9f} km/s\n", p.x(), p.y(),
             p.z(), v.x(), v.y(), v.z());
  fmt::print("(ICRF, barycentric; found in {} corrections, {:.3f} km from the aim point)\n", design->iterations,
             design->aim_error_m * 1e-3);
  if (!options.out.empty()) fmt::print("written to {}\n", options.out);
  return 0;
}

struct LowThrustOptions : TransferOptions {
  double days = 0.0;
  double mass_kg = 22.0;
  double thrust_mn = 1.9;
  double isp_s = 3000.0;
  double v_departure_km_s = 2.5;
  double v_arrival_km_s = 2.0;
  bool energy = false;
  double cycle_days = 10.0;
  std::string step = "6h";
  std::string out, plan;
};

Result<int> run_low_thrust(const LowThrustOptions& options) {
  const auto ends = parse_ends(options);
  if (!ends) return forward(ends);
  const auto step = parse_duration(options.step);
  if (!step) return forward(step, "--step");
  const auto kernels = open_kernels(options.kernels);
  if (!kernels) return forward(kernels);
  if (const auto ok = check_writable({options.out, options.plan}); !ok) return forward(ok);
  if (const auto ok = check_apart(options.out, options.plan, "--plan"); !ok) return forward(ok);

  transfer::LowThrustSettings settings;
  settings.mass_kg = options.mass_kg;
  settings.force_n = options.thrust_mn * 1e-3;
  settings.specific_impulse_s = options.isp_s;
  settings.v_infinity_departure_m_s = options.v_departure_km_s * 1e3;
  settings.v_infinity_arrival_m_s = options.v_arrival_km_s * 1e3;
  settings.cycle = Duration::days(options.cycle_days);
  if (options.energy) settings.smoothing = 1.0;
  const auto design = transfer::design_low_thrust((*kernels)->ephemeris, ends->from, ends->to, ends->departure,
                                                  Duration::days(options.days), settings);
  if (!design) return forward(design);
  if (const auto written = write_design(options.out, design->arc, design->begin, design->end, *step, *ends); !written)
    return forward(written);
  if (!options.plan.empty()) {
    if (const auto written = write_file(options.plan, to_text(design->plan)); !written)
      return forward(written, options.plan);
  }

  const double v_departure = design->v_infinity_departure_m_s.norm() * 1e-3;
  const double v_arrival = design->v_infinity_arrival_m_s.norm() * 1e-3;
  if (options.json) {
    fmt::print("{}\n",
               Json{{"from", title(ends->from)},
                    {"to", title(ends->to)},
                    {"begin_tdb", tdb(design->begin)},
                    {"end_tdb", tdb(design->end)},
                    {"arrival_tdb", tdb(design->arrival)},
                    {"duration_days", options.days},
                    {"v_infinity_departure_km_s", v_departure},
                    {"v_infinity_arrival_km_s", v_arrival},
                    {"ballistic_v_infinity_departure_km_s", design->lambert.v_infinity_departure_m_s.norm() * 1e-3},
                    {"ballistic_v_infinity_arrival_km_s", design->lambert.v_infinity_arrival_m_s.norm() * 1e-3},
                    {"propellant_kg", design->propellant_kg},
                    {"delta_v_km_s", design->plan.delta_v_m_s() * 1e-3},
                    {"thrust_share", design->thrust_share},
                    {"thrust_arcs", design->plan.arcs.size()},
                    {"closest_approach_km", design->closest_approach_m * 1e-3},
                    {"miss_distance_km", design->miss_distance_m * 1e-3},
                    {"aim_error_km", design->aim_error_m * 1e-3},
                    {"flights", design->flights},
                    {"position_km", xyz(design->initial.p_m, 1e3)},
                    {"velocity_km_s", xyz(design->initial.v_m_s, 1e3)},
                    {"out", path_or_null(options.out)},
                    {"plan", path_or_null(options.plan)}}
                   .dump());
    return 0;
  }
  fmt::print("{} to {}, low thrust, least {}, {:.3f} days\n", title(ends->from), title(ends->to),
             options.energy ? "energy" : "propellant", options.days);
  fmt::print("departure         {} TDB  v-infinity {:.4f} km/s (ballistic {:.4f})\n", tdb(design->begin), v_departure,
             design->lambert.v_infinity_departure_m_s.norm() * 1e-3);
  fmt::print("arrival           {} TDB  v-infinity {:.4f} km/s (ballistic {:.4f})\n", tdb(design->arrival), v_arrival,
             design->lambert.v_infinity_arrival_m_s.norm() * 1e-3);
  fmt::print("thrust            {} arcs, {:.1f} % of the time, {:.4f} km/s, {:.4f} kg of propellant\n",
             design->plan.arcs.size(), 100.0 * design->thrust_share, design->plan.delta_v_m_s() * 1e-3,
             design->propellant_kg);
  fmt::print("cruise            {} to {} TDB\n", tdb(design->begin), tdb(design->end));
  fmt::print("({:.3f} km from the aim point, {:.0f} km beside {}; {} flights)\n", design->aim_error_m * 1e-3,
             design->miss_distance_m * 1e-3, title(ends->to), design->flights);
  for (const std::string& path : {options.out, options.plan}) {
    if (!path.empty()) fmt::print("written to {}\n", path);
  }
  return 0;
}

struct PorkchopOptions : TransferOptions {
  double window_days = 200.0;
  std::vector<double> flight_days = {120.0, 420.0};
  double step_days = 2.0;
  std::string csv, svg;
};

Result<int> run_porkchop(const PorkchopOptions& options) {
  const auto ends = parse_ends(options);
  if (!ends) return forward(ends);
  if (options.flight_days[1] < options.flight_days[0])
    return fail(ErrorCode::invalid_argument, "the longest flight, {0} d, is shorter than the shortest, {1} d",
                {options.flight_days[1], options.flight_days[0]}, "--flight-days");
  const auto kernels = open_kernels(options.kernels);
  if (!kernels) return forward(kernels);
  if (const auto ok = check_writable({options.csv, options.svg}); !ok) return forward(ok);
  if (const auto ok = check_apart(options.csv, options.svg, "--svg"); !ok) return forward(ok);
  const auto chart = transfer::porkchop((*kernels)->ephemeris, ends->from, ends->to,
                                        {.departure_begin = ends->departure,
                                         .departure_end = ends->departure + Duration::days(options.window_days),
                                         .departure_step = Duration::days(options.step_days),
                                         .shortest = Duration::days(options.flight_days[0]),
                                         .longest = Duration::days(options.flight_days[1]),
                                         .flight_step = Duration::days(options.step_days)});
  if (!chart) return forward(chart);
  if (!options.csv.empty()) {
    if (const auto ok = write_file(options.csv, to_csv(*chart)); !ok) return forward(ok, options.csv);
  }
  if (!options.svg.empty()) {
    const std::string heading = fmt::format("{} to {}, ballistic", title(ends->from), title(ends->to));
    if (const auto ok = write_file(options.svg, to_svg(*chart, heading)); !ok) return forward(ok, options.svg);
  }
  const transfer::LambertLeg best = chart->least_c3();
  const double days = (best.arrival - best.departure).days();
  if (options.json) {
    fmt::print("{}\n", Json{{"from", title(ends->from)},
                            {"to", title(ends->to)},
                            {"departures", chart->departures.size()},
                            {"flights", chart->flights.size()},
                            {"least_c3_km2_s2", best.c3_m2_s2() * 1e-6},
                            {"departure_tdb", tdb(best.departure)},
                            {"arrival_tdb", tdb(best.arrival)},
                            {"duration_days", days},
                            {"v_infinity_departure_km_s", best.v_infinity_departure_m_s.norm() * 1e-3},
                            {"v_infinity_arrival_km_s", best.v_infinity_arrival_m_s.norm() * 1e-3},
                            {"csv", path_or_null(options.csv)},
                            {"svg", path_or_null(options.svg)}}
                           .dump());
    return 0;
  }
  fmt::print("{} to {}: {} departures by {} times of flight\n", title(ends->from), title(ends->to),
             chart->departures.size(), chart->flights.size());
  fmt::print("least C3          {:.4f} km2/s2\n", best.c3_m2_s2() * 1e-6);
  fmt::print("departure         {} TDB  v-infinity {:.4f} km/s\n", tdb(best.departure),
             best.v_infinity_departure_m_s.norm() * 1e-3);
  fmt::print("arrival           {} TDB  v-infinity {:.4f} km/s, after {:g} days\n", tdb(best.arrival),
             best.v_infinity_arrival_m_s.norm() * 1e-3, days);
  for (const std::string& path : {options.csv, options.svg}) {
    if (!path.empty()) fmt::print("written to {}\n", path);
  }
  return 0;
}

void add_ends(CLI::App& app, TransferOptions& options, const char* about_departure) {
  app.add_option("--from", options.from, "planet of departure")->capture_default_str();
  app.add_option("--to", options.to, "planet of arrival")->capture_default_str();
  app.add_option("--departure", options.departure, about_departure)->required();
}

void add_kernels_and_json(CLI::App& app, TransferOptions& options) {
  app.add_option("--kernel", options.kernels, "SPK files in place of DE405; later ones take precedence");
  app.add_flag("--json", options.json, "one JSON object");
}

}  // namespace

void add_trajectory_design(CLI::App& trajectory, Invocation& invocation) {
  auto design = std::make_shared<DesignOptions>();
  CLI::App* design_app =
      trajectory.add_subcommand("design", "a ballistic transfer between two planets under all forces");
  design_app->footer(
      "Example:\n  astronav trajectory design --to venus --departure 2028-03-25 --days 172 --out cruise.oem");
  add_ends(*design_app, *design, "ISO 8601 with scale (UTC if none)");
  design_app->add_option("--days", design->days, "from departure to arrival")
      ->required()
      ->check(number_within(1.0, 1e4));
  design_app
      ->add_option("--miss-km", design->miss_km,
                   "aim point from the planet (default: a fifth of its sphere of influence)")
      ->check(number_within(0.0, 1e9));
  design_app->add_option("--coast-in-days", design->coast_in_days, "from departure to where the cruise begins")
      ->capture_default_str()
      ->check(number_within(0.0, 1e4));
  design_app->add_option("--coast-out-days", design->coast_out_days, "from where the cruise ends to arrival")
      ->capture_default_str()
      ->check(number_within(0.0, 1e4));
  design_app->add_option("--out", design->out, "OEM of the cruise to write");
  design_app->add_option("--step", design->step, "between its states")->capture_default_str();
  add_kernels_and_json(*design_app, *design);
  design_app->callback([design, &invocation] { invocation.action = [design] { return run_design(*design); }; });
}

void add_trajectory_low_thrust(CLI::App& trajectory, Invocation& invocation) {
  auto o = std::make_shared<LowThrustOptions>();
  CLI::App* app = trajectory.add_subcommand("low-thrust", "a transfer by an electric engine, with coasts to navigate");
  app->footer("Example:\n  astronav trajectory low-thrust --departure 2026-11-09 --days 300 --out c.oem --plan c.csv");
  add_ends(*app, *o, "ISO 8601 with scale (UTC if none)");
  app->add_option("--days", o->days, "from departure to arrival")->required()->check(number_within(20.0, 2e3));
  app->add_option("--mass-kg", o->mass_kg, "at departure")->capture_default_str()->check(number_within(1e-3, 1e6));
  app->add_option("--thrust-mn", o->thrust_mn, "mN")->capture_default_str()->check(number_within(1e-6, 1e6));
  app->add_option("--isp-s", o->isp_s, "specific impulse")->capture_default_str()->check(number_within(1.0, 1e6));
  app->add_option("--v-departure", o->v_departure_km_s, "most v-infinity that the launcher gives, km/s")
      ->capture_default_str()
      ->check(number_within(0.1, 20.0));
  app->add_option("--v-arrival", o->v_arrival_km_s, "most v-infinity at arrival, km/s")
      ->capture_default_str()
      ->check(number_within(0.0, 50.0));
  app->add_option("--cycle-days", o->cycle_days, "between the coasts of 155 minutes, the first after a day")
      ->capture_default_str()
      ->check(number_within(0.5, 100.0));
  app->add_flag("--energy", o->energy, "least energy (smooth levels) in place of least propellant");
  app->add_option("--out", o->out, "OEM of the cruise to write");
  app->add_option("--plan", o->plan, "thrust plan (CSV) to write");
  app->add_option("--step", o->step, "between the OEM's states")->capture_default_str();
  add_kernels_and_json(*app, *o);
  app->callback([o, &invocation] { invocation.action = [o] { return run_low_thrust(*o); }; });
}

void add_trajectory_porkchop(CLI::App& trajectory, Invocation& invocation) {
  auto o = std::make_shared<PorkchopOptions>();
  CLI::App* app = trajectory.add_subcommand("porkchop", "what ballistic transfers cost, by day and time of flight");
  app->footer("Example:\n  astronav trajectory porkchop --departure 2026-08-15 --svg mars-2026.svg");
  add_ends(*app, *o, "first day, ISO 8601 with scale (UTC if none)");
  app->add_option("--window-days", o->window_days, "from the first departure to the last")
      ->capture_default_str()
      ->check(number_within(0.0, 1e5));
  app->add_option("--flight-days", o->flight_days, "shortest and longest time of flight")
      ->expected(2)
      ->capture_default_str()
      ->check(number_within(1.0, 1e5));
  app->add_option("--step-days", o->step_days, "of both")->capture_default_str()->check(number_within(0.01, 1e4));
  app->add_option("--csv", o->csv, "table to write");
  app->add_option("--svg", o->svg, "picture to write");
  add_kernels_and_json(*app, *o);
  app->callback([o, &invocation] { invocation.action = [o] { return run_porkchop(*o); }; });
}

Result<Oem> cruise_message(const dynamics::Arc& arc, Epoch begin, Epoch end, Duration step) {
  auto oem = trajectory::to_oem(*trajectory::from_arc(arc), begin, end, step);
  if (!oem) return forward(oem, "--step");
  return oem;
}

Result<void> write_oem(const std::string& path, Oem oem) {
  if (std::filesystem::path(path).extension() == ".bsp") {
    return fail(ErrorCode::unsupported, "SPK kernels are not written; give an .oem file to write", {}, path);
  }
  oem.creation_date = fmt::format("{:%Y-%m-%dT%H:%M:%S}", fmt::gmtime(std::chrono::system_clock::now()));
  const auto written = write_file(path, to_text(oem));
  if (!written) return forward(written, path);
  return {};
}

}  // namespace astronav::cli
