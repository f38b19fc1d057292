// SPDX-License-Identifier: Apache-2.0
// Spots in pictures that are made here, so that every star's place is known.
#include "verification/opensky/spots.h"

#include <cmath>
#include <limits>
#include <vector>

#include <gtest/gtest.h>

#include "foundation/math/random.h"

namespace astronav::opensky {
namespace {

struct Light {
  Pixel pixel;
  double flux_dn;
};

// A sky that grows brighter to the right, noise, and stars of 1.3 pixels.
Picture sky_with(const std::vector<Light>& lights, int width, int height, double noise_dn, int bits) {
  RandomStream random({.seed = 4, .purpose = "spots_test"});
  Picture picture;
  picture.pixels = ImageF(width, height);
  picture.bits = bits;
  picture.white_level = std::exp2(bits) - 1.0;
  constexpr double kSigma = 1.3;
  for (int v = 0; v < height; ++v) {
    for (int u = 0; u < width; ++u) {
      double x = 40.0 + 60.0 * u / width + noise_dn * random.normal();
      for (const Light& light : lights) {
        const double d2 = std::pow(u - light.pixel.u, 2) + std::pow(v - light.pixel.v, 2);
        if (d2 < 200.0) x += light.flux_dn / (2.0 * kPi * kSigma * kSigma) * std::exp(-0.5 * d2 / (kSigma * kSigma));
      }
      picture.pixels(u, v) = static_cast<float>(std::clamp(std::floor(x + 0.5), 0.0, picture.white_level));
    }
  }
  return picture;
}

std::vector<Light> some_stars(int count, double least_dn, double largest_dn) {
  RandomStream random({.seed = 5, .purpose = "spots_test places"});
  std::vector<Light> lights;
  while (static_cast<int>(lights.size()) < count) {
    const Light light{{random.uniform(20.0, 380.0), random.uniform(20.0, 280.0)},
                      least_dn * std::pow(largest_dn / least_dn, random.uniform())};
    bool alone = true;
    for (const Light& other : lights) alone &= (other.pixel.vec() - light.pixel.vec()).norm() > 15.0;
    if (alone) lights.push_back(light);
  }
  return lights;
}

const vision::Centroid* nearest(const Spots& spots, Pixel p) {
  const vision::Centroid* best = nullptr;
  for (const vision::Centroid& s : spots.spots) {
    if (best == nullptr || (s.pixel.vec() - p.vec()).norm() < (best->pixel.vec() - p.vec()).norm()) best = &s;
  }
  return best;
}

TEST(FindSpots, FindsEveryStarOnAnUnevenSkyAndLittleElse) {
  const auto stars = some_stars(40, 160.0, 4000.0);
  const Spots found = find_spots(sky_with(stars, 400, 300, 3.0, 12));
  double squares = 0.0;
  for (const Light& star : stars) {
    const vision::Centroid* spot = nearest(found, star.pixel);
    ASSERT_NE(spot, nullptr);
    const double off = (spot->pixel.vec() - star.pixel.vec()).norm();
    EXPECT_LT(off, 0.8);
    EXPECT_NEAR(spot->flux_dn, star.flux_dn, 0.15 * star.flux_dn + 60.0);
    squares += off * off;
  }
  EXPECT_LT(std::sqrt(squares / static_cast<double>(stars.size())), 0.25);
  // Five sigma in 120,000 pixels: less than one by chance.
  EXPECT_LE(found.spots.size(), stars.size() + 2);
  EXPECT_NEAR(found.noise_dn, 3.3, 0.2);  // of the pixels, and of the slope within a tile
  EXPECT_NEAR(found.background_dn, 70.0, 3.0);
}

TEST(FindSpots, TheMostCertainComeFirst) {
  const auto stars = some_stars(30, 160.0, 6000.0);
  const Spots found = find_spots(sky_with(stars, 400, 300, 3.0, 12));
  ASSERT_GE(found.spots.size(), 30u);
  double first = 0.0, last = 0.0;
  for (int k = 0; k < 10; ++k) {
    first += found.spots[static_cast<std::size_t>(k)].flux_dn;
    last += found.spots[static_cast<std::size_t>(20 + k)].flux_dn;
  }
  EXPECT_GT(first, 4.0 * last);
}

TEST(FindSpots, HotPixelsAndHolesAreNoSpots) {
  Picture picture = sky_with({{{200.0, 150.0}, 3000.0}}, 400, 300, 3.0, 12);
  picture.pixels(100, 100) = 3000.0f;
  picture.pixels(300, 50) = std::numeric_limits<float>::quiet_NaN();
  picture.pixels(50, 250) = std::numeric_limits<float>::infinity();
  const Spots found = find_spots(picture);
  ASSERT_EQ(found.spots.size(), 1u);
  EXPECT_NEAR(found.spots[0].pixel.u, 200.0, 0.2);
  EXPECT_NEAR(found.spots[0].pixel.v, 150.0, 0.2);
}

// More hot pixels than spots are kept, brighter than any star: the stars come through.
TEST(FindSpots, ManyHotPixelsCrowdNoStarOut) {
  const auto stars = some_stars(40, 300.0, 4000.0);
  Picture picture = sky_with(stars, 400, 300, 3.0, 12);
  RandomStream random({.seed = 6, .purpose = "spots_test hot"});
  for (int k = 0; k < 60; ++k)
    picture.pixels(static_cast<int>(random.uniform(0.0, 400.0)), static_cast<int>(random.uniform(0.0, 300.0))) =
        4000.0f;
  SpotSettings settings;
  settings.max_spots = 45;
  const Spots found = find_spots(picture, settings);
  int seen = 0;
  for (const Light& star : stars) {
    const vision::Centroid* spot = nearest(found, star.pixel);
    seen += spot != nullptr && (spot->pixel.vec() - star.pixel.vec()).norm() < 1.0;
  }
  EXPECT_GE(seen, 35);
}

// Whole numbers are whole numbers, whatever they are stored as.
TEST(FindSpots, FloatingPicturesOfGreyLevelsAreReadAsThose) {
  const auto stars = some_stars(40, 160.0, 4000.0);
  const Picture whole = sky_with(stars, 400, 300, 0.05, 12);
  Picture floating = whole;
  floating.bits = 32;
  const Spots a = find_spots(whole), b = find_spots(floating);
  ASSERT_EQ(a.spots.size(), b.spots.size());
  EXPECT_EQ(a.noise_dn, b.noise_dn);
  EXPECT_EQ(a.threshold_dn, b.threshold_dn);
  for (float& value : floating.pixels.pixels()) value /= 65535.0f;
  EXPECT_NEAR(static_cast<double>(find_spots(floating).spots.size()), static_cast<double>(a.spots.size()), 2.0);
}

TEST(FindSpots, SaysWhatIsSaturated) {
  const Spots found = find_spots(sky_with({{{100.0, 150.0}, 6000.0}, {{300.0, 150.0}, 500.0}}, 400, 300, 2.0, 8));
  ASSERT_EQ(found.spots.size(), 2u);
  EXPECT_TRUE(found.spots[0].saturated);
  EXPECT_FALSE(found.spots[1].saturated);
}

// A picture whose level everywhere is one grey has noise only of its rounding; small and empty ones are no mistake.
TEST(FindSpots, FlatAndTinyPicturesHoldNothing) {
  Picture flat;
  flat.pixels = ImageF(256, 256, 17.0f);
  flat.bits = 8;
  flat.white_level = 255.0;
  EXPECT_TRUE(find_spots(flat).spots.empty());
  flat.pixels = ImageF(5, 300, 17.0f);
  EXPECT_TRUE(find_spots(flat).spots.empty());
  flat.pixels = ImageF();
  EXPECT_TRUE(find_spots(flat).spots.empty());
}

}  // namespace
}  // namespace astronav::opensky
