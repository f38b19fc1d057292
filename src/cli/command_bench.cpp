// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <array>
#include <cstdlib>
#include <memory>
#include <string>
#include <string_view>
#include <thread>
#include <utility>
#include <vector>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "cli/bench.h"
#include "cli/command.h"
#include "cli/commands.h"
#include "foundation/base/nearest_word.h"
#include "foundation/base/progress.h"

namespace astronav::cli {
namespace {

struct Options {
  std::vector<std::string> only;
  bool json = false;
};

struct Entry {
  std::string_view name;
  Result<bench::Figure> (*measure)(bench::Bench&);
  double seconds;  // about: for the progress bar
};

constexpr std::array kEntries{
    Entry{"render_fps_1024", bench::render_fps_1024, 1.5},
    Entry{"render_fps_2048", bench::render_fps_2048, 2.0},
    Entry{"render_fps_1024_halo", bench::render_fps_1024_halo, 1.5},
    Entry{"render_frame_ms_1024", bench::render_frame_ms_1024, 1.2},
    Entry{"render_two_threads", bench::render_two_threads, 5.0},
    Entry{"vision_ms_lost_in_space_1024", bench::vision_ms_lost_in_space_1024, 5.0},
    Entry{"vision_ms_tracked_1024", bench::vision_ms_tracked_1024, 0.1},
    Entry{"attitude_cross_arcsec", bench::attitude_cross_arcsec, 0.1},
    Entry{"attitude_cross_scatter_arcsec", bench::attitude_cross_scatter_arcsec, 0.1},
    Entry{"attitude_roll_arcsec", bench::attitude_roll_arcsec, 0.1},
    Entry{"centroid_px", bench::centroid_px, 0.1},
    Entry{"solve_success_rate", bench::solve_success_rate, 0.1},
    Entry{"filter_update_us", bench::filter_update_us, 1.2},
    Entry{"propagate_10d_ms", bench::propagate_10d_ms, 1.2},
    Entry{"ephemeris_states_per_s", bench::ephemeris_states_per_s, 1.2},
    Entry{"cone_search_us", bench::cone_search_us, 1.2},
    Entry{"mission_s", bench::mission_s, 40.0},
    Entry{"onboard_memory_mb", bench::onboard_memory_mb, 0.5},
    Entry{"server_share_of_renderer", bench::server_share_of_renderer, 6.5},
    Entry{"server_latency_ms", bench::server_latency_ms, 4.0},
};

Result<std::vector<Entry>> choose(const std::vector<std::string>& only) {
  std::vector<Entry> chosen;
  for (const Entry& entry : kEntries) {
    if (only.empty() || std::find(only.begin(), only.end(), entry.name) != only.end()) chosen.push_back(entry);
  }
  for (const std::string& name : only) {
    if (std::any_of(kEntries.begin(), kEntries.end(), [&](const Entry& e) { return e.name == name; })) continue;
    const auto nearest = nearest_word(name, kEntries, [](const Entry& e) { return e.name; });
    return fail(ErrorCode::not_found, "there is no such figure; did you mean {s}?", {}, "--only " + name,
                nearest->name);
  }
  return chosen;
}

std::string machine() {
  std::array<double, 1> load{};
  const bool known = getloadavg(load.data(), 1) == 1;
  return fmt::format("{} processors, load {}", std::thread::hardware_concurrency(),
                     known ? fmt::format("{:.1f}", load[0]) : "unknown");
}

// Broken between words, each further line below the first.
std::string wrapped(std::string_view text, std::size_t width, std::size_t indent) {
  std::string out;
  while (text.size() > width) {
    const std::size_t blank = text.rfind(' ', width);
    if (blank == std::string_view::npos) break;
    out += std::string(text.substr(0, blank)) + '\n' + std::string(indent, ' ');
    text.remove_prefix(blank + 1);
  }
  return out += text;
}

void print(const Entry& entry, const bench::Figure& figure, bool json) {
  if (json) {
    const nlohmann::ordered_json line = {
        {"name", entry.name}, {"value", figure.value}, {"unit", figure.unit}, {"detail", figure.detail}};
    fmt::print("{}\n", line.dump());
  } else {
    fmt::print("{:<30} {:>9.4g} {:<6}  {}\n", entry.name, figure.value, figure.unit, wrapped(figure.detail, 70, 49));
  }
}

Result<int> run(const Options& options) {
  const auto chosen = choose(options.only);
  if (!chosen) return forward(chosen);
  double all_s = 0.0, done_s = 0.0;
  for (const Entry& entry : *chosen) all_s += entry.seconds;
  const std::string on = machine();
  ProgressBar bar("bench, " + on);
  auto bench = bench::Bench::create();
  if (!bench) return forward(bench);
  std::vector<std::pair<Entry, bench::Figure>> figures;
  for (const Entry& entry : *chosen) {
    bench->progress = [&](double share, std::string_view) {
      bar.update((done_s + share * entry.seconds) / all_s, entry.name);
    };
    bench->progress(0.0, "");
    auto figure = entry.measure(*bench);
    if (!figure) return forward(figure, entry.name);
    figures.emplace_back(entry, std::move(*figure));
    done_s += entry.seconds;
  }
  bar.finish();
  if (!options.json) fmt::print("astronav {} on this machine: {} (at the start)\n", ASTRONAV_VERSION, on);
  for (const auto& [entry, figure] : figures) print(entry, figure, options.json);
  return 0;
}

}  // namespace

void add_bench(CLI::App& app, Invocation& invocation) {
  auto options = std::make_shared<Options>();
  CLI::App* sub = app.add_subcommand("bench", "speed and accuracy on this machine");
  sub->footer("Example:\n  astronav bench --only render_fps_1024 vision_ms_lost_in_space_1024");
  sub->add_option("--only", options->only, "these figures alone, by name");
  sub->add_flag("--json", options->json, "one JSON object a figure");
  sub->callback([options, &invocation] { invocation.action = [options] { return run(*options); }; });
}

}  // namespace astronav::cli
