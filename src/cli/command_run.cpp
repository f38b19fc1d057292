// SPDX-License-Identifier: Apache-2.0
#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "cli/command.h"
#include "cli/commands.h"
#include "cli/mission_inputs.h"
#include "cli/validators.h"
#include "foundation/base/progress.h"
#include "foundation/files/mapped_file.h"
#include "verification/loop/files.h"
#include "verification/loop/mission.h"
#include "verification/loop/summary.h"
#include "verification/report/report.h"
#include "verification/scenario/keys.h"
#include "verification/scenario/scenario.h"

namespace astronav::cli {
namespace {

struct Options {
  std::string scenario = "earth-mars-ballistic";
  std::string level;
  std::optional<std::uint64_t> seed;
  std::vector<std::string> set;
  std::string out;
  std::string schema;
  bool json = false;
  bool smooth = false;
};

using Json = nlohmann::ordered_json;

// What the ground knows afterwards: errors of the same places, by all images.
Json smoothed_json(const loop::Summary& s) {
  const Json all = Json::parse(loop::to_json(s, -1));
  return {{"position_error_km", all["position_error_km"]},
          {"velocity_error_m_s", all["velocity_error_m_s"]},
          {"nees_mean", all["nees_mean"]}};
}

void tell_smoothed(const loop::Summary& s) {
  if (s.steady_count == 0) return;
  const loop::ErrorSummary &p = s.position_error_km, &v = s.velocity_error_m_s;
  fmt::print(
      "  Afterwards, by all images: after the second window {:.3g} km (bound {:.3g}), {:.3g} m/s ({:.3g}); at the end "
      "of "
      "a coast {:.3g} km ({:.3g}), {:.3g} m/s ({:.3g}); NEES {:.2f}\n",
      p.worst_axis(), p.worst_formal_axis(), v.worst_axis(), v.worst_formal_axis(), p.end_of_coast.worst_axis(),
      p.end_of_coast.worst_formal_axis(), v.end_of_coast.worst_axis(), v.end_of_coast.worst_formal_axis(), s.nees_mean);
}

Result<int> print_schema(const Options& options) {
  if (options.json) {
    const scenario::Scenario defaults;
    for (const scenario::Key& key : scenario::keys()) {
      nlohmann::ordered_json line = {{"key", key.name},
                                     {"unit", key.unit},
                                     {"default", scenario::value_text(key, defaults)},
                                     {"meaning", key.meaning}};
      if (key.is_number()) {
        line["min"] = key.min;
        line["max"] = key.max;
      }
      if (!key.choices.empty()) line["choices"] = key.choices;
      fmt::print("{}\n", line.dump());
    }
    return 0;
  }
  if (options.schema != "text" && options.schema != "markdown") {
    return fail(ErrorCode::invalid_argument, "\"{s}\" is not a form of the schema: text or markdown", {}, "--schema",
                options.schema);
  }
  fmt::print("{}", options.schema == "markdown" ? scenario::schema_markdown() : scenario::schema_text());
  return 0;
}

Result<int> run(const Options& options) {
  if (!options.schema.empty()) return print_schema(options);
  const auto draft = read_draft(options.scenario, options.set);
  if (!draft) return forward(draft);
  const std::string level_name = !options.level.empty()    ? options.level
                                 : !draft->level().empty() ? draft->level()
                                                           : "sil";
  const auto level = parse_level(level_name);
  if (!level) return forward(level);
  loop::FlyOptions fly;
  fly.level = *level;
  fly.seed = options.seed.value_or(draft->seed());
  fly.sample = draft->sample();
  fly.smooth = options.smooth;
  if (fly.smooth && fly.level == loop::Level::cov)
    return fail(ErrorCode::invalid_argument, "the level cov has no sights to look back on; mil or sil", {}, "--smooth");
  const auto scenario = draft->resolve(fly.seed, fly.sample);
  if (!scenario) return forward(scenario);
  const std::filesystem::path out =
      options.out.empty() ? std::filesystem::path("runs") /
                                fmt::format("{}-{}-seed{}", folder_name(scenario->mission.name), level_name, fly.seed)
                          : std::filesystem::path(options.out);
  // Found out before the flight rather than after it.
  std::error_code error;
  std::filesystem::create_directories(out, error);
  if (error) return fail(ErrorCode::io_failure, "cannot make the folder: {s}", {}, out.string(), error.message());

  ProgressBar bar(fmt::format("{}, {}, seed {}", scenario->mission.name, level_name, fly.seed));
  fly.progress = [&bar](double done, std::string_view note) { bar.update(done, note); };
  const auto records = loop::fly(*scenario, fly);
  bar.finish();
  if (!records) return forward(records);

  const loop::Summary summary = loop::summarize(*records);
  if (auto ok = loop::write_files(out, *records, summary); !ok) return forward(ok);
  const std::filesystem::path report = out / "report.html";
  if (auto ok = write_file(report, report::mission_html(*records, summary)); !ok) return forward(ok);
  if (options.json) {
    auto line = Json::parse(loop::to_json(summary, -1));
    if (options.smooth) line["smoothed"] = smoothed_json(loop::summarize(loop::afterwards(*records)));
    line["out"] = out.string();
    line["report"] = report.string();
    fmt::print("{}\n", line.dump());
  } else {
    fmt::print("\n{}", loop::to_text(summary));
    if (options.smooth) tell_smoothed(loop::summarize(loop::afterwards(*records)));
    fmt::print("\nReport: {}\n", std::filesystem::absolute(report).string());
  }
  return 0;
}

}  // namespace

void add_run(CLI::App& app, Invocation& invocation) {
  auto options = std::make_shared<Options>();
  CLI::App* sub = app.add_subcommand("run", "flies one mission and writes its report");
  sub->footer("Example:\n  astronav run --level mil --seed 3 --set conops.cycle_days=5 --out runs/short-cycles");
  sub->add_option("scenario", options->scenario, "TOML file, or a name in scenarios/")->capture_default_str();
  sub->add_option("--level", options->level,
                  "cov (covariance alone), mil (sights) or sil (rendered images); default sil");
  sub->add_option("--seed", options->seed, "of everything random; default 1")->check(seed_number());
  sub->add_option("--set", options->set, "key=value, any key of the scenario; may be repeated")
      ->allow_extra_args(false);
  sub->add_option("--out", options->out, "folder of the results; default runs/NAME-LEVEL-seedN");
  sub->add_option("--schema", options->schema, "print every key of a scenario, as text or markdown, and stop")
      ->expected(0, 1)
      ->default_str("text");
  sub->add_flag("--smooth", options->smooth,
                "looks back on the whole mission afterwards, as the ground would: smoothed.oem");
  sub->add_flag("--json", options->json, "the summary as one JSON object on standard output");
  sub->callback([options, sub, &invocation] {
    if (sub->count("--schema") > 0 && options->schema.empty()) options->schema = "text";
    invocation.action = [options] { return run(*options); };
  });
}

}  // namespace astronav::cli
