// SPDX-License-Identifier: Apache-2.0
// Campaign: the same scenario flown with many seeds, over threads and machines, and the figures of all of them
// together.
//
// Sample i of a campaign is the run with seed `first_seed + i`: `astronav run SCENARIO --seed K` replays it. Each
// result is one line of samples.jsonl (samples.i-of-n.jsonl for a shard), appended when the sample is done, so that a
// campaign that was stopped goes on where it was. The first line names scenario, level, version and first seed; a
// folder that holds another campaign is refused.
#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <string>
#include <vector>

#include "foundation/base/error.h"
#include "foundation/base/progress.h"
#include "verification/loop/records.h"
#include "verification/loop/summary.h"
#include "verification/scenario/scenario.h"

namespace astronav::campaign {

struct Shard {
  int index = 1;  // from 1
  int count = 1;
};
// "3/8".
Result<Shard> parse_shard(std::string_view text);

struct Identity {
  std::string scenario_toml;  // as written, distributions and all
  std::string name;
  std::string level;
  std::string version;
  std::uint64_t first_seed = 1;
  bool operator==(const Identity&) const = default;
};

struct Options {
  int samples = 10;
  int jobs = 1;
  Shard shard;
  std::uint64_t first_seed = 1;
  std::string level = "sil";
  std::string version;
  std::filesystem::path out;
};

// The error when the second window of a cycle ends.
struct WindowError {
  double day = 0.0;  // of the mission
  std::array<double, 3> position_km{}, position_sigma_km{}, velocity_m_s{}, velocity_sigma_m_s{};
  double nees = 0.0;
};

// Any tracking window: NEES after its last image, mean NIS of the measurements taken in it.
struct WindowConsistency {
  int cycle = 0;   // from 0
  int window = 0;  // 0 or 1
  std::string beacon;
  double nees = 0.0;
  double nis = 0.0;  // NaN: nothing was taken
};

struct Sample {
  std::uint64_t seed = 1;
  std::string error;  // empty: flown
  loop::Summary summary;
  std::vector<WindowError> windows;
  std::vector<WindowConsistency> consistency;
  bool flown() const { return error.empty(); }
};

struct Outcome {
  Identity identity;
  std::vector<Sample> samples;  // in the order of their seeds
};

// Called from several threads at once.
using Fly = std::function<Result<loop::Records>(const scenario::Scenario&, std::uint64_t seed, std::uint64_t sample)>;

// Flies what is still missing of this shard, and returns all samples of the folder that belong to it. Samples that
// failed before are flown again.
Result<Outcome> run(const scenario::Draft& draft, const Options& options, const Fly& fly, const ProgressSink& progress);

// All samples found in these folders (or .jsonl files), which must be of one campaign; a seed found twice counts once.
Result<Outcome> merge(const std::vector<std::filesystem::path>& places);

// The same window of all samples. Runs are independent, so the band needs no effective count.
struct WindowStatistics {
  int cycle = 0;
  int window = 0;
  std::string beacon;  // the one that most samples tracked
  int samples = 0;
  double nees_mean = 0.0;
  Band nees_band_95;
  double nis_mean = 0.0;  // NaN: nothing was taken
};

struct Statistics {
  loop::Summary pooled;
  int flown = 0;
  int failed = 0;
  // Largest ratio, over the samples, of a sample's worst axis (3 x rms) to its own formal bound on that axis.
  double worst_position_ratio = 0.0;
  double worst_velocity_ratio = 0.0;
  int nis_inside_band = 0;
  int nees_inside_band = 0;
  // Window by window, from the first cycle on.
  std::vector<WindowStatistics> windows;
  double nees_all_windows = 0.0;  // mean over samples and windows
  int windows_inside_band = 0;    // a perfect filter: 95 in 100
};
// not_converged where no sample has flown.
Result<Statistics> statistics(const Outcome& outcome);

// The pooled summary with `confidence_95` beside it: for each figure of errors, NEES, NIS and vision a pair [lo, hi]:
// bootstrap over whole samples (1000 resamples, percentiles), which keeps the correlation inside a run; null for fewer
// than 3 samples.
std::string summary_json(const Outcome& outcome, const Statistics& statistics);
std::string samples_csv(const Outcome& outcome);
std::string windows_csv(const Statistics& statistics);
std::string to_text(const Outcome& outcome, const Statistics& statistics);

// samples.csv, windows.csv and summary.json.
Result<void> write_files(const std::filesystem::path& folder, const Outcome& outcome, const Statistics& statistics);

// A job script for Slurm: one array task per shard, then the merge.
std::string slurm_script(std::string_view scenario, const Options& options, int shards);

}  // namespace astronav::campaign
