// SPDX-License-Identifier: Apache-2.0
#include "models/ephemeris/refraction.h"

#include <cmath>

#include <erfa.h>
#include <gtest/gtest.h>

#include "foundation/math/random.h"
#include "foundation/math/rotation.h"

namespace astronav {
namespace {

// A star's way from its celestial place to the observed altitude and azimuth by ERFA (apco13 and atioq), which has the
// same law but one step of Newton's method, against ours: aberration by the observer's whole velocity, then refraction.
TEST(Refraction, AgreesWithErfaFromStarToObserver) {
  const GroundSite site{.latitude_rad = 0.8, .longitude_rad = -1.2, .height_m = 1500.0};
  const Epoch epoch = *Epoch::parse("2026-11-22T03:04:05 UTC");
  const Atmosphere air{.pressure_hpa = 850.0, .temperature_c = 5.0, .relative_humidity = 0.6, .wavelength_um = 0.6};
  const auto utc = epoch.julian_date(TimeScale::utc);
  eraASTROM star;
  double origins = 0.0;
  ASSERT_EQ(eraApco13(utc.jd1, utc.jd2, 0.0, site.longitude_rad, site.latitude_rad, site.height_m, 0.0, 0.0,
                      air.pressure_hpa, air.temperature_c, air.relative_humidity, air.wavelength_um, &star, &origins),
            0);
  const Vec3 zenith = ground_zenith(site, epoch);
  const Refraction refraction(air, zenith);
  RandomStream random(StreamId{.seed = 1, .purpose = "refraction"});
  int seen = 0;
  while (seen < 200) {
    const double ra = random.uniform(0.0, 2.0 * kPi), dec = std::asin(random.uniform(-1.0, 1.0));
    double intermediate_ra = 0.0, intermediate_dec = 0.0;
    eraAtciqz(ra, dec, &star, &intermediate_ra, &intermediate_dec);
    double azimuth = 0.0, zenith_distance = 0.0, hour_angle = 0.0, observed_dec = 0.0, observed_ra = 0.0;
    eraAtioq(intermediate_ra, intermediate_dec, &star, &azimuth, &zenith_distance, &hour_angle, &observed_dec,
             &observed_ra);
    if (zenith_distance > 80.0 * kDegree) continue;
    ++seen;
    // Aberration as ERFA has it: annual at the star's place, diurnal with the rotation.
    Vec3 apparent = direction_from_radec(intermediate_ra, intermediate_dec);
    const auto tt = epoch.julian_date(TimeScale::tt);
    double matrix[3][3];
    eraC2i06a(tt.jd1, tt.jd2, matrix);
    eraTrxp(matrix, apparent.data(), apparent.data());
    const Vec3 lifted = refraction.refract(apparent);
    // 0.3 arcsec of diurnal aberration are only in ERFA's.
    EXPECT_NEAR(angle_between(lifted, zenith), zenith_distance, 0.35 * kArcsecond) << zenith_distance / kDegree;
    EXPECT_LT(angle_between(refraction.unrefract(lifted), apparent), 1e-9 * kArcsecond);
    // Only up: the azimuth stays.
    EXPECT_LT(std::abs(lifted.dot(zenith.cross(apparent))), 1e-12);
  }
}

// The Astronomical Almanac's mean refraction: 58.2 arcsec at 45 degrees, 5.3 arcmin at 10 degrees of altitude (1010
// hPa, 10 degrees C).
TEST(Refraction, MeanRefraction) {
  const Refraction refraction({}, Vec3::UnitZ());
  const auto lift_at = [&](double seen_altitude_deg) {
    const double a = seen_altitude_deg * kDegree;
    const Vec3 seen(std::cos(a), 0.0, std::sin(a));
    return angle_between(seen, refraction.unrefract(seen)) / kArcsecond;
  };
  EXPECT_NEAR(lift_at(45.0), 58.2, 0.4);
  EXPECT_NEAR(lift_at(10.0), 318.0, 4.0);
  EXPECT_NEAR(lift_at(90.0), 0.0, 1e-9);
}

TEST(Refraction, NothingWithoutAirAndNothingWildBelowTheHorizon) {
  RandomStream random(StreamId{.seed = 2, .purpose = "refraction below"});
  const Refraction none({.pressure_hpa = 0.0}, Vec3::UnitZ()), air({}, Vec3::UnitZ());
  for (int i = 0; i < 500; ++i) {
    const Vec3 d = Vec3(random.normal(), random.normal(), random.normal()).normalized();
    EXPECT_LT(angle_between(none.refract(d), d), 1e-12);
    EXPECT_LT(angle_between(Refraction().refract(d), d), 1e-15);
    const Vec3 seen = air.refract(d);
    EXPECT_LT(angle_between(seen, d), 15.0 / 60.0 * kDegree);
    EXPECT_NEAR(seen.norm(), 1.0, 1e-14);
    EXPECT_LT(angle_between(air.unrefract(seen), d), 1e-6 * kArcsecond);
  }
}

TEST(Refraction, TheZenithIsUp) {
  // Away from the Earth's centre, but for the flattening: 11.5 arcmin at 45 degrees.
  const GroundSite site{.latitude_rad = 45.0 * kDegree, .longitude_rad = 0.3, .height_m = 0.0};
  const Epoch epoch = *Epoch::parse("2026-11-22T03:04:05 UTC");
  const Vec3 zenith = ground_zenith(site, epoch);
  EXPECT_NEAR(angle_between(zenith, ground_state(site, epoch).p_m), 11.5 / 60.0 * kDegree, 0.1 / 60.0 * kDegree);
  GroundSite higher = site;
  higher.height_m = 1000.0;
  EXPECT_LT(angle_between(ground_state(higher, epoch).p_m - ground_state(site, epoch).p_m, zenith), 1e-9);
}

}  // namespace
}  // namespace astronav
