// SPDX-License-Identifier: Apache-2.0
// `astronav fix` on six frames that New Horizons took of Proxima Centauri and Wolf 359 on 2020-04-22 and 23 from 47 au
// (Lauer et al. 2025, who came within 0.35 au by twelve), against its trajectory: JPL Horizons, and the headers, of
// which the fix uses epochs and plates only.
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <string>
#include <vector>

#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include "foundation/math/linear.h"
#include "foundation/time/epoch.h"
#include "models/ephemeris/bodies.h"
#include "support/program.h"
#include "support/shared_data.h"

namespace astronav {
namespace {

using nlohmann::json;
using testing::words;

constexpr double kAuKm = kAstronomicalUnit / 1e3;

json fixed(const std::string& line) {
  const testing::ScratchFolder scratch;
  setenv("ASTRONAV_HOME", ASTRONAV_TEST_HOME, 1);
  const testing::Outcome outcome = testing::run_program(ASTRONAV_PROGRAM, words("fix --json " + line), scratch.path());
  EXPECT_EQ(outcome.status, 0) << outcome.err;
  return outcome.status == 0 ? json::parse(outcome.out) : json::object();
}

std::string frames(const std::filesystem::path& folder, const std::vector<const char*>& mets) {
  std::string list;
  for (const char* met : mets) list += (folder / ("lor_" + std::string(met) + "_0x633_pwcs2.fits")).string() + " ";
  return list;
}
const std::vector<const char*> kAll{"0449855930", "0449855931", "0449913531", "0449933827", "0449933832", "0449955456"};

// Barycentric, km: the cubic through two rows of Horizons (30 days, au and au/day) with their velocities.
Vec3 new_horizons(const std::filesystem::path& horizons, Epoch epoch) {
  const std::string text = testing::read_text(horizons);
  struct Row {
    double jd;
    Vec3 p, v;
  };
  std::vector<Row> rows;
  std::size_t at = text.find("$$SOE");
  const std::size_t end = text.find("$$EOE");
  while ((at = text.find('\n', at) + 1) < end) {
    Row row;
    const char* line = text.c_str() + at;
    if (std::sscanf(line, "%lf, A.D. %*[^,], %lf, %lf, %lf, %lf, %lf, %lf", &row.jd, &row.p[0], &row.p[1], &row.p[2],
                    &row.v[0], &row.v[1], &row.v[2]) == 7)
      rows.push_back(row);
  }
  const double jd = 2451545.0 + epoch.tdb_seconds() / 86400.0;
  for (std::size_t i = 0; i + 1 < rows.size(); ++i) {
    const Row &a = rows[i], &b = rows[i + 1];
    if (jd < a.jd || jd > b.jd) continue;
    const double T = b.jd - a.jd, t = (jd - a.jd) / T;
    return kAuKm * ((1 + 2 * t) * (1 - t) * (1 - t) * a.p + t * (1 - t) * (1 - t) * T * a.v +
                    t * t * (3 - 2 * t) * b.p - t * t * (1 - t) * T * b.v);
  }
  ADD_FAILURE() << "the table has no row about " << jd;
  return Vec3::Zero();
}

struct Judged {
  double error_au = 0.0, nees = 0.0;
};
Judged judge(const json& found, const std::filesystem::path& horizons) {
  const json& p = found["position_km"];
  const Vec3 truth = new_horizons(horizons, Epoch::parse(found["epoch_tdb"].get<std::string>() + " TDB").value());
  const Vec3 error = Vec3(p["x"], p["y"], p["z"]) - truth;
  Mat3 covariance;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) covariance(i, j) = found["covariance_km2"][i][j];
  return {error.norm() / kAuKm, error.dot(covariance.inverse() * error)};
}

TEST(StarFixAgainstNewHorizons, SixFrames) {
  const auto folder = ASTRONAV_SHARED_DATA("images/lorri");
  const auto horizons = ASTRONAV_SHARED_DATA("trajectories/newhorizons_horizons.txt");
  const auto stars = ASTRONAV_SHARED_DATA("stars/nearby_gaia_dr3.csv");
  const std::string targets = " --camera lorri --targets " + stars.string();
  const json found = fixed(frames(folder, kAll) + targets);
  ASSERT_TRUE(found.contains("position_km"));
  const Judged judged = judge(found, horizons);
  std::printf("  %.3f au off at 47 au, NEES %.2f (3), chi-square %.2f of %d\n", judged.error_au, judged.nees,
              found["chi2"].get<double>(), found["degrees_of_freedom"].get<int>());
  EXPECT_LE(judged.error_au, 0.35);
  EXPECT_LE(judged.nees, 14.16);  // 3 sigma: 99.73 % of chi-square with three degrees of freedom
  EXPECT_EQ(found["degrees_of_freedom"], 9);
  EXPECT_GE(found["chi2"].get<double>() / 9.0, 0.5);
  EXPECT_LE(found["chi2"].get<double>() / 9.0, 2.0);
  // It must not be so unsure that anything fits.
  for (const char* axis : {"x", "y", "z"}) EXPECT_LE(found["sigma_km"][axis].get<double>() / kAuKm, 0.35);
  ASSERT_EQ(found["fields"].size(), 2u);
  for (const json& field : found["fields"]) {
    EXPECT_TRUE(field["sigma_measured"].get<bool>());
    EXPECT_GE(field["field_stars"].get<int>(), 8);
  }
  // 36 arcsec of parallax: nine pixels.
  for (const json& sight : found["sights"])
    if (sight["name"] == "Proxima Centauri") EXPECT_NEAR(sight["parallax_shift_east_arcsec"].get<double>(), -31.8, 1.0);

  // What the spacecraft's velocity adds is a share of the error.
  const json with = fixed(frames(folder, kAll) + targets + " --velocity 5.44,-11.98,-4.65");
  ASSERT_TRUE(with.contains("position_km"));
  EXPECT_LE(judge(with, horizons).error_au, 0.35);
}

// Frames of one star alone, and one frame of each: no fix, or one with the error that is told.
TEST(StarFixAgainstNewHorizons, TooFewFrames) {
  const auto folder = ASTRONAV_SHARED_DATA("images/lorri");
  const auto horizons = ASTRONAV_SHARED_DATA("trajectories/newhorizons_horizons.txt");
  const auto stars = ASTRONAV_SHARED_DATA("stars/nearby_gaia_dr3.csv");
  const std::string targets = " --camera lorri --targets " + stars.string();
  const testing::ScratchFolder scratch;
  setenv("ASTRONAV_HOME", ASTRONAV_TEST_HOME, 1);
  EXPECT_EQ(testing::run_program(ASTRONAV_PROGRAM, words("fix " + frames(folder, {kAll[0], kAll[1]}) + targets),
                                 scratch.path())
                .status,
            3);
  EXPECT_EQ(testing::run_program(ASTRONAV_PROGRAM, words("fix " + frames(folder, {kAll[2], kAll[5]}) + targets),
                                 scratch.path())
                .status,
            2);
  const json found = fixed(frames(folder, {kAll[2], kAll[5]}) + targets + " --sigma-arcsec 0.5");
  ASSERT_TRUE(found.contains("position_km"));
  EXPECT_LE(judge(found, horizons).nees, 14.16);
}

}  // namespace
}  // namespace astronav
