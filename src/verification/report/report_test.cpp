// SPDX-License-Identifier: Apache-2.0
#include "verification/report/report.h"

#include <algorithm>
#include <cmath>
#include <string>

#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include "support/synthetic_records.h"

namespace astronav::report {
namespace {

nlohmann::json data_of(const std::string& html) {
  const std::string open = "<script type=\"application/json\" id=\"data\">";
  const std::size_t begin = html.find(open) + open.size();
  return nlohmann::json::parse(html.substr(begin, html.find("</script>", begin) - begin));
}

TEST(Report, HoldsEverythingInOneFile) {
  const loop::Records records =
      astronav::testing::synthetic_records({.seed = 2, .cycles = 6, .images_per_window = 5, .frames = 2});
  const loop::Summary summary = loop::summarize(records);
  const std::string html = mission_html(records, summary);
  EXPECT_LT(html.size(), 6'000'000u);
  EXPECT_EQ(html.find("{{"), std::string::npos);
  for (const char* outside :
       {"<link", "src=\"http", "href=\"http", "url(http", "@import", "fetch(", "XMLHttpRequest"}) {
    EXPECT_EQ(html.find(outside), std::string::npos) << outside;
  }
  const auto data = data_of(html);
  EXPECT_EQ(data["images"]["index"].size(), 60u);
  const auto first = std::find_if(records.events.begin(), records.events.end(),
                                  [](const loop::Event& e) { return e.kind == loop::EventKind::image; });
  ASSERT_TRUE(first->planet_found);
  EXPECT_NEAR(data["images"]["planet_error"][1][0].get<double>(), first->planet_error_px[1],
              1e-4 * std::abs(first->planet_error_px[1]));
  EXPECT_EQ(data["cycle"]["day"].size(), 6u);
  EXPECT_EQ(data["window"]["nis"].size(), 12u);
  EXPECT_EQ(data["errors"]["day"].size(), records.events.size());
  EXPECT_EQ(data["frames"].size(), 2u);
  EXPECT_EQ(data["orbit"]["planets"].size(), 8u);
  const loop::Event& last = records.events.back();
  EXPECT_NEAR(data["errors"]["position"][0].back().get<double>(), (last.estimate.p_m[0] - last.truth.p_m[0]) * 1e-3,
              1e-5 * std::abs(last.estimate.p_m[0] - last.truth.p_m[0]) * 1e-3);
  EXPECT_NEAR(data["summary"]["nees_mean"].get<double>(), summary.nees_mean, 1e-12);
}

TEST(Report, TextFromOutsideCannotBreakThePage) {
  loop::Records records = astronav::testing::synthetic_records({.cycles = 1, .images_per_window = 1, .frames = 1});
  records.scenario_toml = "# </script><script>alert(1)</script>\n[mission]\nname = \"<b>&\"\n";
  records.frames[0].marks.push_back({{3.0, 4.0}, "</script> \xff", "spot", 5.0});
  const std::string html = mission_html(records, loop::summarize(records));
  EXPECT_EQ(html.find("alert(1)</script>"), std::string::npos);
  EXPECT_NE(html.find("<title>astronav: &lt;b>&amp;"), std::string::npos);
  EXPECT_EQ(data_of(html)["scenario"].get<std::string>(), records.scenario_toml);
}

TEST(Report, FramesBeyondTheBudgetAreLeftOut) {
  loop::Records records = astronav::testing::synthetic_records({.cycles = 1, .images_per_window = 1});
  loop::KeptFrame noise;
  noise.pixels = ImageU16(1024, 1024);
  std::uint32_t state = 1;
  for (auto& pixel : noise.pixels.pixels())
    pixel = static_cast<std::uint16_t>((state = state * 1664525u + 1013904223u) >> 16);
  records.frames.assign(12, noise);
  const std::string html = mission_html(records, loop::summarize(records));
  EXPECT_LT(html.size(), 6'000'000u);
  EXPECT_FALSE(data_of(html)["frames"].empty());
}

TEST(Report, NothingAtAllStillGivesAPage) {
  const loop::Records records;
  const std::string html = mission_html(records, loop::summarize(records));
  EXPECT_EQ(data_of(html)["kind"], "mission");
}

TEST(Report, BrighteningKeepsOrderAndDarkSky) {
  ImageU16 frame(64, 64, 100);
  for (int i = 0; i < 64 * 64; ++i) frame(i % 64, i / 64) = static_cast<std::uint16_t>(98 + i % 5);
  frame(10, 10) = 200;
  frame(20, 20) = 2000;
  frame(30, 30) = 65535;
  const auto bright = brighten(frame.view());
  EXPECT_LT(bright(0, 0), 30);
  EXPECT_GT(bright(10, 10), 60);
  EXPECT_GT(bright(20, 20), bright(10, 10));
  EXPECT_EQ(bright(30, 30), 255);
}

TEST(Report, CampaignPoolsItsSamples) {
  campaign::Outcome outcome;
  outcome.identity = {"[mission]\nname = \"many\"\n", "many", "sil", "0", 1};
  for (std::uint64_t seed = 1; seed <= 4; ++seed) {
    campaign::Sample sample;
    sample.seed = seed;
    if (seed == 2) {
      sample.error = "lost </script>";
    } else {
      sample.summary =
          loop::summarize(astronav::testing::synthetic_records({.seed = seed, .cycles = 8, .images_per_window = 3}));
      for (int k = 0; k < 8; ++k) {
        campaign::WindowError w;
        w.day = 1.0 + 10.0 * k;
        w.position_km = {1.0, -2.0, 0.5};
        w.position_sigma_km = w.velocity_sigma_m_s = {2.0, 2.0, 2.0};
        sample.windows.push_back(w);
      }
    }
    outcome.samples.push_back(sample);
  }
  const auto statistics = campaign::statistics(outcome);
  ASSERT_TRUE(statistics);
  const auto data = data_of(campaign_html(outcome, *statistics));
  EXPECT_EQ(data["samples"].size(), 3u);
  EXPECT_EQ(data["failed"].size(), 1u);
  EXPECT_NEAR(data["formal"]["position_sigma"][0][0].get<double>(), 2.0, 1e-9);
  int counted = 0;
  for (const auto& count : data["normalised"]["counts"][0]) counted += count.get<int>();
  EXPECT_EQ(counted, 15);  // 3 runs, 5 steady windows
}

}  // namespace
}  // namespace astronav::report
