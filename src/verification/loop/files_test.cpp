// SPDX-License-Identifier: Apache-2.0
#include "verification/loop/files.h"

#include <algorithm>
#include <filesystem>
#include <sstream>

#include <gtest/gtest.h>

#include "foundation/files/mapped_file.h"
#include "support/synthetic_records.h"

namespace astronav::loop {
namespace {

TEST(Files, EveryRowOfTheRecordsHasEveryColumn) {
  Records records = astronav::testing::synthetic_records({.cycles = 4, .images_per_window = 3});
  records.events[1].attitude = {.foretold = true, .accepted = true, .knows_bias = true};
  records.events[2].kind = EventKind::survey_image;
  std::istringstream csv(records_csv(records));
  std::string line;
  std::getline(csv, line);
  const auto columns = std::count(line.begin(), line.end(), ',');
  std::size_t rows = 0;
  while (std::getline(csv, line)) {
    EXPECT_EQ(std::count(line.begin(), line.end(), ','), columns) << line;
    ++rows;
  }
  EXPECT_EQ(rows, records.events.size());
}

TEST(Files, OrbitEphemerisMessagesReadBack) {
  const Records records = astronav::testing::synthetic_records({.cycles = 4, .images_per_window = 3});
  const auto estimate = parse_oem(to_text(estimate_oem(records)), "estimate");
  ASSERT_TRUE(estimate) << describe(estimate.error());
  ASSERT_FALSE(estimate->epochs.empty());
  EXPECT_TRUE(std::is_sorted(estimate->epochs.begin(), estimate->epochs.end()));
  EXPECT_EQ(std::adjacent_find(estimate->epochs.begin(), estimate->epochs.end()), estimate->epochs.end());
  const Event& last = records.events.back();
  EXPECT_EQ(estimate->epochs.back(), last.epoch);
  EXPECT_LT((estimate->states.back().p_m - last.estimate.p_m).norm(), 1.0);
  EXPECT_LT((estimate->states.back().v_m_s - last.estimate.v_m_s).norm(), 1e-5);
  ASSERT_FALSE(estimate->covariances.empty());
  EXPECT_NEAR(estimate->covariances.back().covariance(0, 0) / last.covariance(0, 0), 1.0, 1e-6);
  const auto truth = parse_oem(to_text(truth_oem(records)), "truth");
  ASSERT_TRUE(truth) << describe(truth.error());
  EXPECT_LT((truth->states.back().p_m - last.truth.p_m).norm(), 1.0);
}

TEST(Files, AFolderHoldsThemAll) {
  const Records records = astronav::testing::synthetic_records({.cycles = 2, .images_per_window = 2});
  const auto folder = std::filesystem::temp_directory_path() / "astronav_files_test" / "run";
  std::filesystem::remove_all(folder);
  const auto ok = write_files(folder, records, summarize(records));
  ASSERT_TRUE(ok) << describe(ok.error());
  for (const char* file : {"summary.json", "estimate.oem", "truth.oem", "records.csv", "scenario.resolved.toml"}) {
    EXPECT_GT(std::filesystem::file_size(folder / file), 20u) << file;
  }
  // A file where the folder should be.
  ASSERT_TRUE(write_file(folder.parent_path() / "taken", "x"));
  EXPECT_FALSE(write_files(folder.parent_path() / "taken", records, summarize(records)));
  std::filesystem::remove_all(folder.parent_path());
}

}  // namespace
}  // namespace astronav::loop
