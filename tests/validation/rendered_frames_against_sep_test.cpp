// SPDX-License-Identifier: Apache-2.0
// Rendered stars measured by SEP: places and fluxes must be those of the truth.
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <sstream>

#include <gtest/gtest.h>
#include <unistd.h>

#include "foundation/files/mapped_file.h"
#include "foundation/math/rotation.h"
#include "foundation/math/statistics.h"
#include "foundation/raster/raster.h"
#include "models/camera_file/camera_file.h"
#include "simulator/render/renderer.h"
#include "support/shared_data.h"

namespace astronav {
namespace {

namespace fs = std::filesystem;

constexpr int kFrames = 20;
constexpr double kLeastSnr = 50.0;
constexpr double kApart = 14.0;  // px: two apertures and a little
constexpr double kEdge = 15.0;

bool tools_are_there() {
  return std::system("/usr/bin/python3 -c 'import sep, astropy' 2>/dev/null") == 0;
}

// Bright enough, not saturated, and alone: what a measurement of a single star can be asked for.
std::vector<render::RenderedSource> fair(const std::vector<render::RenderedSource>& all, const Camera& camera) {
  std::vector<render::RenderedSource> out;
  for (const render::RenderedSource& s : all) {
    const double u = s.pixel.u;
    const double v = s.pixel.v;
    const bool inside = u > kEdge && v > kEdge && u < camera.intrinsics.width_px - 1 - kEdge &&
                        v < camera.intrinsics.height_px - 1 - kEdge;
    const double noise = std::sqrt(s.electrons + 113.0 * 170.0);  // 113 pixels of the aperture
    const double peak = s.electrons / (2.0 * kPi * camera.psf.sigma_px * camera.psf.sigma_px);
    if (!inside || s.electrons / noise < kLeastSnr || peak > 0.8 * camera.detector.full_well_e) continue;
    bool alone = true;
    for (const render::RenderedSource& other : all) {
      const double distance = (other.pixel.vec() - s.pixel.vec()).norm();
      if (&other != &s && distance < kApart && other.electrons > 0.003 * s.electrons) alone = false;
      if (other.electrons > 3e5 && &other != &s && distance < 60.0) alone = false;
    }
    if (alone) out.push_back(s);
  }
  return out;
}

TEST(RenderedFramesAgainstSep, PlacesWithinATwentiethOfAPixelAndFluxesWithinTwoPercent) {
  if (!tools_are_there()) {
    const char* missing = "python3-sep or python3-astropy is not installed";
    if (testing::shared_data_required()) FAIL() << missing;
    GTEST_SKIP() << missing;
  }
  const MappedFile kernel = *MappedFile::open(home_directory() / "data" / "de405_2000_2050.bsp");
  const MappedFile stars = *MappedFile::open(home_directory() / "data" / "hipparcos.stars");
  const Ephemeris ephemeris = *Ephemeris::open(kernel.bytes());
  const StarCatalogue catalogue = *StarCatalogue::open(stars.bytes());
  const sky::Sky sky(ephemeris, catalogue);
  const State observer{.p_m = Vec3(kAstronomicalUnit, 0.0, 0.0), .v_m_s = Vec3(0.0, 3e4, 0.0)};
  const fs::path folder = fs::temp_directory_path() / ("astronav_sep_" + std::to_string(::getpid()));
  fs::create_directories(folder);
  RandomStream random({.seed = 7, .purpose = "pointings for SEP"});
  Camera camera = *read_camera("extrema-20deg");
  // SEP takes a median for the background: with half a DN of noise that is a whole number, and 0.3 DN off.
  camera.detector.gain_e_dn = 2.0;
  camera.detector.bits = 16;
  const BandPhotometry band(camera);
  const render::Renderer renderer(camera, 1);
  std::size_t asked = 0;
  {
    std::ofstream(folder / "gain.txt") << camera.detector.gain_e_dn;
    std::ofstream list(folder / "stars.csv");
    list.precision(12);
    for (int i = 0; i < kFrames; ++i) {
      const Mat3 R_CN = R_CN_from_pointing(
          {2.0 * kPi * random.uniform(), std::asin(random.uniform(-1.0, 1.0)), 2.0 * kPi * random.uniform()});
      const auto seen = sky.look(*Epoch::parse("2026-11-22T00:00:00 TDB"), observer, R_CN.row(2).transpose(),
                                 camera.intrinsics.half_diagonal_rad() + 0.01, band, {.max_v_mag = 12.0});
      ASSERT_TRUE(seen);
      const auto sources = render::place_sources(*seen, camera, R_CN, camera.exposure_s);
      ImageU16 frame;
      renderer.frame(sources, {.duration_s = camera.exposure_s},
                     {.image = static_cast<std::uint64_t>(i), .purpose = ""}, frame);
      const std::string name = "frame" + std::to_string(i) + ".fits";
      ASSERT_TRUE(write_fits(folder / name, frame, {}));
      for (const render::RenderedSource& s : fair(sources, camera)) {
        list << name << ',' << s.pixel.u << ',' << s.pixel.v << ',' << s.electrons << '\n';
        ++asked;
      }
    }
  }
  ASSERT_GT(asked, 200u);
  const std::string command =
      "/usr/bin/python3 '" ASTRONAV_VALIDATION_DIR "/measure_with_sep.py' '" + folder.string() + "'";
  ASSERT_EQ(std::system(command.c_str()), 0);
  std::vector<double> distances;
  std::vector<double> ratios;
  std::vector<double> misses;
  std::ifstream measured(folder / "measured.csv");
  std::size_t lost = 0;
  for (std::string line; std::getline(measured, line);) {
    std::istringstream fields(line);
    std::string frame, distance, ratio, snr;
    std::getline(fields, frame, ',');
    std::getline(fields, distance, ',');
    std::getline(fields, ratio, ',');
    std::getline(fields, snr, ',');
    if (distance.empty()) {
      ++lost;
      continue;
    }
    distances.push_back(std::stod(distance));
    ratios.push_back(std::stod(ratio));
    misses.push_back(std::abs(std::stod(ratio) - 1.0));
  }
  ASSERT_EQ(distances.size() + lost, asked);
  std::printf(
      "SEP on %d frames, %zu stars with S/N > 50: places within %.4f px (median), %.4f (95 %%); flux ratio %.4f "
      "(median), off by %.4f (median); %zu not found\n",
      kFrames, asked, median(distances), quantile(distances, 0.95), median(ratios), median(misses), lost);
  EXPECT_EQ(lost, 0u);
  EXPECT_LE(median(distances), 0.05);
  EXPECT_LE(std::abs(median(ratios) - 1.0), 0.015);  // the light of faint neighbours is in it
  EXPECT_LE(median(misses), 0.02);
  fs::remove_all(folder);
}

}  // namespace
}  // namespace astronav
