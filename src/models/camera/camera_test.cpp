// SPDX-License-Identifier: Apache-2.0
#include "models/camera/camera.h"

#include <cmath>
#include <limits>

#include <gtest/gtest.h>

namespace astronav {
namespace {

Intrinsics distorted_camera() {
  Intrinsics camera = Intrinsics::from_field_of_view(1024, 768, 20.0 * kDegree);
  camera.fy_px *= 1.01;
  camera.cx_px += 3.7;
  camera.cy_px -= 5.2;
  camera.distortion = {.k1 = -0.12, .k2 = 0.05, .k3 = -0.02, .p1 = 4e-4, .p2 = -7e-4};
  return camera;
}

// An all-sky camera: the corners lie 125 degrees off the axis.
Intrinsics distorted_fisheye() {
  Intrinsics camera = Intrinsics::from_field_of_view(512, 480, 185.0 * kDegree, ProjectionModel::fisheye);
  camera.fy_px *= 1.005;
  camera.cx_px += 2.7;
  camera.cy_px -= 4.2;
  camera.distortion = {.k1 = -0.01, .k2 = 2e-3, .k3 = -1e-4, .p1 = 4e-4, .p2 = -7e-4};
  return camera;
}

TEST(Camera, FieldOfViewIsEdgeToEdge) {
  const Intrinsics camera = Intrinsics::from_field_of_view(1024, 1024, 20.0 * kDegree);
  EXPECT_NEAR(camera.field_of_view_horizontal_rad(), 20.0 * kDegree, 1e-14);
  EXPECT_NEAR(camera.field_of_view_vertical_rad(), 20.0 * kDegree, 1e-14);
  EXPECT_NEAR(camera.fx_px, 2903.7, 0.1);  // 512 / tan 10 degrees
  EXPECT_NEAR(camera.half_diagonal_rad(), std::atan(std::sqrt(2.0) * std::tan(10.0 * kDegree)), 1e-14);
}

TEST(Camera, FisheyeFieldOfViewGoesBeyondAHalfCircle) {
  const Intrinsics camera = Intrinsics::from_field_of_view(512, 256, 200.0 * kDegree, ProjectionModel::fisheye);
  EXPECT_NEAR(camera.fx_px, 256.0 / (100.0 * kDegree), 1e-12);
  EXPECT_NEAR(camera.field_of_view_horizontal_rad(), 200.0 * kDegree, 1e-14);
  EXPECT_NEAR(camera.field_of_view_vertical_rad(), 100.0 * kDegree, 1e-14);
  EXPECT_NEAR(camera.half_diagonal_rad(), std::hypot(100.0, 50.0) * kDegree, 1e-12);
  // No direction is farther off the axis than straight back: corners of a square beyond see nothing.
  const Intrinsics whole = Intrinsics::from_field_of_view(512, 512, 300.0 * kDegree, ProjectionModel::fisheye);
  EXPECT_NEAR(whole.half_diagonal_rad(), kPi, 1e-12);
  EXPECT_FALSE(unproject(whole, {0.0, 0.0}));
}

TEST(Camera, FisheyeIsEquidistant) {
  const Intrinsics camera = Intrinsics::from_field_of_view(512, 512, 200.0 * kDegree, ProjectionModel::fisheye);
  for (const double off_axis_deg : {0.0, 1e-4, 0.5, 0.6, 45.0, 89.9, 90.0, 135.0, 179.0}) {
    const double a = off_axis_deg * kDegree;
    const Vec3 direction_C(std::sin(a) * 0.6, std::sin(a) * 0.8, std::cos(a));
    const Pixel p = *project(camera, 7.0 * direction_C);
    EXPECT_NEAR(p.u, camera.cx_px + 0.6 * a * camera.fx_px, 1e-11) << off_axis_deg;
    EXPECT_NEAR(p.v, camera.cy_px + 0.8 * a * camera.fy_px, 1e-11) << off_axis_deg;
  }
  EXPECT_FALSE(project(camera, {0, 0, -1}));
  EXPECT_FALSE(project(camera, {0, 0, 0}));
  EXPECT_FALSE(project(camera, {std::nan(""), 0, 1}));
}

// tan a = a + a^3/3 + 2 a^5/15 ...: near the axis the two models differ by a third of the angle's cube.
TEST(Camera, ModelsAgreeNearTheAxisToThirdOrder) {
  Intrinsics pinhole = distorted_camera();
  Intrinsics fisheye = pinhole;
  fisheye.model = ProjectionModel::fisheye;
  pinhole.distortion = fisheye.distortion = {};
  for (const double a : {1e-3, 4e-3, 1.6e-2, 6.4e-2}) {
    const Vec3 direction_C(std::sin(a) * 0.6, std::sin(a) * 0.8, std::cos(a));
    const double difference = project(pinhole, direction_C)->u - project(fisheye, direction_C)->u;
    EXPECT_NEAR(difference / (0.6 * pinhole.fx_px), a * a * a / 3.0, 0.15 * std::pow(a, 5) + 1e-15) << a;
  }
}

TEST(Camera, AxesAreColumnsRowsBoresight) {
  const Intrinsics camera = Intrinsics::from_field_of_view(1024, 1024, 20.0 * kDegree);
  const Pixel centre = *project(camera, {0, 0, 3});
  EXPECT_DOUBLE_EQ(centre.u, 511.5);
  EXPECT_DOUBLE_EQ(centre.v, 511.5);
  const Pixel right_edge = *project(camera, {std::tan(10.0 * kDegree), 0, 1});
  EXPECT_NEAR(right_edge.u, 1023.5, 1e-10);
  EXPECT_NEAR(project(camera, {0, 0.1, 1})->v, 511.5 + 0.1 * camera.fy_px, 1e-10);  // +y is down
}

// Values computed with the formula by hand: x = 0.1, y = -0.05, r2 = 0.0125, r4 = 1.5625e-4, r6 = 1.953125e-6.
TEST(Camera, DistortionFollowsBrownConrady) {
  Intrinsics camera;
  camera.width_px = camera.height_px = 100;
  camera.fx_px = camera.fy_px = 1000.0;
  camera.distortion = {.k1 = -0.2, .k2 = 1.0, .k3 = 3.0, .p1 = 0.01, .p2 = 0.02};
  const double radial = 1.0 - 0.0025 + 1.5625e-4 + 5.859375e-6;
  const Pixel p = *project(camera, {0.1, -0.05, 1.0});
  EXPECT_NEAR(p.u, 1000.0 * (0.1 * radial + 2 * 0.01 * -0.005 + 0.02 * (0.0125 + 0.02)), 1e-10);
  EXPECT_NEAR(p.v, 1000.0 * (-0.05 * radial + 0.01 * (0.0125 + 0.005) + 2 * 0.02 * -0.005), 1e-10);
}

TEST(Camera, UnprojectUndoesProject) {
  const Intrinsics camera = distorted_camera();
  for (double u = -50.0; u < 1100.0; u += 37.3) {
    for (double v = -50.0; v < 850.0; v += 41.1) {
      const Result<Vec3> direction_C = unproject(camera, {u, v});
      ASSERT_TRUE(direction_C) << u << " " << v;
      EXPECT_NEAR(direction_C->norm(), 1.0, 1e-15);
      const Result<Pixel> back = project(camera, *direction_C);
      ASSERT_TRUE(back);
      EXPECT_NEAR(back->u, u, 1e-9);
      EXPECT_NEAR(back->v, v, 1e-9);
    }
  }
}

TEST(Camera, FisheyeUnprojectUndoesProjectOverTheWholeField) {
  const Intrinsics camera = distorted_fisheye();
  double widest = 0.0;
  for (double u = -0.5; u < 512.0; u += 7.3) {
    for (double v = -0.5; v < 480.0; v += 7.1) {
      const Result<Vec3> direction_C = unproject(camera, {u, v});
      ASSERT_TRUE(direction_C) << u << " " << v;
      EXPECT_NEAR(direction_C->norm(), 1.0, 1e-15);
      const Result<Pixel> back = project(camera, *direction_C);
      ASSERT_TRUE(back);
      EXPECT_NEAR(back->u, u, 1e-10);  // 1e-12 of the focal length
      EXPECT_NEAR(back->v, v, 1e-10);
      const Result<Vec3> again = unproject(camera, *back);
      ASSERT_TRUE(again);
      EXPECT_LT((*again - *direction_C).norm(), 1e-12);
      widest = std::max(widest, std::acos(direction_C->z()));
    }
  }
  EXPECT_GT(widest, 110.0 * kDegree);
}

void expect_jacobians_agree_with_differences(const Intrinsics& camera, std::initializer_list<Vec3> directions_C) {
  for (const Vec3& direction_C : directions_C) {
    Mat23 by_direction;
    IntrinsicsJacobian by_intrinsics;
    const Pixel p = *project(camera, direction_C, &by_direction, &by_intrinsics);
    const double h = 1e-6;
    for (int i = 0; i < 3; ++i) {
      const Vec2 slope = (project(camera, direction_C + h * Vec3::Unit(i))->vec() -
                          project(camera, direction_C - h * Vec3::Unit(i))->vec()) /
                         (2.0 * h);
      EXPECT_LT((slope - by_direction.col(i)).norm(), 1e-5) << i;  // of values up to 3000
    }
    for (int i = 0; i < 9; ++i) {
      const auto moved = [&](double step) {
        Intrinsics c = camera;
        Distortion& d = c.distortion;
        double* const parameters[] = {&c.fx_px, &c.fy_px, &c.cx_px, &c.cy_px, &d.k1, &d.k2, &d.k3, &d.p1, &d.p2};
        *parameters[i] += step;
        return project(c, direction_C)->vec();
      };
      const double step = i < 4 ? 1e-2 : 1e-5;
      const Vec2 slope = (moved(step) - moved(-step)) / (2.0 * step);
      EXPECT_LT((slope - by_intrinsics.col(i)).norm(), 1e-6 * std::max(1.0, by_intrinsics.col(i).norm()) + 1e-6) << i;
    }
    Eigen::Matrix<double, 3, 2> by_pixel;
    ASSERT_TRUE(unproject(camera, p, &by_pixel));
    for (int i = 0; i < 2; ++i) {
      const double step = 1e-3;
      const Pixel plus{p.u + (i == 0 ? step : 0.0), p.v + (i == 1 ? step : 0.0)};
      const Pixel minus{p.u - (i == 0 ? step : 0.0), p.v - (i == 1 ? step : 0.0)};
      const Vec3 slope = (*unproject(camera, plus) - *unproject(camera, minus)) / (2.0 * step);
      EXPECT_LT((slope - by_pixel.col(i)).norm(), 3e-11) << i;  // of values about 3e-4 and 6e-3
    }
  }
}

TEST(Camera, JacobiansAgreeWithDifferences) {
  expect_jacobians_agree_with_differences(distorted_camera(),
                                          {Vec3(0.11, -0.07, 0.93), Vec3(-0.3, 0.22, 2.0), Vec3(0.0, 0.0, 1.0)});
}

// On the axis, on both sides of where the series ends (0.01 of the axis), sideways and backwards.
TEST(Camera, FisheyeJacobiansAgreeWithDifferences) {
  expect_jacobians_agree_with_differences(
      distorted_fisheye(), {Vec3(0.0, 0.0, 1.0), Vec3(0.0059, -0.0079, 1.0), Vec3(0.0061, -0.0081, 1.0),
                            Vec3(0.4, -0.7, 0.3), Vec3(-1.0, 0.2, 0.0), Vec3(0.5, 0.8, -0.4), Vec3(-0.9, 0.1, -0.5)});
}

TEST(Camera, RefusesWhatLiesBehind) {
  const Intrinsics camera = distorted_camera();
  for (const Vec3& direction : {Vec3(0, 0, -1), Vec3(1, 0, 0), Vec3(0, 0, std::nan(""))}) {
    const Result<Pixel> p = project(camera, direction);
    ASSERT_FALSE(p);
    EXPECT_EQ(p.error().code, ErrorCode::out_of_range);
  }
}

TEST(Camera, FoldOfTheDistortionIsDetected) {
  Intrinsics camera = Intrinsics::from_field_of_view(1000, 1000, 90.0 * kDegree);
  camera.distortion.k1 = -0.3;  // the radius r - 0.3 r3 is largest at r = 1/sqrt(0.9) = 1.054, with 0.703
  EXPECT_TRUE(project(camera, {1.05, 0, 1}));
  const Result<Pixel> folded = project(camera, {1.06, 0, 1});
  ASSERT_FALSE(folded);
  EXPECT_EQ(folded.error().code, ErrorCode::out_of_range);
  const auto at_radius = [&](double r) { return Pixel{camera.cx_px + camera.fx_px * r, camera.cy_px}; };
  EXPECT_TRUE(unproject(camera, at_radius(0.702)));
  const Result<Vec3> beyond = unproject(camera, at_radius(0.704));
  ASSERT_FALSE(beyond);
  EXPECT_EQ(beyond.error().code, ErrorCode::not_converged);
  // Here the radius shrinks between r2 = 0.25 and 0.5 (1 - 6 s + 8 s2 = 0) and grows again: a place beyond is folded
  // too.
  camera.distortion = {.k1 = -2.0, .k2 = 1.6};
  EXPECT_TRUE(project(camera, {0.49, 0, 1}));
  EXPECT_FALSE(project(camera, {0.6, 0, 1}));
  EXPECT_FALSE(project(camera, {0.9, 0, 1}));
}

TEST(Camera, UnprojectRefusesNonsensePixels) {
  const double nan = std::numeric_limits<double>::quiet_NaN();
  EXPECT_FALSE(unproject(distorted_camera(), {nan, 0.0}));
}

TEST(Camera, ConvertersToFitsAndCorner) {
  const Vec2 xy = fits_from_pixel({0.0, 0.0}, 768);
  EXPECT_EQ(xy, Vec2(1.0, 768.0));  // the top row is stored last
  EXPECT_EQ(fits_from_pixel({10.0, 767.0}, 768), Vec2(11.0, 1.0));
  const Pixel back = pixel_from_fits(xy, 768);
  EXPECT_EQ(back.u, 0.0);
  EXPECT_EQ(back.v, 0.0);
  EXPECT_EQ(corner_from_pixel({0.0, 0.0}), Vec2(0.5, 0.5));
  EXPECT_EQ(pixel_from_corner({0.5, 1.5}).v, 1.0);
}

}  // namespace
}  // namespace astronav
