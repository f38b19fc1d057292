// SPDX-License-Identifier: Apache-2.0
#include <chrono>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <fmt/chrono.h>
#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "cli/answers.h"
#include "cli/command.h"
#include "cli/commands.h"
#include "cli/inputs.h"
#include "cli/trajectory_design.h"
#include "cli/validators.h"
#include "foundation/files/mapped_file.h"
#include "models/oem/oem.h"
#include "simulator/trajectory/trajectory.h"

namespace astronav::cli {
namespace {

using Json = nlohmann::ordered_json;

struct InfoOptions {
  std::string file;
  bool json = false;
};

struct ConvertOptions {
  std::string in;
  std::string out;
  std::string body, center, begin, end, step;
  std::vector<std::string> kernels;
  bool json = false;
};

enum class Kind { spk, oem };

Result<Kind> kind_of(const MappedFile& file) {
  const std::string_view text = file.text();
  if (text.starts_with("DAF/SPK") || text.starts_with("NAIF/DAF")) return Kind::spk;
  const std::size_t first = text.find_first_not_of(" \t\r\n");
  if (first != std::string_view::npos && (text.substr(first).starts_with("CCSDS_OEM_VERS") || text[first] == '<'))
    return Kind::oem;
  return fail(ErrorCode::corrupt_data,
              text.empty() ? "the file is empty; expected an SPK kernel or an Orbit Ephemeris Message (KVN)"
                           : "neither an SPK kernel (DAF/SPK) nor an Orbit Ephemeris Message (CCSDS_OEM_VERS = ...)",
              {}, file.path().string());
}

Result<void> info_of_spk(const InfoOptions& options, const MappedFile& file) {
  const auto ephemeris = Ephemeris::open(file.bytes());
  if (!ephemeris) return forward(ephemeris, options.file);
  if (!options.json) {
    fmt::print("SPK kernel, {} segments\n{:<28} {:<28} {:>4}  {:<23} {:<23}\n", ephemeris->segments().size(), "body",
               "relative to", "type", "begin TDB", "end TDB");
  }
  for (const Ephemeris::Segment& s : ephemeris->segments()) {
    const std::string begin = tdb(Epoch::tdb_seconds(s.begin_tdb_s));
    const std::string end = tdb(Epoch::tdb_seconds(s.end_tdb_s));
    if (options.json) {
      fmt::print("{}\n", Json{{"file", options.file},
                              {"format", "spk"},
                              {"body", title(s.target)},
                              {"body_id", s.target.value},
                              {"center", title(s.center)},
                              {"center_id", s.center.value},
                              {"spk_type", s.type},
                              {"begin_tdb", begin},
                              {"end_tdb", end}}
                             .dump());
    } else {
      fmt::print("{:<28} {:<28} {:>4}  {:<23} {:<23}\n", title(s.target), title(s.center), s.type, begin, end);
    }
  }
  return {};
}

Result<void> info_of_oem(const InfoOptions& options, const MappedFile& file) {
  const auto oem = parse_oem(file.text(), options.file);
  if (!oem) return forward(oem);
  const std::string begin = tdb(oem->epochs.front());
  const std::string end = tdb(oem->epochs.back());
  const double days = (oem->epochs.back() - oem->epochs.front()).days();
  if (options.json) {
    fmt::print("{}\n", Json{{"file", options.file},
                            {"format", "oem"},
                            {"object", oem->object_name},
                            {"object_id", oem->object_id},
                            {"center", title(oem->center)},
                            {"center_id", oem->center.value},
                            {"time_system", name(oem->scale)},
                            {"begin_tdb", begin},
                            {"end_tdb", end},
                            {"duration_days", days},
                            {"states", oem->states.size()},
                            {"covariances", oem->covariances.size()}}
                           .dump());
  } else {
    fmt::print(
        "Orbit Ephemeris Message of {} ({}), by {}\nrelative to {}, time system {}\n{} to {} TDB, {:.3f} days\n"
        "{} states, {} covariances\n",
        oem->object_name, oem->object_id, oem->originator, title(oem->center), name(oem->scale), begin, end, days,
        oem->states.size(), oem->covariances.size());
  }
  return {};
}

Result<int> run_info(const InfoOptions& options) {
  const auto file = MappedFile::open(options.file);
  if (!file) return forward(file, options.file);
  const auto kind = kind_of(*file);
  if (!kind) return forward(kind, options.file);
  const Result<void> done = *kind == Kind::spk ? info_of_spk(options, *file) : info_of_oem(options, *file);
  if (!done) return forward(done, options.file);
  return 0;
}

// The one body a spacecraft's kernel is about, where it is about one.
Result<BodyId> only_target(const Ephemeris& ephemeris, const std::string& path) {
  std::optional<BodyId> target;
  for (const Ephemeris::Segment& s : ephemeris.segments()) {
    if (target && *target != s.target) {
      return fail(ErrorCode::invalid_argument, "the kernel holds several bodies: choose one with --body", {}, path);
    }
    target = s.target;
  }
  if (!target) return fail(ErrorCode::corrupt_data, "the kernel holds no segment", {}, path);
  return *target;
}

// Another centre for states about the barycentre.
Result<void> refer(Oem& oem, BodyId center, const Ephemeris& ephemeris) {
  for (std::size_t i = 0; i < oem.states.size(); ++i) {
    const auto center_O = ephemeris.state(center, body::solar_system_barycenter, oem.epochs[i]);
    if (!center_O) return forward(center_O);
    oem.states[i].p_m -= center_O->p_m;
    oem.states[i].v_m_s -= center_O->v_m_s;
  }
  oem.center = center;
  return {};
}

Result<Oem> resample(const trajectory::Trajectory& trajectory, const ConvertOptions& options) {
  const auto limit = [](const std::string& text, Epoch fallback) -> Result<Epoch> {
    return text.empty() ? Result<Epoch>(fallback) : Epoch::parse(text);
  };
  const auto begin = limit(options.begin, trajectory.begin());
  if (!begin) return forward(begin, "--begin");
  const auto end = limit(options.end, trajectory.end());
  if (!end) return forward(end, "--end");
  const auto step = parse_duration(options.step.empty() ? "1h" : options.step);
  if (!step) return forward(step, "--step");
  return trajectory::to_oem(trajectory, *begin, *end, *step);
}

Result<int> run_convert(const ConvertOptions& options) {
  if (std::filesystem::path(options.out).extension() == ".bsp") {
    return fail(ErrorCode::unsupported, "SPK kernels are not written; give an .oem file to write", {}, options.out);
  }
  const auto file = MappedFile::open(options.in);
  if (!file) return forward(file, options.in);
  const auto kind = kind_of(*file);
  if (!kind) return forward(kind, options.in);

  std::vector<std::string> paths = options.kernels;
  if (paths.empty()) paths.push_back((home_directory() / "data" / "de405_2000_2050.bsp").string());
  if (*kind == Kind::spk) paths.push_back(options.in);
  const auto kernels = open_kernels(paths);
  if (!kernels) return forward(kernels);
  const Ephemeris& ephemeris = (*kernels)->ephemeris;
  std::optional<BodyId> center;
  if (!options.center.empty()) {
    const auto asked = parse_body(options.center);
    if (!asked) return forward(asked, "--center");
    center = *asked;
  }

  Oem oem;
  const bool as_it_is = options.step.empty() && options.begin.empty() && options.end.empty() && !center;
  if (*kind == Kind::spk) {
    const auto alone = Ephemeris::open(file->bytes());
    if (!alone) return forward(alone, options.in);
    const auto target = options.body.empty() ? only_target(*alone, options.in) : parse_body(options.body);
    if (!target) return forward(target, "--body");
    const auto trajectory = trajectory::from_ephemeris(ephemeris, *target);
    if (!trajectory) return forward(trajectory, options.in);
    auto sampled = resample(**trajectory, options);
    if (!sampled) return forward(sampled, options.in);
    oem = std::move(*sampled);
    oem.object_name = title(*target);
    oem.object_id = fmt::format("{}", target->value);
  } else {
    if (!options.body.empty())
      return fail(ErrorCode::invalid_argument, "a message is about one body: --body is for SPK kernels", {}, "--body");
    auto read = parse_oem(file->text(), options.in);
    if (!read) return forward(read);
    if (as_it_is) {
      oem = std::move(*read);
    } else {
      const auto trajectory = trajectory::from_oem(*read, &ephemeris);
      if (!trajectory) return forward(trajectory, options.in);
      auto sampled = resample(**trajectory, options);
      if (!sampled) return forward(sampled, options.in);
      oem = std::move(*sampled);
      oem.object_name = read->object_name;
      oem.object_id = read->object_id;
      if (!center) center = read->center;
    }
  }
  if (center && *center != body::solar_system_barycenter) {
    const auto referred = refer(oem, *center, ephemeris);
    if (!referred) return forward(referred, "--center");
  }
  const std::size_t states = oem.states.size();
  const Epoch begin = oem.epochs.front(), end = oem.epochs.back();
  const auto written = write_oem(options.out, std::move(oem));
  if (!written) return forward(written);
  if (options.json) {
    fmt::print("{}\n",
               Json{{"out", options.out}, {"states", states}, {"begin_tdb", tdb(begin)}, {"end_tdb", tdb(end)}}.dump());
  } else {
    fmt::print("{}: {} states from {} to {}\n", options.out, states, begin.iso(), end.iso());
  }
  return 0;
}

}  // namespace

void add_trajectory(CLI::App& app, Invocation& invocation) {
  CLI::App* sub = app.add_subcommand("trajectory", "where a spacecraft is: inspect, convert and design trajectories");
  sub->require_subcommand(1);
  sub->footer("Example:\n  astronav trajectory design --departure 2026-11-09 --days 300 --out cruise.oem");

  auto info = std::make_shared<InfoOptions>();
  CLI::App* info_app = sub->add_subcommand("info", "what an SPK kernel or an OEM file holds");
  info_app->footer("Example:\n  astronav trajectory info cruise.oem");
  info_app->add_option("file", info->file, "SPK kernel or CCSDS OEM (KVN)")->required();
  info_app->add_flag("--json", info->json, "one JSON object a segment or message");
  info_app->callback([info, &invocation] { invocation.action = [info] { return run_info(*info); }; });

  auto convert = std::make_shared<ConvertOptions>();
  CLI::App* convert_app = sub->add_subcommand("convert", "SPK or OEM to OEM");
  convert_app->footer("Example:\n  astronav trajectory convert spacecraft.bsp spacecraft.oem --step 1h");
  convert_app->add_option("in", convert->in, "SPK kernel or CCSDS OEM (KVN)")->required();
  convert_app->add_option("out", convert->out, "OEM to write")->required();
  convert_app->add_option("--body", convert->body, "of the kernel, where it holds several");
  convert_app->add_option("--center", convert->center, "default: that of the OEM; of a kernel, the barycentre");
  convert_app->add_option("--begin", convert->begin, "epoch (default: all)");
  convert_app->add_option("--end", convert->end, "epoch (default: all)");
  convert_app->add_option("--step", convert->step, "10d, 1h, 60s (default: an OEM's own states; of a kernel, 1h)");
  convert_app->add_option("--kernel", convert->kernels, "SPK files of the planets in place of DE405");
  convert_app->add_flag("--json", convert->json, "one JSON object");
  convert_app->callback([convert, &invocation] { invocation.action = [convert] { return run_convert(*convert); }; });

  add_trajectory_design(*sub, invocation);
  add_trajectory_low_thrust(*sub, invocation);
  add_trajectory_fly(*sub, invocation);
  add_trajectory_porkchop(*sub, invocation);
  add_trajectory_arrival(*sub, invocation);
}

}  // namespace astronav::cli
