// SPDX-License-Identifier: Apache-2.0
// The DE405 that ships with the program against JPL's DE440, 2023 to 2025: the differences of the ephemerides
// themselves (Park et al. 2021), nothing of ours.
#include <algorithm>

#include <gtest/gtest.h>

#include "foundation/files/mapped_file.h"
#include "models/ephemeris/ephemeris.h"
#include "support/shared_data.h"

namespace astronav {
namespace {

struct Limit {
  BodyId target;
  BodyId center;
  double km;
  double mm_s;
};

constexpr Limit kLimits[] = {
    {body::mercury, body::sun, 2.3, 2.5},
    {body::venus, body::sun, 1.2, 0.4},
    {body::earth_moon_barycenter, body::sun, 1.6, 0.3},
    {body::mars_barycenter, body::sun, 1.8, 0.2},
    {body::jupiter_barycenter, body::sun, 205.0, 3.4},
    {body::saturn_barycenter, body::sun, 250.0, 2.2},
    {body::uranus_barycenter, body::sun, 2780.0, 6.9},
    {body::neptune_barycenter, body::sun, 7750.0, 11.6},
    {body::moon, body::earth, 0.02, 0.05},
    // The barycentre itself moved by 116 km: DE440 counts the mass beyond Neptune.
    {body::sun, body::solar_system_barycenter, 116.0, 0.02},
    {body::earth, body::solar_system_barycenter, 116.0 + 1.6, 0.32},
};

TEST(EphemerisAgainstDe440, De405DiffersByWhatIsKnown) {
  const auto path = ASTRONAV_SHARED_DATA("ephemeris/de440s_excerpt_20221231_20260104.bsp");
  const auto truth_file = MappedFile::open(path);
  const auto our_file = MappedFile::open(home_directory() / "data/de405_2000_2050.bsp");
  ASSERT_TRUE(truth_file && our_file);
  const auto truth = Ephemeris::open(truth_file->bytes());
  const auto ours = Ephemeris::open(our_file->bytes());
  ASSERT_TRUE(truth && ours);
  for (const Limit& limit : kLimits) {
    double worst_km = 0.0, worst_mm_s = 0.0;
    for (double day = 0.0; day < 1095.0; day += 0.7) {
      const Epoch epoch = Epoch::parse("2023-01-01 TDB").value() + Duration::days(day);
      const auto a = ours->state(limit.target, limit.center, epoch);
      const auto b = truth->state(limit.target, limit.center, epoch);
      ASSERT_TRUE(a && b);
      worst_km = std::max(worst_km, (a->p_m - b->p_m).norm() / 1e3);
      worst_mm_s = std::max(worst_mm_s, (a->v_m_s - b->v_m_s).norm() * 1e3);
    }
    EXPECT_LE(worst_mm_s, limit.mm_s) << limit.target.value;
    EXPECT_GT(worst_km, 0.1 * limit.km) << limit.target.value << ": suspiciously alike";
  }
}

// The interfaces promise 2000 to 2050; the file reaches a little farther on both sides.
TEST(EphemerisAgainstDe440, TheFileThatShipsCoversItsYears) {
  const auto file = MappedFile::open(home_directory() / "data/de405_2000_2050.bsp");
  ASSERT_TRUE(file);
  const auto ephemeris = Ephemeris::open(file->bytes());
  ASSERT_TRUE(ephemeris);
  for (const char* text : {"1999-12-15 TDB", "2026-11-09 TDB", "2051-01-15 TDB"}) {
    const Epoch epoch = Epoch::parse(text).value();
    for (const int id : {199, 299, 399, 301, 499, 599, 699, 799, 899, 999, 10, 1, 2, 3, 4, 5, 6, 7, 8, 9}) {
      const auto state = ephemeris->state(BodyId{id}, body::solar_system_barycenter, epoch);
      EXPECT_TRUE(state) << id << " " << text << " " << describe(state.error());
    }
  }
}

}  // namespace
}  // namespace astronav
