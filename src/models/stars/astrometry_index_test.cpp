// SPDX-License-Identifier: Apache-2.0
#include "models/stars/astrometry_index.h"

#include <cmath>
#include <cstring>
#include <filesystem>
#include <string>

#include <gtest/gtest.h>

#include "foundation/files/mapped_file.h"
#include "foundation/math/random.h"
#include "foundation/math/rotation.h"
#include "models/stars/tables.h"
#include "models/stars/writer.h"

namespace astronav {
namespace {

// ---- An index made by hand ----

std::string block(std::string text, char fill) {
  text.resize((text.size() + 2879) / 2880 * 2880, fill);
  return text;
}

std::string header(const std::vector<std::string>& cards) {
  std::string out;
  for (std::string card : cards) {
    card.resize(80, ' ');
    out += card;
  }
  std::string end = "END";
  end.resize(80, ' ');
  return block(out + end, ' ');
}

std::string table(const std::string& name, std::size_t width, std::size_t rows, const std::string& data,
                  const std::string& endian = {}) {
  std::vector<std::string> cards{"XTENSION= 'BINTABLE'",
                                 "BITPIX  =                    8",
                                 "NAXIS   =                    2",
                                 "NAXIS1  = " + std::to_string(width),
                                 "NAXIS2  = " + std::to_string(rows) + " / rows",
                                 "PCOUNT  =                    0",
                                 "TTYPE1  = '" + name + "' / Field label"};
  if (!endian.empty()) cards.push_back("ENDIAN  = '" + endian + "'");
  return header(cards) + block(data, '\0');
}

template <typename T>
std::string raw(T value, bool big = false) {
  std::string out(sizeof(T), '\0');
  std::memcpy(out.data(), &value, sizeof(T));
  if (big) out = std::string(out.rbegin(), out.rend());
  return out;
}

std::string index_of(const std::vector<Vec3>& directions, const std::vector<float>& vt) {
  std::string range, places, magnitudes;
  for (int k = 0; k < 6; ++k) range += raw(k < 3 ? -1.0 : 1.0);
  range += raw(2147483647.5);
  for (const Vec3& d : directions) {
    for (int k = 0; k < 3; ++k) places += raw(static_cast<std::uint32_t>((d[k] + 1.0) * 2147483647.5));
  }
  for (const float m : vt) magnitudes += raw(m, true);
  return header(
             {"SIMPLE  =                    T", "BITPIX  =                    8", "NAXIS   =                    0"}) +
         table("kdtree_header_stars", 0, 0, "", "04:03:02:01") + table("kdtree_range_stars", 8, 7, range) +
         table("kdtree_data_stars", 12, directions.size(), places) + table("MAG_VT", 4, vt.size(), magnitudes);
}

std::span<const std::byte> bytes_of(const std::string& s) {
  return std::as_bytes(std::span(s));
}

TEST(AstrometryIndex, GivesPlacesAndMagnitudes) {
  const std::vector<Vec3> directions{direction_from_radec(1.0, 0.5), direction_from_radec(4.0, -1.2)};
  const std::string file = index_of(directions, {8.25f, 10.5f});
  const auto stars = read_astrometry_index(bytes_of(file));
  ASSERT_TRUE(stars) << describe(stars.error());
  ASSERT_EQ(stars->size(), 2u);
  for (std::size_t i = 0; i < 2; ++i) {
    EXPECT_LT(angle_between((*stars)[i].direction_N, directions[i]), 1e-3 * kArcsecond);
    EXPECT_EQ((*stars)[i].id, 1'000'000'000u + i);
    EXPECT_TRUE(std::isnan((*stars)[i].b_v));
  }
  EXPECT_NEAR((*stars)[0].v_mag, 8.18, 1e-5);
}

TEST(AstrometryIndex, RefusesWhatIsNone) {
  const auto message = [](const std::string& file) {
    const auto stars = read_astrometry_index(bytes_of(file));
    return stars ? std::string("was read") : describe(stars.error());
  };
  const std::string good = index_of({Vec3::UnitX()}, {8.0f});
  EXPECT_EQ(message(good), "was read");
  EXPECT_NE(message(good.substr(0, good.size() - 2880)).find("the file ends at"), std::string::npos);
  EXPECT_NE(message(good.substr(0, 2880 * 6)).find("is missing"), std::string::npos);
  EXPECT_NE(message(index_of({Vec3::UnitX()}, {8.0f, 9.0f})).find("do not belong together"), std::string::npos);
  EXPECT_NE(message(index_of({0.5 * Vec3::UnitX()}, {8.0f})).find("unit vector"), std::string::npos);
  EXPECT_NE(message(index_of({Vec3::UnitX()}, {99.0f})).find("magnitude"), std::string::npos);
  std::string odd = good;
  odd.replace(odd.find("04:03:02:01"), 11, "02:01:04:03");
  EXPECT_NE(message(odd).find("byte order"), std::string::npos);
  // Damage anywhere: no crash and, under the sanitizer, no byte read outside.
  RandomStream random(StreamId{.seed = 1, .purpose = "index mutation"});
  for (int i = 0; i < 3000; ++i) {
    std::string file = good;
    const auto at = static_cast<std::size_t>(random.uniform() * static_cast<double>(file.size()));
    file[at] = static_cast<char>(random.uniform() * 256.0);
    if (i % 3 == 0) file.resize(at);
    (void)message(file);
  }
}

TEST(AstrometryIndex, MergesBelowHipparcos) {
  Star fast;  // moves 2 arcsec a year
  fast.id = 7;
  fast.direction_N = direction_from_radec(1.0, 0.3);
  fast.pm_dec_rad_yr = 2.0 * kArcsecond;
  fast.v_mag = 9.0f;
  const StarTable hipparcos{StarTableKind::hipparcos, {fast}, 0};
  const std::vector<Vec3> places{direction_from_radec(1.0, 0.3),                      // itself
                                 direction_from_radec(1.0, 0.3 - 17.5 * kArcsecond),  // itself in 1991
                                 direction_from_radec(1.0, 0.3 + 40.0 * kArcsecond),  // another
                                 direction_from_radec(2.0, 0.0),  // astray: far too bright to be unknown
                                 direction_from_radec(2.5, 0.0)};
  const std::string file = index_of(places, {9.1f, 9.1f, 9.1f, 4.0f, 7.2f});
  const StarTable tables[] = {read_star_table(bytes_of(file)).value(), hipparcos};
  const auto stars = merge_star_tables(tables);
  ASSERT_EQ(stars.size(), 3u);
  EXPECT_EQ(stars[0].id, 7u);
  EXPECT_EQ(stars[1].id, 1'000'000'002u);
  EXPECT_EQ(stars[2].id, 1'000'000'004u);
}

// ---- Debian's package ----

TEST(AstrometryIndex, Tycho2BelowHipparcos) {
  std::filesystem::path path;
  for (const char* level : {"07", "08", "09", "10"}) {
    path = std::string("/usr/share/astrometry/index-tycho2-") + level + ".littleendian.fits";
    if (std::filesystem::exists(path)) break;
  }
  if (!std::filesystem::exists(path)) GTEST_SKIP() << "astrometry-data-tycho2 is not installed";
  const bool deepest = path.string().find("-07.") != std::string::npos;
  const auto index = MappedFile::open(path);
  const auto shipped = MappedFile::open(home_directory() / "data/hipparcos.stars");
  StarTable tycho = read_star_table(index->bytes()).value();
  const StarTable hipparcos = read_star_table(shipped->bytes()).value();
  EXPECT_EQ(tycho.kind, StarTableKind::tycho2_index);
  EXPECT_EQ(hipparcos.kind, StarTableKind::catalogue);
  std::erase_if(tycho.stars, [](const Star& s) { return s.v_mag > 11.0f; });
  const StarTable tables[] = {hipparcos, tycho};
  std::vector<Star> stars = merge_star_tables(tables);
  std::erase_if(stars, [](const Star& s) { return s.v_mag > 11.0f; });
  const auto down_to = [&](float v) {
    return std::count_if(stars.begin(), stars.end(), [&](const Star& s) { return s.v_mag <= v; });
  };
  // Counts of the sky (Allen's Astrophysical Quantities, 4th edition, table 19.10, by V): 1.1e5 to V 9, 3.2e5 to 10 and
  // 8.4e5 to 11 or so. To V 7 Hipparcos alone.
  EXPECT_EQ(down_to(7.0f), std::count_if(hipparcos.stars.begin(), hipparcos.stars.end(),
                                         [](const Star& s) { return s.v_mag <= 7.0f; }));
  EXPECT_NEAR(static_cast<double>(down_to(9.0f)), 1.25e5, 0.15e5);
  if (deepest) {
    EXPECT_NEAR(static_cast<double>(down_to(10.0f)), 3.4e5, 0.3e5);
    EXPECT_NEAR(static_cast<double>(down_to(11.0f)), 8.9e5, 0.8e5);
  }

  // No star twice: around Hipparcos stars there are no more Tycho-2 stars than chance brings there.
  const std::string bytes = write_star_catalogue(stars, "Hipparcos, Tycho-2").value();
  const auto catalogue = StarCatalogue::open(bytes_of(bytes)).value();
  RandomStream random(StreamId{.seed = 1, .purpose = "chance neighbours"});
  std::vector<std::uint32_t> found(100);
  const auto neighbours = [&](const Vec3& place) {
    const std::size_t n = catalogue.cone(place, 60.0 * kArcsecond, 11.0, found);
    return std::count_if(found.begin(), found.begin() + static_cast<std::ptrdiff_t>(std::min(n, found.size())),
                         [&](std::uint32_t i) {
                           return catalogue.star(i).id >= 1'000'000'000u && catalogue.star(i).id < 2'000'000'000u;
                         });
  };
  int around_stars = 0, around_chance = 0;
  constexpr int kTried = 4000;
  for (int i = 0; i < kTried; ++i) {
    const Star& star =
        hipparcos.stars[static_cast<std::size_t>(random.uniform() * static_cast<double>(hipparcos.stars.size()))];
    around_stars += static_cast<int>(neighbours(star.direction_N));
    // The same region of the sky, 10 arcmin away.
    const auto [east, north] = east_north(star.direction_N);
    around_chance += static_cast<int>(neighbours((star.direction_N + 600.0 * kArcsecond * east).normalized()));
  }
  // Both are near 80; wide double stars beyond the 10 arcsec bring some more.
  EXPECT_LT(around_stars, 2 * around_chance + 60);
  EXPECT_LT(around_stars, kTried / 20);

  // Sirius, Vega, 61 Cygni (5 arcsec a year) and Groombridge 1830 (7) are there once.
  for (const std::uint32_t hip : {32349u, 91262u, 104214u, 57939u}) {
    const Star star = catalogue.star(catalogue.find(hip).value());
    EXPECT_EQ(catalogue.cone(star.direction_N, 8.0 * kArcsecond, 8.0, found), 1u) << hip;
  }
  // Two that are not in Hipparcos, at the places of Simbad: HAT-P-7 (V 10.48) and WASP-121 (V 10.51).
  if (!deepest) return;
  const Vec3 planets_stars[] = {direction_from_radec((19.0 + 28.0 / 60.0 + 59.354 / 3600.0) * 15.0 * kDegree,
                                                     (47.0 + 58.0 / 60.0 + 10.22 / 3600.0) * kDegree),
                                direction_from_radec((7.0 + 10.0 / 60.0 + 24.060 / 3600.0) * 15.0 * kDegree,
                                                     -(39.0 + 5.0 / 60.0 + 50.57 / 3600.0) * kDegree)};
  for (const Vec3& place : planets_stars) {
    ASSERT_EQ(catalogue.cone(place, 1.0 * kArcsecond, 11.0, found), 1u);
    EXPECT_NEAR(catalogue.star(found[0]).v_mag, 10.5, 0.15);
    EXPECT_GE(catalogue.star(found[0]).id, 1'000'000'000u);
  }
}

}  // namespace
}  // namespace astronav
