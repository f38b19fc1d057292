// SPDX-License-Identifier: Apache-2.0
// What lens and detector do to light, each by its law. Stochastic limits are five sigma (one in two million) under a
// fixed seed unless said.
#include <cmath>
#include <map>
#include <thread>
#include <utility>

#include <gtest/gtest.h>

#include "foundation/math/statistics.h"
#include "models/ephemeris/bodies.h"
#include "simulator/render/detector_pattern.h"
#include "simulator/render/frames_for_tests.h"
#include "simulator/render/protons.h"

namespace astronav::render {
namespace {

ImageF expected(const Camera& camera, const Exposure& exposure, const Effects& effects = {}) {
  ImageF image;
  Renderer(camera, 1).electrons({}, exposure, image, effects);
  return image;
}

TEST(Lens, VignettingTakesItsShareOfSkyAndStars) {
  Camera camera = quiet_camera(256);
  camera.detector.background_e_s_px = 1000.0;
  camera.optics.vignetting_cos_power = 4.0;
  camera.optics.vignetting_corner_loss = 0.3;
  const auto law = [&](double u, double v) {
    const double r = std::hypot(u - 127.5, v - 127.5);
    const double cosine = std::cos(std::atan(r / camera.intrinsics.fx_px));
    return std::pow(cosine, 4) * (1.0 - 0.3 * r * r / (2.0 * 128.0 * 128.0));
  };
  const ImageF sky = expected(camera, {.duration_s = 1.0});
  for (const auto& [u, v] : {std::pair{127, 127}, std::pair{0, 0}, std::pair{37, 201}, std::pair{255, 100}}) {
    EXPECT_NEAR(sky(u, v) / 1000.0, law(u, v), 1e-3);
  }
  sky::SkySource star;
  star.direction_N = Vec3(0.12, -0.05, 1.0).normalized();
  star.flux.electrons_per_s = 1e5;
  const auto placed = place_sources({&star, 1}, camera, Mat3::Identity(), 1.0);
  ASSERT_EQ(placed.size(), 1u);
  EXPECT_NEAR(placed[0].electrons / 1e5, law(placed[0].pixel.u, placed[0].pixel.v), 1e-9);
  Effects clear;
  clear.vignetting = false;
  EXPECT_FLOAT_EQ(expected(camera, {.duration_s = 1.0}, clear)(0, 0), 1000.0f);
  EXPECT_DOUBLE_EQ(place_sources({&star, 1}, camera, Mat3::Identity(), {.duration_s = 1.0}, 20.0, clear)[0].electrons,
                   1e5);
}

TEST(Lens, StrayLightFallsWithAngleAndDistance) {
  Camera camera = quiet_camera(256);
  camera.optics.stray_light_e_s_px = 50.0;
  camera.optics.stray_light_power = 3.0;
  const auto at = [&](double degrees, double au) {
    const Vec3 sun_C = au * kAstronomicalUnit * Vec3(std::sin(degrees * kDegree), 0.0, std::cos(degrees * kDegree));
    return expected(camera, {.duration_s = 2.0, .sun_C_m = sun_C});
  };
  // The mean of the four middle pixels is the boresight's.
  EXPECT_NEAR(at(30.0, 1.0)(127, 127), 100.0, 1.0);
  EXPECT_NEAR(at(60.0, 1.0)(127, 127), 100.0 / 8.0, 0.15);
  EXPECT_NEAR(at(30.0, 2.0)(127, 127), 25.0, 0.3);
  // To the right, where the Sun is, there is more of it: 30 degrees less the angle of the pixel.
  const double off = std::atan((250.0 - 127.5) / camera.intrinsics.fx_px);
  const Vec3 there = Vec3(std::sin(off), 0.0, std::cos(off));
  const double angle = std::acos(there.dot(Vec3(std::sin(30 * kDegree), 0.0, std::cos(30 * kDegree))));
  EXPECT_NEAR(at(30.0, 1.0)(250, 127), 100.0 * std::pow(30.0 * kDegree / angle, 3), 2.0);
  Effects dark;
  dark.stray_light = false;
  EXPECT_EQ(expected(camera, {.duration_s = 2.0, .sun_C_m = Vec3(0.0, 0.0, 1e11)}, dark)(127, 127), 0.0f);
}

TEST(Dark, DoublesEverySoManyKelvin) {
  Camera camera = quiet_camera(16);
  camera.detector.dark_current_e_s = 12.0;
  camera.detector.dark_reference_c = 20.0;
  camera.detector.dark_doubling_k = 6.0;
  for (const auto& [celsius, factor] : {std::pair{20.0, 1.0}, std::pair{26.0, 2.0}, std::pair{2.0, 0.125}}) {
    camera.detector.temperature_c = celsius;
    EXPECT_NEAR(expected(camera, {.duration_s = 10.0})(3, 3), 120.0 * factor, 1e-4);
  }
}

TEST(Dark, HotPixelsAreAsManyAndAsHotAsTold) {
  Camera camera = quiet_camera(512);
  camera.detector.hot_pixel_share = 2e-3;
  camera.detector.hot_pixel_e_s = 5000.0;
  const DetectorPattern pattern(camera, 9);
  const double wanted = 2e-3 * 512 * 512;
  EXPECT_NEAR(static_cast<double>(pattern.hot.size()), wanted, 5.0 * std::sqrt(wanted));
  double sum = 0.0;
  for (const HotPixel& hot : pattern.hot) sum += static_cast<double>(hot.leak);
  EXPECT_NEAR(sum / static_cast<double>(pattern.hot.size()), 5000.0, 5.0 * 5000.0 / std::sqrt(wanted));
  // The same pixels stand out in every frame of the detector, and in none with the switch off.
  const Renderer renderer(camera, 9);
  ImageU16 frame;
  const auto bright = [&](const Effects& effects, std::uint64_t image) {
    renderer.frame({}, {.duration_s = 1.0}, frame_name(1, image), frame, effects);
    std::size_t count = 0;
    for (const HotPixel& hot : pattern.hot) {
      if (hot.leak > 1000.0f) count += frame.pixels()[hot.index] > 64 + 20;
    }
    return count;
  };
  std::size_t hotter = 0;
  for (const HotPixel& hot : pattern.hot) hotter += hot.leak > 1000.0f;
  EXPECT_EQ(bright({}, 1), hotter);
  EXPECT_EQ(bright({}, 2), hotter);
  Effects cold;
  cold.hot_pixels = false;
  EXPECT_EQ(bright(cold, 3), 0u);
}

// An isotropic flux crosses a layer of depth d on ways of 2 d in the mean; Moyal's law adds w (gamma + ln 2).
TEST(Protons, LeaveTheChargeOfTheirTracks) {
  Camera camera = quiet_camera(1024);
  camera.detector.cosmic_rays_cm2_s = 20.0;
  camera.detector.cosmic_ray_e_um = 80.0;
  camera.detector.depth_um = 15.0;
  RandomStream random({.purpose = "protons"});
  std::vector<double> totals;
  for (int i = 0; i < 400; ++i) {
    double total = 0.0;
    for (const ProtonPixel& hit : proton_hits(camera, 1.0, random)) {
      ASSERT_TRUE(hit.u >= 0 && hit.u < 1024 && hit.v >= 0 && hit.v < 1024 && hit.electrons > 0.0);
      total += hit.electrons;
    }
    totals.push_back(total);
  }
  const double hits = 20.0 * std::pow(1024 * 13e-4, 2);
  const double each = 80.0 * 15.0 * 2.0 * (1.0 + 0.1 * (0.57721566 + std::log(2.0)));
  const double spread = standard_deviation(totals) / std::sqrt(400.0);
  EXPECT_LT(spread / (hits * each), 0.02);
  EXPECT_NEAR(mean(totals), hits * each, 5.0 * spread);
  // Frames hold them, with new ones in each.
  const Renderer renderer(camera, 1);
  const auto bright = [&](const Effects& effects, std::uint64_t image) {
    ImageU16 frame;
    renderer.frame({}, {.duration_s = 1.0}, frame_name(1, image), frame, effects);
    std::vector<std::size_t> places;
    for (std::size_t i = 0; i < frame.pixels().size(); ++i) {
      if (frame.pixels()[i] > 64 + 20) places.push_back(i);
    }
    return places;
  };
  EXPECT_GT(bright({}, 1).size(), 20u);
  EXPECT_NE(bright({}, 1), bright({}, 2));
  Effects sheltered;
  sheltered.cosmic_rays = false;
  EXPECT_TRUE(bright(sheltered, 1).empty());
}

// Charge is no light: the sensitivity of the pixel does not count, and Poisson has nothing to draw.
TEST(Protons, LeaveChargeAndNoLight) {
  Camera camera = quiet_camera(256);
  camera.detector.photo_nonuniformity = 0.3;
  camera.detector.read_noise_e = 0.0;
  camera.detector.dark_current_e_s = camera.detector.background_e_s_px = 0.0;
  camera.detector.cosmic_rays_cm2_s = 2000.0;
  camera.detector.cosmic_ray_e_um = 80.0;
  camera.detector.depth_um = 15.0;
  ImageU16 frame;
  Renderer(camera, 1).frame({}, {.duration_s = 1.0}, frame_name(1, 1), frame);
  RandomStream random(
      {.seed = frame_name(1, 1).seed, .sample = frame_name(1, 1).sample, .image = 1, .purpose = "protons"});
  std::map<std::pair<int, int>, double> charge;
  for (const ProtonPixel& hit : proton_hits(camera, 1.0, random)) charge[{hit.u, hit.v}] += hit.electrons;
  ASSERT_GT(charge.size(), 100u);
  for (int v = 0; v < 256; ++v) {
    for (int u = 0; u < 256; ++u) {
      const auto hit = charge.find({u, v});
      const double electrons = std::min(hit == charge.end() ? 0.0 : hit->second, camera.detector.full_well_e);
      ASSERT_NEAR(frame(u, v), camera.detector.bias_dn + electrons / camera.detector.gain_e_dn, 0.5 + 1e-6);
    }
  }
}

TEST(FullWell, BloomingKeepsAllCharge) {
  Camera camera = quiet_camera(256);
  camera.detector.blooming = true;
  camera.detector.gain_e_dn = 2.0;
  camera.detector.bias_dn = 100.0;
  camera.detector.bits = 16;
  const Renderer renderer(camera, 1);
  const RenderedSource venus = star_at(120.2, 131.4, 8e6);
  Effects effects = Effects::expected();
  ImageU16 image;
  const auto charge = [&](const Effects& e) {
    renderer.frame({&venus, 1}, {.duration_s = 0.4}, frame_name(1, 0), image, e);
    double sum = 0.0;
    for (const std::uint16_t dn : image.pixels()) sum += 2.0 * (dn - 100.0);
    return sum;
  };
  EXPECT_NEAR(charge(effects) / 8e6, 1.0, 1e-3);
  // As much runs up as down, along columns only: no pixel holds more than the well, and the rows beside are as without.
  int full_above = 0;
  int full_below = 0;
  for (int v = 0; v < 256; ++v) {
    EXPECT_LE(image(120, v), 100 + 50000);
    if (image(120, v) == 100 + 50000) ++(v < 131 ? full_above : full_below);
  }
  EXPECT_GT(full_above, 10);
  EXPECT_NEAR(full_above, full_below, 3.0);
  EXPECT_EQ(image(60, 131), 100);
  // With all noise the charge is closed as well: shot noise 1 sigma 2800 of 8e6, read noise 2560.
  Effects noisy;
  EXPECT_NEAR(charge(noisy) / 8e6, 1.0, 0.0025);
  // Without blooming it is lost.
  effects.blooming = false;
  EXPECT_LT(charge(effects) / 8e6, 0.5);
}

TEST(FullWell, NoiseOfAPixelThatOverflowsIsOnlyThatOfReading) {
  Camera camera = quiet_camera(64);
  camera.detector.blooming = true;
  camera.detector.gain_e_dn = 2.0;
  camera.detector.bits = 16;
  const Renderer renderer(camera, 1);
  const RenderedSource venus = star_at(32.0, 32.0, 5e6);
  std::vector<double> read;
  ImageU16 image;
  for (std::uint64_t i = 0; i < 400; ++i) {
    renderer.frame({&venus, 1}, {.duration_s = 0.4}, frame_name(1, i), image);
    read.push_back(2.0 * image(32, 36));
  }
  EXPECT_NEAR(standard_deviation(read), std::sqrt(100.0 + 4.0 / 12.0), 5.0 * 10.0 / std::sqrt(800.0));
}

TEST(FrameTransfer, SmearsColumnsByTheTimeUnderLight) {
  Camera camera = quiet_camera(128);
  camera.detector.frame_transfer_row_us = 40.0;
  camera.detector.background_e_s_px = 100.0;
  const RenderedSource star = star_at(50.0, 70.0, 1e6);
  ImageF image;
  const Renderer renderer(camera, 1);
  renderer.electrons({&star, 1}, {.duration_s = 0.4}, image);
  // A share of 1e-4 of the light of the column: the sky's 128 x 40 electrons, and what of the star falls there.
  EXPECT_NEAR(image(100, 10), 40.0 * (1.0 + 128e-4), 1e-3);
  const double in_column = std::erf(0.5 / (0.8 * std::sqrt(2.0))) * 1e6;
  EXPECT_NEAR(image(50, 10), 40.0 * (1.0 + 128e-4) + 1e-4 * in_column, 0.05);
  EXPECT_NEAR(image(50, 120), image(50, 10), 1e-3);
  Effects still;
  still.frame_transfer = false;
  renderer.electrons({&star, 1}, {.duration_s = 0.4}, image, still);
  EXPECT_NEAR(image(50, 10), 40.0, 1e-3);
  // In a frame with noise: the mean of the column over that of the others.
  double above = 0.0;
  ImageU16 frame;
  for (std::uint64_t i = 0; i < 100; ++i) {
    renderer.frame({&star, 1}, {.duration_s = 0.4}, frame_name(1, i), frame);
    for (int v = 0; v < 50; ++v) above += 25.0 * (frame(50, v) - 0.5 * (frame(20, v) + frame(90, v)));
  }
  const double noise = std::sqrt(1.5 * (40.0 + 50.0 + 100.0 + 625.0 / 12.0) / 5000.0);
  EXPECT_NEAR(above / 5000.0, 1e-4 * in_column, 5.0 * noise);
}

TEST(TimeTag, IsLateAndScatters) {
  Detector detector;
  detector.time_tag_latency_ms = 12.0;
  detector.time_tag_jitter_ms = 3.0;
  std::vector<double> late;
  for (std::uint64_t i = 0; i < 2000; ++i) late.push_back(time_tag_error_s(detector, frame_name(1, i)));
  EXPECT_NEAR(mean(late), 0.012, 5.0 * 0.003 / std::sqrt(2000.0));
  EXPECT_NEAR(standard_deviation(late), 0.003, 5.0 * 0.003 / std::sqrt(4000.0));
  EXPECT_EQ(time_tag_error_s(detector, frame_name(1, 7)), late[7]);
}

TEST(Effects, EveryOneHasAName) {
  Effects effects;
  for (const std::string_view name : effect_names()) {
    bool* const on = effect(effects, name);
    ASSERT_NE(on, nullptr) << name;
    EXPECT_TRUE(*on) << name;
    *on = false;
  }
  EXPECT_EQ(effect(effects, "noise"), nullptr);
}

TEST(Threads, FramesDoNotDependOnWhoMakesThem) {
  Camera camera = quiet_camera(256);
  Detector& d = camera.detector;
  d.background_e_s_px = 30.0;
  d.dark_current_e_s = 12.0;
  d.photo_nonuniformity = 0.01;
  d.cosmic_rays_cm2_s = 50.0;
  d.blooming = true;
  d.frame_transfer_row_us = 1.0;
  std::vector<RenderedSource> stars;
  RandomStream random({.purpose = "stars"});
  for (int i = 0; i < 60; ++i) {
    stars.push_back(star_at(random.uniform(0, 255), random.uniform(0, 255), std::pow(10.0, random.uniform(2, 7))));
  }
  const Renderer renderer(camera, 3);
  std::vector<ImageU16> alone(8);
  for (std::uint64_t i = 0; i < 8; ++i) renderer.frame(stars, {.duration_s = 0.4}, frame_name(1, i), alone[i]);
  std::vector<ImageU16> together(8);
  const auto half = [&](std::uint64_t first) {
    for (std::uint64_t i = 8; i-- > 0;) {
      if (i % 2 == first) renderer.frame(stars, {.duration_s = 0.4}, frame_name(1, i), together[i]);
    }
  };
  std::thread other(half, 1);
  half(0);
  other.join();
  for (std::size_t i = 0; i < 8; ++i) {
    EXPECT_TRUE(std::equal(alone[i].pixels().begin(), alone[i].pixels().end(), together[i].pixels().begin())) << i;
  }
}

}  // namespace
}  // namespace astronav::render
