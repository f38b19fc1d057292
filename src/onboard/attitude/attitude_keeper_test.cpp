// SPDX-License-Identifier: Apache-2.0
#include "onboard/attitude/attitude_keeper.h"

#include <cmath>

#include <gtest/gtest.h>

#include "foundation/math/rotation.h"

namespace astronav::attitude {
namespace {

// A spacecraft that turns at a constant rate, and a gyro with a bias and no noise.
struct Craft {
  Epoch begin = Epoch::tdb_seconds(8e8);
  Vec3 rate = Vec3(0.02, -0.01, 0.015) * kDegree;
  Vec3 bias = Vec3(4.0, -7.0, 2.0) * kDegree / 3600.0;

  Epoch at(double seconds) const { return begin + Duration::seconds(seconds); }
  Mat3 R_CN(double seconds) const { return rotation_exp(-rate * seconds); }
  AttitudeMeasurement frame(double seconds) const {
    const double sigma = 1.0 * kArcsecond;
    return {at(seconds), R_CN(seconds), Mat3::Identity() * sigma * sigma};
  }
  void feed(AttitudeKeeper& keeper, double from, double to) const {
    for (double t = from; t < to; t += 1.0) keeper.sense({at(t), at(t + 1.0), rate + bias});
  }
  double error_arcsec(const AttitudeEstimate& estimate, double seconds) const {
    return rotation_log(R_CN(seconds) * estimate.R_CN.transpose()).norm() / kArcsecond;
  }
};

TEST(AttitudeKeeper, StartsWithAFrameAndFollowsTheGyro) {
  const Craft craft;
  AttitudeKeeper keeper({});
  craft.feed(keeper, 0.0, 100.0);
  EXPECT_FALSE(keeper.at(craft.at(99.5)));  // nobody said where it stands
  // In the middle of a sample; what is left of that one counts.
  EXPECT_EQ(keeper.take(craft.frame(99.5)).verdict, AttitudeVerdict::started);
  craft.feed(keeper, 100.0, 200.0);
  const auto foretold = keeper.at(craft.at(199.5));
  ASSERT_TRUE(foretold);
  // The bias, of which nothing is known yet, over 100 s; its sigma says as much.
  EXPECT_NEAR(craft.error_arcsec(*foretold, 199.5), craft.bias.norm() * 100.0 / kArcsecond, 5.0);
  EXPECT_GT(std::sqrt(foretold->covariance_rad2(0, 0)), 900.0 * kArcsecond);
  EXPECT_TRUE(keeper.take(craft.frame(199.5)).accepted());
  EXPECT_LT((keeper.now()->gyro_bias_rad_s - craft.bias).norm(), 0.2 * craft.bias.norm());
  craft.feed(keeper, 200.0, 300.0);
  EXPECT_LT(craft.error_arcsec(*keeper.at(craft.at(299.5)), 299.5), 100.0);
}

// A frame that could not be solved is only a longer way to the next one.
TEST(AttitudeKeeper, MayMissAFrame) {
  const Craft craft;
  AttitudeKeeper keeper({});
  keeper.take(craft.frame(0.0));
  for (int image = 1; image <= 20; ++image) {
    craft.feed(keeper, 100.0 * (image - 1), 100.0 * image);
    if (image % 4 == 3) {
      EXPECT_TRUE(keeper.at(craft.at(100.0 * image)));
    } else {
      EXPECT_TRUE(keeper.take(craft.frame(100.0 * image)).accepted()) << image;
    }
  }
  EXPECT_LT((keeper.now()->gyro_bias_rad_s - craft.bias).norm(), 0.01 * craft.bias.norm());
}

// A picture is tagged to some milliseconds: a little before the first sample, and beside others' ends.
TEST(AttitudeKeeper, FramesNeedNotMeetSamples) {
  const Craft craft;
  AttitudeKeeper keeper({});
  keeper.take(craft.frame(-0.005));
  for (int image = 1; image <= 6; ++image) {
    craft.feed(keeper, 100.0 * (image - 1), 100.0 * image);
    EXPECT_TRUE(keeper.take(craft.frame(100.0 * image + (image % 2 == 0 ? 0.005 : -0.005))).accepted()) << image;
  }
  EXPECT_LT((keeper.now()->gyro_bias_rad_s - craft.bias).norm(), 0.05 * craft.bias.norm());
}

TEST(AttitudeKeeper, BridgesOneLostSampleAndForgetsAfterMore) {
  const Craft craft;
  for (const int lost : {1, 2}) {
    AttitudeKeeper keeper({});
    keeper.take(craft.frame(0.0));
    craft.feed(keeper, 0.0, 50.0);
    craft.feed(keeper, 50.0 + lost, 100.0);
    EXPECT_EQ(keeper.at(craft.at(100.0)).has_value(), lost == 1);
  }
  // Nor is anything known of times that are past, or long after the last sample.
  AttitudeKeeper keeper({});
  keeper.take(craft.frame(0.0));
  craft.feed(keeper, 0.0, 50.0);
  EXPECT_TRUE(keeper.at(craft.at(50.5)));
  EXPECT_FALSE(keeper.at(craft.at(40.0)));
  EXPECT_TRUE(keeper.now());
  EXPECT_FALSE(keeper.at(craft.at(53.0)));
  EXPECT_FALSE(keeper.now());
  EXPECT_EQ(keeper.take(craft.frame(100.0)).verdict, AttitudeVerdict::started);
}

// A frame that comes late, when the gyro is already further on.
TEST(AttitudeKeeper, PassesOverWhatIsPast) {
  const Craft craft;
  AttitudeKeeper keeper({});
  keeper.take(craft.frame(0.0));
  craft.feed(keeper, 0.0, 50.0);
  EXPECT_EQ(keeper.take(craft.frame(30.0)).verdict, AttitudeVerdict::not_now);
  EXPECT_TRUE(keeper.at(craft.at(50.0)));
  AttitudeKeeper late({});
  craft.feed(late, 0.0, 50.0);
  EXPECT_EQ(late.take(craft.frame(30.0)).verdict, AttitudeVerdict::started);
  EXPECT_FALSE(late.at(craft.at(50.0)));  // who knows how it turned from 30 to 49
}

// The gyro's bias jumps by ten times its sigma: one frame is gated, the next one says what the bias is now.
TEST(AttitudeKeeper, ComesBackFromAJumpOfTheBias) {
  Craft craft;
  AttitudeKeeper keeper({});
  keeper.take(craft.frame(0.0));
  for (int image = 1; image <= 10; ++image) {
    if (image == 5) craft.bias += Vec3(100.0, 0.0, 0.0) * kDegree / 3600.0;
    craft.feed(keeper, 100.0 * (image - 1), 100.0 * image);
    EXPECT_EQ(keeper.take(craft.frame(100.0 * image)).verdict,
              image == 5 ? AttitudeVerdict::gated : AttitudeVerdict::accepted)
        << image;
    if (image >= 6) {
      EXPECT_LT((keeper.now()->gyro_bias_rad_s - craft.bias).norm(), 1.0 * kDegree / 3600.0) << image;
    }
  }
}

// A frame that is solved wrongly leads astray for a while only.
TEST(AttitudeKeeper, ComesBackFromAWrongFrame) {
  const Craft craft;
  AttitudeKeeper keeper({});
  keeper.take(craft.frame(0.0));
  AttitudeVerdict verdict = AttitudeVerdict::started;
  for (int image = 1; image <= 12; ++image) {
    craft.feed(keeper, 100.0 * (image - 1), 100.0 * image);
    auto frame = craft.frame(100.0 * image);
    if (image == 5) frame.R_CN = rotation_exp(Vec3(1.0, -0.5, 0.3)) * frame.R_CN;
    verdict = keeper.take(frame).verdict;
    if (image == 5) {
      EXPECT_EQ(verdict, AttitudeVerdict::gated);
    }
    if (image > 9) {
      EXPECT_EQ(verdict, AttitudeVerdict::accepted) << image;
    }
  }
  EXPECT_LT((keeper.now()->gyro_bias_rad_s - craft.bias).norm(), 1.0 * kDegree / 3600.0);
}

TEST(AttitudeKeeper, RefusesWhatIsNoRotation) {
  const Craft craft;
  AttitudeKeeper keeper({});
  auto wrong = craft.frame(0.0);
  wrong.R_CN *= 2.0;
  EXPECT_EQ(keeper.take(wrong).verdict, AttitudeVerdict::bad_measurement);
  EXPECT_FALSE(keeper.now());
  keeper.take(craft.frame(0.0));
  craft.feed(keeper, 0.0, 10.0);
  wrong.epoch = craft.at(10.0);
  EXPECT_EQ(keeper.take(wrong).verdict, AttitudeVerdict::bad_measurement);
  EXPECT_TRUE(keeper.now());  // a broken frame is no reason to forget
}

}  // namespace
}  // namespace astronav::attitude
