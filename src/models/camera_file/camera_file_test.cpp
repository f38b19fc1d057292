// SPDX-License-Identifier: Apache-2.0
#include "models/camera_file/camera_file.h"

#include <filesystem>
#include <fstream>
#include <set>
#include <sstream>

#include <fmt/format.h>
#include <gtest/gtest.h>

#include "foundation/files/mapped_file.h"
#include "foundation/raster/raster.h"

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

// A file with every key of docs/formats.md, no value twice, none its default.
constexpr const char* kEveryKey = R"(name = "all keys"
exposure_ms = 123.0

[image]
width_px = 640
height_px = 480

[projection]
fx_px = 301.5
fy_px = 302.5
cx_px = 320.25
cy_px = 239.75
model = "fisheye"

[distortion]
k1 = -0.011
k2 = 0.0022
k3 = -0.00033
p1 = 0.000044
p2 = -0.000055

[optics]
focal_length_mm = 12.5
pupil_diameter_mm = 6.25
vignetting_cos_power = 3.5
vignetting_corner_loss = 0.15
stray_light_e_s_px = 42.0
stray_light_power = 2.5
transmission_wavelength_nm = [410.0, 510.0, 910.0]
transmission = [0.25, 0.75, 0.5]

[psf]
sigma_px = 0.85
sigma_growth_px = 0.35
halo_fraction = 0.021
halo_sigma_px = 4.25
halo_offset_u_px = -0.45
halo_offset_v_px = 0.65
coma_px = 1.75
kernel_samples_per_px = 2.0

[detector]
bits = 14
pixel_pitch_um = 4.8
read_noise_e = 5.5
dark_current_e_s = 6.5
dark_nonuniformity = 0.07
photo_nonuniformity = 0.008
full_well_e = 54000.0
gain_e_dn = 3.3
bias_dn = 96.0
background_e_s_px = 7.7
temperature_c = -11.0
dark_reference_c = 22.0
dark_doubling_k = 6.6
hot_pixel_share = 0.0012
hot_pixel_e_s = 1300.0
cosmic_rays_cm2_s = 1.4
cosmic_ray_e_um = 81.0
depth_um = 16.0
frame_transfer_row_us = 1.7
rolling_row_us = 18.0
time_tag_latency_ms = 19.0
time_tag_jitter_ms = 0.23
blooming = true
shutter = "rolling"
quantum_efficiency_wavelength_nm = [420.0, 880.0]
quantum_efficiency = [0.33, 0.66]
)";

TEST(CameraFile, EveryKeyGoesWhereItBelongs) {
  const Result<Camera> read = parse_camera(kEveryKey, "all.toml");
  ASSERT_TRUE(read) << describe(read.error());
  const Camera& c = *read;
  EXPECT_EQ(c.intrinsics.model, ProjectionModel::fisheye);
  EXPECT_EQ(c.intrinsics.fy_px, 302.5);
  EXPECT_EQ(c.intrinsics.distortion.p2, -0.000055);
  EXPECT_EQ(c.optics.vignetting_cos_power, 3.5);
  EXPECT_EQ(c.optics.vignetting_corner_loss, 0.15);
  EXPECT_EQ(c.optics.stray_light_e_s_px, 42.0);
  EXPECT_EQ(c.optics.stray_light_power, 2.5);
  EXPECT_EQ(c.psf.sigma_growth_px, 0.35);
  EXPECT_EQ(c.psf.coma_px, 1.75);
  EXPECT_EQ(c.psf.kernel.samples_per_px, 2.0);
  EXPECT_EQ(c.detector.temperature_c, -11.0);
  EXPECT_EQ(c.detector.dark_reference_c, 22.0);
  EXPECT_EQ(c.detector.dark_doubling_k, 6.6);
  EXPECT_NEAR(dark_factor(c.detector), 1.0 / 32.0, 1e-15);  // 33 K colder, half for every 6.6
  EXPECT_EQ(c.detector.hot_pixel_share, 0.0012);
  EXPECT_EQ(c.detector.hot_pixel_e_s, 1300.0);
  EXPECT_EQ(c.detector.cosmic_rays_cm2_s, 1.4);
  EXPECT_EQ(c.detector.cosmic_ray_e_um, 81.0);
  EXPECT_EQ(c.detector.depth_um, 16.0);
  EXPECT_TRUE(c.detector.blooming);
  EXPECT_EQ(c.detector.frame_transfer_row_us, 1.7);
  EXPECT_EQ(c.detector.shutter, Shutter::rolling);
  EXPECT_EQ(c.detector.rolling_row_us, 18.0);
  EXPECT_EQ(c.detector.time_tag_latency_ms, 19.0);
  EXPECT_EQ(c.detector.time_tag_jitter_ms, 0.23);
  // Written and read again; the writer's order of the keys is free, their set is not.
  const std::string text = to_toml(c);
  const Result<Camera> back = parse_camera(text, "back.toml");
  ASSERT_TRUE(back) << describe(back.error()) << text;
  EXPECT_EQ(to_toml(*back), text);
  const auto lines = [](const std::string& toml) {
    std::multiset<std::string> keys;
    std::istringstream in(toml);
    for (std::string line; std::getline(in, line);) keys.insert(line.substr(0, line.find(' ')));
    return keys;
  };
  EXPECT_EQ(lines(text), lines(kEveryKey));
}

// What stands in the file is what the camera holds: every number, changed in the text, changes what is written.
TEST(CameraFile, NoKeyIsReadInVain) {
  std::istringstream in(kEveryKey);
  std::string before;
  int changed = 0;
  const std::string first = to_toml(*parse_camera(kEveryKey, "all.toml"));
  for (std::string line; std::getline(in, line); before += line + "\n") {
    const std::size_t equals = line.find(" = ");
    if (equals == std::string::npos) continue;
    std::string other = line;
    if (const std::size_t digit = line.find_last_of("123456789"); digit != std::string::npos && digit > equals) {
      other[digit] = other[digit] == '1' ? '2' : '1';
    } else if (other.ends_with("true")) {
      other = line.substr(0, equals) + " = false";
    } else {
      other = line.find("fisheye") != std::string::npos   ? "model = \"pinhole\""
              : line.find("rolling") != std::string::npos ? "shutter = \"global\""
                                                          : "name = \"other\"";
    }
    const std::string text = before + other + "\n" + std::string(kEveryKey).substr(before.size() + line.size() + 1);
    const Result<Camera> camera = parse_camera(text, "all.toml");
    ASSERT_TRUE(camera) << other << ": " << describe(camera.error());
    EXPECT_NE(to_toml(*camera), first) << other;
    ++changed;
  }
  EXPECT_EQ(changed, 56);
}

TEST(CameraFile, ChoicesAndSwitchesSayWhatTheyTake) {
  const std::string good = kEveryKey;
  EXPECT_EQ(error_of(replaced(good, "\"fisheye\"", "\"fish-eye\"")),
            "cam.toml:13:9: projection.model must be \"pinhole\" or \"fisheye\"");
  EXPECT_EQ(error_of(replaced(good, "blooming = true", "blooming = \"yes\"")),
            "cam.toml:65:12: detector.blooming must be false or true");
  EXPECT_EQ(error_of(replaced(good, "shutter = \"rolling\"", "shutter = true")),
            "cam.toml:66:11: detector.shutter must be \"global\" or \"rolling\"");
  EXPECT_EQ(error_of(replaced(good, "hot_pixel_share = 0.0012", "hot_pixel_share = 1.2")),
            "cam.toml:56:19: detector.hot_pixel_share must be a number from 0 to 1");
  EXPECT_EQ(error_of(replaced(good, "temperature_c = -11.0", "temperature_c = -300.0")),
            "cam.toml:53:17: detector.temperature_c must be a number from -273.15 to 200");
  EXPECT_EQ(error_of(replaced(good, "coma_px", "comma_px")),
            "cam.toml:39:1: unknown key \"psf.comma_px\"; did you mean \"psf.coma_px\"?");
  EXPECT_EQ(error_of(replaced(good, "kernel_samples_per_px = 2.0", "kernel = 3")),
            "cam.toml:40:10: psf.kernel must be the name of an image");
}

class CameraFileKernel : public ::testing::Test {
 protected:
  void SetUp() override {
    folder_ = std::filesystem::path(::testing::TempDir()) /
              fmt::format("camera_file_{}", ::testing::UnitTest::GetInstance()->current_test_info()->name());
    std::filesystem::create_directories(folder_);
  }
  void TearDown() override { std::filesystem::remove_all(folder_); }
  Result<Camera> read_with(const std::string& psf_line) {
    std::ofstream(folder_ / "cam.toml") << replaced(kEveryKey, "kernel_samples_per_px = 2.0",
                                                    "kernel_samples_per_px = 2.0\n" + psf_line);
    return read_camera(folder_ / "cam.toml");
  }
  std::filesystem::path folder_;
};

TEST_F(CameraFileKernel, IsReadBesideTheCameraAndNormalised) {
  ImageF kernel(5, 3);
  for (int v = 0; v < 3; ++v)
    for (int u = 0; u < 5; ++u) kernel(u, v) = static_cast<float>(u + 10 * v);
  ASSERT_TRUE(write_fits(folder_ / "psf.fits", kernel.view(), {}));
  const Result<Camera> camera = read_with("kernel = \"psf.fits\"");
  ASSERT_TRUE(camera) << describe(camera.error());
  const PsfKernel& read = camera->psf.kernel;
  EXPECT_EQ(read.width, 5);
  EXPECT_EQ(read.height, 3);
  ASSERT_EQ(read.values.size(), 15u);
  EXPECT_FLOAT_EQ(read.values[7], 12.0f / 180.0f);  // sum: 3 * 10 + 5 * 30
  EXPECT_NE(to_toml(*camera).find("kernel = \"psf.fits\""), std::string::npos);
}

TEST_F(CameraFileKernel, RefusesWhatIsNoLight) {
  const Result<Camera> absent = read_with("kernel = \"psf.fits\"");
  ASSERT_FALSE(absent);
  EXPECT_EQ(absent.error().code, ErrorCode::not_found);
  EXPECT_NE(describe(absent.error()).find("psf.fits"), std::string::npos);
  ImageF kernel(3, 3);
  ASSERT_TRUE(write_fits(folder_ / "psf.fits", kernel.view(), {}));
  EXPECT_NE(describe(read_with("kernel = \"psf.fits\"").error()).find("without light"), std::string::npos);
  kernel(1, 1) = 2.0f;
  kernel(0, 1) = -1.0f;
  ASSERT_TRUE(write_fits(folder_ / "psf.fits", kernel.view(), {}));
  EXPECT_NE(describe(read_with("kernel = \"psf.fits\"").error()).find("no negative light"), std::string::npos);
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
