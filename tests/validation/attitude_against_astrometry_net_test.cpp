// SPDX-License-Identifier: Apache-2.0
// Real skies of five cameras, solved with nothing known, against the plate solutions that astrometry.net finds.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <map>
#include <sstream>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "foundation/files/mapped_file.h"
#include "foundation/math/random.h"
#include "foundation/math/rotation.h"
#include "foundation/math/statistics.h"
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

const StarCatalogue& catalogue() {
  static const Result<MappedFile> file = MappedFile::open(home_directory() / "data/hipparcos.stars");
  static const Result<StarCatalogue> stars = StarCatalogue::open(file.value().bytes());
  return stars.value();
}
Solver& solver() {
  static Solver only(catalogue());
  return only;
}

// Nothing is known: neither field nor pointing nor time.
TEST(AttitudeAgainstAstrometryNet, RealSkiesBlind) {
  const auto truth_path = ASTRONAV_SHARED_DATA("images/truth.csv");
  int listed = 0, right = 0, wrong = 0;
  std::map<std::string, std::vector<double>> off_of;
  for (const Row& row : read_truth(truth_path)) {
    if (!row.solved) continue;
    ++listed;
    const auto picture = read_picture(truth_path.parent_path() / row.image);
    ASSERT_TRUE(picture) << describe(picture.error());
    const auto solution = solver().solve(*picture, {});
    if (!solution) {
      std::printf("  none   %-50s %s\n", row.image.c_str(), describe(solution.error()).c_str());
      continue;
    }
    const Pointing center = center_pointing(*solution);
    const double off = angle_between(direction_from_radec(center.ra_rad, center.dec_rad),
                                     direction_from_radec(row.ra_deg * kDegree, row.dec_deg * kDegree)) /
                       kArcsecond;
    const double roll = std::abs(std::remainder(center.roll_rad / kDegree - row.roll_deg, 360.0));
    const bool ok = off <= row.tolerance_arcsec && roll <= row.tolerance_roll_deg && !solution->mirrored;
    ++(ok ? right : wrong);
    off_of[row.image.substr(0, row.image.rfind('/'))].push_back(off);
    std::printf(
        "  %s %-50s off %.1f of %.0f arcsec, roll %.3f of %.2f deg, %zu of %zu stars, rms %.2f px, chance %.1g\n",
        ok ? "right " : "WRONG ", row.image.c_str(), off, row.tolerance_arcsec, roll, row.tolerance_roll_deg,
        solution->stars.size(), solution->detected, solution->attitude.residual_rms_px,
        solution->attitude.chance_probability);
    EXPECT_LT(solution->attitude.chance_probability, 1e-6);
  }
  EXPECT_EQ(listed, 23);
  EXPECT_EQ(right, 23);
  EXPECT_EQ(wrong, 0);
  EXPECT_LE(median(off_of["tetra3"]), 5.0);
  EXPECT_LE(median(off_of["openstartracker/exp50ms"]), 5.0);
}

// Turned round, a picture gives the same centre and says so.
TEST(AttitudeAgainstAstrometryNet, AMirroredSkyIsRecognised) {
  const auto path = ASTRONAV_SHARED_DATA("images/cedar/jan1_g90_e50ms.jpg");
  auto picture = read_picture(path);
  ASSERT_TRUE(picture);
  const auto direct = solver().solve(*picture, {});
  for (int v = 0; v < picture->pixels.height(); ++v)
    std::reverse(picture->pixels.row(v), picture->pixels.row(v) + picture->pixels.width());
  const auto mirrored = solver().solve(*picture, {});
  ASSERT_TRUE(direct && mirrored);
  EXPECT_TRUE(!direct->mirrored && mirrored->mirrored);
  const Pointing a = center_pointing(*direct), b = center_pointing(*mirrored);
  EXPECT_LT(angle_between(direction_from_radec(a.ra_rad, a.dec_rad), direction_from_radec(b.ra_rad, b.dec_rad)),
            5.0 * kArcsecond);
}

// What is no sky is no match: a frame of an eyepiece camera without stars, noise, a page of text, a gradient with soft
// blobs, a lattice of lamps. Each at 1e-6.
TEST(AttitudeAgainstAstrometryNet, NoSkyIsNoMatch) {
  std::map<std::string, Picture> pictures;
  const auto path = ASTRONAV_SHARED_DATA("images/pifinder/empty.png");
  const auto empty = read_picture(path);
  ASSERT_TRUE(empty) << describe(empty.error());
  pictures["empty"] = *empty;
  RandomStream random({.seed = 3, .purpose = "pictures of anything else"});
  const auto make = [&](const std::string& name, auto&& level) {
    Picture& picture = pictures[name];
    picture.bits = 8;
    picture.white_level = 255.0;
    picture.pixels = ImageF(800, 600);
    for (int v = 0; v < 600; ++v)
      for (int u = 0; u < 800; ++u)
        picture.pixels(u, v) = static_cast<float>(std::clamp(std::round(level(u, v)), 0.0, 255.0));
  };
  make("noise", [&](int, int) { return 60.0 + 25.0 * random.normal(); });
  std::vector<int> strokes(100 * 40);
  for (int& s : strokes) s = static_cast<int>(random.uniform(0.0, 65536.0));
  // Letters of 4 x 4 strokes, white on black.
  make("text", [&](int u, int v) {
    const bool gap = u % 8 > 5 || v % 15 > 8;
    return !gap && (strokes[static_cast<std::size_t>(u / 8 + 100 * (v / 15))] >> (u % 8 / 2 + 4 * (v % 15 / 3)) & 1)
               ? 230.0
               : 10.0;
  });
  std::vector<std::array<double, 4>> blobs;
  for (int k = 0; k < 60; ++k)
    blobs.push_back({random.uniform(0.0, 800.0), random.uniform(0.0, 600.0), random.uniform(1.5, 12.0),
                     random.uniform(20.0, 150.0)});
  make("blobs", [&](int u, int v) {
    double x = 30.0 + 0.1 * u + 0.05 * v + 2.0 * random.normal();
    for (const auto& [cu, cv, size, height] : blobs)
      x += height * std::exp(-0.5 * ((u - cu) * (u - cu) + (v - cv) * (v - cv)) / (size * size));
    return x;
  });
  make("lamps", [&](int u, int v) { return (u % 53 < 4 && v % 47 < 4 ? 220.0 : 20.0) + 3.0 * random.normal(); });
  for (const auto& [name, picture] : pictures) {
    const auto solution = solver().solve(picture, {});
    ASSERT_FALSE(solution) << name;
    EXPECT_EQ(solution.error().code, ErrorCode::no_match) << name;
  }
}

}  // namespace
}  // namespace astronav::opensky
