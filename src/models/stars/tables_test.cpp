// SPDX-License-Identifier: Apache-2.0
#include "models/stars/tables.h"

#include <cmath>
#include <string>

#include <gtest/gtest.h>
#include <zlib.h>

#include "foundation/math/rotation.h"
#include "models/stars/gzip.h"

namespace astronav {
namespace {

std::span<const std::byte> bytes_of(const std::string& s) {
  return std::as_bytes(std::span(s));
}

// An original line.
const std::string kHip25 =
    "H|          25|H|00 00 19.05|-44 17 25.1| 6.28| |G|000.07936537|-44.29029741|A|  13.74|   58.36| -108.64|  0.88|  "
    "0.81|  "
    "0.98|  0.73|  0.68|-0.32| 0.18|-0.07| 0.02|-0.14| 0.02|-0.10|-0.25| 0.10|-0.02|  2|-0.52|    25| 7.238|0.004| "
    "6.375|0.003|*| 0.763|0.003|G|0.80|0.00|H|*| 6.4211|0.0006|0.008|197|*| 6.41| 6.44|       |D| | |00003-4417|I| 1| "
    "2|C| "
    "|A|AB|316|  0.463|0.002| 0.66|0.01|S| | |224750|          |C-44 15420|P-44 10394|0.80|G3IV        |X ";
// Original lines of Tycho-2: no colour to speak of, an ordinary star, one without mean place and without VT.
const std::string kTycho8 =
    "0001 00008 1| |  2.31750494|  2.23184345|  -16.3|   -9.0| 68| 73| 1.7| 1.8|1958.89|1951.94| "
    "4|1.0|1.0|0.9|1.0|12.146|0.158|"
    "12.146|0.223|999| |         |  2.31754222|  2.23186444|1.67|1.54| 88.0|100.8| |-0.2";
const std::string kTycho13 =
    "0001 00013 1| |  1.12558209|  2.26739400|   27.7|   -0.5|  9| 12| 1.2| 1.2|1990.76|1989.25| "
    "8|1.0|0.8|1.0|0.7|10.488|0.038| "
    "8.670|0.015|999|T|         |  1.12551889|  2.26739556|1.81|1.52|  9.3| 12.7| |-0.2";
const std::string kTycho33 =
    "0001 00033 1|X|            |            |       |       |   |   |    |    |       |       |  |   |   |   |   "
    "|12.512|0.228|"
    "      |     |  5|T|         |  1.58432611|  0.94286667|1.69|1.58|115.5|125.1| | 0.0";

std::string with(std::string line, const std::string& from, const std::string& to) {
  line.replace(line.find(from), from.size(), to);
  return line;
}

std::string gzipped(const std::string& text) {
  std::string out(text.size() + 1000, '\0');
  z_stream stream{};
  EXPECT_EQ(deflateInit2(&stream, 9, Z_DEFLATED, 16 + MAX_WBITS, 8, Z_DEFAULT_STRATEGY), Z_OK);
  stream.next_in = reinterpret_cast<Bytef*>(const_cast<char*>(text.data()));
  stream.avail_in = static_cast<uInt>(text.size());
  stream.next_out = reinterpret_cast<Bytef*>(out.data());
  stream.avail_out = static_cast<uInt>(out.size());
  EXPECT_EQ(deflate(&stream, Z_FINISH), Z_STREAM_END);
  out.resize(out.size() - stream.avail_out);
  deflateEnd(&stream);
  return out;
}

TEST(StarTables, ReadsAHipparcosLine) {
  const auto table = read_star_table(bytes_of(kHip25 + "\r\n"));
  ASSERT_TRUE(table) << describe(table.error());
  ASSERT_EQ(table->stars.size(), 1u);
  const Star& star = table->stars[0];
  EXPECT_EQ(table->kind, StarTableKind::hipparcos);
  EXPECT_EQ(star.id, 25u);
  EXPECT_FLOAT_EQ(star.v_mag, 6.28f);
  EXPECT_FLOAT_EQ(star.b_v, 0.763f);
  EXPECT_NEAR(star.parallax_rad / kMilliarcsecond, 13.74, 1e-9);
  EXPECT_NEAR(star.pm_dec_rad_yr / kMilliarcsecond, -108.64, 1e-3);
  // 8.75 years of its motion later than in the line.
  const RaDec place = radec_from_direction(star.direction_N);
  EXPECT_NEAR(place.dec_rad / kDegree, -44.29029741 - 108.64e-3 * 8.75 / 3600.0, 1e-9);
  EXPECT_NEAR(place.ra_rad / kDegree, 0.07936537 + 58.36e-3 * 8.75 / 3600.0 / std::cos(place.dec_rad), 1e-9);
}

TEST(StarTables, HipparcosStarWithoutSolutionKeepsItsPlaceToATenthOfAnArcsecond) {
  std::string line = with(kHip25, "000.07936537|-44.29029741", "            |            ");
  line = with(line, "  13.74|   58.36| -108.64", "       |        |        ");
  const auto table = read_star_table(bytes_of(line));
  ASSERT_TRUE(table) << describe(table.error());
  ASSERT_EQ(table->stars.size(), 1u);
  const RaDec place = radec_from_direction(table->stars[0].direction_N);
  EXPECT_NEAR(place.ra_rad / kDegree, 15.0 * 19.05 / 3600.0, 1e-9);
  EXPECT_NEAR(place.dec_rad / kDegree, -(44.0 + 17.0 / 60.0 + 25.1 / 3600.0), 1e-9);
  EXPECT_EQ(table->stars[0].pm_dec_rad_yr, 0.0);
}

TEST(StarTables, ReadsTycho2Lines) {
  const auto table = read_star_table(bytes_of(kTycho8 + "\n" + kTycho13 + "\n" + kTycho33 + "\n"));
  ASSERT_TRUE(table) << describe(table.error());
  EXPECT_EQ(table->kind, StarTableKind::tycho2);
  ASSERT_EQ(table->stars.size(), 2u);
  EXPECT_EQ(table->skipped, 1u);  // no VT
  const Star& star = table->stars[1];
  EXPECT_NEAR(star.v_mag, 8.670 - 0.090 * 1.818, 1e-5);
  EXPECT_NEAR(star.b_v, 0.850 * 1.818, 1e-5);
  EXPECT_NEAR(star.pm_ra_cosdec_rad_yr / kMilliarcsecond, 27.7, 1e-9);
  EXPECT_LT(angle_between(star.direction_N, direction_from_radec(1.12558209 * kDegree, 2.26739400 * kDegree)), 1e-12);
}

TEST(StarTables, Tycho2StarWithoutMeanPlaceTakesTheObservedOne) {
  const auto table = read_star_table(bytes_of(with(kTycho33, "12.512|0.228|      ", "12.512|0.228|11.012")));
  ASSERT_TRUE(table) << describe(table.error());
  ASSERT_EQ(table->stars.size(), 1u);
  EXPECT_LT(
      angle_between(table->stars[0].direction_N, direction_from_radec(1.58432611 * kDegree, 0.94286667 * kDegree)),
      1e-12);
}

TEST(StarTables, MergePrefersHipparcosAndNumbersTheRest) {
  const std::string known = with(kTycho13, "|T|         |", "|T|    25A  |");
  const std::string other = with(kTycho13, "|T|         |", "|T|   333   |");
  StarTable tables[] = {*read_star_table(bytes_of(kTycho8 + "\n" + known + "\n" + other + "\n" + other)),
                        *read_star_table(bytes_of(kHip25))};
  const auto stars = merge_star_tables(tables);
  ASSERT_EQ(stars.size(), 4u);
  EXPECT_EQ(stars[0].id, 25u);
  EXPECT_FLOAT_EQ(stars[0].v_mag, 6.28f);
  EXPECT_EQ(stars[1].id, 1'000'000'000u);
  EXPECT_EQ(stars[2].id, 333u);
  EXPECT_EQ(stars[3].id, 1'000'000'001u);
}

TEST(StarTables, ReadsGzip) {
  const std::string packed = gzipped(kHip25 + "\n");
  const auto table = read_star_table(bytes_of(packed + packed));  // two members, as cat makes them
  ASSERT_TRUE(table) << describe(table.error());
  EXPECT_EQ(table->stars.size(), 2u);
  for (std::size_t size = 2; size < packed.size(); ++size) {
    EXPECT_FALSE(gunzip(bytes_of(packed).first(size))) << size;
  }
  EXPECT_EQ(gunzip(bytes_of(packed), 10).error().code, ErrorCode::limit_exceeded);
}

TEST(StarTables, NamesTheLineAndFieldThatIsWrong) {
  const auto message = [](const std::string& text) {
    const auto table = read_star_table(bytes_of(text));
    return table ? std::string() : describe(table.error());
  };
  EXPECT_NE(message("").find("line 1"), std::string::npos);
  EXPECT_NE(message("ra,dec,mag\n1,2,3\n").find("line 1"), std::string::npos);
  EXPECT_NE(message(kHip25 + "\n" + kHip25.substr(0, 200)).find("line 2"), std::string::npos);
  const std::string broken = message(kHip25 + "\n\n" + with(kHip25, "-44.29029741", "-94.29029741"));
  EXPECT_NE(broken.find("line 3"), std::string::npos) << broken;
  EXPECT_NE(broken.find("field 9"), std::string::npos) << broken;
  EXPECT_NE(broken.find("-94.29029741"), std::string::npos) << broken;
  EXPECT_NE(message(with(kHip25, "  13.74", "    nan")), "");
  EXPECT_NE(message(with(kHip25, "  13.74", "  13.7x")), "");
}

}  // namespace
}  // namespace astronav
