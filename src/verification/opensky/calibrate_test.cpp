// SPDX-License-Identifier: Apache-2.0
#include "verification/opensky/calibrate.h"

#include <algorithm>
#include <cmath>
#include <cstdio>

#include <Eigen/LU>
#include <gtest/gtest.h>

#include "foundation/math/random.h"
#include "foundation/math/rotation.h"
#include "foundation/math/statistics.h"
#include "models/camera_file/camera_file.h"
#include "support/shipped_ephemeris.h"
#include "verification/opensky/calibrate_fisheye.h"
#include "verification/opensky/calibrate_stars.h"
#include "verification/opensky/night_for_tests.h"

namespace astronav::opensky {
namespace {

constexpr double kFalseAlarm = 1e-4;

Intrinsics distorted(ProjectionModel model) {
  const bool fisheye = model == ProjectionModel::fisheye;
  Intrinsics camera = Intrinsics::from_field_of_view(800, 700, (fisheye ? 175.0 : 22.0) * kDegree, model);
  camera.cx_px += 6.3;
  camera.cy_px -= 4.1;
  camera.distortion = fisheye ? Distortion{.k1 = -0.05, .k2 = -0.002, .k3 = 0.0, .p1 = 4e-4, .p2 = -6e-4}
                              : Distortion{.k1 = -0.08, .k2 = 0.4, .k3 = 0.0, .p1 = 9e-4, .p2 = -7e-4};
  return camera;
}

// Stars where a camera sees them, with errors of a known size.
struct Synthetic {
  Intrinsics camera;
  std::vector<Mat3> R_CN;
  std::vector<StarObservation> stars;
};
Synthetic synthesize(const Intrinsics& camera, int frames, int stars, const Scatter& scatter, RandomStream& random) {
  Synthetic out{.camera = camera, .R_CN = {}, .stars = {}};
  for (int k = 0; k < frames; ++k) {
    const Vec3 turn(random.normal(), random.normal(), random.normal());
    out.R_CN.push_back(rotation_exp(turn));
    for (int i = 0; i < stars; ++i) {
      Pixel p{random.uniform(0.0, camera.width_px - 1.0), random.uniform(0.0, camera.height_px - 1.0)};
      const Result<Vec3> direction_C = unproject(camera, p);
      if (!direction_C) continue;
      const double sigma = std::exp(random.uniform(std::log(0.01), std::log(0.3)));
      const Mat2 believed = Mat2::Identity() * sigma * sigma;
      const double real = std::sqrt(scatter.covariance(believed)(0, 0));
      p.u += real * random.normal();
      p.v += real * random.normal();
      out.stars.push_back({k, p, believed, out.R_CN.back().transpose() * *direction_C});
    }
  }
  return out;
}

// (found - true)' C^-1 (found - true) over what was solved for, with fx and fy as one unless they were apart.
double surprise(const Intrinsics& found, const IntrinsicsCovariance& covariance, const LensFreedom& freedom,
                const Intrinsics& truth) {
  const auto free = freedom.free();
  const auto a = intrinsics_values(found), b = intrinsics_values(truth);
  std::vector<Eigen::Index> rows;
  for (std::size_t i = 0; i < free.size(); ++i) {
    if (free[i] && (i != 1 || freedom.aspect)) rows.push_back(static_cast<Eigen::Index>(i));
  }
  Eigen::VectorXd error(rows.size());
  for (std::size_t i = 0; i < rows.size(); ++i) {
    const auto at = static_cast<std::size_t>(rows[i]);
    error[static_cast<Eigen::Index>(i)] = a[at] - b[at];
  }
  const Eigen::MatrixXd part = covariance(rows, rows);
  return error.dot(part.fullPivLu().solve(error));
}

void tell(const char* what, const Calibration& found, const Intrinsics& truth) {
  std::printf("%s: %zu stars, %.3f px rms, %.3f held out, chi-square %.1f of %d parameters\n", what, found.stars,
              found.rms_px, found.held_out_rms_px, surprise(found.camera, found.covariance, found.freedom, truth),
              found.freedom.count());
}

class CalibrateAdjust : public ::testing::TestWithParam<ProjectionModel> {};
INSTANTIATE_TEST_SUITE_P(Models, CalibrateAdjust, ::testing::Values(ProjectionModel::pinhole, ProjectionModel::fisheye),
                         [](const auto& suite) {
                           return suite.param == ProjectionModel::pinhole ? "Pinhole" : "Fisheye";
                         });

// Forty skies: the sum of their chi-squares lies in its 99.98 % band, and so do those of the attitudes.
TEST_P(CalibrateAdjust, ErrorsAreWhatTheCovarianceSays) {
  RandomStream random({.seed = 4, .purpose = "calibrate_test errors"});
  const Intrinsics truth = distorted(GetParam());
  const LensFreedom freedom{.centre = true, .radial = 2, .tangential = true};
  const int runs = 40;
  double lens = 0.0, attitude = 0.0;
  for (int run = 0; run < runs; ++run) {
    const Synthetic s = synthesize(truth, 2, 90, {.scale = 1.0, .extra_sigma_px = 0.08}, random);
    std::vector<Mat3> first;
    for (const Mat3& R : s.R_CN) first.push_back(rotation_exp(Vec3(2e-3, -1e-3, 3e-3)) * R);
    Intrinsics start =
        Intrinsics::from_field_of_view(800, 700, truth.field_of_view_horizontal_rad() * 1.01, truth.model);
    const auto found = adjust(s.stars, first, start, freedom, {.gate_sigma = 6.0, .scatter = {}, .passes = 5});
    ASSERT_TRUE(found) << describe(found.error());
    lens += surprise(found->camera, found->covariance, freedom, truth);
    for (std::size_t k = 0; k < s.R_CN.size(); ++k) {
      const Vec3 theta = -rotation_log(s.R_CN[k] * found->R_CN[k].transpose());
      attitude += theta.dot(found->attitude_covariance_rad2[k].inverse() * theta);
    }
  }
  // The scatter is itself estimated, from 360 residuals less 13: its own 4 % widens the band by as much.
  const auto expect_chi_square = [](double sum, double degrees) {
    EXPECT_GT(sum, 0.9 * chi_square_quantile(kFalseAlarm, degrees));
    EXPECT_LT(sum, 1.1 * chi_square_quantile(1.0 - kFalseAlarm, degrees));
  };
  expect_chi_square(lens, runs * freedom.count());
  expect_chi_square(attitude, runs * 6.0);
}

TEST_P(CalibrateAdjust, ScatterOfTheStarsIsFound) {
  RandomStream random({.seed = 5, .purpose = "calibrate_test scatter"});
  const Scatter truth{.scale = 1.8, .extra_sigma_px = 0.06};
  const Synthetic s = synthesize(distorted(GetParam()), 3, 500, truth, random);
  const auto found = adjust(s.stars, s.R_CN, s.camera, {.centre = true, .radial = 2, .tangential = true});
  ASSERT_TRUE(found);
  EXPECT_NEAR(found->scatter.scale, truth.scale, 0.25);  // steps of 10 %
  EXPECT_NEAR(found->scatter.extra_sigma_px, truth.extra_sigma_px, 0.015);
}

TEST_P(CalibrateAdjust, WrongStarsAreLeftOut) {
  RandomStream random({.seed = 6, .purpose = "calibrate_test wrong stars"});
  Synthetic s = synthesize(distorted(GetParam()), 2, 100, {.scale = 1.0, .extra_sigma_px = 0.05}, random);
  for (std::size_t i = 0; i < s.stars.size(); i += 12) s.stars[i].pixel.u += 3.0 + 0.1 * static_cast<double>(i % 7);
  const LensFreedom freedom{.centre = true, .radial = 2, .tangential = true};
  const auto found = adjust(s.stars, s.R_CN, s.camera, freedom);
  ASSERT_TRUE(found);
  for (std::size_t i = 0; i < s.stars.size(); i += 12) EXPECT_FALSE(found->used[i]) << i;
  EXPECT_GT(std::count(found->used.begin(), found->used.end(), true),
            0.97 * 11.0 / 12.0 * static_cast<double>(s.stars.size()));
  EXPECT_LT(surprise(found->camera, found->covariance, freedom, s.camera), chi_square_quantile(1.0 - kFalseAlarm, 7));
}

TEST_P(CalibrateAdjust, TooFewStarsAreAnError) {
  RandomStream random({.seed = 7, .purpose = "calibrate_test few"});
  const Synthetic s = synthesize(distorted(GetParam()), 2, 5, {.scale = 1.0, .extra_sigma_px = 0.05}, random);
  const auto found = adjust(s.stars, s.R_CN, s.camera, {.centre = true, .radial = 3, .tangential = true});
  ASSERT_FALSE(found);
  EXPECT_EQ(found.error().code, ErrorCode::not_converged);
}

// Stars that were held out tell which model is wrong: too poor a one by far, too rich a one by nothing.
TEST_P(CalibrateAdjust, HeldOutStarsKnowTheModel) {
  RandomStream random({.seed = 8, .purpose = "calibrate_test held out"});
  const Scatter scatter{.scale = 1.0, .extra_sigma_px = 0.05};
  const Synthetic s = synthesize(distorted(GetParam()), 2, 150, scatter, random);
  const auto held_out = [&](const LensFreedom& freedom) {
    Intrinsics start = s.camera;
    start.distortion = {};
    const auto found = cross_validate(s.stars, s.R_CN, start, freedom, scatter, 5);
    return found ? found->mean_surprise : 1e9;
  };
  const double right = held_out({.centre = true, .radial = 2, .tangential = true});
  EXPECT_NEAR(right, 2.0, 0.5);  // two degrees of freedom a star
  EXPECT_GT(held_out({}), 2.0 * right);
  EXPECT_NEAR(held_out({.centre = true, .radial = 3, .tangential = true}), right, 0.2);
}

TEST(CalibrateCamera, KnownPinholeComesBackWithinItsSigmas) {
  Camera camera = *read_camera("extrema-20deg");
  Intrinsics& truth = camera.intrinsics;
  truth.cx_px += 8.0;
  truth.cy_px -= 5.0;
  truth.distortion = {.k1 = -0.09, .k2 = 0.35, .k3 = 0.0, .p1 = 9e-4, .p2 = -7e-4};
  const std::array<Pointing, 4> pointings{{{84.0 * kDegree, 2.0 * kDegree, 0.3},
                                           {290.0 * kDegree, 35.0 * kDegree, 2.0},
                                           {190.0 * kDegree, -55.0 * kDegree, 4.0},
                                           {20.0 * kDegree, 60.0 * kDegree, 5.5}}};
  const Night night = take_pictures(camera, pointings, false, 8.5);
  CalibrationRequest request;
  request.field = FieldRange{18.0 * kDegree, 22.0 * kDegree};
  request.ephemeris = &shipped_ephemeris();
  const auto found = calibrate_camera(catalogue(), night.frames, request);
  ASSERT_TRUE(found) << describe(found.error());
  EXPECT_FALSE(found->mirrored);
  for (std::size_t k = 0; k < pointings.size(); ++k) {
    ASSERT_FALSE(found->frames[k].error) << describe(*found->frames[k].error);
    const Vec3 theta = -rotation_log(R_CN_from_pointing(pointings[k]) * found->frames[k].R_CN.transpose());
    EXPECT_LT(theta.dot(found->frames[k].covariance_rad2.inverse() * theta), chi_square_quantile(1 - kFalseAlarm, 3));
  }
  EXPECT_GT(found->stars, 400u);
  EXPECT_TRUE(found->freedom.centre && found->freedom.tangential && found->freedom.radial >= 2);
  EXPECT_LT(found->held_out_rms_px, 0.2);
  EXPECT_LT(surprise(found->camera, found->covariance, found->freedom, truth),
            chi_square_quantile(1.0 - kFalseAlarm, found->freedom.count()));
  tell("rendered pinhole", *found, truth);
  EXPECT_LT(std::sqrt(found->covariance(0, 0)), 0.3);  // of 2904 px: a covariance that says nothing would pass the rest
}

// A lens that draws straight lines needs a focal length, and no more.
TEST(CalibrateCamera, NoDistortionIsInventedWhereThereIsNone) {
  const Camera camera = *read_camera("star-tracker-10deg");
  const std::array<Pointing, 2> pointings{
      {{84.0 * kDegree, 2.0 * kDegree, 0.3}, {290.0 * kDegree, 35.0 * kDegree, 2.0}}};
  const Night night = take_pictures(camera, pointings, true, 9.5);
  CalibrationRequest request;
  request.field = FieldRange{9.0 * kDegree, 11.0 * kDegree};
  const auto found = calibrate_camera(catalogue(), night.frames, request);
  ASSERT_TRUE(found) << describe(found.error());
  EXPECT_TRUE(found->mirrored);
  EXPECT_LE(found->freedom.count(), 2);
  EXPECT_NEAR(found->camera.fx_px, camera.intrinsics.fx_px, 4.0 * std::sqrt(found->covariance(0, 0)));
}

// An all-sky camera, its picture mirrored; nobody says where it looks.
TEST(CalibrateCamera, KnownFisheyeComesBackWithinItsSigmas) {
  Camera camera = *read_camera("all-sky-fisheye");
  Intrinsics& truth = camera.intrinsics;
  truth.cx_px += 5.0;
  truth.cy_px -= 9.0;
  truth.distortion = {.k1 = -0.05, .k2 = -0.012, .k3 = 0.0, .p1 = 5e-4, .p2 = -4e-4};
  const std::array<Pointing, 1> pointings{{{75.0 * kDegree, 78.0 * kDegree, 0.9}}};
  const Night night = take_pictures(camera, pointings, true, 7.0);
  CalibrationRequest request;
  request.model = ProjectionModel::fisheye;
  request.ephemeris = &shipped_ephemeris();
  const auto found = calibrate_camera(catalogue(), night.frames, request);
  ASSERT_TRUE(found) << describe(found.error());
  EXPECT_TRUE(found->mirrored);
  EXPECT_GT(found->stars, 100u);
  EXPECT_LT(
      angle_between(found->frames[0].R_CN.row(2).transpose(), R_CN_from_pointing(pointings[0]).row(2).transpose()),
      0.2 * kDegree);
  EXPECT_LT(surprise(found->camera, found->covariance, found->freedom, truth),
            chi_square_quantile(1.0 - kFalseAlarm, found->freedom.count()));
  tell("rendered fisheye", *found, truth);
  EXPECT_LT(std::sqrt(found->covariance(0, 0)), 0.3);
}

// The first picture is of another kind than the rest: it goes, not they.
TEST(CalibrateCamera, MostPicturesDecide) {
  const Camera camera = *read_camera("star-tracker-10deg");
  const std::array<Pointing, 3> pointings{{{84.0 * kDegree, 2.0 * kDegree, 0.3},
                                           {290.0 * kDegree, 35.0 * kDegree, 2.0},
                                           {190.0 * kDegree, -55.0 * kDegree, 4.0}}};
  const Night turned = take_pictures(camera, std::span(pointings).first(1), true, 9.5);
  Camera wider = camera;
  wider.intrinsics.fx_px *= 0.9;
  wider.intrinsics.fy_px *= 0.9;
  const Night wide = take_pictures(wider, std::span(pointings).first(1), false, 9.5);
  const Night night = take_pictures(camera, std::span(pointings), false, 9.5);
  CalibrationRequest request;
  request.field = FieldRange{8.0 * kDegree, 13.0 * kDegree};
  for (const Night* odd : {&turned, &wide}) {
    const std::array<CalibrationFrame, 4> frames{odd->frames[0], night.frames[0], night.frames[1], night.frames[2]};
    const auto found = calibrate_camera(catalogue(), frames, request);
    ASSERT_TRUE(found) << describe(found.error());
    EXPECT_FALSE(found->mirrored);
    EXPECT_TRUE(found->frames[0].error);
    for (std::size_t k = 1; k < frames.size(); ++k) {
      EXPECT_FALSE(found->frames[k].error);
      EXPECT_FALSE(found->frames[k].stands_apart());
    }
    EXPECT_NEAR(found->camera.fx_px, camera.intrinsics.fx_px, 4.0 * std::sqrt(found->covariance(0, 0)));
  }
}

// Two focal lengths are no one camera: a picture is left out, or says that it would lie better alone.
class CalibrateTwoCameras : public ::testing::TestWithParam<double> {};
INSTANTIATE_TEST_SUITE_P(Ratios, CalibrateTwoCameras, ::testing::Values(1.002, 1.0003));
TEST_P(CalibrateTwoCameras, AreToldApart) {
  Camera camera = *read_camera("star-tracker-10deg");
  const std::array<Pointing, 2> pointings{
      {{84.0 * kDegree, 2.0 * kDegree, 0.3}, {290.0 * kDegree, 35.0 * kDegree, 2.0}}};
  const Night one = take_pictures(camera, std::span(pointings).first(1), false, 9.5);
  camera.intrinsics.fx_px *= GetParam();
  camera.intrinsics.fy_px *= GetParam();
  const Night other = take_pictures(camera, std::span(pointings).last(1), false, 9.5);
  CalibrationRequest request;
  request.field = FieldRange{9.0 * kDegree, 11.0 * kDegree};
  const std::array<CalibrationFrame, 2> frames{one.frames[0], other.frames[0]};
  const auto found = calibrate_camera(catalogue(), frames, request);
  ASSERT_TRUE(found) << describe(found.error());
  bool told = false;
  for (const CalibratedFrame& f : found->frames) told |= f.error || f.stands_apart();
  EXPECT_TRUE(told);
}

TEST(CalibrateCamera, SaysWhatIsWrong) {
  Picture small, large;
  small.pixels = ImageF(64, 64, 100.0f);
  large.pixels = ImageF(64, 65, 100.0f);
  const std::array<CalibrationFrame, 2> two_sizes{{{.picture = &small}, {.picture = &large}}};
  const auto sizes = calibrate_camera(catalogue(), two_sizes, {});
  ASSERT_FALSE(sizes);
  EXPECT_EQ(sizes.error().code, ErrorCode::invalid_argument);
  for (const ProjectionModel model : {ProjectionModel::pinhole, ProjectionModel::fisheye}) {
    CalibrationRequest request;
    request.model = model;
    const auto empty = calibrate_camera(catalogue(), std::span(two_sizes).first(1), request);
    ASSERT_FALSE(empty);
    EXPECT_EQ(empty.error().code, ErrorCode::no_match);
  }
}

// Spots at random places are no sky, whatever the parity, the focal length and the attitude.
TEST(FindFisheye, RandomSpotsAreNoSky) {
  RandomStream random({.seed = 9, .purpose = "calibrate_test random spots"});
  std::vector<vision::Centroid> spots(200);
  for (vision::Centroid& spot : spots) {
    const double r = 250.0 * std::sqrt(random.uniform()), at = random.uniform(0.0, 2.0 * kPi);
    spot.pixel = {255.5 + r * std::cos(at), 255.5 + r * std::sin(at)};
    spot.flux_dn = 100.0;
  }
  const auto sky = apparent_stars(catalogue(), 5.5, *Epoch::parse("2020-12-11"), {});
  const auto found = find_fisheye(spots, sky, 512, 512, 140.0, 220.0, {});
  ASSERT_FALSE(found);
  EXPECT_EQ(found.error().code, ErrorCode::no_match);
}

TEST(MatchStars, LeavesOutBlendsPlanetsAndWrongBrightness) {
  const Intrinsics camera = Intrinsics::from_field_of_view(512, 512, 10.0 * kDegree);
  std::vector<SkyStar> sky;
  std::vector<vision::Centroid> spots;
  const auto add = [&](double u, double v, double v_mag, double seen_mag) {
    sky.push_back({*unproject(camera, {u, v}), v_mag, 0, static_cast<std::uint32_t>(sky.size() + 1)});
    vision::Centroid spot;
    spot.pixel = {u + 0.2, v};
    spot.flux_dn = std::pow(10.0, -0.4 * (seen_mag - 15.0));
    spots.push_back(spot);
  };
  for (int i = 0; i < 12; ++i) add(40.0 + 35.0 * i, 100.0, 4.0 + 0.1 * i, 4.0 + 0.1 * i);
  add(100.0, 300.0, 6.0, 6.0);  // 12 and 13: two stars at one place
  add(101.5, 300.0, 6.5, 6.5);
  add(300.0, 300.0, 7.0, 2.0);  // 14: far too bright
  add(400.0, 400.0, 7.1, 7.1);  // 15: closed
  std::vector<char> closed(spots.size(), 0);
  closed[15] = 1;
  const auto matches = match_stars(sky, spots, closed, camera, Mat3::Identity(), {.radius_px = 1.0});
  ASSERT_EQ(matches.size(), 12u);
  for (const StarMatch& m : matches) {
    EXPECT_EQ(m.star, m.spot);
    EXPECT_LT(m.star, 12u);
  }
}

}  // namespace
}  // namespace astronav::opensky
