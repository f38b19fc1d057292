// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "cli/command.h"
#include "cli/commands.h"
#include "cli/mission_inputs.h"
#include "cli/validators.h"
#include "foundation/base/progress.h"
#include "foundation/files/mapped_file.h"
#include "verification/campaign/campaign.h"
#include "verification/loop/mission.h"
#include "verification/loop/world.h"
#include "verification/report/report.h"
#include "verification/scenario/scenario.h"

namespace astronav::cli {
namespace {

struct Options {
  std::string scenario;
  std::string level = "sil";
  std::vector<std::string> set;
  int samples = 10;
  int jobs = 1;
  std::uint64_t seed = 1;
  std::string shard = "1/1";
  std::string out;
  bool json = false;
  std::vector<std::string> folders;  // merge
  int shards = 8;                    // slurm
};

Result<int> finish(const Options& options, const campaign::Outcome& outcome, const std::filesystem::path& out) {
  const auto statistics = campaign::statistics(outcome);
  if (!statistics) return forward(statistics);
  if (auto ok = campaign::write_files(out, outcome, *statistics); !ok) return forward(ok);
  const std::filesystem::path report = out / "report.html";
  if (auto ok = write_file(report, report::campaign_html(outcome, *statistics)); !ok) return forward(ok);
  if (options.json) {
    auto line = nlohmann::ordered_json::parse(campaign::summary_json(outcome, *statistics));
    line["out"] = out.string();
    line["report"] = report.string();
    fmt::print("{}\n", line.dump());
  } else {
    fmt::print("\n{}\nReport: {}\n", campaign::to_text(outcome, *statistics),
               std::filesystem::absolute(report).string());
  }
  return 0;
}

Result<campaign::Options> campaign_options(const Options& options, const std::string& name) {
  const auto shard = campaign::parse_shard(options.shard);
  if (!shard) return forward(shard);
  campaign::Options out;
  out.samples = options.samples;
  out.jobs = options.jobs;
  out.shard = *shard;
  out.first_seed = options.seed;
  out.level = options.level;
  out.version = ASTRONAV_VERSION;
  out.out = options.out.empty()
                ? std::filesystem::path("runs") / fmt::format("campaign-{}-{}", folder_name(name), options.level)
                : std::filesystem::path(options.out);
  return out;
}

// What flying a campaign and writing its job script need alike.
struct Plan {
  loop::Level level;
  scenario::Draft draft;
  scenario::Scenario first;  // of the first seed
  campaign::Options settings;
};

Result<Plan> read_plan(const Options& options) {
  const auto level = parse_level(options.level);
  if (!level) return forward(level);
  auto draft = read_draft(options.scenario, options.set);
  if (!draft) return forward(draft);
  auto first = draft->resolve(options.seed);
  if (!first) return forward(first);
  auto settings = campaign_options(options, first->mission.name);
  if (!settings) return forward(settings);
  return Plan{*level, std::move(*draft), std::move(*first), std::move(*settings)};
}

Result<int> fly(const Options& options) {
  if (options.scenario.empty()) {
    return fail(ErrorCode::invalid_argument,
                "which scenario? A TOML file or a name in scenarios/, like earth-mars-ballistic", {}, "campaign");
  }
  const auto plan = read_plan(options);
  if (!plan) return forward(plan);
  // What no sample could fly with is bad input, and is said before the first of them.
  const auto world = loop::World::create(plan->first, options.seed, 0);
  if (!world) return forward(world);
  const auto camera = scenario::onboard_camera(plan->first);
  if (!camera) return forward(camera);

  ProgressBar bar(fmt::format("campaign {}, {}", plan->first.mission.name, options.level));
  const auto outcome = campaign::run(
      plan->draft, plan->settings,
      [&](const scenario::Scenario& scenario, std::uint64_t seed, std::uint64_t sample) {
        return loop::fly(scenario,
                         {.level = plan->level, .seed = seed, .sample = sample, .keep_frames = 0, .progress = {}});
      },
      [&bar](double done, std::string_view note) { bar.update(done, note); });
  bar.finish();
  if (!outcome) return forward(outcome);
  if (plan->settings.shard.count > 1) {
    // The figures of all shards come with the merge.
    const auto flown = std::count_if(outcome->samples.begin(), outcome->samples.end(),
                                     [](const campaign::Sample& s) { return s.flown(); });
    if (options.json) {
      fmt::print(
          "{}\n",
          nlohmann::ordered_json{{"shard", options.shard}, {"flown", flown}, {"out", plan->settings.out.string()}}
              .dump());
    } else {
      fmt::print("Shard {}: {} samples flown. When all shards are done: astronav campaign merge {}\n", options.shard,
                 flown, plan->settings.out.string());
    }
    return 0;
  }
  return finish(options, *outcome, plan->settings.out);
}

Result<int> merge(const Options& options) {
  std::vector<std::filesystem::path> places(options.folders.begin(), options.folders.end());
  const auto outcome = campaign::merge(places);
  if (!outcome) return forward(outcome);
  std::filesystem::path out = options.out;
  if (out.empty()) out = std::filesystem::is_directory(places.front()) ? places.front() : places.front().parent_path();
  return finish(options, *outcome, out);
}

Result<int> slurm(const Options& options) {
  const auto plan = read_plan(options);
  if (!plan) return forward(plan);
  fmt::print("{}", campaign::slurm_script(options.scenario, plan->settings, options.shards));
  return 0;
}

}  // namespace

void add_campaign(CLI::App& app, Invocation& invocation) {
  auto options = std::make_shared<Options>();
  options->jobs = static_cast<int>(std::max(1u, std::thread::hardware_concurrency()));
  CLI::App* sub = app.add_subcommand("campaign", "flies a mission with many seeds and pools the figures");
  sub->footer(
      "A campaign that was stopped goes on where it was.\n\nExample:\n  astronav campaign earth-mars-ballistic "
      "--samples 100 --jobs 4 --out runs/hundred");
  const auto add_common = [options](CLI::App* to) {
    to->add_option("--level", options->level, "cov, mil or sil")->capture_default_str();
    to->add_option("--samples", options->samples, "how many; sample i has seed SEED + i")
        ->check(number_within(1, 1e7))
        ->capture_default_str();
    to->add_option("--seed", options->seed, "of the first sample")->check(seed_number())->capture_default_str();
    to->add_option("--jobs", options->jobs, "threads")->check(number_within(1, 1024))->capture_default_str();
    to->add_option("--out", options->out, "folder of the results; default runs/campaign-NAME-LEVEL");
  };
  sub->add_option("scenario", options->scenario, "TOML file, or a name in scenarios/");
  add_common(sub);
  sub->add_option("--set", options->set, "key=value, any key of the scenario; may be repeated")
      ->allow_extra_args(false);
  sub->add_option("--shard", options->shard, "i/n: fly every n-th sample only, for many machines");
  sub->add_flag("--json", options->json, "the pooled summary as one JSON object on standard output");
  sub->callback([options, sub, &invocation] {
    if (sub->get_subcommands().empty()) invocation.action = [options] { return fly(*options); };
  });

  CLI::App* merge_sub = sub->add_subcommand("merge", "pools the samples of shards");
  merge_sub->add_option("folders", options->folders, "folders or .jsonl files of one campaign")->required();
  merge_sub->add_option("--out", options->out, "folder of the results; default the first one");
  merge_sub->add_flag("--json", options->json, "the pooled summary as one JSON object on standard output");
  merge_sub->footer("Example:\n  astronav campaign merge runs/hundred");
  merge_sub->callback([options, &invocation] { invocation.action = [options] { return merge(*options); }; });

  CLI::App* slurm_sub = sub->add_subcommand("slurm", "writes a job script for Slurm to standard output");
  slurm_sub->add_option("scenario", options->scenario, "TOML file, or a name in scenarios/")->required();
  add_common(slurm_sub);
  slurm_sub->add_option("--shards", options->shards, "array tasks")
      ->check(number_within(1, 1e5))
      ->capture_default_str();
  slurm_sub->footer(
      "Example:\n  astronav campaign slurm earth-mars-ballistic --samples 1000 --shards 20 --jobs 8 --out "
      "runs/thousand > job.sh");
  slurm_sub->callback([options, &invocation] { invocation.action = [options] { return slurm(*options); }; });
}

}  // namespace astronav::cli
