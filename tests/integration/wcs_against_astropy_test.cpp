// SPDX-License-Identifier: Apache-2.0
// The world coordinates in a rendered frame's header, read by astropy, against the truth file of the same frame.
#include <cmath>
#include <cstdlib>
#include <sstream>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "support/program.h"
#include "support/shared_data.h"

namespace astronav {
namespace {

struct Frame {
  const char* camera;
  const char* pointing;
};

TEST(WcsAgainstAstropy, SourcesOfTheTruthStandWhereTheHeaderPutsThem) {
  if (std::system("/usr/bin/python3 -c 'import astropy.wcs' 2>/dev/null") != 0) {
    if (testing::shared_data_required()) FAIL() << "no astropy on this machine";
    GTEST_SKIP() << "no astropy on this machine";
  }
  const testing::ScratchFolder scratch;
  // Without and with distortion, near the equator, near a pole, across RA 0.
  for (const Frame& frame : {Frame{"extrema-20deg", "83.8,-1.2,25"}, Frame{"navcam", "10,88,200"},
                             Frame{"star-tracker-10deg", "0.5,-60,-100"}, Frame{"bent.toml", "200,40,300"},
                             Frame{"all-sky-fisheye", "75,78,40 --max-v 6"}}) {
    if (std::string(frame.camera) == "bent.toml") {
      std::string camera =
          testing::read_text(std::filesystem::path(ASTRONAV_TEST_HOME) / "scenarios/cameras/extrema-20deg.toml");
      ASSERT_EQ(camera.find("[distortion]"), std::string::npos);
      camera += "\n[distortion]\nk1 = -0.08\nk2 = 0.02\np1 = 1e-3\np2 = -5e-4\n";
      testing::write_text(scratch.path() / frame.camera, camera);
    }
    const auto rendered = testing::run_program(
        ASTRONAV_PROGRAM,
        testing::words(std::string("render --epoch 2026-11-22 --out frame.fits --truth truth.json --camera ") +
                       frame.camera + " --pointing " + frame.pointing),
        scratch.path());
    ASSERT_EQ(rendered.status, 0) << rendered.err;
    const auto read = testing::run_program(
        "/usr/bin/python3", {ASTRONAV_INTEGRATION_DIR "/wcs_places.py", "frame.fits", "truth.json", "places.csv"},
        scratch.path());
    ASSERT_EQ(read.status, 0) << read.err;
    double worst_px = 0.0, worst_arcsec = 0.0;
    int sources = 0;
    for (std::string line : testing::lines_of(testing::read_text(scratch.path() / "places.csv"))) {
      for (char& c : line) c = c == ',' ? ' ' : c;
      std::istringstream numbers(line);
      double u = 0, v = 0, wcs_u = 0, wcs_v = 0, arcsec = 0;
      ASSERT_TRUE(numbers >> u >> v >> wcs_u >> wcs_v >> arcsec) << line;
      worst_px = std::max(worst_px, std::hypot(wcs_u - u, wcs_v - v));
      worst_arcsec = std::max(worst_arcsec, arcsec);
      ++sources;
    }
    std::printf("%s: %d sources, at most %.2e px and %.2e arcsec apart\n", frame.camera, sources, worst_px,
                worst_arcsec);
    EXPECT_GT(sources, 20) << frame.camera;
    // TAN and ARC are exact; the polynomials of SIP follow a strong distortion to a thousandth of a pixel.
    const bool bent = std::string(frame.camera) == "bent.toml";
    EXPECT_LT(worst_px, bent ? 1e-3 : 1e-7) << frame.camera;
    EXPECT_LT(worst_arcsec, bent ? 0.07 : 1e-5) << frame.camera;
  }
}

}  // namespace
}  // namespace astronav
