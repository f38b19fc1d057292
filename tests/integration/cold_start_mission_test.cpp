// SPDX-License-Identifier: Apache-2.0
// Missions that begin with nothing but a clock and the Sun's direction: a survey of the ecliptic names planets, two
// windows make a state of them, and from there on the mission is as any other.
#include <cmath>

#include <gtest/gtest.h>

#include "verification/loop/mission.h"
#include "verification/loop/summary.h"
#include "verification/scenario/scenario.h"

namespace astronav {
namespace {

constexpr int kCycles = 4;

Result<loop::Records> fly(loop::Level level, std::initializer_list<const char*> set,
                          const char* scenario = "earth-mars-ballistic", std::uint64_t seed = 1) {
  scenario::Draft draft = scenario::Draft::read(scenario).value();
  for (const char* assignment : set) EXPECT_TRUE(draft.set(assignment));
  loop::FlyOptions options;
  options.level = level;
  options.keep_frames = 0;
  options.most_cycles = kCycles;
  options.seed = seed;
  return loop::fly(draft.resolve(seed).value(), options);
}

double last_error_km(const loop::Records& records) {
  const State off{records.events.back().estimate.p_m - records.events.back().truth.p_m, Vec3::Zero()};
  return off.p_m.norm() * 1e-3;
}

// One in a million of a right answer's normalised squares (6) lies beyond 38.3.
void expect_honest(const loop::Records& records) {
  for (const loop::Event& e : records.events)
    if (e.kind == loop::EventKind::cycle_end) {
      EXPECT_LT(e.nees, 38.3) << "cycle " << e.cycle + 1;
    }
}

class ColdStartMission : public ::testing::TestWithParam<std::pair<loop::Level, const char*>> {};

TEST_P(ColdStartMission, EndsAsOneWithAPrior) {
  const auto [level, day] = GetParam();
  const auto cold = fly(level, {day, "onboard.start.from=survey"});
  ASSERT_TRUE(cold) << describe(cold.error());
  const auto primed = fly(level, {day, "onboard.start.from=prior"});
  ASSERT_TRUE(primed) << describe(primed.error());
  const loop::StartSummary start = loop::summarize(*cold).start;
  EXPECT_EQ(start.from, "survey");
  EXPECT_EQ(start.cycle, 1);
  EXPECT_GT(start.pictures, 10);
  EXPECT_GE(start.planets.size(), 2u);
  EXPECT_LT(start.survey_error_km, 1e5);
  EXPECT_GT(start.survey_error_km, 1.0);  // nobody told it
  expect_honest(*cold);
  expect_honest(*primed);
  std::printf("  survey off by %.0f km, first state by %.0f km (%.0f), last cycle %.0f km, with a prior %.0f km\n",
              start.survey_error_km, start.position_error_km, start.position_sigma_km, last_error_km(*cold),
              last_error_km(*primed));
  const auto sigma = [](const loop::Records& r) {
    return std::sqrt(r.events.back().covariance.topLeftCorner<3, 3>().trace());
  };
  EXPECT_NEAR(sigma(*cold) / sigma(*primed), 1.0, 0.1);
}

INSTANTIATE_TEST_SUITE_P(Levels, ColdStartMission,
                         ::testing::Values(std::pair{loop::Level::mil, "conops.first_window_day=1"},
                                           std::pair{loop::Level::sil, "conops.first_window_day=1"},
                                           std::pair{loop::Level::sil, "conops.first_window_day=120"}));

// 0.1 km/s for 250 days: 6.5 million km. With images 17 of 24 such missions became sure of a wrong place.
TEST(ColdStartMission, APriorThatSpreadTooFarIsNotUsed) {
  const auto records = fly(loop::Level::sil, {"conops.first_window_day=250", "onboard.start.from=prior"});
  ASSERT_TRUE(records) << describe(records.error());
  EXPECT_EQ(loop::summarize(*records).start.from, "survey");
  expect_honest(*records);
}

// A first velocity three sigmas off, near Mars: a million kilometres after the coast, which its pull makes bend. Linear
// along the way that was believed, the filter was sure of a wrong place for months (NEES 171 after the second cycle).
TEST(ColdStartMission, AFirstVelocityThatIsFarOffIsFlownAnew) {
  const auto records = fly(loop::Level::mil, {"onboard.start.from=survey"}, "mars-earth", 2);
  ASSERT_TRUE(records) << describe(records.error());
  EXPECT_GT(records->start.error.tail<3>().norm(), 1000.0);
  expect_honest(*records);
}

// No planet is bright enough for seven months; the prior has spread to eighteen million kilometres (3 sigma) by then.
TEST(ColdStartMission, AFirstSightAfterMonthsIsFlownAnew) {
  scenario::Draft draft = scenario::Draft::read("earth-mars-ballistic").value();
  ASSERT_TRUE(draft.set("conops.limiting_magnitude=-5"));
  loop::FlyOptions options;
  options.level = loop::Level::mil;
  options.keep_frames = 0;
  const auto records = loop::fly(draft.resolve(1).value(), options);
  ASSERT_TRUE(records) << describe(records.error());
  int seen = 0;
  for (const loop::Event& e : records->events) {
    seen += e.kind == loop::EventKind::image;
    if (e.kind == loop::EventKind::cycle_end && seen > 0) {
      EXPECT_LT(e.nees, 38.3) << "cycle " << e.cycle + 1;
    }
  }
  EXPECT_GT(seen, 100);
}

// Planets that are all too faint: said after the last cycle, with the reason of the last try.
TEST(ColdStartMission, WithoutPlanetsIsToldAsSuch) {
  const auto records = fly(loop::Level::mil, {"onboard.start.from=survey", "conops.limiting_magnitude=-5"});
  ASSERT_FALSE(records);
  EXPECT_EQ(records.error().code, ErrorCode::no_match);
  EXPECT_NE(describe(records.error()).find("no start from nothing in 4 cycles"), std::string::npos)
      << describe(records.error());
}

TEST(ColdStartMission, NeedsTimeForItsSurvey) {
  const auto records = fly(loop::Level::mil, {"onboard.start.from=survey", "conops.first_window_day=0.01"});
  ASSERT_FALSE(records);
  EXPECT_EQ(records.error().code, ErrorCode::invalid_argument);
}

}  // namespace
}  // namespace astronav
