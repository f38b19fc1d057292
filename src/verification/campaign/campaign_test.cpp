// SPDX-License-Identifier: Apache-2.0
#include "verification/campaign/campaign.h"

#include <algorithm>
#include <atomic>
#include <filesystem>
#include <fstream>
#include <sstream>

#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include "foundation/files/mapped_file.h"
#include "support/synthetic_records.h"

namespace astronav::campaign {
namespace {

class Campaign : public ::testing::Test {
 protected:
  void SetUp() override {
    folder_ = std::filesystem::temp_directory_path() /
              (std::string("astronav_campaign_") + ::testing::UnitTest::GetInstance()->current_test_info()->name());
    std::filesystem::remove_all(folder_);
    options_.out = folder_;
    options_.version = "0.0.0";
    options_.samples = 6;
    fly_ = [this](const scenario::Scenario&, std::uint64_t seed, std::uint64_t) -> Result<loop::Records> {
      ++flights_;
      if (seed == fail_seed_)
        return fail(ErrorCode::not_converged, "seed {0} went astray", {static_cast<double>(seed)});
      return astronav::testing::synthetic_records({.seed = seed, .cycles = 8, .images_per_window = 4});
    };
  }
  void TearDown() override { std::filesystem::remove_all(folder_); }

  std::filesystem::path folder_;
  Options options_;
  Fly fly_;
  std::atomic<int> flights_{0};
  std::uint64_t fail_seed_ = 0;
  scenario::Draft draft_;
};

std::string figures(const Outcome& outcome) {
  return samples_csv(outcome);
}

TEST_F(Campaign, TheOrderOfWorkChangesNothing) {
  const auto one = run(draft_, options_, fly_, {});
  ASSERT_TRUE(one) << describe(one.error());
  ASSERT_EQ(one->samples.size(), 6u);
  EXPECT_EQ(one->samples[2].seed, 3u);
  options_.out = folder_ / "threads";
  options_.jobs = 3;
  const auto three = run(draft_, options_, fly_, {});
  ASSERT_TRUE(three);
  EXPECT_EQ(figures(*one), figures(*three));
  // A sample is the run with its seed.
  const loop::Summary alone =
      loop::summarize(astronav::testing::synthetic_records({.seed = 3, .cycles = 8, .images_per_window = 4}));
  EXPECT_EQ(loop::to_json(alone), loop::to_json(one->samples[2].summary));
}

TEST_F(Campaign, GoesOnWhereItWasStopped) {
  options_.samples = 3;
  ASSERT_TRUE(run(draft_, options_, fly_, {}));
  EXPECT_EQ(flights_, 3);
  // Stopped in the middle of a line.
  std::ofstream(folder_ / "samples.jsonl", std::ios::app) << R"({"seed":4,"summary":{"level":)";
  options_.samples = 6;
  const auto all = run(draft_, options_, fly_, {});
  ASSERT_TRUE(all) << describe(all.error());
  EXPECT_EQ(flights_, 6);
  ASSERT_TRUE(run(draft_, options_, fly_, {}));
  EXPECT_EQ(flights_, 6);
  options_.out = folder_ / "at_once";
  const auto at_once = run(draft_, options_, fly_, {});
  ASSERT_TRUE(at_once);
  EXPECT_EQ(figures(*all), figures(*at_once));
}

TEST_F(Campaign, AFailedSampleIsReportedAndFlownAgain) {
  fail_seed_ = 2;
  const auto first = run(draft_, options_, fly_, {});
  ASSERT_TRUE(first);
  const auto s = statistics(*first);
  ASSERT_TRUE(s);
  EXPECT_EQ(s->flown, 5);
  EXPECT_EQ(s->failed, 1);
  EXPECT_NE(to_text(*first, *s).find("seed 2 failed: seed 2 went astray"), std::string::npos);
  fail_seed_ = 0;
  const auto second = run(draft_, options_, fly_, {});
  ASSERT_TRUE(second);
  EXPECT_EQ(flights_, 7);
  EXPECT_TRUE(second->samples[1].flown());
}

TEST_F(Campaign, ShardsMergeToTheWhole) {
  const auto whole = run(draft_, options_, fly_, {});
  ASSERT_TRUE(whole);
  options_.out = folder_ / "shards";
  for (int i = 1; i <= 4; ++i) {
    options_.shard = {i, 4};
    const auto part = run(draft_, options_, fly_, {});
    ASSERT_TRUE(part);
    EXPECT_LE(part->samples.size(), 2u);
  }
  const auto merged = merge({options_.out});
  ASSERT_TRUE(merged) << describe(merged.error());
  EXPECT_EQ(figures(*merged), figures(*whole));
}

TEST_F(Campaign, AnotherCampaignIsNotMixedIn) {
  ASSERT_TRUE(run(draft_, options_, fly_, {}));
  ASSERT_TRUE(draft_.set("conops.cycle_days=5"));
  EXPECT_FALSE(run(draft_, options_, fly_, {}));
  options_.out = folder_ / "other";
  ASSERT_TRUE(run(draft_, options_, fly_, {}));
  EXPECT_FALSE(merge({folder_, options_.out}));
}

TEST_F(Campaign, HostileFilesAreRefused) {
  std::filesystem::create_directories(folder_);
  EXPECT_FALSE(merge({folder_}));
  EXPECT_FALSE(merge({folder_ / "nothing"}));
  for (const char* text :
       {"", "\n", "[]\n", "{}\n", "{\"format\":\"astronav campaign 1\"}\n", "not json\n",
        "{\"format\":\"astronav campaign 1\",\"version\":\"1\",\"first_seed\":1}\n{\"seed\":-1}\n",
        "{\"format\":\"astronav campaign 1\",\"version\":\"1\",\"first_seed\":1}\n{\"seed\":1,\"summary\":3}\n"}) {
    ASSERT_TRUE(write_file(folder_ / "samples.jsonl", text));
    EXPECT_FALSE(merge({folder_})) << text;
    EXPECT_FALSE(run(draft_, options_, fly_, {})) << text;
  }
}

TEST_F(Campaign, IntervalsHoldTheFiguresAndNarrowWithSamples) {
  const auto width = [&](int samples, const char* folder) {
    options_.samples = samples;
    options_.jobs = 2;
    options_.out = folder_ / folder;
    const auto outcome = run(draft_, options_, fly_, {});
    const auto s = statistics(*outcome);
    const auto j = nlohmann::json::parse(summary_json(*outcome, *s));
    const double value = j["position_error_km"]["steady_3sigma_axis"][0];
    const auto ci = j["confidence_95"]["position_error_km"]["steady_3sigma_axis"][0];
    EXPECT_LT(ci[0].get<double>(), value);
    EXPECT_GT(ci[1].get<double>(), value);
    EXPECT_TRUE(j["confidence_95"]["nees_mean"].is_array());
    EXPECT_TRUE(j["confidence_95"]["vision"]["attitude_success_rate"].is_array());
    return (ci[1].get<double>() - ci[0].get<double>()) / value;
  };
  EXPECT_GT(width(8, "few"), width(64, "many"));  // about 2.8 times; the same seeds every time
}

// The bands per window, of a filter that is right and of one that believes itself three halves as good as it is.
TEST_F(Campaign, NeesWindowByWindow) {
  options_.samples = 200;
  options_.jobs = 2;
  const auto inside = [&](double factor, const char* folder) {
    options_.out = folder_ / folder;
    const auto outcome = run(
        draft_, options_,
        [&](const scenario::Scenario&, std::uint64_t seed, std::uint64_t) -> Result<loop::Records> {
          return astronav::testing::synthetic_records(
              {.seed = seed, .cycles = 8, .images_per_window = 4, .truth_over_filter = factor});
        },
        {});
    const auto s = statistics(*outcome);
    EXPECT_EQ(s->windows.size(), 16u);
    for (const WindowStatistics& w : s->windows) EXPECT_EQ(w.samples, 200);
    const std::string table = windows_csv(*s);
    EXPECT_EQ(std::count(table.begin(), table.end(), '\n'), 17);
    EXPECT_NE(to_text(*outcome, *s).find("of 16, mean of all"), std::string::npos);
    const auto again = merge({options_.out});
    EXPECT_EQ(windows_csv(*statistics(*again)), table);
    return std::pair(s->windows_inside_band, s->nees_all_windows);
  };
  const auto [right, right_mean] = inside(1.0, "right");
  EXPECT_GE(right, 13);  // neighbours are correlated: when one is outside, so may be the next
  EXPECT_NEAR(right_mean, 6.0, 0.3);
  const auto [wrong, wrong_mean] = inside(1.5, "wrong");
  EXPECT_LE(wrong, 1);
  EXPECT_NEAR(wrong_mean, 6.0 * 1.5 * 1.5, 0.8);
}

TEST_F(Campaign, SamplesTableIsRectangular) {
  fail_seed_ = 4;
  const auto outcome = run(draft_, options_, fly_, {});
  ASSERT_TRUE(outcome);
  std::istringstream csv(samples_csv(*outcome));
  std::string line;
  std::getline(csv, line);
  const auto columns = std::count(line.begin(), line.end(), ',');
  int rows = 0;
  for (; std::getline(csv, line); ++rows) EXPECT_EQ(std::count(line.begin(), line.end(), ','), columns) << line;
  EXPECT_EQ(rows, 6);
}

TEST(Shard, Texts) {
  EXPECT_EQ(parse_shard("3/8")->index, 3);
  EXPECT_EQ(parse_shard("3/8")->count, 8);
  for (const char* wrong : {"", "3", "0/8", "9/8", "3/", "/8", "a/b", "3/8x", "-1/8"})
    EXPECT_FALSE(parse_shard(wrong)) << wrong;
}

TEST(Slurm, ScriptNamesItsShards) {
  Options options;
  options.samples = 100;
  options.jobs = 4;
  options.out = "runs/x";
  const std::string script = slurm_script("earth-mars-ballistic", options, 8);
  EXPECT_NE(script.find("#SBATCH --array=1-8"), std::string::npos);
  EXPECT_NE(script.find("--shard \"$SLURM_ARRAY_TASK_ID/8\""), std::string::npos);
}

}  // namespace
}  // namespace astronav::campaign
