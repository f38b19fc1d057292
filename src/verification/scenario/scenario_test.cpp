// SPDX-License-Identifier: Apache-2.0
#include "verification/scenario/scenario.h"

#include <cmath>
#include <set>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "foundation/files/mapped_file.h"
#include "verification/scenario/keys.h"

namespace astronav::scenario {
namespace {

std::string message(const Result<Draft>& draft) {
  return draft ? "accepted" : describe(draft.error());
}

TEST(Scenario, EmptyTextGivesTheDefaults) {
  const auto draft = Draft::parse("", "x.toml");
  ASSERT_TRUE(draft) << message(draft);
  const auto s = draft->resolve(1);
  ASSERT_TRUE(s);
  EXPECT_EQ(s->mission.departure.iso(TimeScale::tdb, 0), "2026-11-09T00:00:00 TDB");
  EXPECT_EQ(s->mission.days, 300.0);
  EXPECT_EQ(s->conops.image_period_s, 100.0);
  EXPECT_EQ(s->onboard.filter.initial_position_sigma_km, 10000.0);
}

TEST(Scenario, EveryKindOfValueIsRead) {
  const auto draft = Draft::parse(R"(
[mission]
departure = "2028-12-05T00:00:00 TDB"
to = 'venus'
[conops]
cycle_days = 5
[onboard]
vision = { max_spots = 12 }
[truth.dynamics]
relativity = false
bodies = ["earth"]
)",
                                  "x.toml");
  ASSERT_TRUE(draft) << message(draft);
  const auto s = draft->resolve(1);
  ASSERT_TRUE(s);
  EXPECT_EQ(s->mission.departure.iso(TimeScale::tdb, 0), "2028-12-05T00:00:00 TDB");
  EXPECT_EQ(s->mission.to, "venus");
  EXPECT_EQ(s->conops.cycle_days, 5.0);
  EXPECT_EQ(s->onboard.vision.max_spots, 12);
  EXPECT_FALSE(s->truth.dynamics.relativity);
  EXPECT_EQ(s->truth.dynamics.bodies, std::vector<std::string>{"earth"});
}

TEST(Scenario, MistakesAreNamedWithPlaceAndRemedy) {
  const struct {
    const char* toml;
    const char* expected;
  } cases[] = {
      {"[conops]\n\n  traking_min = 1",
       "x.toml:3:3: unknown key \"conops.traking_min\"; did you mean \"conops.tracking_min\"?"},
      {"[conop]\ntracking_min = 1", "x.toml:1:2: unknown section \"conop\"; did you mean \"conops\"?"},
      {"[conops]\ntracking_min = \"long\"", "x.toml:2:1: conops.tracking_min must be a number (min)"},
      {"[conops]\ntracking_min = -1", "x.toml:2:1: conops.tracking_min = -1 is outside 1 to 1440 min"},
      {"[conops]\ntracking_min = nan", "outside"},
      {"[conops]\ntracking_min = { gaussian = { mean = 60 } }", "must be a number, {"},
      {"[conops]\ntracking_min = { gaussian = { mean = 60, sigma = -1 } }", "sigma must not be negative"},
      {"[conops]\ntracking_min = { uniform = { min = 60, max = 50 } }", "max must not be below min"},
      {"[onboard.vision]\nmax_spots = 4.5", "whole number"},
      {"[onboard.vision]\ncentroid_method = \"magic\"", "must be one of: moment psf_fit"},
      {"[mission]\ndeparture = \"tomorrow\"", "x.toml:2:1: mission.departure: "},
      {"[mission]\nname = 3", "text in quotes"},
      {"[truth.dynamics]\nrelativity = 1", "true or false"},
      {"[truth.dynamics]\nbodies = \"earth\"", "list of names"},
      {"[mission\n", "x.toml:1:"},
      {"[run]\nspeed = 1", "unknown key \"run.speed\""},
  };
  for (const auto& c : cases) {
    const auto draft = Draft::parse(c.toml, "x.toml");
    EXPECT_NE(message(draft).find(c.expected), std::string::npos) << c.toml << "\n  gave: " << message(draft);
    if (!draft) {
      EXPECT_EQ(draft.error().code, ErrorCode::invalid_argument);
    }
  }
}

TEST(Scenario, SetOverridesAndExplains) {
  Draft draft;
  EXPECT_TRUE(draft.set("conops.cycle_days=5"));
  EXPECT_TRUE(draft.set("mission.to = venus"));
  EXPECT_TRUE(draft.set("mission.departure=2028-12-05T00:00:00 TDB"));
  EXPECT_TRUE(draft.set("truth.dynamics.bodies=[\"mars\"]"));
  EXPECT_TRUE(draft.set("truth.camera.psf_halo_fraction={ uniform = { min = 0.1, max = 0.2 } }"));
  const auto s = draft.resolve(1);
  ASSERT_TRUE(s);
  EXPECT_EQ(s->conops.cycle_days, 5.0);
  EXPECT_EQ(s->mission.to, "venus");
  EXPECT_GE(s->truth.camera.psf_halo_fraction, 0.1);
  EXPECT_LE(s->truth.camera.psf_halo_fraction, 0.2);
  for (const char* wrong : {"conops.cycle_days", "conops.cycle=5", "conops.cycle_days=", "conops.cycle_days=five",
                            "conops.cycle_days=5\nconops = 3"}) {
    EXPECT_FALSE(draft.set(wrong)) << wrong;
  }
}

TEST(Scenario, DrawsDependOnSeedSampleAndKeyAlone) {
  const auto draft = Draft::parse(
      "[truth.camera]\ncenter_offset_u_px = { gaussian = { mean = 3.0, sigma = 2.0 } }\n"
      "center_offset_v_px = { gaussian = { mean = 3.0, sigma = 2.0 } }",
      "x.toml");
  ASSERT_TRUE(draft) << message(draft);
  // The same names drawn in another order, among others, give the same values.
  auto other = Draft::parse("[conops]\ndither_px = { uniform = { min = 0, max = 9 } }", "y.toml");
  ASSERT_TRUE(other);
  ASSERT_TRUE(other->set("truth.camera.center_offset_u_px={ gaussian = { mean = 3.0, sigma = 2.0 } }"));
  double sum = 0.0;
  double sum2 = 0.0;
  std::set<double> distinct;
  constexpr int n = 4000;
  for (int sample = 0; sample < n; ++sample) {
    const auto s = draft->resolve(7, static_cast<std::uint64_t>(sample));
    const auto t = other->resolve(7, static_cast<std::uint64_t>(sample));
    ASSERT_TRUE(s && t);
    const double u = s->truth.camera.center_offset_u_px;
    EXPECT_EQ(u, t->truth.camera.center_offset_u_px);
    EXPECT_NE(u, s->truth.camera.center_offset_v_px);
    sum += u;
    sum2 += (u - 3.0) * (u - 3.0);
    distinct.insert(u);
  }
  EXPECT_EQ(distinct.size(), static_cast<std::size_t>(n));
  // 5 sigma: false alarm 6e-7 each.
  EXPECT_NEAR(sum / n, 3.0, 5.0 * 2.0 / std::sqrt(n));
  EXPECT_NEAR(std::sqrt(sum2 / n), 2.0, 5.0 * 2.0 / std::sqrt(2.0 * n));
  EXPECT_NE(draft->resolve(7, 0)->truth.camera.center_offset_u_px,
            draft->resolve(8, 0)->truth.camera.center_offset_u_px);
}

TEST(Scenario, ADrawOutsideTheRangeIsAnError) {
  const auto draft = Draft::parse("[conops]\ntracking_min = { gaussian = { mean = 2.0, sigma = 500.0 } }", "x.toml");
  ASSERT_TRUE(draft);
  bool refused = false;
  for (std::uint64_t sample = 0; sample < 20; ++sample) refused = refused || !draft->resolve(1, sample);
  EXPECT_TRUE(refused);
}

TEST(Scenario, ResolvedScenarioReadsBackToTheSameValues) {
  Draft draft;
  ASSERT_TRUE(draft.set("truth.dynamics.srp_scale_error={ gaussian = { mean = 0.0, sigma = 0.05 } }"));
  ASSERT_TRUE(draft.set("mission.name=a \"quoted\" \\ name"));
  ASSERT_TRUE(draft.set("truth.dynamics.bodies=[]"));
  const auto s = draft.resolve(11, 5);
  ASSERT_TRUE(s);
  const std::string text = to_toml(*s, {.version = "9.9", .level = "mil", .seed = 11, .sample = 5});
  const auto again = Draft::parse(text, "resolved");
  ASSERT_TRUE(again) << message(again) << "\n" << text;
  EXPECT_EQ(again->seed(), 11u);
  EXPECT_EQ(again->sample(), 5u);
  EXPECT_EQ(again->level(), "mil");
  EXPECT_TRUE(again->distributions().empty());
  const auto t = again->resolve(99, 99);
  ASSERT_TRUE(t);
  for (const Key& key : keys()) EXPECT_EQ(value_text(key, *s), value_text(key, *t)) << key.name;
  // The draft as written keeps its distribution.
  const auto drawn_again = Draft::parse(draft.to_toml(), "draft");
  ASSERT_TRUE(drawn_again) << message(drawn_again);
  EXPECT_EQ(drawn_again->distributions(), draft.distributions());
  EXPECT_EQ(drawn_again->resolve(11, 5)->truth.dynamics.srp_scale_error, s->truth.dynamics.srp_scale_error);
}

TEST(Scenario, TheTableIsInOrder) {
  const Scenario defaults;
  std::set<std::string_view> names;
  std::set<std::string_view> closed;
  std::string_view open;
  for (const Key& key : keys()) {
    EXPECT_TRUE(names.insert(key.name).second) << key.name;
    EXPECT_FALSE(key.meaning.empty()) << key.name;
    if (section_of(key.name) != open) {
      EXPECT_TRUE(closed.insert(section_of(key.name)).second) << "section in two places: " << key.name;
      open = section_of(key.name);
    }
    // A default must be allowed by its own range.
    const auto draft = Draft::parse(std::string(key.name) + " = " + value_text(key, defaults), "default");
    EXPECT_TRUE(draft) << message(draft);
  }
}

TEST(Scenario, TheShippedScenarioIsSound) {
  const auto draft = Draft::read("earth-mars-ballistic");
  ASSERT_TRUE(draft) << message(draft);
  const auto s = draft->resolve(1);
  ASSERT_TRUE(s);
  EXPECT_EQ(s->mission.departure.iso(TimeScale::tdb, 0), "2026-11-09T00:00:00 TDB");
  EXPECT_EQ(s->mission.days, 300.0);
  EXPECT_EQ(s->conops.sun_exclusion_deg, 35.0);
  EXPECT_EQ(s->conops.tracking_min, 60.0);
  EXPECT_EQ(s->conops.cycle_days, 10.0);
  EXPECT_EQ(s->onboard.filter.initial_position_sigma_km, 10000.0);
  EXPECT_EQ(s->onboard.filter.initial_velocity_sigma_km_s, 0.1);
  EXPECT_GT(s->truth.camera.psf_halo_fraction, 0.0);
}

TEST(Scenario, MissingAndEmptyFilesAreRefused) {
  EXPECT_FALSE(Draft::read("no-such-scenario"));
  EXPECT_FALSE(Draft::read("/"));
  const auto empty = std::filesystem::temp_directory_path() / "astronav_empty_scenario.toml";
  ASSERT_TRUE(write_file(empty, ""));
  EXPECT_FALSE(Draft::read(empty));
  std::filesystem::remove(empty);
}

TEST(Scenario, TheDocumentationIsTheTable) {
  const auto page = MappedFile::open(home_directory() / "docs" / "scenario.md");
  ASSERT_TRUE(page);
  EXPECT_EQ(page->text(), schema_markdown()) << "write it anew: astronav run --schema=markdown > docs/scenario.md";
}

}  // namespace
}  // namespace astronav::scenario
