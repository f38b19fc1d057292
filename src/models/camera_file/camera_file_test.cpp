// SPDX-License-Identifier: Apache-2.0
#include "models/camera_file/camera_file.h"

#include <gtest/gtest.h>

#include "foundation/files/mapped_file.h"

namespace astronav {
namespace {

std::string preset_text(const char* name) {
  const auto file = MappedFile::open(home_directory() / "scenarios" / "cameras" / (std::string(name) + ".toml"));
  return file ? std::string(file->text()) : std::string();
}

std::string replaced(std::string text, const std::string& from, const std::string& to) {
  const std::size_t at = text.find(from);
  EXPECT_NE(at, std::string::npos) << from;
  return at == std::string::npos ? text : text.replace(at, from.size(), to);
}

std::string error_of(const std::string& toml) {
  const Result<Camera> camera = parse_camera(toml, "cam.toml");
  EXPECT_FALSE(camera);
  return camera ? "" : describe(camera.error());
}

TEST(CameraFile, PresetsAreTheCamerasTheyAreNamedAfter) {
  const Result<Camera> extrema = read_camera("extrema-20deg");
  ASSERT_TRUE(extrema) << describe(extrema.error());
  EXPECT_EQ(extrema->name, "extrema-20deg");
  EXPECT_NEAR(extrema->intrinsics.field_of_view_horizontal_rad(), 20.0 * kDegree, 1e-9);
  EXPECT_DOUBLE_EQ(extrema->intrinsics.cx_px, 511.5);
  EXPECT_NEAR(extrema->optics.focal_length_m / extrema->optics.pupil_diameter_m, 2.2, 1e-12);
  EXPECT_NEAR(extrema->optics.transmission[0].value * extrema->detector.quantum_efficiency[0].value, 0.49, 1e-12);
  EXPECT_DOUBLE_EQ(extrema->exposure_s, 0.4);
  const Result<Camera> navcam = read_camera("navcam");
  ASSERT_TRUE(navcam) << describe(navcam.error());
  EXPECT_NEAR(navcam->intrinsics.field_of_view_horizontal_rad(), 5.0 * kDegree, 0.005 * kDegree);
  EXPECT_NEAR(navcam->intrinsics.plate_scale_rad_px(), 17.6 * kArcsecond, 0.05 * kArcsecond);
  const Result<Camera> tracker = read_camera("star-tracker-10deg");
  ASSERT_TRUE(tracker) << describe(tracker.error());
  EXPECT_NEAR(tracker->intrinsics.field_of_view_horizontal_rad(), 10.0 * kDegree, 1e-9);
}

TEST(CameraFile, TextReadsBackToTheSameCamera) {
  for (const char* name : {"extrema-20deg", "navcam", "star-tracker-10deg"}) {
    Camera camera = *read_camera(name);
    camera.name = "odd \"name\"";
    camera.intrinsics.distortion = {.k1 = -0.0123, .k2 = 1e-7, .k3 = 0.0, .p1 = 1.0 / 3.0, .p2 = -2e-5};
    camera.psf.halo_fraction = 0.02;
    camera.exposure_s = 0.1;
    const std::string text = to_toml(camera);
    const Result<Camera> back = parse_camera(text, "x");
    ASSERT_TRUE(back) << describe(back.error()) << "\n" << text;
    EXPECT_EQ(to_toml(*back), text);
    EXPECT_EQ(back->name, camera.name);
    EXPECT_EQ(back->exposure_s, camera.exposure_s);
    EXPECT_EQ(back->intrinsics.fx_px, camera.intrinsics.fx_px);
    EXPECT_EQ(back->intrinsics.distortion.p1, camera.intrinsics.distortion.p1);
    EXPECT_EQ(back->optics.pupil_diameter_m, camera.optics.pupil_diameter_m);
    EXPECT_EQ(back->detector.pixel_pitch_m, camera.detector.pixel_pitch_m);
    ASSERT_EQ(back->detector.quantum_efficiency.size(), camera.detector.quantum_efficiency.size());
    EXPECT_NEAR(back->detector.quantum_efficiency[1].wavelength_m, camera.detector.quantum_efficiency[1].wavelength_m,
                1e-21);
  }
}

TEST(CameraFile, UnknownKeysNameTheirLineAndTheNearestKey) {
  const std::string good = preset_text("extrema-20deg");
  EXPECT_EQ(error_of(replaced(good, "sigma_px = 0.8", "sigma_pix = 0.8")),
            "cam.toml:19:1: unknown key \"psf.sigma_pix\"; did you mean \"psf.sigma_px\"?");
  EXPECT_EQ(error_of(replaced(good, "exposure_ms", "exposure_s")),
            "cam.toml:5:1: unknown key \"exposure_s\"; did you mean \"exposure_ms\"?");
  EXPECT_NE(error_of(good + "\n[stray]\nx = 1\n").find("unknown key \"stray\""), std::string::npos);
}

TEST(CameraFile, WrongTypesRangesAndMissingKeysAreNamed) {
  const std::string good = preset_text("extrema-20deg");
  EXPECT_EQ(error_of(replaced(good, "bits = 12", "bits = 12.5")),
            "cam.toml:33:8: detector.bits must be a whole number from 1 to 16");
  EXPECT_EQ(error_of(replaced(good, "read_noise_e = 10.0", "read_noise_e = \"low\"")),
            "cam.toml:26:16: detector.read_noise_e must be a number from 0 to 100000");
  EXPECT_NE(error_of(replaced(good, "read_noise_e = 10.0", "read_noise_e = nan")).find("must be a number"),
            std::string::npos);
  EXPECT_NE(error_of(replaced(good, "full_well_e = 100000.0", "")).find("the key detector.full_well_e is missing"),
            std::string::npos);
  EXPECT_NE(error_of(replaced(good, "[0.7, 0.7]", "[0.7, 0.7, 0.7]")).find("has 3 values for 2 wavelengths"),
            std::string::npos);
  EXPECT_NE(error_of(replaced(good, "[450.0, 900.0]", "[900.0, 450.0]")).find("must rise"), std::string::npos);
  EXPECT_NE(error_of(replaced(good, "[0.7, 0.7]", "[0.7, 1.7]")).find("list of two or more numbers"),
            std::string::npos);
  EXPECT_NE(error_of("psf = 3\n").find("psf must be a section"), std::string::npos);
  EXPECT_NE(error_of("").find("is missing"), std::string::npos);
}

TEST(CameraFile, BrokenTomlNamesItsPlace) {
  EXPECT_EQ(error_of("name = \"x\"\nexposure_ms = = 3\n").substr(0, 13), "cam.toml:2:15");
}

TEST(CameraFile, NoSuchCamera) {
  const Result<Camera> camera = read_camera("no-such-camera");
  ASSERT_FALSE(camera);
  EXPECT_EQ(camera.error().code, ErrorCode::not_found);
}

}  // namespace
}  // namespace astronav
