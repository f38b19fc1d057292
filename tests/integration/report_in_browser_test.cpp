// SPDX-License-Identifier: Apache-2.0
// The report opened in a browser, from disk and with no network: every chart is drawn and no script fails.
#include <array>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <string>

#include <gtest/gtest.h>

#include "foundation/files/mapped_file.h"
#include "support/shared_data.h"
#include "support/synthetic_records.h"
#include "verification/campaign/campaign.h"
#include "verification/report/report.h"

namespace astronav {
namespace {

std::string output_of(const std::string& command) {
  std::string out;
  FILE* pipe = popen(command.c_str(), "r");
  if (pipe == nullptr) return out;
  std::array<char, 65536> buffer;
  for (std::size_t n = 0; (n = fread(buffer.data(), 1, buffer.size(), pipe)) > 0;) out.append(buffer.data(), n);
  pclose(pipe);
  return out;
}

std::size_t count(const std::string& text, const std::string& what) {
  std::size_t n = 0;
  for (std::size_t at = text.find(what); at != std::string::npos; at = text.find(what, at + what.size())) ++n;
  return n;
}

class ReportInBrowser : public ::testing::Test {
 protected:
  void SetUp() override {
    if (output_of("command -v chromium").empty()) {
      if (testing::shared_data_required()) FAIL() << "CI needs chromium";
      GTEST_SKIP() << "no chromium on this machine";
    }
    std::string pattern = (std::filesystem::temp_directory_path() / "astronav_report_XXXXXX").string();
    ASSERT_NE(mkdtemp(pattern.data()), nullptr);
    folder_ = pattern;
  }
  void TearDown() override {
    if (!folder_.empty()) std::filesystem::remove_all(folder_);
  }
  std::string browse(const std::string& file, const std::string& what) const {
    return output_of(
        "timeout 100 chromium --no-sandbox --headless --disable-gpu --no-first-run --disable-background-networking"
        " --disable-component-update --disable-sync --disable-dev-shm-usage --host-resolver-rules='MAP * ~NOTFOUND'"
        " --user-data-dir=" +
        (folder_ / "profile").string() + " --window-size=1280,2000 " + what + " file://" + (folder_ / file).string() +
        " 2>/dev/null");
  }
  std::filesystem::path folder_;
};

TEST_F(ReportInBrowser, MissionDrawsEveryChart) {
  const auto records =
      astronav::testing::synthetic_records({.seed = 5, .cycles = 8, .images_per_window = 6, .frames = 2});
  ASSERT_TRUE(write_file(folder_ / "report.html", report::mission_html(records, loop::summarize(records))));
  const std::string dom = browse("report.html", "--dump-dom");
  EXPECT_NE(dom.find("data-ready=\"yes\""), std::string::npos) << dom.substr(0, 400);
  EXPECT_NE(dom.find("data-errors=\"0\""), std::string::npos) << dom.substr(0, 400);
  // Three axes of position and of velocity, NEES, NIS, residuals u and v, attitude, stars, star errors, times.
  EXPECT_NE(dom.find("data-charts=\"14\""), std::string::npos) << dom.substr(0, 400);
  EXPECT_EQ(count(dom, "class=\"uplot"), 14u);
  EXPECT_EQ(count(dom, "href=\"data:image/png;base64,"), 2u);
  EXPECT_NE(dom.find("<canvas class=\"orbit\""), std::string::npos);
  EXPECT_NE(dom.find("<canvas class=\"density\""), std::string::npos);
  EXPECT_GT(count(dom, "class=\"mark star\""), 50u);
  EXPECT_NE(dom.find("the spacecraft knew its place to"), std::string::npos);
  EXPECT_EQ(dom.find("[object "), std::string::npos);
  browse("report.html", "--screenshot=" + (folder_ / "page.png").string());
  ASSERT_TRUE(std::filesystem::exists(folder_ / "page.png"));
  EXPECT_GT(std::filesystem::file_size(folder_ / "page.png"), 60'000u);  // an empty page compresses to a tenth of this
}

TEST_F(ReportInBrowser, AGyroHasAChartOfItsOwn) {
  auto records = astronav::testing::synthetic_records({.seed = 5, .cycles = 5, .images_per_window = 3});
  for (loop::Event& e : records.events)
    e.attitude = {.foretold = e.image % 6 != 0, .error_rad = Vec3(3e-4, 2e-4, 1e-4), .sigma_rad = Vec3::Constant(4e-4)};
  ASSERT_TRUE(write_file(folder_ / "report.html", report::mission_html(records, loop::summarize(records))));
  const std::string dom = browse("report.html", "--dump-dom");
  EXPECT_NE(dom.find("data-errors=\"0\""), std::string::npos) << dom.substr(0, 400);
  EXPECT_NE(dom.find("data-charts=\"15\""), std::string::npos) << dom.substr(0, 400);
  EXPECT_NE(dom.find("Attitude between images"), std::string::npos);
}

TEST_F(ReportInBrowser, MissionWithoutImagesAndShortMissionsAreDrawnToo) {
  for (const int cycles : {1, 5}) {
    auto records = astronav::testing::synthetic_records({.seed = 5, .cycles = cycles, .images_per_window = 3});
    records.level = "mil";
    ASSERT_TRUE(write_file(folder_ / "report.html", report::mission_html(records, loop::summarize(records))));
    const std::string dom = browse("report.html", "--dump-dom");
    EXPECT_NE(dom.find("data-errors=\"0\""), std::string::npos) << dom.substr(0, 400);
    EXPECT_NE(dom.find("data-ready=\"yes\""), std::string::npos) << dom.substr(0, 400);
  }
}

TEST_F(ReportInBrowser, CampaignDrawsEveryChart) {
  campaign::Options options;
  options.samples = 4;
  options.version = "0";
  options.out = folder_ / "campaign";
  const auto outcome =
      campaign::run(scenario::Draft(), options,
                    [](const scenario::Scenario&, std::uint64_t seed, std::uint64_t) -> Result<loop::Records> {
                      if (seed == 3) return fail(ErrorCode::not_converged, "went astray");
                      return astronav::testing::synthetic_records({.seed = seed, .cycles = 8, .images_per_window = 4});
                    },
                    {});
  ASSERT_TRUE(outcome);
  const auto statistics = campaign::statistics(*outcome);
  ASSERT_TRUE(statistics);
  ASSERT_TRUE(write_file(folder_ / "report.html", report::campaign_html(*outcome, *statistics)));
  const std::string dom = browse("report.html", "--dump-dom");
  EXPECT_NE(dom.find("data-errors=\"0\""), std::string::npos) << dom.substr(0, 400);
  EXPECT_NE(dom.find("data-charts=\"13\""), std::string::npos) << dom.substr(0, 400);
  EXPECT_NE(dom.find("went astray"), std::string::npos);
}

}  // namespace
}  // namespace astronav
