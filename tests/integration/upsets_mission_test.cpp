// SPDX-License-Identifier: Apache-2.0
// Missions in which something goes wrong, as a scenario says it (truth.upsets): two cycles later the error is again
// what the filter says.
#include <algorithm>
#include <cmath>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "foundation/math/statistics.h"
#include "verification/loop/mission.h"
#include "verification/loop/summary.h"
#include "verification/scenario/scenario.h"

namespace astronav {
namespace {

using Settings = std::vector<std::string>;

Result<loop::Records> fly(loop::Level level, const Settings& set, std::uint64_t seed, int cycles) {
  scenario::Draft draft = scenario::Draft::read("earth-mars-ballistic").value();
  for (const std::string& assignment : set) EXPECT_TRUE(draft.set(assignment)) << assignment;
  loop::FlyOptions options;
  options.level = level;
  options.seed = seed;
  options.keep_frames = 0;
  options.most_cycles = cycles;
  return loop::fly(draft.resolve(seed).value(), options);
}

struct Upset {
  const char* name;
  Settings set;
  int two_cycles_later;     // from 0
  double least_nees = 1.0;  // of the band: what is untold is doubted rather too much
};

class Upsets : public ::testing::TestWithParam<Upset> {};

// Sixteen missions each; chi-square leaves the band once in a thousand times.
TEST_P(Upsets, TheFilterComesBack) {
  constexpr int kRuns = 16;
  const Upset& upset = GetParam();
  const int later = upset.two_cycles_later;
  std::vector<double> nees;
  for (int run = 1; run <= kRuns; ++run) {
    const auto records = fly(loop::Level::mil, upset.set, static_cast<std::uint64_t>(run), later + 1);
    ASSERT_TRUE(records) << describe(records.error());
    for (const loop::Event& e : records->events)
      if (e.kind == loop::EventKind::cycle_end && e.cycle == later) nees.push_back(e.nees);
  }
  ASSERT_EQ(nees.size(), static_cast<std::size_t>(kRuns));
  const Band band = chi_square_mean_band(0.999, 6.0, kRuns);
  std::printf("  NEES %.2f two cycles later\n", mean(nees));
  EXPECT_GT(mean(nees), upset.least_nees * band.lo);
  EXPECT_LT(mean(nees), band.hi);
}

INSTANTIATE_TEST_SUITE_P(
    Mission, Upsets,
    ::testing::Values(Upset{"LostWindow", {"truth.upsets.safe_mode_day=41", "truth.upsets.safe_mode_days=0.04"}, 5},
                      Upset{"SafeMode", {"truth.upsets.safe_mode_day=40", "truth.upsets.safe_mode_days=30"}, 8},
                      Upset{"ClockStep",
                            {"truth.upsets.clock_step_day=40", "truth.upsets.clock_step_ms=1000",
                             "onboard.filter.clock_sigma_ms=1000"},
                            6},
                      Upset{"ClockStepBack",
                            {"truth.upsets.clock_step_day=40", "truth.upsets.clock_step_ms=-1000",
                             "onboard.filter.clock_sigma_ms=1000"},
                            6},
                      Upset{"Maneuver", {"truth.upsets.maneuver_day=45", "truth.upsets.maneuver_m_s=4"}, 6},
                      Upset{"UntoldManeuver",
                            {"truth.upsets.maneuver_day=45", "truth.upsets.maneuver_m_s=20",
                             "onboard.filter.knows_maneuver=false"},
                            6,
                            0.3}),
    [](const auto& suite) { return suite.param.name; });

// A second that the filter does not know of is 30 km along the planets' way: the errors that it cannot see.
TEST(UpsetsMission, AClockThatIsBelievedIsFoundOut) {
  const Settings set{"truth.upsets.clock_step_day=40", "truth.upsets.clock_step_ms=1000"};
  const auto records = fly(loop::Level::mil, set, 1, 12);
  ASSERT_TRUE(records) << describe(records.error());
  EXPECT_GT(records->events.back().nees, 20.0);
}

// Two thousand protons a second and square centimetre, for three cycles.
TEST(UpsetsMission, AStormTakesNoImage) {
  const Settings set{"truth.upsets.storm_day=9", "truth.upsets.storm_days=30", "truth.upsets.storm_protons_cm2_s=2000"};
  const auto records = fly(loop::Level::sil, set, 1, 4);
  ASSERT_TRUE(records) << describe(records.error());
  int images = 0, found = 0;

  for (const loop::Event& e : records->events) {
    if (e.kind != loop::EventKind::image) continue;
    ++images;
    found += e.attitude_found && e.planet_found && e.accepted;
    EXPECT_FALSE(e.planet_false || e.attitude_wrong) << e.image;
  }
  EXPECT_EQ(images, 4 * 2 * 36);
  EXPECT_GT(found, images * 98 / 100);
  for (const loop::Event& e : records->events)
    if (e.kind == loop::EventKind::cycle_end) {
      EXPECT_LT(e.nees, 38.3) << "cycle " << e.cycle + 1;  // once in a million
    }
}

TEST(UpsetsMission, AFixedTrajectoryTakesNoCorrection) {
  scenario::Draft draft = scenario::Draft::read("main-belt").value();
  ASSERT_TRUE(draft.set("truth.upsets.maneuver_m_s=3"));
  const auto records = loop::fly(draft.resolve(1).value(), {.level = loop::Level::mil, .progress = {}});
  ASSERT_FALSE(records);
  EXPECT_NE(describe(records.error()).find("truth.upsets.maneuver_m_s"), std::string::npos);
}

}  // namespace
}  // namespace astronav
