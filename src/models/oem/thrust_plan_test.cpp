// SPDX-License-Identifier: Apache-2.0
#include "models/oem/thrust_plan.h"

#include <cmath>
#include <string>

#include <gtest/gtest.h>

namespace astronav {
namespace {

Epoch day(double d) {
  return Epoch::parse("2027-01-01T00:00:00 TDB").value() + Duration::days(d);
}
ThrustPlan plan() {
  return {.mass_kg = 22.0,
          .arcs = {{day(1), day(3), 1.9e-3, 3000.0, Vec3(2.0, 3.0, 6.0) / 7.0},
                   {day(3), day(4), 1.0e-3, 3000.0, Vec3::UnitY()},
                   {day(10), day(12), 1.9e-3, 2000.0, -Vec3::UnitZ()}}};
}
std::string refusal(const std::string& text) {
  const auto read = parse_thrust_plan(text, "x.csv");
  return read ? "" : describe(read.error());
}
std::string replaced(std::string text, const std::string& from, const std::string& to) {
  const std::size_t at = text.find(from);
  EXPECT_NE(at, std::string::npos) << from;
  if (at != std::string::npos) text.replace(at, from.size(), to);
  return text;
}

TEST(ThrustPlan, KnowsWhatIsOn) {
  const ThrustPlan p = plan();
  EXPECT_EQ(p.at(day(0.5)), nullptr);
  EXPECT_EQ(p.at(day(1)), &p.arcs[0]);
  EXPECT_EQ(p.at(day(3)), &p.arcs[1]) << "an arc's end is not part of it";
  EXPECT_EQ(p.at(day(4)), nullptr);
  EXPECT_EQ(p.at(day(11)), &p.arcs[2]);
  EXPECT_EQ(p.at(day(12)), nullptr);
  EXPECT_EQ(p.next_change(day(0), day(99)), day(1));
  EXPECT_EQ(p.next_change(day(1), day(99)), day(3));
  EXPECT_EQ(p.next_change(day(3.5), day(99)), day(4));
  EXPECT_EQ(p.next_change(day(4), day(9)), day(9));
  EXPECT_EQ(p.next_change(day(12), day(99)), day(99));
}

// 1.9 mN at 3000 s use 6.458e-8 kg/s: 11.16 g in two days.
TEST(ThrustPlan, LosesMassAsItThrusts) {
  const ThrustPlan p = plan();
  EXPECT_DOUBLE_EQ(p.mass_at_kg(day(1)), 22.0);
  EXPECT_NEAR(22.0 - p.mass_at_kg(day(3)), 1.9e-3 / (3000.0 * 9.80665) * 2 * 86400.0, 1e-12);
  EXPECT_NEAR(22.0 - p.mass_at_kg(day(3)), 0.01116, 1e-5);
  EXPECT_DOUBLE_EQ(p.mass_at_kg(day(5)), p.mass_at_kg(day(10)));
  // Over such small shares of the mass: impulse over mean mass.
  const double impulse = 1.9e-3 * 4 * 86400.0 + 1.0e-3 * 86400.0;
  EXPECT_NEAR(p.delta_v_m_s() * 0.5 * (22.0 + p.mass_at_kg(day(12))) / impulse, 1.0, 1e-4);
}

TEST(ThrustPlan, RoundTrip) {
  const ThrustPlan p = plan();
  const auto back = parse_thrust_plan("# a comment\n\n" + to_text(p), "x.csv");
  ASSERT_TRUE(back) << describe(back.error());
  EXPECT_EQ(back->mass_kg, p.mass_kg);
  ASSERT_EQ(back->arcs.size(), 3u);
  for (std::size_t i = 0; i < 3; ++i) {
    EXPECT_EQ(back->arcs[i].begin, p.arcs[i].begin);
    EXPECT_EQ(back->arcs[i].end, p.arcs[i].end);
    EXPECT_EQ(back->arcs[i].force_n, p.arcs[i].force_n);
    EXPECT_EQ(back->arcs[i].specific_impulse_s, p.arcs[i].specific_impulse_s);
    EXPECT_LT((back->arcs[i].direction_N - p.arcs[i].direction_N).norm(), 1e-11);
  }
  EXPECT_EQ(to_text(*back), to_text(p));
  EXPECT_TRUE(parse_thrust_plan(to_text(ThrustPlan{.mass_kg = 1.0, .arcs = {}}), "x.csv")->arcs.empty());
}

TEST(ThrustPlan, RefusesWhatCannotBeFlown) {
  const std::string good = to_text(plan());
  EXPECT_EQ(refusal(good), "");
  EXPECT_NE(refusal("").find("x.csv:1: the file is empty"), std::string::npos);
  EXPECT_NE(refusal("hello\n").find("x.csv:1: not a thrust plan"), std::string::npos);
  EXPECT_NE(refusal(replaced(good, ",3000,", ",3000,,")).find("x.csv:2: expected 8 columns"), std::string::npos);
  EXPECT_NE(refusal(replaced(good, "0.0019", "much")).find("x.csv:2: 'much' is not a number"), std::string::npos);
  EXPECT_NE(refusal(replaced(good, "0.0019", "-0.0019")).find("must be above zero"), std::string::npos);
  EXPECT_NE(refusal(replaced(good, "2027-01-04T00", "2027-01-05T00")).find("x.csv:3: thrust arc 2 begins before"),
            std::string::npos);
  EXPECT_NE(refusal(replaced(good, "2027-01-02T", "2028-01-02T")).find("ends before it begins"), std::string::npos);
  EXPECT_NE(refusal(replaced(good, "1.000000000000", "2.000000000000")).find("x.csv:3: the direction has length 2"),
            std::string::npos);
  EXPECT_NE(refusal(replaced(good, ",22.0", ",21.0")).find("x.csv:3: the mass is 21.98"), std::string::npos);
  EXPECT_NE(refusal(replaced(good, "2027-01-02T", "2027-13-02T")).find("x.csv:2"), std::string::npos);
  ThrustPlan thirsty = plan();
  thirsty.mass_kg = 0.02;
  EXPECT_FALSE(check(thirsty));
  thirsty.mass_kg = std::nan("");
  EXPECT_FALSE(check(thirsty));
}

}  // namespace
}  // namespace astronav
