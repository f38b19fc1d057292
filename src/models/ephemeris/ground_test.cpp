// SPDX-License-Identifier: Apache-2.0
#include "models/ephemeris/ground.h"

#include <cmath>

#include <gtest/gtest.h>

namespace astronav {
namespace {

// astropy 5.2, EarthLocation.from_geodetic(16.043 E, 78.148 N, 100 m).get_gcrs_posvel at 2020-12-11T20:09:36 UTC, with
// its IERS tables: UT1-UTC and polar motion make the difference (at 78 degrees 0.2 s are 20 m).
TEST(Ground, AgreesWithAstropy) {
  const GroundSite site{78.148 * kDegree, 16.043 * kDegree, 100.0};
  const State state = ground_state(site, Epoch::parse("2020-12-11T20:09:36 UTC").value());
  EXPECT_LT((state.p_m - Vec3(1031285.5, 830134.8, 6218396.9)).norm(), 60.0);
  EXPECT_LT((state.v_m_s - Vec3(-60.5338, 74.2950, 0.1211)).norm(), 0.01);
}

TEST(Ground, VelocityIsTheDerivative) {
  const GroundSite site{-31.0 * kDegree, 200.0 * kDegree, 2000.0};
  const Epoch epoch = Epoch::parse("2028-03-01 UTC").value();
  const Duration h = Duration::seconds(10.0);
  const Vec3 slope = (ground_state(site, epoch + h).p_m - ground_state(site, epoch - h).p_m) / 20.0;
  EXPECT_LT((slope - ground_state(site, epoch).v_m_s).norm(), 1e-3);
}

}  // namespace
}  // namespace astronav
