// SPDX-License-Identifier: Apache-2.0
#include "simulator/motion/turn.h"

#include <algorithm>

#include <gtest/gtest.h>

#include "foundation/math/rotation.h"

namespace astronav::motion {
namespace {

// What a perfect gyro says, summed up sample by sample, ends where the turn ends.
TEST(Turn, RatesSumUpToTheTurn) {
  const Epoch begin = Epoch::tdb_seconds(8e8), end = begin + Duration::seconds(1600.0);
  const Mat3 from = rotation_exp(Vec3(0.3, -1.0, 0.2)), to = rotation_exp(Vec3(-1.2, 0.4, 2.0)) * from;
  const Turn turn(begin, from, end, to);
  EXPECT_LT((turn.R_BN(begin) - from).norm(), 1e-15);
  EXPECT_LT((turn.R_BN(end) - to).norm(), 1e-14);
  Mat3 R = from;
  double fastest = 0.0;
  for (int k = 0; k < 1600; ++k) {
    const Vec3 rate = turn.mean_rate_rad_s(begin + Duration::seconds(k), begin + Duration::seconds(k + 1.0));
    fastest = std::max(fastest, rate.norm());
    R = rotation_exp(-rate) * R;
    if (k == 799) {
      EXPECT_LT((R - turn.R_BN(begin + Duration::seconds(800.0))).norm(), 1e-12);
    }
  }
  EXPECT_LT((R - to).norm(), 1e-12);
  const double angle = rotation_log(to * from.transpose()).norm();
  EXPECT_NEAR(fastest, 1.875 * angle / 1600.0, 1e-4 * angle / 1600.0);
}

TEST(Turn, IsAtRestWhereAPictureIsTaken) {
  const Epoch begin = Epoch::tdb_seconds(8e8), end = begin + Duration::seconds(100.0);
  const Turn turn(begin, Mat3::Identity(), end, rotation_exp(Vec3(1.0 * kDegree, 0.0, 0.0)));
  const Duration half = Duration::seconds(0.5);
  // A second's exposure, half of it before the turn: 5 milliarcsec.
  EXPECT_LT(rotation_log(turn.R_BN(begin + half)).norm(), 0.01 * kArcsecond);
  EXPECT_EQ(turn.R_BN(begin - half), turn.R_BN(begin));
  EXPECT_EQ(turn.R_BN(end + half), turn.R_BN(end));
}

}  // namespace
}  // namespace astronav::motion
