// SPDX-License-Identifier: Apache-2.0
// What the exposure control expects of an exposure is what rendered frames give, and its choice follows from it. The
// short form of benchmarks/accuracy/exposure.cpp. Every draw has a fixed seed.
#include <gtest/gtest.h>

#include "benchmarks/accuracy/exposure_ladder.h"

namespace astronav::accuracy {
namespace {

ExposureLadder& ladder() {
  static ExposureLadder instance;
  return instance;
}

TEST(Exposure, ForecastIsWhatComes) {
  double measured2 = 0.0, expected2 = 0.0;
  int windows = 0;
  for (const double v_mag : {-3.5, 0.0, 4.0}) {
    for (const double exposure_s : {0.4, 0.1, 0.025}) {
      const ExposureRow row = ladder().window(windows, v_mag, exposure_s, 8);
      ASSERT_GE(row.images, 7) << v_mag << " " << exposure_s;
      const double once = std::hypot(row.expected.planet.sigma_px, row.expected.attitude_px);
      // 14 degrees of freedom: a true forecast leaves this interval once in 4000 windows.
      EXPECT_GT(row.scatter_px, 0.45 * once) << v_mag << " " << exposure_s;
      EXPECT_LT(row.scatter_px, 1.75 * once) << v_mag << " " << exposure_s;
      measured2 += std::pow(row.scatter_px / once, 2);
      expected2 += 1.0;
      ++windows;
    }
  }
  // 126 degrees of freedom.
  EXPECT_GT(measured2, 0.65 * expected2);
  EXPECT_LT(measured2, 1.45 * expected2);
}

TEST(Exposure, BrightPlanetsAreExposedLessThanFaintOnes) {
  const vision::ExposureForecast mars_nearby = ladder().choose(1, -5.0), saturn = ladder().choose(1, 1.0),
                                 uranus = ladder().choose(1, 5.7);
  EXPECT_LT(mars_nearby.exposure_s, uranus.exposure_s);
  EXPECT_LE(mars_nearby.exposure_s, saturn.exposure_s);
  EXPECT_GT(saturn.exposure_s, 0.1);
  EXPECT_EQ(uranus.exposure_s, 0.4);
  EXPECT_GT(mars_nearby.stars, 40);
}

// Each spot of the forecast is the flight software's own fit: an unsaturated one at the photon limit.
TEST(Exposure, SpotForecastIsThePhotonLimit) {
  vision::SensorModel sensor;
  sensor.gain_e_dn = 10.0;
  sensor.saturation_dn = 60000.0;
  sensor.halo_fraction = 1e-4;
  sensor.psf_shape_relative = sensor.photo_nonuniformity = 0.0;
  sensor.psf_sigma_relative = 1e-4;
  sensor.halo_offset_px = 1e-3;
  const vision::LocalPsf psf = vision::LocalPsf::from(sensor);
  const double flux_dn = 20000.0;
  const vision::SpotForecast spot = vision::forecast_spot(sensor, psf, flux_dn, 0.01);
  ASSERT_TRUE(spot.measured);
  EXPECT_FALSE(spot.saturated);
  // sigma / sqrt(electrons) for a Gaussian that is sampled finely; pixels of the core's width cost a few percent.
  const double limit = sensor.psf_sigma_px / std::sqrt(flux_dn * sensor.gain_e_dn);
  EXPECT_GT(spot.sigma_px, limit);
  EXPECT_LT(spot.sigma_px, 1.12 * limit);
  EXPECT_FALSE(vision::forecast_spot(sensor, psf, 1e15, 0.01).measured);  // a core wider than any fit
}

}  // namespace
}  // namespace astronav::accuracy
