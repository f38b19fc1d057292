// SPDX-License-Identifier: Apache-2.0
// Shapes of light: where it falls, how wide, and that none is lost.
#include "simulator/render/point_spread.h"

#include <cmath>

#include <gtest/gtest.h>

#include "simulator/render/frames_for_tests.h"

namespace astronav::render {
namespace {

constexpr double kPixelVariance = 1.0 / 12.0;  // a pixel's square, which widens every shape

Vec2 outwards_at(const Camera& camera, const RenderedSource& source) {
  return (source.pixel.vec() - Vec2(camera.intrinsics.cx_px, camera.intrinsics.cy_px)).normalized();
}

TEST(PointSpread, ComaHasTheMomentsOfItsPattern) {
  Camera camera = quiet_camera(256);
  camera.psf.coma_px = 3.0;
  for (const auto& [u, v] : {std::pair{200.3, 180.6}, std::pair{40.2, 90.9}}) {
    const RenderedSource star = star_at(u, v, 1e6);
    const Moments m = drawn(camera, star);
    EXPECT_NEAR(m.sum / 1e6, 1.0, 1e-3);
    EXPECT_LT((m.centre - star.pixel.vec()).norm(), 1e-3);
    const double distance =
        std::hypot(u - camera.intrinsics.cx_px, v - camera.intrinsics.cy_px) / (128.0 * std::sqrt(2.0));
    const double c = 3.0 * distance / 3.0;
    const Vec2 out = outwards_at(camera, star);
    const Vec2 across(-out.y(), out.x());
    // Over a pupil of even light, E[rho^4] = 1/3: C^2 (9/2 / 3 - 1) outwards and C^2 / 6 across.
    const double plain = 0.8 * 0.8 + kPixelVariance;
    EXPECT_NEAR(out.dot(m.second * out), plain + 0.5 * c * c, 2e-3);
    EXPECT_NEAR(across.dot(m.second * across), plain + c * c / 6.0, 2e-3);
  }
  // On the axis there is none, and the switch takes it away.
  const RenderedSource star = star_at(200.3, 180.6, 1e6);
  Effects plain;
  plain.psf_aberrations = false;
  EXPECT_NEAR(drawn(camera, star, plain).second(0, 0), 0.64 + kPixelVariance, 1e-3);
  EXPECT_NEAR(drawn(camera, star_at(127.5, 127.5, 1e6)).second(0, 0), 0.64 + kPixelVariance, 1e-3);
}

TEST(PointSpread, WidthGrowsWithTheSquareOfTheField) {
  Camera camera = quiet_camera(256);
  camera.psf.sigma_growth_px = 0.5;
  const RenderedSource star = star_at(191.5, 191.5, 1e6);  // half way to the corner
  EXPECT_NEAR(std::sqrt(drawn(camera, star).second(0, 0) - kPixelVariance), 0.8 + 0.5 / 4.0, 1e-3);
}

PsfKernel gaussian_kernel(double sigma_px, double samples_per_px, int size) {
  PsfKernel kernel{.file = "made here", .width = size, .height = size, .samples_per_px = samples_per_px, .values = {}};
  double sum = 0.0;
  for (int j = 0; j < size; ++j) {
    for (int i = 0; i < size; ++i) {
      const double x = (i - 0.5 * (size - 1)) / samples_per_px;
      const double y = (j - 0.5 * (size - 1)) / samples_per_px;
      const double value = std::exp(-(x * x + y * y) / (2.0 * sigma_px * sigma_px));
      kernel.values.push_back(static_cast<float>(value));
      sum += value;
    }
  }
  for (float& value : kernel.values) value = static_cast<float>(static_cast<double>(value) / sum);
  return kernel;
}

TEST(PointSpread, AMeasuredKernelIsDrawnWhereItBelongs) {
  Camera camera = quiet_camera(64);
  camera.psf.kernel = gaussian_kernel(1.1, 5.0, 61);
  for (const auto& [u, v] : {std::pair{31.0, 31.0}, std::pair{30.27, 33.64}}) {
    const RenderedSource star = star_at(u, v, 1e5);
    const Moments m = drawn(camera, star);
    EXPECT_NEAR(m.sum / 1e5, 1.0, 1e-3);
    EXPECT_LT((m.centre - star.pixel.vec()).norm(), 1e-3);
    // A sample is a square of 1/5 pixel, cut by the pixels' edges or not.
    EXPECT_NEAR(m.second(0, 0), 1.1 * 1.1 + kPixelVariance, 8e-3);
    EXPECT_NEAR(m.second(0, 1), 0.0, 1e-3);
  }
  // A kernel whose light is beside its middle moves the source by as much: 10 samples of 1/5 pixel to the right.
  PsfKernel& kernel = camera.psf.kernel;
  std::fill(kernel.values.begin(), kernel.values.end(), 0.0f);
  kernel.values[static_cast<std::size_t>(30 * 61 + 40)] = 1.0f;
  EXPECT_NEAR(drawn(camera, star_at(20.5, 20.0, 1e5)).centre.x(), 22.5, 1e-3);
}

TEST(PointSpread, MotionSmearsALineOfItsLength) {
  Camera camera = quiet_camera(128);
  RenderedSource star = star_at(60.3, 61.8, 1e6);
  star.smear_px = Vec2(6.0, -3.0);
  const Moments m = drawn(camera, star);
  EXPECT_NEAR(m.sum / 1e6, 1.0, 1e-3);
  EXPECT_LT((m.centre - star.pixel.vec()).norm(), 1e-3);
  const double plain = 0.64 + kPixelVariance;
  EXPECT_NEAR(m.second(0, 0), plain + 36.0 / 12.0, 0.01);
  EXPECT_NEAR(m.second(1, 1), plain + 9.0 / 12.0, 0.01);
  EXPECT_NEAR(m.second(0, 1), -18.0 / 12.0, 0.01);
  Effects still;
  still.motion = false;
  EXPECT_NEAR(drawn(camera, star, still).second(0, 0), plain, 1e-3);
}

// A camera that turns sees a star move against the turn, by f omega t.
TEST(PointSpread, RatesAndExposureMakeTheMotion) {
  Camera camera = quiet_camera(512);
  const double f = camera.intrinsics.fx_px;
  sky::SkySource star;
  star.direction_N = Vec3(0.0, 0.0, 1.0);
  star.flux.electrons_per_s = 1e5;
  const Exposure exposure{.duration_s = 0.5, .rate_C_rad_s = Vec3(0.0, 0.01, 0.0), .sun_C_m = Vec3::Zero()};
  // The camera turns about its downward axis, the boresight to the right: the star goes to the left.
  auto placed = place_sources({&star, 1}, camera, Mat3::Identity(), exposure);
  ASSERT_EQ(placed.size(), 1u);
  EXPECT_NEAR(placed[0].smear_px.x(), -2.0 * f * std::tan(0.0025), 1e-9);
  EXPECT_NEAR(placed[0].smear_px.y(), 0.0, 1e-12);
  EXPECT_NEAR(placed[0].bend_px.norm(), 0.0, 1e-12);
  EXPECT_NEAR(placed[0].pixel.u, 255.5, 1e-9);
  // About the boresight: an arc; its chord's middle lies inside of it by r (1 - cos).
  star.direction_N = Vec3(0.1, 0.0, 1.0).normalized();
  const Exposure roll{.duration_s = 0.5, .rate_C_rad_s = Vec3(0.0, 0.0, 0.2), .sun_C_m = Vec3::Zero()};
  placed = place_sources({&star, 1}, camera, Mat3::Identity(), roll);
  EXPECT_NEAR(placed[0].smear_px.y(), -2.0 * 0.1 * f * std::sin(0.05), 1e-9);
  EXPECT_NEAR(placed[0].bend_px.x(), -0.1 * f * (1.0 - std::cos(0.05)), 1e-9);
}

TEST(PointSpread, ARollingShutterShiftsRowByRow) {
  Camera camera = quiet_camera(512);
  camera.detector.shutter = Shutter::rolling;
  camera.detector.rolling_row_us = 50.0;
  const double f = camera.intrinsics.fx_px;
  sky::SkySource star;
  star.direction_N = Vec3(0.0, 0.1, 1.0).normalized();
  const Exposure exposure{.duration_s = 0.01, .rate_C_rad_s = Vec3(0.0, 0.3, 0.0), .sun_C_m = Vec3::Zero()};
  const auto placed = place_sources({&star, 1}, camera, Mat3::Identity(), exposure);
  ASSERT_EQ(placed.size(), 1u);
  // The star's row is read 0.1 f rows below the middle one.
  const double late = 0.1 * f * 50e-6;
  EXPECT_NEAR(placed[0].pixel.u, 255.5 - f * std::tan(0.3 * late), 1e-4);
  EXPECT_NEAR(placed[0].pixel.v, 255.5 + 0.1 * f / std::cos(0.3 * late), 1e-3);
  camera.detector.shutter = Shutter::global;
  EXPECT_NEAR(place_sources({&star, 1}, camera, Mat3::Identity(), exposure)[0].pixel.u, 255.5, 1e-9);
}

// theory.md 4.4: R (3 pi / 16) sin a (1 + cos a) / (sin a + (pi - a) cos a) towards the Sun.
TEST(Disc, ItsCentreOfLightIsThatOfALambertSphere) {
  for (const double degrees : {0.0, 10.0, 45.0, 60.0, 90.0, 120.0, 150.0}) {
    const double a = degrees * kDegree;
    const Vec2 sunward = Vec2(0.6, -0.8);
    const Vec2 at = lit_disc({.radius_px = 1.0, .phase_angle_rad = a, .sunward = sunward}, 256).photocentre_px;
    EXPECT_NEAR(at.dot(sunward), sky::lambert_photocentre_shift(1.0, a), 1e-3) << degrees;
    EXPECT_NEAR(at.x() * sunward.y() - at.y() * sunward.x(), 0.0, 1e-3) << degrees;
  }
}

TEST(Disc, IsDrawnSoThatItsCentreOfLightIsWhereItWouldBe) {
  const Camera camera = quiet_camera(128);
  for (const double radius : {0.3, 2.0, 12.0}) {
    RenderedSource venus = star_at(60.37, 65.81, 1e7);
    venus.radius_px = radius;
    venus.sunward_px = Vec2(-0.28, 0.96);
    venus.source.phase_angle_rad = 80.0 * kDegree;
    const Moments m = drawn(camera, venus);
    EXPECT_NEAR(m.sum / 1e7, 1.0, 1e-3) << radius;
    EXPECT_LT((m.centre - venus.pixel.vec()).norm(), 1e-3) << radius;
    Effects point;
    point.discs = false;
    EXPECT_NEAR(drawn(camera, venus, point).second(0, 0), 0.64 + kPixelVariance, 2e-3);
  }
  // Fully lit, Lambert's disc has <x^2> = R^2 / 5.
  RenderedSource full = star_at(63.5, 63.5, 1e7);
  full.radius_px = 10.0;
  full.sunward_px = Vec2(1.0, 0.0);
  const Moments m = drawn(camera, full);
  EXPECT_NEAR(m.second(0, 0), 20.0 + 0.64 + kPixelVariance, 0.05);
  EXPECT_NEAR(m.second(1, 1), 20.0 + 0.64 + kPixelVariance, 0.05);
  // Minnaert's: R^2 / (2 k + 3), from the integral of (1 - r^2)^(k - 1/2).
  full.source.minnaert = 0.8;
  const Moments flatter = drawn(camera, full);
  EXPECT_NEAR(flatter.sum / 1e7, 1.0, 1e-3);
  EXPECT_LT((flatter.centre - full.pixel.vec()).norm(), 1e-3);
  EXPECT_NEAR(flatter.second(0, 0), 100.0 / 4.6 + 0.64 + kPixelVariance, 0.05);
}

// A part of a disc that is sampled once a pixel against the whole one.
TEST(Disc, LargeOnesAreTheSameAsSmallOnes) {
  const Globe globe{.radius_px = 170.3, .phase_angle_rad = 70.0 * kDegree, .sunward = Vec2(0.6, 0.8)};
  const LitDisc part = lit_disc_part(globe, {-300.0, 300.0, -300.0, 300.0});
  double sum = 0.0;
  Vec2 moment = Vec2::Zero();
  for (int j = 0; j < part.rows; ++j) {
    for (int i = 0; i < part.columns; ++i) {
      const auto light =
          static_cast<double>(part.light[static_cast<std::size_t>(j) * static_cast<std::size_t>(part.columns) +
                                         static_cast<std::size_t>(i)]);
      sum += light;
      moment += light * Vec2(part.u_px(i), part.v_px(j));
    }
  }
  EXPECT_NEAR(sum, 1.0, 1e-4);
  EXPECT_LT((moment - part.photocentre_px).norm(), 0.02);
  EXPECT_LT((lit_disc(globe, 1024).photocentre_px - part.photocentre_px).norm(), 0.02);
}

TEST(Disc, LargerThanThePictureItIsSmooth) {
  const Camera camera = quiet_camera(128);
  RenderedSource moon = star_at(63.5, 63.5, 1e10);
  moon.radius_px = 3000.0;
  moon.sunward_px = Vec2(1.0, 0.0);
  ImageF light;
  Renderer(camera, 1).electrons({&moon, 1}, {.duration_s = 0.1}, light);
  // In the middle of a full disc: 3 / (2 pi R^2) of the light a pixel.
  const double expected = 1e10 * 3.0 / (2.0 * kPi * 9e6);
  for (const float pixel : light.pixels()) ASSERT_NEAR(static_cast<double>(pixel) / expected, 1.0, 1e-3);
}

TEST(Disc, ThroughAMeasuredKernel) {
  Camera camera = quiet_camera(512);
  camera.psf.kernel = {
      .file = "", .width = 3, .height = 3, .samples_per_px = 1.0, .values = std::vector<float>(9, 1.0f / 9.0f)};
  for (const double radius : {0.4, 12.0, 150.0}) {
    RenderedSource venus = star_at(250.37, 255.81, 1e8);
    venus.radius_px = radius;
    venus.sunward_px = Vec2(-0.28, 0.96);
    venus.source.phase_angle_rad = 80.0 * kDegree;
    const Moments m = drawn(camera, venus);
    EXPECT_NEAR(m.sum / 1e8, 1.0, 1e-3) << radius;
    EXPECT_LT((m.centre - venus.pixel.vec()).norm(), 1e-3 + 1e-4 * radius) << radius;
  }
  RenderedSource full = star_at(255.5, 255.5, 1e8);
  full.radius_px = 10.0;
  full.sunward_px = Vec2(1.0, 0.0);
  // Of the disc, of a kernel three pixels wide, and of the pixel that looks.
  EXPECT_NEAR(drawn(camera, full).second(0, 0), 20.0 + 9.0 / 12.0 + kPixelVariance, 0.05);
}

TEST(PaintingWork, FollowsWhatIsPainted) {
  const Camera camera = quiet_camera(512);
  const RenderedSource star = star_at(255.5, 255.5, 1e4);
  const double one = painting_work({&star, 1}, camera, {});
  EXPECT_GT(one, 49.0);
  EXPECT_LT(one, 400.0);
  RenderedSource smeared = star;
  smeared.smear_px = Vec2(100.0, 0.0);
  EXPECT_GT(painting_work({&smeared, 1}, camera, {}), 200.0 * one);
  RenderedSource disc = star;
  disc.radius_px = 100.0;
  EXPECT_GT(painting_work({&disc, 1}, camera, {}), 1e4);
}

TEST(Disc, SizeAndSunComeFromTheSky) {
  const Camera camera = quiet_camera(512);
  sky::SkySource venus;
  venus.kind = sky::SourceKind::planet;
  venus.direction_N = Vec3(0.0, 0.0, 1.0);
  venus.angular_radius_rad = 0.002;
  venus.sunward_N = Vec3(0.6, -0.8, 0.0);
  venus.flux.electrons_per_s = 1e6;
  const auto placed = place_sources({&venus, 1}, camera, Mat3::Identity(), 0.4);
  ASSERT_EQ(placed.size(), 1u);
  EXPECT_NEAR(placed[0].radius_px, 0.002 * camera.intrinsics.fx_px, 1e-6);
  EXPECT_NEAR((placed[0].sunward_px - Vec2(0.6, -0.8)).norm(), 0.0, 1e-6);
}

}  // namespace
}  // namespace astronav::render
