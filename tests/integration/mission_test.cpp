// SPDX-License-Identifier: Apache-2.0
// Short missions from end to end: the truth flies, the onboard software finds out where it is.
#include "verification/loop/mission.h"

#include <cmath>
#include <cstdio>

#include <gtest/gtest.h>

#include "foundation/math/statistics.h"
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
  EXPECT_LT(summary.position_error_km.worst_axis(), 130.0);  // twice the covariance bound
  EXPECT_LT(summary.velocity_error_m_s.worst_axis(), 0.1);
  // False-alarm probability 1e-3 where the filter is right: 15 windows are worth few independent ones, so NEES is wide.
  EXPECT_TRUE(chi_square_mean_band(0.999, 2.0, summary.nis_count).contains(summary.nis_mean)) << summary.nis_mean;
  EXPECT_LT(summary.nees_mean, 16.0);
}

TEST(Mission, ImagesOfTheRealSkyFindTheSpacecraft) {
  const auto records = loop::fly(short_scenario(1), {});
  ASSERT_TRUE(records) << describe(records.error());
  const loop::Summary summary = loop::summarize(*records);
  std::puts(loop::to_text(summary).c_str());
  EXPECT_LT(summary.position_error_km.worst_axis(), 1000.0);
  EXPECT_LT(summary.velocity_error_m_s.worst_axis(), 0.5);
  EXPECT_GT(summary.nis_mean, 1.8);
  EXPECT_LT(summary.nis_mean, 2.2);
  EXPECT_LT(summary.nees_mean, 16.0);
  EXPECT_GT(summary.vision.attitude_success_rate, 0.99);
  EXPECT_GT(summary.vision.planet_success_rate, 0.99);
  EXPECT_EQ(summary.vision.false_planets, 0);
}

// Covariance analysis knows no luck, and foretells what the filter of a mission with images says of itself.
TEST(Mission, CovarianceAnalysisForetellsTheFilter) {
  loop::FlyOptions options;
  options.level = loop::Level::cov;
  const auto once = loop::fly(short_scenario(1), options);
  options.seed = 2;
  const auto again = loop::fly(short_scenario(2), options);
  ASSERT_TRUE(once && again);
  EXPECT_EQ(once->events.back().covariance, again->events.back().covariance);
  EXPECT_EQ(once->events.back().estimate.p_m, again->events.back().estimate.p_m);
  const loop::Summary expected = loop::summarize(*once);
  std::puts(loop::to_text(expected).c_str());
  EXPECT_TRUE(std::isnan(expected.nees_mean) && std::isnan(expected.nis_mean));
  EXPECT_EQ(expected.edited_count, 0);
  // The models agree but for relativity and the like.
  EXPECT_LT(expected.position_error_km.worst_axis(), 10.0);
  const auto flown = loop::fly(short_scenario(1), {});
  ASSERT_TRUE(flown);
  const loop::Summary summary = loop::summarize(*flown);
  const double ratio = summary.position_error_km.worst_formal_axis() / expected.position_error_km.worst_formal_axis();
  EXPECT_GT(ratio, 0.7);
  EXPECT_LT(ratio, 1.5);
}

// The same seed gives the same bits.
// By all images the past is better known than it was then, and the last state is the same.
TEST(Mission, TheGroundLooksBack) {
  loop::FlyOptions options;
  options.level = loop::Level::mil;
  options.smooth = true;
  const auto records = loop::fly(short_scenario(1), options);
  ASSERT_TRUE(records) << describe(records.error());
  const loop::Summary then = loop::summarize(*records), now = loop::summarize(loop::afterwards(*records));
  EXPECT_EQ(now.steady_count, then.steady_count);
  for (std::size_t axis = 0; axis < 3; ++axis) {
    EXPECT_LT(now.velocity_error_m_s.formal_3sigma_axis[axis], 0.9 * then.velocity_error_m_s.formal_3sigma_axis[axis]);
    EXPECT_LT(now.position_error_km.formal_3sigma_axis[axis], then.position_error_km.formal_3sigma_axis[axis]);
    EXPECT_LT(now.position_error_km.end_of_coast.formal_3sigma_axis[axis],
              0.8 * then.position_error_km.end_of_coast.formal_3sigma_axis[axis]);
  }
  EXPECT_LT(now.nees_mean, 16.0);
  EXPECT_GT(now.nees_mean, 1.5);
  // The last words: the same.
  const loop::Event& last = records->smoothed.back();
  const loop::Event* online = nullptr;
  for (const loop::Event& e : records->events)
    if (e.kind == last.kind && e.cycle == last.cycle) online = &e;
  ASSERT_NE(online, nullptr);
  EXPECT_LT((last.estimate.p_m - online->estimate.p_m).norm(), 1.0);
  EXPECT_TRUE(last.covariance.isApprox(online->covariance, 1e-6));
}

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
