// SPDX-License-Identifier: Apache-2.0
// Starts from nothing in missions as `astronav run` flies them, by rendered pictures: a survey of the ecliptic with
// attitudes lost in space, the first two windows, the batch; beside the same missions that were told a prior. How many
// started, how many were sure of something wrong, and from which cycle on both are the same. One JSON object a line.
//
//   cold_start_mission_accuracy [SEEDS] [FIRST_WINDOW_DAY] [LEVEL] [FIRST_SEED]     default 20, 1, sil, 1
#include <cmath>
#include <cstdlib>
#include <string>
#include <vector>

#include <fmt/format.h>

#include "benchmarks/accuracy/arguments.h"
#include "verification/loop/mission.h"
#include "verification/loop/summary.h"
#include "verification/scenario/scenario.h"

namespace {

using namespace astronav;

constexpr int kCycles = 5;
// One in 1e9 of a right answer's NEES (6) lies beyond.
constexpr double kConfidentlyWrong = 56.0;

struct Cycle {
  double position2_m2 = 0.0, velocity2 = 0.0, formal_position2_m2 = 0.0, nees = 0.0;
  int count = 0;
};

// Returns the largest NEES of any cycle's end.
double add(const loop::Records& records, std::vector<Cycle>& cycles) {
  double worst = 0.0;
  for (const loop::Event& e : records.events) {
    if (e.kind != loop::EventKind::cycle_end) continue;
    Cycle& cycle = cycles[static_cast<std::size_t>(e.cycle - records.start.cycle)];
    cycle.position2_m2 += (e.estimate.p_m - e.truth.p_m).squaredNorm() / 3.0;
    cycle.velocity2 += (e.estimate.v_m_s - e.truth.v_m_s).squaredNorm() / 3.0;
    cycle.formal_position2_m2 += e.covariance.topLeftCorner<3, 3>().trace() / 3.0;
    cycle.nees += e.nees;
    ++cycle.count;
    worst = std::max(worst, e.nees);
  }
  return worst;
}

}  // namespace

int main(int argc, char** argv) {
  const int seeds = astronav::accuracy::count_of(argc, argv, 1, "seeds", 20);
  const std::string day = argc > 2 ? argv[2] : "1";
  const std::string level = argc > 3 ? argv[3] : "sil";
  std::vector<Cycle> cold(kCycles), primed(kCycles);
  const int first = astronav::accuracy::count_of(argc, argv, 4, "first seeds", 1);
  int started = 0, wrong = 0, wrong_with_prior = 0, late = 0;
  for (int seed = first; seed < first + seeds; ++seed) {
    for (const bool from_nothing : {true, false}) {
      auto draft = scenario::Draft::read("earth-mars-ballistic");
      if (!draft || !draft->set("conops.first_window_day=" + day) ||
          !draft->set(from_nothing ? "onboard.start.from=survey" : "onboard.start.from=prior"))
        return 2;
      const auto scenario = draft->resolve(static_cast<std::uint64_t>(seed));
      if (!scenario) return 2;
      loop::FlyOptions options;
      options.level = level == "mil" ? loop::Level::mil : loop::Level::sil;
      options.seed = static_cast<std::uint64_t>(seed);
      options.keep_frames = 0;
      options.most_cycles = kCycles;
      const auto records = loop::fly(*scenario, options);
      if (!records) {
        fmt::print("{{\"seed\":{},\"failed\":\"{}\"}}\n", seed, describe(records.error()));
        continue;
      }
      const double worst = add(*records, from_nothing ? cold : primed);
      if (!from_nothing) {
        wrong_with_prior += worst > kConfidentlyWrong;
        fmt::print("{{\"seed\":{},\"start\":\"prior\",\"worst_nees\":{:.1f}}}\n", seed, worst);
        continue;
      }
      const loop::StartSummary start = loop::summarize(*records).start;
      ++started;
      wrong += worst > kConfidentlyWrong;
      late += start.cycle > 1;
      fmt::print(
          "{{\"seed\":{},\"start\":\"survey\",\"cycle\":{},\"pictures\":{},\"planets\":{},\"survey_error_km\":{:.0f},"
          "\"survey_sigma_km\":"
          "{:.0f},\"error_km\":{:.0f},\"sigma_km\":{:.0f},\"error_m_s\":{:.1f},\"sigma_m_s\":{:.1f},\"worst_nees\":"
          "{:.1f}}}\n",
          seed, start.cycle, start.pictures, start.planets.size(), start.survey_error_km, start.survey_sigma_km,
          start.position_error_km, start.position_sigma_km, start.velocity_error_m_s, start.velocity_sigma_m_s, worst);
      std::fflush(stdout);
    }
  }
  fmt::print(
      "{{\"starts\":{},\"started\":{},\"after_the_first_cycle\":{},\"confidently_wrong\":{},\"with_a_prior\":{}}}\n",
      seeds, started, late, wrong, wrong_with_prior);
  for (int c = 0; c < kCycles; ++c) {
    for (const bool from_nothing : {true, false}) {
      const Cycle& cycle = (from_nothing ? cold : primed)[static_cast<std::size_t>(c)];
      if (cycle.count == 0) continue;
      const auto three_sigma = [&](double sum2) { return 3.0 * std::sqrt(sum2 / cycle.count); };
      fmt::print(
          "{{\"cycle\":{},\"start\":\"{}\",\"position_3sigma_km\":{:.0f},\"formal_km\":{:.0f},\"velocity_3sigma_m_s\":"
          "{:.3f},\"nees_of_6\":{:.2f},\"missions\":{}}}\n",
          c + 1, from_nothing ? "survey" : "prior", three_sigma(cycle.position2_m2) * 1e-3,
          three_sigma(cycle.formal_position2_m2) * 1e-3, three_sigma(cycle.velocity2), cycle.nees / cycle.count,
          cycle.count);
    }
  }
}
