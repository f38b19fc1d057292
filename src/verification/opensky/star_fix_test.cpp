// SPDX-License-Identifier: Apache-2.0
#include "verification/opensky/star_fix.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include <gtest/gtest.h>

#include "foundation/math/random.h"
#include "foundation/math/rotation.h"
#include "foundation/math/statistics.h"
#include "models/aberration/aberration.h"
#include "models/ephemeris/ephemeris.h"

namespace astronav::opensky {
namespace {

constexpr double kStarScatter = 0.25 * kArcsecond;  // of a centroid, an axis
constexpr double kPlateScatter = 0.12 * kArcsecond;

Epoch start() {
  return Epoch::parse("2020-04-22T10:00:00 TDB").value();
}

Star star(double ra_deg, double dec_deg, double parallax_mas, double east_mas, double north_mas) {
  Star s;
  s.direction_N = direction_from_radec(ra_deg * kDegree, dec_deg * kDegree);
  s.parallax_rad = parallax_mas * kMilliarcsecond;
  s.pm_ra_cosdec_rad_yr = east_mas * kMilliarcsecond;
  s.pm_dec_rad_yr = north_mas * kMilliarcsecond;
  return s;
}
const std::vector<NearStar>& near_stars() {
  static const std::vector<NearStar> stars{{"one", star(217.4, -62.7, 768.0, -3780.0, 770.0)},
                                           {"two", star(164.1, 7.0, 415.0, -3870.0, -2700.0)},
                                           {"not in view", star(10.0, 40.0, 550.0, 0.0, 0.0)}};
  return stars;
}

struct Sky {
  State craft;  // in the middle of the frames
  std::vector<FixFrame> frames;
};

// Three frames of either star, hours apart: the star, thirty far ones, spots that only one frame has. The plate of each
// is a little off.
Sky look(RandomStream& random, bool aberration, int frames_each = 3) {
  // A single frame cannot tell a false spot from a star: then none may outshine the star.
  const double brightest_false = frames_each > 1 ? 9.0 : 7.0;
  Sky sky;
  sky.craft.p_m = Vec3(13.6, -42.0, -16.5) * kAstronomicalUnit;
  sky.craft.v_m_s = Vec3(5.4e3, -12e3, -4.6e3);
  const Epoch middle = start() + Duration::seconds(6 * 3600.0);
  for (std::size_t s = 0; s < 2; ++s) {
    const Vec3 home = star_direction(near_stars()[s].star, start(), sky.craft.p_m);
    std::vector<std::pair<Vec3, double>> far;
    for (int i = 0; i < 30; ++i)
      far.push_back({(home + 1.2e-3 * Vec3(random.normal(), random.normal(), random.normal())).normalized(),
                     std::exp(random.uniform(4.0, 7.0))});
    for (int k = 0; k < frames_each; ++k) {
      FixFrame frame;
      frame.epoch = start() + Duration::seconds(3600.0 * (k + 10.0 * static_cast<double>(s)));
      frame.plate = Intrinsics::from_field_of_view(256, 256, 0.29 * kDegree);
      frame.mirrored = s == 1;
      const RaDec aim = radec_from_direction((home + 3e-5 * Vec3(random.normal(), random.normal(), 0.0)).normalized());
      frame.R_CN = R_CN_from_pointing({aim.ra_rad, aim.dec_rad, random.uniform(0.0, 6.28)});
      const Mat3 truth =
          rotation_exp(kPlateScatter * Vec3(random.normal(), random.normal(), random.normal())) * frame.R_CN;
      const Vec3 here = sky.craft.p_m + sky.craft.v_m_s * (frame.epoch - middle).seconds();
      const Vec3 boresight = frame.R_CN.row(2).transpose();
      const auto see = [&](const Vec3& direction, double flux) {
        Vec3 seen = direction;
        if (aberration)
          seen += aberrate(direction, sky.craft.v_m_s) - direction - aberrate(boresight, sky.craft.v_m_s) + boresight;
        const auto pixel = project(frame.plate, truth * seen);
        if (!pixel || !frame.plate.contains(*pixel)) return;
        const double noise = kStarScatter * frame.plate.fx_px;
        vision::Centroid spot;
        spot.pixel = {pixel->u + noise * random.normal(), pixel->v + noise * random.normal()};
        if (frame.mirrored) spot.pixel.u = 255 - spot.pixel.u;
        spot.flux_dn = flux * (1.0 + 0.02 * random.normal());
        frame.spots.push_back(spot);
      };
      see(star_direction(near_stars()[s].star, frame.epoch, here), 2700.0);
      for (const auto& [direction, flux] : far) see(direction, flux);
      for (int i = 0; i < 20; ++i)
        see((home + 1.2e-3 * Vec3(random.normal(), random.normal(), random.normal())).normalized(),
            std::exp(random.uniform(4.0, brightest_false)));
      sky.frames.push_back(frame);
    }
  }
  return sky;
}

// 300 skies: the scatter that is measured is the scatter that was put in, and the fix is as good as it says. NEES (3
// degrees) in a band that a right program leaves once in 1000 times if it knew its sigmas; it measures them, which
// scatters chi-square by the share that their own uncertainty has, hence 10 % more.
TEST(StarFix, FindsItsPlaceAndKnowsHowWell) {
  RandomStream random(StreamId{.seed = 3, .purpose = "star fix"});
  constexpr int kRuns = 300;
  double nees = 0.0, chi2 = 0.0, star2 = 0.0, plate2 = 0.0;
  for (int run = 0; run < kRuns; ++run) {
    const Sky sky = look(random, true);
    StarFixSettings settings;
    settings.velocity_m_s = sky.craft.v_m_s;
    const auto fix = fix_by_near_stars(sky.frames, near_stars(), settings);
    ASSERT_TRUE(fix) << describe(fix.error());
    EXPECT_EQ(fix->sights.size(), 6u);
    const Vec3 error = fix->p_O_N - sky.craft.p_m;
    nees += error.dot(fix->covariance_m2.inverse() * error) / kRuns;
    chi2 += fix->chi2 / fix->degrees_of_freedom / kRuns;
    for (const FixField& field : fix->fields) {
      EXPECT_TRUE(field.measured);
      star2 += field.star_scatter_rad * field.star_scatter_rad / (2.0 * kRuns);
      plate2 += field.plate_scatter_rad * field.plate_scatter_rad / (2.0 * kRuns);
    }
  }
  EXPECT_NEAR(std::sqrt(star2) / kStarScatter, 1.0, 0.05);
  EXPECT_NEAR(std::sqrt(plate2) / kPlateScatter, 1.0, 0.1);
  const Band band = chi_square_mean_band(0.999, 3, kRuns);
  EXPECT_GT(nees, 0.9 * band.lo);
  EXPECT_LT(nees, 1.1 * band.hi);
  EXPECT_NEAR(chi2, 1.0, 0.1);
}

// Aberration and the way between the frames move a fix by less than its error, and are seen without noise.
TEST(StarFix, VelocityCountsALittle) {
  RandomStream random(StreamId{.seed = 4, .purpose = "star fix"});
  double with = 0.0, without = 0.0;
  for (int run = 0; run < 40; ++run) {
    const Sky sky = look(random, true);
    StarFixSettings settings;
    const auto plain = fix_by_near_stars(sky.frames, near_stars(), settings);
    settings.velocity_m_s = sky.craft.v_m_s;
    const auto fix = fix_by_near_stars(sky.frames, near_stars(), settings);
    ASSERT_TRUE(plain && fix);
    with += (fix->p_O_N - sky.craft.p_m).norm() / kAstronomicalUnit / 40;
    without += (plain->p_O_N - sky.craft.p_m).norm() / kAstronomicalUnit / 40;
    EXPECT_LT((plain->p_O_N - fix->p_O_N).norm(), 0.2 * kAstronomicalUnit);
  }
  EXPECT_LT(with, 0.5);
  EXPECT_LT(without, 0.55);
}

TEST(StarFix, SaysWhatIsMissing) {
  RandomStream random(StreamId{.seed = 5, .purpose = "star fix"});
  Sky sky = look(random, false);
  const std::vector<NearStar> one{near_stars()[0]};
  EXPECT_EQ(fix_by_near_stars(sky.frames, one).error().code, ErrorCode::no_match);
  EXPECT_EQ(fix_by_near_stars({}, near_stars()).error().code, ErrorCode::no_match);
  std::vector<NearStar> far = near_stars();
  far[1].star.parallax_rad = 0.0;
  EXPECT_EQ(fix_by_near_stars(sky.frames, far).error().code, ErrorCode::invalid_argument);
  // One frame of each tells no scatter: it must be said.
  const Sky two = look(random, false, 1);
  EXPECT_EQ(fix_by_near_stars(two.frames, near_stars()).error().code, ErrorCode::invalid_argument);
  StarFixSettings settings;
  settings.sight_sigma_rad = 0.5 * kArcsecond;
  const auto fix = fix_by_near_stars(two.frames, near_stars(), settings);
  ASSERT_TRUE(fix) << describe(fix.error());
  EXPECT_FALSE(fix->fields[0].measured);
  EXPECT_LT((fix->p_O_N - two.craft.p_m).norm(), 4.0 * std::sqrt(fix->covariance_m2.trace()));
}

}  // namespace
}  // namespace astronav::opensky
