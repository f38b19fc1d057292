// SPDX-License-Identifier: Apache-2.0
// Rosetta's NavCam as its description tells (navcam_inst.cat of ESA's archive and NSSDC): what the preset renders. No
// real frame of it is at hand.
#include <algorithm>
#include <cmath>

#include <gtest/gtest.h>

#include "models/camera_file/camera_file.h"
#include "models/photometry/photometry.h"
#include "simulator/render/renderer.h"

namespace astronav {
namespace {

constexpr double kSunlike = 0.65;

class NavCam : public ::testing::Test {
 protected:
  void SetUp() override {
    const auto camera = read_camera("navcam");
    ASSERT_TRUE(camera) << describe(camera.error());
    camera_ = *camera;
    middle_ = {512.0, 512.0};
  }
  render::RenderedSource star(double v_mag, double exposure_s) const {
    render::RenderedSource source;
    source.pixel = middle_;
    source.electrons = BandPhotometry(camera_).flux(v_mag, kSunlike).electrons_per_s * exposure_s;
    return source;
  }
  ImageU16 frame(double v_mag, double exposure_s, const render::Effects& effects = {}) const {
    const render::RenderedSource source = star(v_mag, exposure_s);
    ImageU16 out;
    render::Renderer(camera_, 1)
        .frame({&source, 1}, {.duration_s = exposure_s}, {.seed = 1, .purpose = ""}, out, effects);
    return out;
  }
  Camera camera_;
  Pixel middle_;
};

TEST_F(NavCam, PlateScaleAndField) {
  EXPECT_NEAR(camera_.intrinsics.plate_scale_rad_px() / kArcsecond, 17.6, 0.05);
  EXPECT_NEAR(camera_.intrinsics.field_of_view_horizontal_rad() / kDegree, 5.0, 0.02);
}

// 50 to 55 % of a star in the middle of a pixel falls into that pixel.
TEST_F(NavCam, CentralPixelHoldsHalfOfTheLight) {
  const render::RenderedSource source = star(6.0, 1.0);
  render::Effects light = render::Effects::expected();
  light.background = light.dark = false;
  ImageF electrons;
  render::Renderer(camera_, 1).electrons({&source, 1}, {.duration_s = 1.0}, electrons, light);
  const double share = static_cast<double>(electrons(512, 512)) / source.electrons;
  EXPECT_GE(share, 0.50);
  EXPECT_LE(share, 0.55);
}

// 1e5 electrons in 12 bits.
TEST_F(NavCam, FullWellClips) {
  const ImageU16 bright = frame(0.0, 1.0);
  const double full_dn = camera_.detector.bias_dn + camera_.detector.full_well_e / camera_.detector.gain_e_dn;
  EXPECT_NEAR(camera_.detector.full_well_e, 1e5, 1e4);
  EXPECT_NEAR(bright(512, 512), std::min(full_dn, 4095.0), 3.0);
  EXPECT_LE(*std::max_element(bright.pixels().begin(), bright.pixels().end()), 4095);
}

// Detection to V 11 with S/N 5 and more, in 5 s; V 1.6 fills a pixel in the shortest exposure, 10 ms, within half a
// magnitude.
TEST_F(NavCam, FaintAndBrightLimits) {
  const ImageU16 faint = frame(11.0, 5.0), empty = frame(30.0, 5.0);
  double sum = 0.0, mean = 0.0, square = 0.0;
  for (int v = 510; v <= 514; ++v)
    for (int u = 510; u <= 514; ++u) sum += faint(u, v);
  int n = 0;
  for (int v = 0; v < 1000; v += 5) {
    for (int u = 0; u < 1000; u += 5) {
      double box = 0.0;
      for (int j = 0; j < 5; ++j)
        for (int i = 0; i < 5; ++i) box += empty(u + i, v + j);
      mean += box;
      square += box * box;
      ++n;
    }
  }
  mean /= n;
  EXPECT_GE((sum - mean) / std::sqrt(square / n - mean * mean), 5.0);

  const auto peak = [&](double v_mag) {
    ImageF electrons;
    const render::RenderedSource source = star(v_mag, 0.01);
    render::Renderer(camera_, 1).electrons({&source, 1}, {.duration_s = 0.01}, electrons, render::Effects::expected());
    return static_cast<double>(electrons(512, 512));
  };
  EXPECT_GE(peak(1.1), camera_.detector.full_well_e);
  EXPECT_LE(peak(2.1), camera_.detector.full_well_e);
}

}  // namespace
}  // namespace astronav
