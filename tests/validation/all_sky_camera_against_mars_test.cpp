// SPDX-License-Identifier: Apache-2.0
// An all-sky camera on Svalbard, calibrated from the stars of its own picture through the real program: Mars, which
// takes no part, must stand where the ephemeris and the calibrated camera foretell it. The lens, the focal length, the
// attitude and the parity are told to nobody.
#include <algorithm>
#include <cmath>
#include <string>

#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include "support/program.h"
#include "support/shared_data.h"

namespace astronav {
namespace {

using Json = nlohmann::json;
using testing::Outcome;

const std::string kWhere = " --epoch 2020-12-11T20:09:36 --observer ground:78.148,16.043,0";

Json planet(const Json& calibration, const std::string& name) {
  for (const Json& p : calibration["frames"][0]["planets"])
    if (p["name"] == name) return p;
  return {};
}

class AllSkyCamera : public ::testing::Test {
 protected:
  Outcome astronav(const std::string& line) const {
    return testing::run_program(ASTRONAV_PROGRAM, testing::words(line), scratch_.path(), 120);
  }
  Outcome calibrate(const std::filesystem::path& image, const std::string& options) const {
    return astronav("calibrate camera " + image.string() + " --raw 512x512,u16le,66 --fisheye --json " + options);
  }
  testing::ScratchFolder scratch_;
};

TEST_F(AllSkyCamera, MarsStandsWhereItsStarsForetellIt) {
  const auto image = ASTRONAV_SHARED_DATA("images/kho/W8446B18_2020-12-11_20-09-36.img");
  const Outcome got = calibrate(image, "--out kho.toml" + kWhere);
  ASSERT_EQ(got.status, 0) << got.err;
  const Json found = Json::parse(got.out);
  EXPECT_EQ(found["parity"], "direct");
  EXPECT_GE(found["stars"].get<int>(), 120);
  EXPECT_LT(found["residual_rms_px"].get<double>(), 0.3);  // of pixels of 17 arcmin, in both axes together
  EXPECT_LT(found["held_out_rms_px"].get<double>(), 0.3);
  EXPECT_TRUE(found["frames"][0]["aberration_corrected"].get<bool>());

  // The picture's provenance says where Mars is: its brightest star-like source, near column 427, row 392.
  const Json mars = planet(found, "mars");
  ASSERT_FALSE(mars.is_null());
  std::printf("Mars foretold at (%.2f, %.2f), seen %.2f px off; %d stars, %.3f px rms\n",
              mars["predicted_u_px"].get<double>(), mars["predicted_v_px"].get<double>(),
              mars["distance_px"].get<double>(), found["stars"].get<int>(), found["residual_rms_px"].get<double>());
  EXPECT_NEAR(mars["u_px"].get<double>(), 427.0, 1.5);
  EXPECT_NEAR(mars["v_px"].get<double>(), 392.0, 1.5);
  EXPECT_LT(mars["distance_px"].get<double>(), 2.0);

  // The zenith of the site is where the camera looks, within what a tripod is worth.
  EXPECT_NEAR(found["frames"][0]["boresight"]["dec_deg"].get<double>(), 78.148, 5.0);

  // The file says the same as the answer: a rendering with it puts Mars at the same place.
  const Json at = found["frames"][0]["boresight"];
  const std::string pointing = at["ra_deg"].dump() + "," + at["dec_deg"].dump() + "," + at["roll_deg"].dump();
  const Outcome rendered =
      astronav("render --camera kho.toml --refraction --max-v 4 --out kho.fits --truth kho.json --pointing " +
               pointing + kWhere);
  ASSERT_EQ(rendered.status, 0) << rendered.err;
  const Json truth = Json::parse(testing::read_text(scratch_.path() / "kho.json"));
  bool drawn = false;
  for (const Json& source : truth["sources"]) {
    if (source.value("name", "") != "mars") continue;
    drawn = true;
    EXPECT_NEAR(source["u_px"].get<double>(), mars["predicted_u_px"].get<double>(), 0.02);
    EXPECT_NEAR(source["v_px"].get<double>(), mars["predicted_v_px"].get<double>(), 0.02);
  }
  EXPECT_TRUE(drawn);
}

// Nothing of place and time: the same camera. Turned round on disk: the same camera, and the parity is told.
TEST_F(AllSkyCamera, NeedsNeitherPlaceNorParity) {
  const auto image = ASTRONAV_SHARED_DATA("images/kho/W8446B18_2020-12-11_20-09-36.img");
  std::string bytes = testing::read_text(image);
  for (std::size_t row = 0; row < 512; ++row) {
    char* const first = bytes.data() + 66 + row * 1024;
    for (std::size_t u = 0; u < 256; ++u) std::swap_ranges(first + 2 * u, first + 2 * u + 2, first + 2 * (511 - u));
  }
  testing::write_text(scratch_.path() / "turned.img", bytes);
  const Outcome placed = calibrate(image, kWhere);
  const Outcome blind = calibrate(image, "");
  const Outcome turned = calibrate("turned.img", kWhere);
  ASSERT_EQ(placed.status, 0) << placed.err;
  ASSERT_EQ(blind.status, 0) << blind.err;
  ASSERT_EQ(turned.status, 0) << turned.err;
  const Json a = Json::parse(placed.out), b = Json::parse(blind.out), c = Json::parse(turned.out);
  EXPECT_EQ(b["parity"], "direct");
  EXPECT_EQ(c["parity"], "mirrored");
  EXPECT_NEAR(a["intrinsics"]["fx_px"].get<double>(), b["intrinsics"]["fx_px"].get<double>(), 0.15);
  EXPECT_NEAR(a["intrinsics"]["fx_px"].get<double>(), c["intrinsics"]["fx_px"].get<double>(), 0.15);
  EXPECT_NEAR(511.0 - a["intrinsics"]["cx_px"].get<double>(), c["intrinsics"]["cx_px"].get<double>(), 0.3);
  EXPECT_NEAR(planet(a, "mars")["distance_px"].get<double>(), planet(c, "mars")["distance_px"].get<double>(), 0.1);
}

// The shipped all-sky camera, rendered on the ground and calibrated from that rendering alone.
TEST_F(AllSkyCamera, ShippedPresetIsRenderedAndFoundAgain) {
  const std::string where = " --epoch 2026-11-22T02:00:00 --observer ground:52,10,100";
  const Outcome rendered = astronav(
      "render --camera all-sky-fisheye --refraction --max-v 8 --pointing 100,50,10 --out sky.fits --truth sky.json" +
      where);
  ASSERT_EQ(rendered.status, 0) << rendered.err;
  const double fx = 4.0 / 13e-3;  // focal length over pitch
  int behind = 0;
  const Json truth = Json::parse(testing::read_text(scratch_.path() / "sky.json"));
  for (const Json& s : truth["sources"])
    behind += std::hypot(s["u_px"].get<double>() - 511.5, s["v_px"].get<double>() - 511.5) > 0.5 * M_PI * fx;
  EXPECT_GT(behind, 100);  // more than 90 degrees off the axis
  const Outcome got = astronav("calibrate camera sky.fits --fisheye --json --out found.toml" + where);
  ASSERT_EQ(got.status, 0) << got.err;
  const Json found = Json::parse(got.out);
  EXPECT_LT(std::abs(found["intrinsics"]["fx_px"].get<double>() - fx), 5.0 * found["sigma"]["fx_px"].get<double>());
  EXPECT_LT(found["sigma"]["fx_px"].get<double>(), 0.1);
  EXPECT_LT(found["held_out_rms_px"].get<double>(), 0.5);
  EXPECT_NEAR(found["frames"][0]["boresight"]["ra_deg"].get<double>(), 100.0, 0.1);
  EXPECT_NEAR(found["frames"][0]["boresight"]["dec_deg"].get<double>(), 50.0, 0.1);
}

}  // namespace
}  // namespace astronav
