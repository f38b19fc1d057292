// SPDX-License-Identifier: Apache-2.0
// Flying, storing and reading back.
#include "verification/campaign/campaign.h"

#include <algorithm>
#include <atomic>
#include <charconv>
#include <cmath>
#include <fstream>
#include <map>
#include <mutex>
#include <set>
#include <thread>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "foundation/files/mapped_file.h"

namespace astronav::campaign {
namespace {

using Json = nlohmann::ordered_json;

constexpr const char* kFormat = "astronav campaign 1";

std::string header_line(const Identity& id) {
  return Json{{"format", kFormat},           {"name", id.name},
              {"level", id.level},           {"version", id.version},
              {"first_seed", id.first_seed}, {"scenario", id.scenario_toml}}
      .dump();
}

std::string sample_line(const Sample& sample) {
  Json line = {{"seed", sample.seed}};
  if (!sample.flown()) {
    line["error"] = sample.error;
    return line.dump();
  }
  line["summary"] = Json::parse(loop::to_json(sample.summary, -1));
  Json windows = Json::array();
  for (const WindowError& w : sample.windows) {
    Json row = {w.day, w.nees};
    for (const auto* values : {&w.position_km, &w.position_sigma_km, &w.velocity_m_s, &w.velocity_sigma_m_s}) {
      for (const double v : *values) row.push_back(v);
    }
    windows.push_back(std::move(row));
  }
  line["windows"] = std::move(windows);
  Json consistency = Json::array();
  for (const WindowConsistency& w : sample.consistency)
    consistency.push_back({w.cycle, w.window, w.beacon, w.nees, w.nis});
  line["consistency"] = std::move(consistency);
  return line.dump();
}

double number(const Json& cell) {
  return cell.is_null() ? std::nan("") : cell.get<double>();
}

Result<Sample> read_sample(const std::string& text, std::string_view where) {
  try {
    const Json line = Json::parse(text);
    Sample sample;
    sample.seed = line.at("seed").get<std::uint64_t>();
    if (line.contains("error")) {
      sample.error = line.at("error").get<std::string>();
      return sample;
    }
    auto summary = loop::summary_from_json(line.at("summary").dump(), where);
    if (!summary) return forward(summary);
    sample.summary = std::move(*summary);
    for (const Json& row : line.at("windows")) {
      WindowError w;
      w.day = row.at(0).get<double>();
      w.nees = number(row.at(1));
      std::size_t i = 2;
      for (auto* values : {&w.position_km, &w.position_sigma_km, &w.velocity_m_s, &w.velocity_sigma_m_s}) {
        for (double& v : *values) v = number(row.at(i++));
      }
      sample.windows.push_back(w);
    }
    for (const Json& row : line.at("consistency")) {
      sample.consistency.push_back({row.at(0).get<int>(), row.at(1).get<int>(), row.at(2).get<std::string>(),
                                    number(row.at(3)), number(row.at(4))});
    }
    return sample;
  } catch (const nlohmann::json::exception& e) {
    return fail(ErrorCode::corrupt_data, "not a sample of a campaign: {s}", {}, where, e.what());
  }
}

// One file of a campaign. What a stopped process left half written at the end is dropped.
Result<Outcome> read_file(const std::filesystem::path& path) {
  const auto file = MappedFile::open(path);
  if (!file) return forward(file, path.string());
  Outcome outcome;
  std::map<std::uint64_t, Sample> samples;
  std::string_view rest = file->text();
  for (int line_number = 1; !rest.empty(); ++line_number) {
    const std::size_t end = rest.find('\n');
    if (end == std::string_view::npos) break;  // without its end: not finished
    const std::string line(rest.substr(0, end));
    rest.remove_prefix(end + 1);
    const std::string where = fmt::format("{}:{}", path.string(), line_number);
    if (line_number == 1) {
      const Json header = Json::parse(line, nullptr, false);
      const auto text = [&](const char* key) {
        return header.contains(key) && header[key].is_string() ? header[key].get<std::string>() : "";
      };
      if (!header.is_object() || text("format") != kFormat || !header.contains("first_seed") ||
          !header["first_seed"].is_number_unsigned()) {
        return fail(ErrorCode::corrupt_data,
                    "not a file of a campaign (the first line must say \"astronav campaign 1\")", {}, where);
      }
      outcome.identity = {text("scenario"), text("name"), text("level"), text("version"),
                          header["first_seed"].get<std::uint64_t>()};
      continue;
    }
    auto sample = read_sample(line, where);
    if (!sample) return forward(sample);
    samples[sample->seed] = std::move(*sample);
  }
  if (outcome.identity.version.empty() && outcome.identity.scenario_toml.empty()) {
    return fail(ErrorCode::corrupt_data, "not a file of a campaign: it is empty", {}, path.string());
  }
  for (auto& [seed, sample] : samples) outcome.samples.push_back(std::move(sample));
  return outcome;
}

std::filesystem::path file_of(const Options& options) {
  if (options.shard.count == 1) return options.out / "samples.jsonl";
  return options.out / fmt::format("samples.{}-of-{}.jsonl", options.shard.index, options.shard.count);
}

std::vector<WindowConsistency> consistency_of(const loop::Records& records) {
  std::vector<WindowConsistency> out;
  double nis = 0.0;
  int taken = 0;
  for (const loop::Event& e : records.events) {
    if (e.kind != loop::EventKind::image || e.for_start) continue;
    if (out.empty() || out.back().cycle != e.cycle || out.back().window != e.window) {
      out.push_back({.cycle = e.cycle, .window = e.window, .beacon = std::string(body_name(e.body))});
      nis = 0.0;
      taken = 0;
    }
    if (e.accepted) {
      nis += e.nis;
      ++taken;
    }
    out.back().nees = e.nees;
    out.back().nis = taken > 0 ? nis / taken : std::nan("");
  }
  return out;
}

Sample to_sample(std::uint64_t seed, const Result<loop::Records>& records) {
  Sample sample;
  sample.seed = seed;
  if (!records) {
    sample.error = describe(records.error());
    return sample;
  }
  sample.summary = loop::summarize(*records);
  // Without noise errors say nothing of a covariance.
  if (records->level != "cov") sample.consistency = consistency_of(*records);
  for (const loop::Event& e : records->events) {
    if (e.kind != loop::EventKind::cycle_end) continue;
    WindowError w;
    w.day = (e.epoch - loop::day_zero(*records)).days();
    w.nees = e.nees;
    for (int i = 0; i < 3; ++i) {
      const auto k = static_cast<std::size_t>(i);
      w.position_km[k] = (e.estimate.p_m[i] - e.truth.p_m[i]) * 1e-3;
      w.position_sigma_km[k] = std::sqrt(e.covariance(i, i)) * 1e-3;
      w.velocity_m_s[k] = e.estimate.v_m_s[i] - e.truth.v_m_s[i];
      w.velocity_sigma_m_s[k] = std::sqrt(e.covariance(3 + i, 3 + i));
    }
    sample.windows.push_back(w);
  }
  return sample;
}

}  // namespace

Result<Shard> parse_shard(std::string_view text) {
  Shard shard;
  const char* end = text.data() + text.size();
  const auto first = std::from_chars(text.data(), end, shard.index);
  if (first.ec == std::errc() && first.ptr != end && *first.ptr == '/') {
    const auto second = std::from_chars(first.ptr + 1, end, shard.count);
    if (second.ec == std::errc() && second.ptr == end && shard.index >= 1 && shard.index <= shard.count) return shard;
  }
  return fail(ErrorCode::invalid_argument, "\"{s}\" is not a shard: expected i/n with 1 <= i <= n, like 3/8", {},
              "--shard", text);
}

Result<Outcome> run(const scenario::Draft& draft, const Options& options, const Fly& fly,
                    const ProgressSink& progress) {
  if (options.samples < 1)
    return fail(ErrorCode::invalid_argument, "{0} samples: at least 1 is needed",
                {static_cast<double>(options.samples)}, "--samples");
  if (options.jobs < 1)
    return fail(ErrorCode::invalid_argument, "{0} jobs: at least 1 is needed", {static_cast<double>(options.jobs)},
                "--jobs");
  const auto named = draft.resolve(options.first_seed);
  if (!named) return forward(named);
  const Identity identity{draft.to_toml(), named->mission.name, options.level, options.version, options.first_seed};

  std::error_code error;
  std::filesystem::create_directories(options.out, error);
  if (error)
    return fail(ErrorCode::io_failure, "cannot make the folder: {s}", {}, options.out.string(), error.message());
  const std::filesystem::path path = file_of(options);
  std::map<std::uint64_t, Sample> samples;
  if (std::filesystem::exists(path)) {
    auto before = read_file(path);
    if (!before) return before;
    if (before->identity != identity) {
      return fail(ErrorCode::invalid_argument,
                  "holds a campaign of another scenario, level, version or seed; name another folder with --out", {},
                  path.string());
    }
    for (Sample& sample : before->samples) {
      if (sample.flown()) samples[sample.seed] = std::move(sample);
    }
  }
  // Written anew, so that a half written last line is gone.
  std::string text = header_line(identity) + "\n";
  for (const auto& [seed, sample] : samples) text += sample_line(sample) + "\n";
  if (auto ok = write_file(path, text); !ok) return forward(ok);
  std::ofstream store(path, std::ios::app | std::ios::binary);

  std::vector<std::uint64_t> wanted;
  std::vector<std::uint64_t> missing;
  for (int i = options.shard.index - 1; i < options.samples; i += options.shard.count) {
    const std::uint64_t seed = options.first_seed + static_cast<std::uint64_t>(i);
    wanted.push_back(seed);
    if (!samples.contains(seed)) missing.push_back(seed);
  }

  std::atomic<std::size_t> next{0};
  std::mutex mutex;  // over samples, store and progress
  std::size_t done = wanted.size() - missing.size();
  const auto tell = [&](std::uint64_t seed) {
    if (progress)
      progress(static_cast<double>(done) / static_cast<double>(wanted.size()),
               fmt::format("{} of {}, seed {}", done, wanted.size(), seed));
  };
  const auto work = [&] {
    while (true) {
      const std::size_t k = next++;
      if (k >= missing.size()) return;
      const std::uint64_t seed = missing[k];
      const auto resolved = draft.resolve(seed);
      Sample sample = to_sample(seed, resolved ? fly(*resolved, seed, 0) : Result<loop::Records>(forward(resolved)));
      const std::string line = sample_line(sample) + "\n";
      const std::lock_guard lock(mutex);
      store << line << std::flush;
      samples[seed] = std::move(sample);
      ++done;
      tell(seed);
    }
  };
  if (progress && !wanted.empty())
    progress(static_cast<double>(done) / static_cast<double>(wanted.size()), fmt::format("{} samples", wanted.size()));
  std::vector<std::thread> threads;
  const std::size_t workers = std::min(static_cast<std::size_t>(options.jobs), missing.size());
  for (std::size_t i = 1; i < workers; ++i) threads.emplace_back(work);
  work();
  for (std::thread& thread : threads) thread.join();
  if (!store) return fail(ErrorCode::io_failure, "could not be written", {}, path.string());

  Outcome outcome{identity, {}};
  for (const std::uint64_t seed : wanted) outcome.samples.push_back(std::move(samples.at(seed)));
  return outcome;
}

Result<Outcome> merge(const std::vector<std::filesystem::path>& places) {
  std::set<std::filesystem::path> files;
  std::error_code error;
  for (const std::filesystem::path& place : places) {
    if (!std::filesystem::is_directory(place, error)) {
      files.insert(place);
      continue;
    }
    for (const auto& entry : std::filesystem::directory_iterator(place, error)) {
      if (entry.path().extension() == ".jsonl") files.insert(entry.path());
    }
  }
  if (files.empty()) {
    return fail(ErrorCode::not_found, "no samples*.jsonl of a campaign found there", {},
                places.empty() ? "merge" : places.front().string());
  }
  Outcome all;
  std::map<std::uint64_t, Sample> samples;
  for (const std::filesystem::path& file : files) {
    auto part = read_file(file);
    if (!part) return part;
    if (file == *files.begin()) all.identity = part->identity;
    if (part->identity != all.identity) {
      return fail(ErrorCode::invalid_argument, "is of another campaign than {s}", {}, file.string(),
                  files.begin()->string());
    }
    for (Sample& sample : part->samples) {
      const auto [it, inserted] = samples.try_emplace(sample.seed, sample);
      if (!inserted && !it->second.flown()) it->second = std::move(sample);
    }
  }
  for (auto& [seed, sample] : samples) all.samples.push_back(std::move(sample));
  return all;
}

std::string slurm_script(std::string_view scenario, const Options& options, int shards) {
  const std::string out = options.out.string();
  return fmt::format(
      "#!/bin/bash\n"
      "# Flies {samples} samples of {scenario} in {shards} tasks. Hand it in with: sbatch THIS_FILE\n"
      "# A task that was stopped goes on where it was when it is handed in again. When all are done:\n"
      "#   astronav campaign merge {out}\n"
      "#SBATCH --job-name=astronav\n"
      "#SBATCH --array=1-{shards}\n"
      "#SBATCH --ntasks=1\n"
      "#SBATCH --cpus-per-task={jobs}\n"
      "#SBATCH --mem-per-cpu=1G\n"
      "#SBATCH --requeue\n"
      "set -euo pipefail\n"
      "astronav campaign '{scenario}' --level {level} --seed {seed} --samples {samples} --jobs "
      "\"$SLURM_CPUS_PER_TASK\" \\\n"
      "  --shard \"$SLURM_ARRAY_TASK_ID/{shards}\" --out '{out}'\n",
      fmt::arg("samples", options.samples), fmt::arg("scenario", scenario), fmt::arg("shards", shards),
      fmt::arg("out", out), fmt::arg("jobs", options.jobs), fmt::arg("level", options.level),
      fmt::arg("seed", options.first_seed));
}

}  // namespace astronav::campaign
