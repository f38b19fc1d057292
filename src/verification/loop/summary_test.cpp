// SPDX-License-Identifier: Apache-2.0
#include "verification/loop/summary.h"

#include <cmath>
#include <vector>

#include <gtest/gtest.h>

#include "support/synthetic_records.h"

namespace astronav::loop {
namespace {

using astronav::testing::synthetic_records;
using astronav::testing::SyntheticOptions;

// Two steady windows with errors that can be worked out by hand.
Records by_hand() {
  Records records;
  records.level = "sil";
  records.images = 4;
  for (int cycle = 0; cycle < 5; ++cycle) {
    Event e;
    e.kind = EventKind::cycle_end;
    e.cycle = cycle;
    e.epoch = Epoch::tdb_seconds(864000.0 * cycle);
    e.truth.p_m = Vec3(1.5e11, 0, 0);
    const double size = cycle < 3 ? 1e9 : cycle == 3 ? 3000.0 : 4000.0;  // the first three must not count
    e.estimate.p_m = e.truth.p_m + Vec3(size, 0, -2.0 * size);
    e.estimate.v_m_s = Vec3(0, cycle == 3 ? 1.0 : -1.0, 0);
    e.covariance.diagonal() << 1e6, 4e6, 9e6, 0.01, 0.04, 0.09;
    e.nees = cycle == 3 ? 5.0 : 8.0;
    records.events.push_back(e);
  }
  for (int i = 0; i < 4; ++i) {
    Event e;
    e.kind = EventKind::image;
    e.cycle = 4;
    e.attitude_found = i != 3;
    e.attitude_wrong = i == 2;
    e.planet_found = i < 3;
    e.planet_false = i == 2;
    e.accepted = i < 2;
    e.nis = i + 1.0;
    e.planet_error_px = Vec2(0.3, 0.4);
    e.attitude_error_rad = Vec3(3, 4, 20) * kArcsecond;
    e.centroid_error_sum2_px2 = 2.0;
    e.centroid_error_count = 50;
    records.events.push_back(e);
  }
  records.image_ms = {4.0, 1.0, 2.0, 3.0};
  return records;
}

TEST(Summary, FiguresWorkedOutByHand) {
  const Summary s = summarize(by_hand());
  EXPECT_EQ(s.steady_count, 2);
  EXPECT_NEAR(s.position_error_km.final_rss, 4.0 * std::sqrt(5.0), 1e-6);
  EXPECT_NEAR(s.position_error_km.steady_rms_rss, std::sqrt(5.0 * 12.5), 1e-6);
  EXPECT_NEAR(s.position_error_km.steady_3sigma_axis[0], 3.0 * std::sqrt(12.5), 1e-6);
  EXPECT_NEAR(s.position_error_km.steady_3sigma_axis[1], 0.0, 1e-6);
  EXPECT_NEAR(s.position_error_km.worst_axis(), 6.0 * std::sqrt(12.5), 1e-6);
  EXPECT_NEAR(s.position_error_km.formal_3sigma_axis[2], 9.0, 1e-9);
  // About zero: +1 and -1 do not cancel.
  EXPECT_NEAR(s.velocity_error_m_s.steady_3sigma_axis[1], 3.0, 1e-9);
  EXPECT_NEAR(s.velocity_error_m_s.formal_3sigma_axis[0], 0.3, 1e-9);
  EXPECT_TRUE(std::isnan(s.position_error_km.end_of_coast.steady_rms_rss));
  EXPECT_NEAR(s.nees_mean, 6.5, 1e-12);
  EXPECT_NEAR(s.nis_mean, 1.5, 1e-12);
  EXPECT_EQ(s.nis_count, 2);
  EXPECT_EQ(s.edited_count, 1);
  EXPECT_NEAR(s.vision.attitude_success_rate, 0.5, 1e-12);
  EXPECT_NEAR(s.vision.planet_success_rate, 0.5, 1e-12);
  EXPECT_EQ(s.vision.false_planets, 1);
  EXPECT_NEAR(s.vision.centroid_error_px_1sigma, 0.2, 1e-12);
  EXPECT_NEAR(s.vision.planet_error_px_1sigma, std::sqrt(0.125), 1e-12);
  EXPECT_NEAR(s.vision.attitude_cross_arcsec_1sigma, std::sqrt(12.5), 1e-9);
  EXPECT_NEAR(s.vision.attitude_roll_arcsec_1sigma, 20.0, 1e-9);
  EXPECT_NEAR(s.image_ms_median, 2.5, 1e-12);
}

// Two cycles of two windows with two images each; the first image of a cycle is foretold by nothing.
TEST(Summary, AttitudeFilterWorkedOutByHand) {
  Records records;
  records.level = "sil";
  records.images = 8;
  for (int i = 0; i < 8; ++i) {
    Event e;
    e.kind = EventKind::image;
    e.cycle = i / 4;
    e.window = i / 2 % 2;
    e.attitude_found = true;
    AttitudeRecord& a = e.attitude;
    a.foretold = i % 4 != 0;
    e.by_prior = a.foretold && i != 6;
    a.after_slew = i % 4 == 2;
    a.error_rad = a.after_slew ? Vec3(300, 400, 50) * kArcsecond : Vec3(30, 40, 5) * kArcsecond;
    a.nees = i;
    a.restarted = i == 6;
    a.accepted = a.foretold && !a.restarted;
    a.nis = 10.0 * i;
    a.knows_bias = true;
    a.bias_error_rad_s = Vec3(1, -2, 2) * (i == 3 ? 1.0 : i == 7 ? 2.0 : 1e3) * kDegree / 3600.0;
    records.events.push_back(e);
  }
  const Summary summary = summarize(records);
  const AttitudeFilterSummary& s = summary.attitude_filter;
  EXPECT_NEAR(s.by_prior_rate, 5.0 / 8.0, 1e-12);
  EXPECT_NEAR(s.cross_arcsec_1sigma, std::sqrt(1250.0), 1e-9);
  EXPECT_NEAR(s.roll_arcsec_1sigma, 5.0, 1e-9);
  EXPECT_NEAR(s.slew_cross_arcsec_1sigma, std::sqrt(125000.0), 1e-9);
  EXPECT_NEAR(s.slew_roll_arcsec_1sigma, 50.0, 1e-9);
  EXPECT_NEAR(s.nees_mean, (1 + 2 + 3 + 5 + 6 + 7) / 6.0, 1e-12);
  EXPECT_NEAR(s.nis_mean, (10 + 20 + 30 + 50 + 70) / 5.0, 1e-12);
  EXPECT_NEAR(s.bias_error_deg_h_1sigma, std::sqrt((3.0 + 12.0) / 2.0), 1e-9);
  EXPECT_EQ(s.restarts, 1);
  EXPECT_EQ(s.foretold, 6);
  EXPECT_EQ(s.slews, 2);
  EXPECT_NE(to_text(summary).find("begun anew 1 time"), std::string::npos);
  EXPECT_EQ(to_json(*summary_from_json(to_json(summary), "x")), to_json(summary));
  const Summary both[] = {summary, summary};
  const AttitudeFilterSummary pooled = pool(both).attitude_filter;
  EXPECT_NEAR(pooled.slew_cross_arcsec_1sigma, s.slew_cross_arcsec_1sigma, 1e-9);
  EXPECT_NEAR(pooled.nees_mean, s.nees_mean, 1e-12);
  EXPECT_EQ(pooled.foretold, 12);
  EXPECT_LT(pooled.nees_band_95.hi, s.nees_band_95.hi);
  EXPECT_TRUE(std::isnan(summarize(by_hand()).attitude_filter.nees_mean));  // without a gyro
}

TEST(Summary, JsonReadsBackAndNamesWhatTheContractNames) {
  Summary s = summarize(by_hand());
  const std::string text = to_json(s);
  for (const char* key : {"\"level\"",
                          "\"seed\"",
                          "\"version\"",
                          "\"cycles\"",
                          "\"images\"",
                          "\"duration_days\"",
                          "\"position_error_km\"",
                          "\"velocity_error_m_s\"",
                          "\"final_rss\"",
                          "\"steady_rms_rss\"",
                          "\"steady_3sigma_axis\"",
                          "\"formal_3sigma_axis\"",
                          "\"end_of_coast\"",
                          "\"nees_mean\"",
                          "\"nees_band_95\"",
                          "\"nis_mean\"",
                          "\"nis_band_95\"",
                          "\"attitude_success_rate\"",
                          "\"planet_success_rate\"",
                          "\"false_planets\"",
                          "\"centroid_error_px_1sigma\"",
                          "\"planet_error_px_1sigma\"",
                          "\"attitude_error_arcsec_1sigma\"",
                          "\"cross\"",
                          "\"roll\"",
                          "\"time_ms_per_image\"",
                          "\"median\"",
                          "\"p99\"",
                          "\"time_ms\"",
                          "\"render\"",
                          "\"centroid\"",
                          "\"identify\"",
                          "\"planets\"",
                          "\"propagate\"",
                          "\"update\"",
                          "\"peak_memory_mb\"",
                          "\"wall_s\""}) {
    EXPECT_NE(text.find(key), std::string::npos) << key;
  }
  const auto again = summary_from_json(text, "x");
  ASSERT_TRUE(again) << describe(again.error());
  EXPECT_EQ(to_json(*again), text);
  EXPECT_TRUE(std::isnan(again->position_error_km.end_of_coast.final_rss));
  EXPECT_FALSE(summary_from_json("{", "x"));
  EXPECT_FALSE(summary_from_json("{}", "x"));
  EXPECT_FALSE(summary_from_json("[1, 2]", "x"));
}

TEST(Summary, PoolingEqualsTheFiguresOfAllEventsTogether) {
  const Records a = synthetic_records({.seed = 1, .cycles = 12, .images_per_window = 8});
  const Records b = synthetic_records({.seed = 2, .cycles = 20, .images_per_window = 8});
  Records all = a;
  all.events.insert(all.events.end(), b.events.begin(), b.events.end());
  all.images += b.images;
  all.cycles += b.cycles;
  const Summary together = summarize(all);
  const std::vector<Summary> parts{summarize(a), summarize(b)};
  const Summary pooled = pool(parts);
  EXPECT_EQ(pooled.runs, 2);
  EXPECT_EQ(pooled.steady_count, together.steady_count);
  for (std::size_t i = 0; i < 3; ++i) {
    EXPECT_NEAR(pooled.position_error_km.steady_3sigma_axis[i] / together.position_error_km.steady_3sigma_axis[i], 1.0,
                1e-12);
    EXPECT_NEAR(pooled.velocity_error_m_s.formal_3sigma_axis[i] / together.velocity_error_m_s.formal_3sigma_axis[i],
                1.0, 1e-12);
    EXPECT_NEAR(pooled.position_error_km.end_of_coast.steady_3sigma_axis[i] /
                    together.position_error_km.end_of_coast.steady_3sigma_axis[i],
                1.0, 1e-12);
  }
  EXPECT_NEAR(pooled.nees_mean, together.nees_mean, 1e-10);
  EXPECT_NEAR(pooled.nis_mean, together.nis_mean, 1e-10);
  EXPECT_NEAR(pooled.vision.planet_error_px_1sigma, together.vision.planet_error_px_1sigma, 1e-12);
}

// The band of one run must hold the mean NEES of a perfect filter in 95 % of the runs, where the textbook band does
// not. 200 runs: a share outside [0.88, 0.995] has a chance below 1e-3 if the true share is between 0.93 and 0.97.
TEST(Summary, TheBandOfTheMeanNeesHoldsAPerfectFilter) {
  constexpr int runs = 200;
  int inside = 0;
  int inside_textbook = 0;
  double sum = 0.0;
  double sum2 = 0.0;
  double effective = 0.0;
  for (int seed = 1; seed <= runs; ++seed) {
    const Summary s =
        summarize(synthetic_records({.seed = static_cast<std::uint64_t>(seed), .cycles = 25, .images_per_window = 6}));
    inside += s.nees_band_95.contains(s.nees_mean);
    inside_textbook += chi_square_mean_band(0.95, 6.0, s.steady_count).contains(s.nees_mean);
    sum += s.nees_mean;
    sum2 += s.nees_mean * s.nees_mean;
    effective = s.nees_effective_count;
  }
  const double mean_nees = sum / runs;
  const double variance = sum2 / runs - mean_nees * mean_nees;
  RecordProperty("effective_windows", std::to_string(effective));
  RecordProperty("share_inside", std::to_string(static_cast<double>(inside) / runs));
  RecordProperty("variance", std::to_string(variance));
  EXPECT_GE(inside, 176);
  EXPECT_LE(inside, 199);
  EXPECT_LT(inside_textbook, 160);
  // The predicted variance 12 / N_eff against the one found (its own scatter over 200 runs is about 15 %).
  EXPECT_NEAR(variance / (12.0 / effective), 1.0, 0.6);
}

TEST(Summary, AnOverconfidentFilterLeavesTheBands) {
  const Summary s = summarize(synthetic_records({.seed = 3, .truth_over_filter = 2.0}));
  EXPECT_GT(s.nees_mean, s.nees_band_95.hi);
  EXPECT_GT(s.nis_mean, s.nis_band_95.hi);
  const Summary good = summarize(synthetic_records({.seed = 3}));
  EXPECT_TRUE(good.nis_band_95.contains(good.nis_mean));  // one fixed seed
}

TEST(Summary, AMissionTooShortForASteadyStateSaysSo) {
  const Summary s = summarize(synthetic_records({.cycles = 2, .images_per_window = 3}));
  EXPECT_EQ(s.steady_count, 0);
  EXPECT_TRUE(std::isnan(s.nees_mean));
  EXPECT_NE(to_text(s).find("too few"), std::string::npos);
  const Summary nothing = summarize(Records{});
  EXPECT_TRUE(std::isnan(nothing.position_error_km.final_rss));
  EXPECT_FALSE(to_text(nothing).empty());
}

}  // namespace
}  // namespace astronav::loop
