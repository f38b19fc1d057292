// SPDX-License-Identifier: Apache-2.0
#include "models/stars/catalogue.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "foundation/files/mapped_file.h"
#include "foundation/math/random.h"
#include "foundation/math/rotation.h"
#include "models/stars/format.h"
#include "models/stars/writer.h"

namespace astronav {
namespace {

std::span<const std::byte> bytes_of(const std::string& s) {
  return std::as_bytes(std::span(s));
}

Vec3 random_direction(RandomStream& random) {
  return Vec3(random.normal(), random.normal(), random.normal()).normalized();
}

std::vector<Star> random_stars(int count) {
  RandomStream random(StreamId{.seed = 7, .purpose = "catalogue test"});
  std::vector<Star> stars;
  for (int i = 0; i < count; ++i) {
    Star star;
    star.id = static_cast<std::uint32_t>(i + 1);
    star.direction_N = random_direction(random);
    star.pm_ra_cosdec_rad_yr = random.normal() * 100 * kMilliarcsecond;
    star.pm_dec_rad_yr = random.normal() * 100 * kMilliarcsecond;
    star.parallax_rad = random.normal(5, 5) * kMilliarcsecond;
    star.v_mag = static_cast<float>(random.uniform(-1, 12));
    star.b_v = i % 10 == 0 ? std::numeric_limits<float>::quiet_NaN() : static_cast<float>(random.uniform(-0.3, 2));
    stars.push_back(star);
  }
  return stars;
}

std::string written(const std::vector<Star>& stars) {
  return write_star_catalogue(stars, "random").value();
}

void set_checksum(std::string& file) {
  const std::uint32_t crc = star_file::crc32(bytes_of(file).subspan(star_file::kChecksummedFrom));
  std::memcpy(file.data() + offsetof(star_file::Header, crc32), &crc, sizeof(crc));
}

TEST(StarFile, ChecksumIsTheOneOfTheStandard) {
  EXPECT_EQ(star_file::crc32(bytes_of("123456789")), 0xCBF43926u);  // the check value of CRC-32/ISO-HDLC
  EXPECT_EQ(star_file::crc32(bytes_of("")), 0u);
}

TEST(StarCatalogue, GivesBackWhatWasWritten) {
  const auto stars = random_stars(5000);
  const std::string file = written(stars);
  const auto catalogue = StarCatalogue::open(bytes_of(file));
  ASSERT_TRUE(catalogue) << describe(catalogue.error());
  ASSERT_EQ(catalogue->size(), stars.size());
  EXPECT_EQ(catalogue->source(), "random");
  std::vector<bool> seen(stars.size());
  for (std::size_t i = 0; i < catalogue->size(); ++i) {
    const Star star = catalogue->star(i);
    const Star& truth = stars[star.id - 1];
    EXPECT_FALSE(seen[star.id - 1]);
    seen[star.id - 1] = true;
    EXPECT_LT(angle_between(star.direction_N, truth.direction_N), 0.1 * kMilliarcsecond);
    EXPECT_NEAR(star.pm_ra_cosdec_rad_yr, truth.pm_ra_cosdec_rad_yr, 0.0051 * kMilliarcsecond);
    EXPECT_NEAR(star.pm_dec_rad_yr, truth.pm_dec_rad_yr, 0.0051 * kMilliarcsecond);
    EXPECT_NEAR(star.parallax_rad, truth.parallax_rad, 0.0051 * kMilliarcsecond);
    EXPECT_NEAR(star.v_mag, truth.v_mag, 0.00051);
    EXPECT_EQ(std::isnan(star.b_v), std::isnan(truth.b_v));
    if (!std::isnan(truth.b_v)) {
      EXPECT_NEAR(star.b_v, truth.b_v, 0.00051);
    }
  }
  EXPECT_EQ(catalogue->star(*catalogue->find(42)).id, 42u);
  EXPECT_FALSE(catalogue->find(5001));
}

TEST(StarCatalogue, DoesNotDependOnTheOrderOfTheStars) {
  auto stars = random_stars(2000);
  const std::string file = written(stars);
  std::reverse(stars.begin(), stars.end());
  EXPECT_EQ(written(stars), file);
}

TEST(StarCatalogue, EmptyCatalogueIsACatalogue) {
  const std::string file = written({});
  const auto catalogue = StarCatalogue::open(bytes_of(file));
  ASSERT_TRUE(catalogue);
  EXPECT_EQ(catalogue->size(), 0u);
  EXPECT_EQ(catalogue->cone(Vec3::UnitX(), kPi, 99, {}), 0u);
}

TEST(StarCatalogue, WriterRefusesWhatTheFormatCannotHold) {
  auto stars = random_stars(3);
  stars[1].v_mag = 40;
  EXPECT_FALSE(write_star_catalogue(stars, ""));
  stars = random_stars(3);
  stars[2].direction_N = Vec3::Constant(std::nan(""));
  const auto refused = write_star_catalogue(stars, "");
  ASSERT_FALSE(refused);
  EXPECT_NE(describe(refused.error()).find("star 3"), std::string::npos);
}

TEST(StarCatalogue, ConeFindsExactlyWhatAFullSearchFinds) {
  const auto stars = random_stars(20000);
  const std::string file = written(stars);
  const auto catalogue = StarCatalogue::open(bytes_of(file)).value();
  RandomStream random(StreamId{.seed = 8, .purpose = "cone test"});
  std::vector<std::uint32_t> out(stars.size());
  std::size_t total = 0;
  for (int k = 0; k < 300; ++k) {
    // From arcseconds to the whole sphere, also around the stars themselves, poles and edges of the cells' cube.
    const Vec3 special[] = {random_direction(random), catalogue.star(random() % catalogue.size()).direction_N,
                            Vec3::UnitZ(), Vec3(1, 1, 0).normalized(), Vec3(-1, 1, -1).normalized()};
    const Vec3 center = special[k % 5];
    const double radius = k % 7 == 0 ? kPi - random.uniform() * 1e-3 : kPi * std::pow(10.0, random.uniform(-5.5, 0.0));
    const double max_v = random.uniform(-1, 13);
    std::vector<std::uint32_t> expected;
    for (std::uint32_t i = 0; i < catalogue.size(); ++i) {
      const Star star = catalogue.star(i);
      if (star.v_mag <= max_v && angle_between(star.direction_N, center) <= radius) expected.push_back(i);
    }
    const std::size_t count = catalogue.cone(center, radius, max_v, out);
    ASSERT_EQ(count, expected.size()) << "radius " << radius;
    EXPECT_TRUE(std::equal(expected.begin(), expected.end(), out.begin()));
    total += count;
  }
  EXPECT_GT(total, 10000u);
}

TEST(StarCatalogue, ConeTellsHowManyThereAreThoughTheyDoNotFit) {
  const std::string file = written(random_stars(1000));
  const auto catalogue = StarCatalogue::open(bytes_of(file)).value();
  std::vector<std::uint32_t> out(11, 77777u);
  EXPECT_EQ(catalogue.cone(Vec3::UnitY(), kPi, 99.0, std::span(out).first(10)), 1000u);
  EXPECT_EQ(out[10], 77777u);
  EXPECT_EQ(catalogue.cone(Vec3::UnitY(), kPi, -2.0, out), 0u);
}

TEST(StarCatalogue, MagnitudeLimitIncludesTheLimit) {
  Star star;
  star.v_mag = 7.0f;
  const std::string file = written({star});
  const auto catalogue = StarCatalogue::open(bytes_of(file)).value();
  EXPECT_EQ(catalogue.cone(Vec3::UnitZ(), 0.1, 7.0, {}), 1u);
  EXPECT_EQ(catalogue.cone(Vec3::UnitZ(), 0.1, 6.999, {}), 0u);
}

TEST(StarCatalogue, RefusesEveryTruncationAndEveryChangedByte) {
  const std::string file = written(random_stars(20));
  for (std::size_t size = 0; size < file.size(); ++size) {
    EXPECT_FALSE(StarCatalogue::open(bytes_of(file).first(size))) << size;
  }
  EXPECT_FALSE(StarCatalogue::open(bytes_of(file + "x")));
  for (std::size_t i = 0; i < file.size(); ++i) {
    for (const char flip : {'\x01', '\x80', '\xff'}) {
      std::string broken = file;
      broken[i] = static_cast<char>(broken[i] ^ flip);
      EXPECT_FALSE(StarCatalogue::open(bytes_of(broken))) << "byte " << i;
    }
  }
}

// A hostile file has a right checksum. Whatever opens must be safe to use and must keep the promises of the format.
TEST(StarCatalogue, HostileFilesWithARightChecksumAreRefusedOrSafe) {
  const std::string file = written(random_stars(20));
  RandomStream random(StreamId{.seed = 9, .purpose = "mutations"});
  std::uint32_t out[64];
  int refused = 0;
  constexpr int kMutations = 20000;
  for (int k = 0; k < kMutations; ++k) {
    std::string broken = file;
    for (std::uint64_t n = 1 + random() % 4; n > 0; --n) {
      broken[random() % broken.size()] = static_cast<char>(random());
    }
    set_checksum(broken);
    const auto catalogue = StarCatalogue::open(bytes_of(broken));
    if (!catalogue) {
      ++refused;
      continue;
    }
    ASSERT_EQ(catalogue->size(), 20u);
    for (std::size_t i = 0; i < catalogue->size(); ++i) {
      ASSERT_NEAR(catalogue->star(i).direction_N.norm(), 1.0, 1e-12);
    }
    ASSERT_EQ(catalogue->cone(random_direction(random), kPi, 40.0, out), 20u);
  }
  EXPECT_GT(refused, kMutations / 2);  // most bytes belong to directions, caps and order
}

TEST(StarCatalogue, SaysAtWhichByteAFileIsBroken) {
  const std::string file = written(random_stars(20));
  const auto catalogue = StarCatalogue::open(bytes_of(file)).value();
  ASSERT_EQ(catalogue.size(), 20u);
  const auto message = [](std::string broken) {
    set_checksum(broken);
    return describe(StarCatalogue::open(bytes_of(broken)).error());
  };
  std::uint32_t cells = 0;
  std::memcpy(&cells, file.data() + 20, 4);

  std::string broken = file;
  broken[64 + 31] = '\x40';  // the exponent of the cosine of the first cell's radius
  EXPECT_NE(message(broken).find("cell at byte 64"), std::string::npos) << message(broken);
  broken = file;
  broken[64 + 40] = 3;  // its first star
  EXPECT_NE(message(broken).find("cell at byte 64"), std::string::npos) << message(broken);
  const std::size_t star = 64 + 48 * std::size_t{cells} + 32 * 5;
  broken = file;
  broken[star + 7] = static_cast<char>(broken[star + 7] ^ 0x20);  // high byte of a direction
  EXPECT_NE(message(broken).find("star at byte " + std::to_string(star)), std::string::npos) << message(broken);
}

TEST(StarCatalogue, ShippedFileHoldsHipparcos) {
  const auto file = MappedFile::open(home_directory() / "data/hipparcos.stars");
  ASSERT_TRUE(file) << describe(file.error());
  EXPECT_LE(file->bytes().size(), 4'600'000u);
  const auto catalogue = StarCatalogue::open(file->bytes());
  ASSERT_TRUE(catalogue) << describe(catalogue.error());
  EXPECT_EQ(catalogue->size(), 118716u);  // 118,215 numbers, and 501 far components of double stars
  const Star sirius = catalogue->star(*catalogue->find(32349));
  EXPECT_FLOAT_EQ(sirius.v_mag, -1.44f);
  EXPECT_NEAR(sirius.parallax_rad / kMilliarcsecond, 379.21, 1.0);
  std::vector<std::uint32_t> out(1);
  EXPECT_EQ(catalogue->cone(Vec3::UnitX(), kPi, -1.0, out), 1u);
  EXPECT_EQ(catalogue->star(out[0]).id, 32349u);
}

// erfa.pmpx(ra, dec, pm_ra / cos(dec), pm_dec, px, 0.0, years, observer_au) of pyerfa 2.0.0.1, angles in radians, px in
// arcseconds: motion, parallax and Roemer's effect.
TEST(StarDirection, AgreesWithErfa) {
  struct Case {
    const char* name;
    double ra_deg, dec_deg, pm_ra_mas, pm_dec_mas, parallax_mas, years;
    Vec3 observer_au, direction;
  };
  const Case cases[] = {
      {"barnard",
       269.452,
       4.6933,
       -798.58,
       10328.12,
       548.31,
       -8.75,
       {0.0, 0.0, 0.0},
       {-0.0094986559338621, -0.9966374513431178, 0.0813852942228791}},
      {"barnard",
       269.452,
       4.6933,
       -798.58,
       10328.12,
       548.31,
       28.7,
       {1.2, -0.7, 0.3},
       {-0.0096453732999780, -0.9964817224507553, 0.0832534899897884}},
      {"barnard",
       269.452,
       4.6933,
       -798.58,
       10328.12,
       548.31,
       50.0,
       {-20.0, 35.0, 10.0},
       {-0.0096697343684139, -0.9963949615086517, 0.0842827201590993}},
      {"polaris",
       37.9545,
       89.2641,
       44.48,
       -11.85,
       7.54,
       -8.75,
       {0.0, 0.0, 0.0},
       {0.0101278760155665, 0.0078974267869392, 0.9999175249877152}},
      {"polaris",
       37.9545,
       89.2641,
       44.48,
       -11.85,
       7.54,
       28.7,
       {1.2, -0.7, 0.3},
       {0.0101245616221311, 0.0079051434661126, 0.9999174975760450}},
      {"alpha cen",
       219.9021,
       -60.834,
       -3679.25,
       473.67,
       754.81,
       28.7,
       {1.2, -0.7, 0.3},
       {-0.3742362248675853, -0.3122597980102830, -0.8731787139775198}},
      {"alpha cen",
       219.9021,
       -60.834,
       -3679.25,
       473.67,
       754.81,
       50.0,
       {-20.0, 35.0, 10.0},
       {-0.3744190372021136, -0.3121129582372430, -0.8731528422223908}},
      {"far",
       10.0,
       -88.5,
       -300.0,
       200.0,
       0.0,
       50.0,
       {-20.0, 35.0, 10.0},
       {0.0258396178655509, 0.0044823781359110, -0.9996560520673143}},
  };
  for (const Case& c : cases) {
    Star star;
    star.direction_N = direction_from_radec(c.ra_deg * kDegree, c.dec_deg * kDegree);
    star.pm_ra_cosdec_rad_yr = c.pm_ra_mas * kMilliarcsecond;
    star.pm_dec_rad_yr = c.pm_dec_mas * kMilliarcsecond;
    star.parallax_rad = c.parallax_mas * kMilliarcsecond;
    const Vec3 d = star_direction(star, Epoch::tdb_seconds(c.years * 365.25 * 86400.0), c.observer_au * 149597870700.0);
    EXPECT_LT(angle_between(d, c.direction), 1e-12) << c.name << " " << c.years;
  }
}

TEST(StarDirection, NegativeParallaxIsNone) {
  Star star = random_stars(1)[0];
  star.parallax_rad = -10 * kMilliarcsecond;
  Star far = star;
  far.parallax_rad = 0;
  const Vec3 observer(2e11, -1e11, 3e10);
  EXPECT_EQ(star_direction(star, Epoch(), observer), star_direction(far, Epoch(), observer));
}

}  // namespace
}  // namespace astronav
