// SPDX-License-Identifier: Apache-2.0
#include "onboard/executive/stance.h"

#include <atomic>
#include <cmath>
#include <cstdlib>

#include <gtest/gtest.h>

#include "foundation/math/rotation.h"

namespace {
std::atomic<long> g_allocations{0};
}  // namespace

// Every allocation of this program passes here. (g++ 12 sees the malloc through the inlined operator and warns.)
#pragma GCC diagnostic ignored "-Wmismatched-new-delete"
void* operator new(std::size_t size) {
  ++g_allocations;
  if (void* p = std::malloc(size)) return p;
  std::abort();
}
void operator delete(void* p) noexcept {
  std::free(p);
}
void operator delete(void* p, std::size_t) noexcept {
  std::free(p);
}

namespace astronav::executive {
namespace {

Intrinsics camera_with_centre(double u_px, double v_px) {
  Intrinsics camera;
  camera.width_px = camera.height_px = 1024;
  camera.fx_px = camera.fy_px = 2904.0;
  camera.cx_px = u_px;
  camera.cy_px = v_px;
  return camera;
}
Epoch at(double seconds) {
  return Epoch::tdb_seconds(8e8) + Duration::seconds(seconds);
}
vision::AttitudeSolution found(const Mat3& R_CN, const Intrinsics& camera) {
  vision::AttitudeSolution attitude;
  attitude.R_CN = R_CN;
  attitude.covariance_rad2 = Mat3::Identity() * 1e-12;
  attitude.intrinsics = camera;
  return attitude;
}

TEST(PixelAxes, LookThroughTheMiddleOfThePicture) {
  const Intrinsics camera = camera_with_centre(500.0, 530.0);
  const Mat3 R_CP = pixel_axes(camera).value();
  EXPECT_LT((R_CP * R_CP.transpose() - Mat3::Identity()).norm(), 1e-14);
  EXPECT_NEAR(R_CP.determinant(), 1.0, 1e-14);
  const auto middle = project(camera, R_CP.col(2));
  EXPECT_NEAR(middle->u, 511.5, 1e-9);
  EXPECT_NEAR(middle->v, 511.5, 1e-9);
  const auto right = project(camera, (R_CP * Vec3(0.05, 0.0, 1.0)).normalized());
  EXPECT_GT(right->u, 600.0);
  EXPECT_NEAR(right->v, 511.5, 1e-9);
}

TEST(Stance, WithoutAGyroFollowsTheCommands) {
  Stance stance({});
  const Intrinsics camera = camera_with_centre(511.5, 511.5);
  const Mat3 first = rotation_exp(Vec3(0.1, 0.2, 0.3)), second = rotation_exp(Vec3(0.01, 0.0, 0.0)) * first;
  const Mat3 off = rotation_exp(Vec3(1e-3, -2e-3, 5e-4));
  EXPECT_FALSE(stance.expected_R_CN(at(0.0), camera, first));
  stance.take(at(0.0), found(off * first, camera), first);
  EXPECT_FALSE(stance.report().foretold || stance.report().update || stance.report().after);
  EXPECT_LT((*stance.expected_R_CN(at(100.0), camera, second) - off * second).norm(), 1e-14);
  EXPECT_FALSE(stance.expected_R_CN(at(100.0), camera, {}));       // no command
  EXPECT_FALSE(stance.expected_R_CN(at(1000.0), camera, second));  // after a pause
  Stance lost({.expects = false, .gyro = {}});
  lost.take(at(0.0), found(off * first, camera), first);
  EXPECT_FALSE(lost.expected_R_CN(at(100.0), camera, second));
}

// The centre of the camera is learned between two frames by ten pixels: the attitude of C jumps, that of the picture's
// middle does not, and the stars are looked for where they are.
TEST(Stance, AGyroHoldsThePictureAndNotTheCameraAxes) {
  Stance stance({.gyro = attitude::AttitudeFilterSettings{}});
  const Mat3 R_PN = rotation_exp(Vec3(0.4, -1.2, 0.3));
  const Intrinsics told = camera_with_centre(511.5, 511.5), learned = camera_with_centre(521.5, 511.5);
  const auto R_CN = [&](const Intrinsics& camera, const Mat3& turned) { return Mat3(*pixel_axes(camera) * turned); };
  EXPECT_FALSE(stance.expected_R_CN(at(0.0), told, {}));
  stance.take(at(0.0), found(R_CN(told, R_PN), told), {});
  EXPECT_EQ(stance.report().update->verdict, attitude::AttitudeVerdict::started);
  const Vec3 rate = Vec3(0.1, -0.2, 0.05) * kDegree;
  for (int k = 0; k < 100; ++k) stance.sense({at(k), at(k + 1.0), rate});
  const Mat3 turned = rotation_exp(-100.0 * rate) * R_PN;
  const auto expected = stance.expected_R_CN(at(100.0), learned, {});
  ASSERT_TRUE(expected);
  EXPECT_LT((*expected - R_CN(learned, turned)).norm(), 1e-12);
  ASSERT_TRUE(stance.report().foretold);
  EXPECT_LT((stance.report().foretold->R_CN - turned).norm(), 1e-12);
  stance.take(at(100.0), found(R_CN(learned, turned), learned), {});
  EXPECT_TRUE(stance.report().update->accepted());
  EXPECT_LT(stance.report().update->innovation_rad.norm(), 1e-10);
  EXPECT_TRUE(stance.report().after);
  // A frame that showed nothing leaves no report of an update.
  stance.sense({at(100.0), at(101.0), rate});
  EXPECT_TRUE(stance.expected_R_CN(at(101.0), learned, {}));
  EXPECT_FALSE(stance.report().update);
}

TEST(Stance, AllocatesNothing) {
  Stance stance({.gyro = attitude::AttitudeFilterSettings{}});
  const Intrinsics camera = camera_with_centre(500.0, 520.0);
  const auto attitude = found(Mat3::Identity(), camera), other = found(rotation_exp(Vec3(0.5, 0.0, 0.0)), camera);
  const long before = g_allocations;
  stance.take(at(0.0), attitude, {});
  for (int k = 0; k < 100; ++k) stance.sense({at(k), at(k + 1.0), Vec3::Zero()});
  const bool expected = stance.expected_R_CN(at(100.0), camera, {}).has_value();
  stance.take(at(100.0), other, {});  // and a start anew
  EXPECT_EQ(g_allocations, before);
  EXPECT_TRUE(expected);
  EXPECT_EQ(stance.report().update->verdict, attitude::AttitudeVerdict::gated);
}

TEST(Stance, AGyroWithoutPriorIsOnlyFollowed) {
  Stance stance({.expects = false, .gyro = attitude::AttitudeFilterSettings{}});
  const Intrinsics camera = camera_with_centre(511.5, 511.5);
  stance.take(at(0.0), found(Mat3::Identity(), camera), {});
  stance.sense({at(0.0), at(100.0), Vec3::Zero()});
  EXPECT_FALSE(stance.expected_R_CN(at(100.0), camera, {}));
  EXPECT_TRUE(stance.report().foretold);
}

}  // namespace
}  // namespace astronav::executive
