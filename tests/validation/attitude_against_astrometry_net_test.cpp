// SPDX-License-Identifier: Apache-2.0
// Real skies of four cameras, against the plate solutions that astrometry.net finds for them.
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <sstream>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "foundation/files/mapped_file.h"
#include "foundation/math/rotation.h"
#include "support/shared_data.h"
#include "verification/opensky/solver.h"

namespace astronav::opensky {
namespace {

struct Row {
  std::string image;
  bool solved = false;
  double ra_deg = 0, dec_deg = 0, roll_deg = 0, fov_h_deg = 0, tolerance_arcsec = 0, tolerance_roll_deg = 0;
};

std::vector<Row> read_truth(const std::filesystem::path& path) {
  std::ifstream in(path);
  std::string line;
  std::getline(in, line);
  std::vector<Row> rows;
  while (std::getline(in, line)) {
    std::vector<std::string> cells;
    std::istringstream cut(line);
    for (std::string cell; std::getline(cut, cell, ',');) cells.push_back(cell);
    if (cells.size() < 15) continue;
    const auto number = [&](int i) { return cells[i].empty() ? 0.0 : std::stod(cells[i]); };
    rows.push_back({cells[0], cells[3] == "1", number(4), number(5), number(6), number(9), number(13), number(14)});
  }
  return rows;
}

TEST(AttitudeAgainstAstrometryNet, RealSkies) {
  const auto truth_path = ASTRONAV_SHARED_DATA("images/truth.csv");
  const auto file = MappedFile::open(home_directory() / "data/hipparcos.stars");
  ASSERT_TRUE(file) << describe(file.error());
  const auto catalogue = StarCatalogue::open(file->bytes());
  ASSERT_TRUE(catalogue) << describe(catalogue.error());
  Solver solver(*catalogue);
  int listed = 0, right = 0, wrong = 0;
  for (const Row& row : read_truth(truth_path)) {
    if (!row.solved) continue;
    ++listed;
    const auto picture = read_picture(truth_path.parent_path() / row.image);
    ASSERT_TRUE(picture) << describe(picture.error());
    SolveRequest request;
    request.field = FieldRange{0.8 * row.fov_h_deg * kDegree, 1.2 * row.fov_h_deg * kDegree};
    const auto t0 = std::chrono::steady_clock::now();
    const auto solution = solver.solve(*picture, request);
    const double s = std::chrono::duration<double>(std::chrono::steady_clock::now() - t0).count();
    if (!solution) {
      std::printf("  none   %-50s %.2f s: %s\n", row.image.c_str(), s, describe(solution.error()).c_str());
      continue;
    }
    // The centre of the picture, not the boresight: a tangential distortion moves it.
    const Pointing pointing = pointing_from_R_CN(solution->attitude.R_CN);
    const double off = angle_between(direction_from_radec(pointing.ra_rad, pointing.dec_rad),
                                     direction_from_radec(row.ra_deg * kDegree, row.dec_deg * kDegree)) /
                       kArcsecond;
    const double roll = std::abs(std::remainder(pointing.roll_rad / kDegree - row.roll_deg, 360.0));
    const bool ok = off <= row.tolerance_arcsec && roll <= row.tolerance_roll_deg;
    ++(ok ? right : wrong);
    std::printf(
        "  %s %-50s %.2f s, off %.1f of %.0f arcsec, roll %.3f of %.2f deg, %zu of %zu stars, rms %.2f px, fov %.2f "
        "(%.2f), chance %.1g\n",
        ok ? "right " : "WRONG ", row.image.c_str(), s, off, row.tolerance_arcsec, roll, row.tolerance_roll_deg,
        solution->stars.size(), solution->detected, solution->attitude.residual_rms_px,
        solution->attitude.intrinsics.field_of_view_horizontal_rad() / kDegree, row.fov_h_deg,
        solution->attitude.chance_probability);
  }
  EXPECT_EQ(listed, 23);
  EXPECT_GE(right, 18);
  EXPECT_EQ(wrong, 0);
}

TEST(AttitudeAgainstAstrometryNet, NoSkyIsNoMatch) {
  const auto path = ASTRONAV_SHARED_DATA("images/pifinder/empty.png");
  const auto file = MappedFile::open(home_directory() / "data/hipparcos.stars");
  ASSERT_TRUE(file) << describe(file.error());
  const auto catalogue = StarCatalogue::open(file->bytes());
  ASSERT_TRUE(catalogue);
  const auto picture = read_picture(path);
  ASSERT_TRUE(picture) << describe(picture.error());
  Solver solver(*catalogue);
  SolveRequest request;
  request.field = FieldRange{8.16 * kDegree, 12.24 * kDegree};
  const auto solution = solver.solve(*picture, request);
  ASSERT_FALSE(solution);
  EXPECT_EQ(solution.error().code, ErrorCode::no_match);
}

}  // namespace
}  // namespace astronav::opensky
