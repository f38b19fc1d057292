// SPDX-License-Identifier: Apache-2.0
#include "onboard/executive/cold_start.h"

#include <algorithm>

#include <gtest/gtest.h>

#include "foundation/math/rotation.h"
#include "models/ephemeris/ecliptic.h"
#include "support/shipped_ephemeris.h"

namespace astronav::executive {
namespace {

ColdStartSettings settings_of(double fov_deg) {
  ColdStartSettings settings;
  settings.filter.camera = Intrinsics::from_field_of_view(1024, 1024, fov_deg * kDegree);
  return settings;
}

TEST(ColdStart, PicturesCoverTheEclipticButForTheSun) {
  const Ephemeris ephemeris = testing::shipped_ephemeris();
  ColdStart start(settings_of(20.0), ephemeris, nullptr);
  const Vec3 to_sun = rotation_exp(ecliptic_north_N() * 1.1) * Vec3::UnitX();
  ASSERT_TRUE(start.begin_survey(to_sun));
  const auto to_edge = [&](const Vec3& direction) {
    double least = kPi;
    for (int k = 0; k < start.pictures(); ++k) {
      const Mat3 R_CN = start.picture_R_CN(k);
      EXPECT_NEAR(R_CN.determinant(), 1.0, 1e-12);
      EXPECT_GT(angle_between(R_CN.row(2), to_sun), 38.0 * kDegree - 1e-9);
      least = std::min(least, angle_between(R_CN.row(2), direction));
    }
    return least;
  };
  for (double off = 38.0; off < 322.0; off += 1.0)
    EXPECT_LT(to_edge(rotation_exp(ecliptic_north_N() * off * kDegree) * to_sun), 9.01 * kDegree) << off;
  // 18 degrees: 12.5 of them while the rate is gathered and lost, in 50 s; the rest in 11 s; and a minute to settle.
  EXPECT_NEAR(start.picture_period().seconds(), 121.0, 1.0);
}

TEST(ColdStart, NarrowFieldsTakeTooManyPictures) {
  const Ephemeris ephemeris = testing::shipped_ephemeris();
  ColdStart start(settings_of(8.0), ephemeris, nullptr);
  const auto begun = start.begin_survey(Vec3::UnitX());
  ASSERT_FALSE(begun);
  EXPECT_EQ(begun.error().code, ErrorCode::limit_exceeded);
}

TEST(ColdStart, NothingSeenIsNoPlace) {
  const Ephemeris ephemeris = testing::shipped_ephemeris();
  ColdStart start(settings_of(20.0), ephemeris, nullptr);
  ASSERT_TRUE(start.begin_survey(Vec3::UnitX()));
  EXPECT_EQ(start.locate().error().code, ErrorCode::no_match);
  start.see_spots(start.picture_R_CN(0), Epoch::tdb_seconds(8e8), {});
  EXPECT_EQ(start.locate().error().code, ErrorCode::no_match);
  EXPECT_EQ(start.solve().error().code, ErrorCode::no_match);
}

}  // namespace
}  // namespace astronav::executive
