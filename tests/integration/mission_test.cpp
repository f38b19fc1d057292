// SPDX-License-Identifier: Apache-2.0
// Short missions from end to end: the truth flies, the onboard software finds out where it is.
#include "verification/loop/mission.h"

#include <gtest/gtest.h>

#include <cstdio>

#include "verification/loop/summary.h"
#include "verification/scenario/scenario.h"

namespace astronav {
namespace {

scenario::Scenario short_scenario(std::uint64_t seed) {
  scenario::Draft draft;
  const auto set = draft.set("conops.cycle_days=20");
  EXPECT_TRUE(set);
  return *draft.resolve(seed);
}

TEST(Mission, SightsWithoutImagesFindTheSpacecraft) {
  loop::FlyOptions options;
  options.level = loop::Level::mil;
  const auto records = loop::fly(short_scenario(1), options);
  ASSERT_TRUE(records) << describe(records.error());
  const loop::Summary summary = loop::summarize(*records);
  std::puts(loop::to_text(summary).c_str());
  EXPECT_LT(summary.position_error_km.worst_axis(), 400.0);
  EXPECT_LT(summary.velocity_error_m_s.worst_axis(), 0.1);
}

TEST(Mission, ImagesOfTheRealSkyFindTheSpacecraft) {
  const auto records = loop::fly(short_scenario(1), {});
  ASSERT_TRUE(records) << describe(records.error());
  const loop::Summary summary = loop::summarize(*records);
  std::puts(loop::to_text(summary).c_str());
  EXPECT_LT(summary.position_error_km.worst_axis(), 2000.0);
  EXPECT_GT(summary.vision.attitude_success_rate, 0.99);
  EXPECT_GT(summary.vision.planet_success_rate, 0.99);
  EXPECT_EQ(summary.vision.false_planets, 0);
}

// The same seed gives the same bits.
TEST(Mission, SeedDecidesEverything) {
  scenario::Draft draft;
  ASSERT_TRUE(draft.set("conops.cycle_days=100"));
  ASSERT_TRUE(draft.set("conops.tracking_min=10"));
  const auto scenario = draft.resolve(7);
  ASSERT_TRUE(scenario);
  loop::FlyOptions options;
  options.seed = 7;
  const auto once = loop::fly(*scenario, options);
  const auto again = loop::fly(*scenario, options);
  options.seed = 8;
  const auto other = loop::fly(*scenario, options);
  ASSERT_TRUE(once && again && other);
  EXPECT_EQ(once->events.back().estimate.p_m, again->events.back().estimate.p_m);
  EXPECT_NE(once->events.back().estimate.p_m, other->events.back().estimate.p_m);
}

}  // namespace
}  // namespace astronav
