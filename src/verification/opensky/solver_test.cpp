// SPDX-License-Identifier: Apache-2.0
#include "verification/opensky/solver.h"

#include <cmath>
#include <cstdio>
#include <vector>

#include <Eigen/LU>
#include <gtest/gtest.h>

#include "foundation/math/random.h"
#include "foundation/math/rotation.h"
#include "foundation/math/statistics.h"
#include "verification/opensky/night_for_tests.h"

namespace astronav::opensky {
namespace {

constexpr double kFalseAlarm = 1e-4;

// Squared errors over what was told, of many pictures; both together have the chi-square distribution.
struct Told {
  double attitude = 0.0, center = 0.0;  // 3 degrees of freedom a picture
  int pictures = 0;
  std::vector<double> center_sigma_arcsec;
};

struct Lens {
  double fov_deg = 0.0, max_v_mag = 0.0;
  Distortion distortion{};
  double centre_off_px = 0.0;
};

Told tell(const Lens& lens, bool camera_is_known, int pictures) {
  Camera camera = *read_camera(lens.fov_deg > 15.0 ? "extrema-20deg" : "star-tracker-10deg");
  camera.intrinsics.distortion = lens.distortion;
  camera.intrinsics.cx_px += lens.centre_off_px;
  RandomStream random({.seed = 11, .purpose = "solver_test"});
  std::vector<Pointing> pointings;
  for (int k = 0; k < pictures; ++k)
    pointings.push_back(
        {random.uniform(0.0, 2.0 * kPi), std::asin(random.uniform(-1.0, 1.0)), random.uniform(0.0, 2.0 * kPi)});
  const Night night = take_pictures(camera, pointings, false, lens.max_v_mag);
  Solver solver(catalogue());
  Told out;
  for (int k = 0; k < pictures; ++k) {
    const auto at = static_cast<std::size_t>(k);
    SolveRequest ask{.epoch = night.frames[at].epoch, .observer = night.frames[at].observer};
    if (camera_is_known)
      ask.camera = camera.intrinsics;
    else
      ask.field = FieldRange{0.9 * lens.fov_deg * kDegree, 1.1 * lens.fov_deg * kDegree};
    const auto found = solver.solve(night.pictures[at], ask);
    EXPECT_TRUE(found) << k << ": " << describe(found.error());
    if (!found) continue;
    const Mat3 R_CN = R_CN_from_pointing(pointings[at]);
    const Vec3 theta = -rotation_log(R_CN * found->attitude.R_CN.transpose());
    out.attitude += theta.dot(found->attitude.covariance_rad2.inverse() * theta);
    const Pixel middle{0.5 * (camera.intrinsics.width_px - 1), 0.5 * (camera.intrinsics.height_px - 1)};
    const Vec3 true_N = R_CN.transpose() * *unproject(camera.intrinsics, middle);
    const Vec3 told_N = found->attitude.R_CN.transpose() * *unproject(found->attitude.intrinsics, middle);
    const Mat3& R_told = found->attitude.R_CN;
    const Vec3 off = told_N.cross(true_N);  // a turn, in N
    const Vec2 right_down(off.dot(R_told.row(0)), off.dot(R_told.row(1)));
    const Mat2 covariance = found->center_covariance_rad2.topLeftCorner<2, 2>();
    out.center += right_down.dot(covariance.inverse() * right_down);
    out.center_sigma_arcsec.push_back(std::sqrt(0.5 * covariance.trace()) / kArcsecond);
    ++out.pictures;
  }
  return out;
}

void expect_true(const char* what, const Told& told) {
  std::printf("%s: %d pictures, NEES of attitude %.2f (3), of the middle %.2f (2); told %.3f arcsec\n", what,
              told.pictures, told.attitude / told.pictures, told.center / told.pictures,
              median(told.center_sigma_arcsec));
  EXPECT_GT(told.attitude, chi_square_quantile(kFalseAlarm, 3 * told.pictures));
  EXPECT_LT(told.attitude, chi_square_quantile(1.0 - kFalseAlarm, 3 * told.pictures));
  EXPECT_GT(told.center, chi_square_quantile(kFalseAlarm, 2 * told.pictures));
  EXPECT_LT(told.center, chi_square_quantile(1.0 - kFalseAlarm, 2 * told.pictures));
}

// What is told of the error is true whether the lens is known or must be found beside, straight or bent.
TEST(Solver, ErrorsAreWhatTheCovarianceSays) {
  constexpr int kPictures = 40;
  const Lens straight{.fov_deg = 20.0, .max_v_mag = 8.0};
  expect_true("known camera", tell(straight, true, kPictures));
  expect_true("unknown camera", tell(straight, false, kPictures));
  const Lens bent{.fov_deg = 20.0,
                  .max_v_mag = 8.0,
                  .distortion = {.k1 = -0.09, .k2 = 0.35, .k3 = 0.0, .p1 = 9e-4, .p2 = -7e-4},
                  .centre_off_px = 6.0};
  expect_true("bent lens", tell(bent, false, kPictures));
  expect_true("bent lens, known", tell(bent, true, kPictures));
  const Lens narrow{.fov_deg = 10.0, .max_v_mag = 9.5};
  expect_true("narrow, unknown", tell(narrow, false, kPictures));
}

}  // namespace
}  // namespace astronav::opensky
