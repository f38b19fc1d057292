// SPDX-License-Identifier: Apache-2.0
#include "verification/opensky/compare.h"

#include <cmath>

#include <gtest/gtest.h>

#include "foundation/files/mapped_file.h"
#include "foundation/math/random.h"
#include "foundation/math/rotation.h"
#include "models/camera_file/camera_file.h"
#include "simulator/render/renderer.h"
#include "simulator/sky/sky.h"
#include "verification/opensky/compare_sky.h"
#include "verification/opensky/compare_star_shape.h"

namespace astronav::opensky {
namespace {

Camera camera_with(PointSpread psf) {
  Camera camera;
  camera.intrinsics = Intrinsics::from_field_of_view(200, 160, 0.2);
  camera.psf = std::move(psf);
  camera.detector.full_well_e = 1e9;
  return camera;
}

PsfKernel slanted_kernel() {
  PsfKernel kernel;
  kernel.width = 9;
  kernel.height = 7;
  kernel.samples_per_px = 3.0;
  double sum = 0.0;
  for (int i = 0; i < 63; ++i) {
    kernel.values.push_back(static_cast<float>(1 + i % 5 + i / 9));
    sum += static_cast<double>(kernel.values.back());
  }
  for (float& value : kernel.values) value = static_cast<float>(static_cast<double>(value) / sum);
  return kernel;
}

// What fits work with is what the renderer draws.
TEST(Compare, StarsOfTheFitAreThoseOfTheRenderer) {
  PointSpread wide, winged;
  wide.sigma_px = 0.9;
  wide.sigma_growth_px = 0.4;
  winged.sigma_px = 0.5;
  winged.halo_fraction = 0.3;
  winged.halo_sigma_px = 1.1;
  winged.halo_offset_u_px = 0.2;
  PointSpread measured;
  measured.kernel = slanted_kernel();
  for (const PointSpread& psf : {wide, winged, measured}) {
    const Camera camera = camera_with(psf);
    const Pixel at{30.3, 120.8};
    render::RenderedSource source;
    source.pixel = at;
    source.electrons = 1e8;
    ImageF light;
    render::Renderer(camera, 1).electrons({&source, 1}, {.duration_s = 1.0}, light);
    StarShape shape(camera, at);
    const ImageF& drawn = shape.draw(at);
    for (int y = 0; y < StarShape::kSide; ++y)
      for (int x = 0; x < StarShape::kSide; ++x)
        ASSERT_NEAR(drawn(x, y), light(shape.u0() + x, shape.v0() + y) / 1e8, 2e-5) << x << " " << y;
  }
}

TEST(Compare, SimilarityOfAPictureWithItselfIsOne) {
  ImageF a(40, 30), b(40, 30);
  RandomStream random({.seed = 1, .purpose = "similarity"});
  for (std::size_t i = 0; i < a.pixels().size(); ++i) {
    a.pixels()[i] = static_cast<float>(100.0 + 20.0 * random.normal());
    b.pixels()[i] = static_cast<float>(100.0 + 20.0 * random.normal());
  }
  const ImageF same = structural_similarity(a, a, 255.0), other = structural_similarity(a, b, 255.0);
  for (const float x : same.pixels()) EXPECT_NEAR(x, 1.0f, 1e-6f);
  double mean = 0.0;
  for (const float x : other.pixels()) mean += static_cast<double>(x) / static_cast<double>(other.pixels().size());
  // Variances of 400 that share nothing, against C2 = 58.5: 58.5 / 858.5, and some scatter of the local means.
  EXPECT_NEAR(mean, 0.068, 0.06);
}

// A sky that brightens to one side, Poisson noise at 3 electrons a DN over read noise of 5 DN.
TEST(Compare, PhotonTransferFindsGainAndFloor) {
  ImageF picture(800, 600);
  RandomStream random({.seed = 2, .purpose = "photon transfer"});
  for (int v = 0; v < 600; ++v)
    for (int u = 0; u < 800; ++u)
      picture(u, v) = static_cast<float>(
          std::round(static_cast<double>(random.poisson(3.0 * (300.0 + 2.0 * u))) / 3.0 + 5.0 * random.normal()));
  const SmoothSky sky = smooth_sky(picture, 1.0);
  EXPECT_NEAR(sky.level_dn(400, 300), 1100.0, 2.0);
  EXPECT_NEAR(sky.scatter, 1.0, 0.25);
  const NoiseLaw law = photon_transfer(picture, sky, 1.0);
  EXPECT_NEAR(law.slope_dn, 1.0 / 3.0, 0.02);     // scatters by 0.004
  EXPECT_NEAR(law.variance(1100.0), 391.8, 4.0);  // 1100/3 + 25 + 1/12; by 0.8
}

class ClosedLoop : public ::testing::Test {
 protected:
  void SetUp() override {
    file_ = MappedFile::open(home_directory() / "data/hipparcos.stars");
    ASSERT_TRUE(file_) << describe(file_.error());
    kernel_ = MappedFile::open(home_directory() / "data/de405_2000_2050.bsp");
    ASSERT_TRUE(kernel_) << describe(kernel_.error());
    stars_ = StarCatalogue::open(file_->bytes());
    ephemeris_ = Ephemeris::open(kernel_->bytes());
    ASSERT_TRUE(stars_ && ephemeris_);
    const auto camera = read_camera("star-tracker-10deg");
    ASSERT_TRUE(camera) << describe(camera.error());
    truth_ = *camera;
  }

  CompareRequest request() const {
    CompareRequest request;
    request.ephemeris = &*ephemeris_;
    request.catalogue = &*stars_;
    request.observer_known = true;
    request.observer.v_m_s = Vec3(2e4, -1e4, 5e3);
    request.plate = truth_.intrinsics;
    request.R_CN = R_CN_;
    request.camera = truth_;
    request.camera_known = true;
    request.exposure_s = truth_.exposure_s;
    request.max_v_mag = 11.0;
    return request;
  }

  // A frame with every kind of noise.
  Picture photograph(const CompareRequest& r) const {
    sky::SkySettings settings;
    settings.max_v_mag = r.max_v_mag;
    const auto seen = sky::Sky(*ephemeris_, *stars_)
                          .look(r.epoch, r.observer, R_CN_.row(2).transpose(),
                                truth_.intrinsics.half_diagonal_rad() + 0.01, BandPhotometry(truth_), settings);
    EXPECT_TRUE(seen.has_value());
    const auto sources = render::place_sources(*seen, truth_, R_CN_, truth_.exposure_s);
    ImageU16 frame;
    render::Renderer(truth_, 7).frame(sources, {.duration_s = truth_.exposure_s}, {.seed = 7, .purpose = ""}, frame);
    Picture picture;
    picture.pixels = ImageF(frame.width(), frame.height());
    for (std::size_t i = 0; i < frame.pixels().size(); ++i)
      picture.pixels.pixels()[i] = static_cast<float>(frame.pixels()[i]);
    return picture;
  }

  Result<MappedFile> file_ = fail(ErrorCode::not_found, ""), kernel_ = fail(ErrorCode::not_found, "");
  Result<StarCatalogue> stars_ = fail(ErrorCode::not_found, "");
  Result<Ephemeris> ephemeris_ = fail(ErrorCode::not_found, "");
  Camera truth_;
  Mat3 R_CN_ = R_CN_from_pointing({1.5, 0.2, 0.7});
};

// Our own frame, begun with a plate that is 0.7 px off: what is left is the noise.
TEST_F(ClosedLoop, ARenderedFrameIsReproducedToItsNoise) {
  CompareRequest asked = request();
  const Picture picture = photograph(asked);
  asked.R_CN = rotation_exp(Vec3(0.7, -0.5, 0.0) / truth_.intrinsics.fx_px) * asked.R_CN;
  asked.plate.fx_px *= 1.0005;
  asked.plate.fy_px *= 1.0005;
  const auto found = compare(picture, asked);
  ASSERT_TRUE(found) << describe(found.error());
  EXPECT_GE(found->counted, 40u);
  EXPECT_EQ(found->lost, 0u);
  EXPECT_LE(found->geometric_rms_px, 0.12);
  EXPECT_LE(found->photometric_rms_mag, 0.10);
  EXPECT_NEAR(found->windows.rmse_over_noise, 1.0, 0.04);
  EXPECT_LE(found->windows.ssim_loss_ratio(), 0.1);
  EXPECT_NEAR(found->camera.intrinsics.fx_px / truth_.intrinsics.fx_px, 1.0, 1e-4);
  EXPECT_LE(rotation_log(found->R_CN * R_CN_.transpose()).head<2>().norm() * truth_.intrinsics.fx_px, 0.05);
}

// A mirrored picture gives the same figures, told in its own columns.
TEST_F(ClosedLoop, MirroredPicturesAreReadFromTheirOtherSide) {
  CompareRequest asked = request();
  const Picture picture = photograph(asked);
  Picture mirrored = picture;
  for (int v = 0; v < mirrored.pixels.height(); ++v)
    std::reverse(mirrored.pixels.row(v), mirrored.pixels.row(v) + mirrored.pixels.width());
  const auto direct = compare(picture, asked);
  asked.mirrored = true;
  const auto other = compare(mirrored, asked);
  ASSERT_TRUE(direct && other);
  EXPECT_EQ(direct->counted, other->counted);
  EXPECT_EQ(direct->geometric_rms_px, other->geometric_rms_px);
  ASSERT_FALSE(direct->stars.empty());
  EXPECT_NEAR(direct->stars[0].predicted.u, truth_.intrinsics.width_px - 1 - other->stars[0].predicted.u, 1e-9);
}

// Where the plate is far off, stars are missed and counted as such, or the fit says that it has too few.
TEST_F(ClosedLoop, AWrongPlateDoesNotPass) {
  CompareRequest asked = request();
  const Picture picture = photograph(asked);
  asked.R_CN = rotation_exp(Vec3(0.3, 0.2, 0.0)) * asked.R_CN;
  const auto found = compare(picture, asked);
  if (!found) {
    EXPECT_EQ(found.error().code, ErrorCode::no_match);
  } else {
    EXPECT_GT(found->windows.ssim_loss_ratio(), 0.8);
  }
  asked.plate.width_px += 1;
  const auto misfit = compare(picture, asked);
  ASSERT_FALSE(misfit);
  EXPECT_EQ(misfit.error().code, ErrorCode::invalid_argument);
}

}  // namespace
}  // namespace astronav::opensky
