// SPDX-License-Identifier: Apache-2.0
#include "models/ephemeris/bodies.h"

#include <algorithm>
#include <cmath>
#include <fstream>
#include <sstream>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "support/shared_data.h"

namespace astronav {
namespace {

TEST(Bodies, NamesAreReadInAnyDress) {
  for (const char* text :
       {"earth-moon barycenter", "Earth Moon Barycenter", "EARTH_MOON_BARYCENTRE", "emb", "3", " 3 "}) {
    const auto id = parse_body(text);
    ASSERT_TRUE(id) << text;
    EXPECT_EQ(*id, body::earth_moon_barycenter) << text;
  }
  EXPECT_EQ(parse_body("Mars").value(), body::mars);
  EXPECT_EQ(parse_body("-96").value(), BodyId{-96});
  EXPECT_EQ(parse_body("SSB").value(), body::solar_system_barycenter);
}

TEST(Bodies, AWrongNameGetsTheNearestOne) {
  const auto id = parse_body("jupitre");
  ASSERT_FALSE(id);
  EXPECT_EQ(id.error().code, ErrorCode::not_found);
  EXPECT_NE(describe(id.error()).find("'jupiter'"), std::string::npos) << describe(id.error());
  EXPECT_FALSE(parse_body(""));
  EXPECT_FALSE(parse_body(std::string(5000, 'x')));
  EXPECT_FALSE(parse_body("99999999999"));
}

TEST(Bodies, NamesAreWritten) {
  EXPECT_EQ(body_name(body::jupiter), "jupiter");
  EXPECT_EQ(body_name(body::solar_system_barycenter), "solar system barycenter");
  EXPECT_EQ(body_name(BodyId{-12345}), "");
  for (int id = 0; id <= 10; ++id) EXPECT_EQ(parse_body(body_name(BodyId{id})).value(), BodyId{id});
}

TEST(Bodies, BarycentresStandInForPlanetsOnly) {
  EXPECT_EQ(barycenter_of(body::jupiter), body::jupiter_barycenter);
  EXPECT_EQ(barycenter_of(body::pluto), body::pluto_barycenter);
  for (const BodyId id : {body::earth, body::moon, body::sun, body::jupiter_barycenter, BodyId{2000099}, BodyId{-1}})
    EXPECT_FALSE(barycenter_of(id)) << id.value;
}

// Numbers of "BODY<id>_<item> = ( a b c )" in a NAIF text kernel; the last assignment counts.
std::vector<double> text_kernel_value(const std::string& kernel, int id, const std::string& item) {
  const std::string name = "BODY" + std::to_string(id) + "_" + item + " ";
  std::vector<double> out;
  bool data = false;
  std::istringstream lines(kernel);
  for (std::string line; std::getline(lines, line);) {
    if (line.find("\\begindata") != std::string::npos) data = true;
    if (line.find("\\begintext") != std::string::npos) data = false;
    const std::size_t at = line.find(name);
    if (!data || at == std::string::npos) continue;
    std::string rest = line.substr(line.find('(', at) + 1);
    std::replace(rest.begin(), rest.end(), 'D', 'E');
    std::istringstream numbers(rest);
    out.clear();
    for (double v; numbers >> v;) out.push_back(v);
  }
  return out;
}

std::string read(const std::filesystem::path& path) {
  std::ifstream file(path);
  return {std::istreambuf_iterator<char>(file), {}};
}

const std::vector<int> kCentres = {10, 199, 299, 399, 301, 499, 599, 699, 799, 899, 999};

TEST(BodiesAgainstNaif, GravitationalParameters) {
  const auto path = ASTRONAV_SHARED_DATA("ephemeris/gm_de440.tpc");
  const std::string kernel = read(path);
  std::vector<int> ids = kCentres;
  for (int id = 1; id <= 9; ++id) ids.push_back(id);
  for (const int id : ids) {
    const auto gm = text_kernel_value(kernel, id, "GM");
    ASSERT_EQ(gm.size(), 1U) << id;
    EXPECT_NEAR(body_constants(BodyId{id}).value().gm_m3_s2 / (gm[0] * 1e9), 1.0, 1e-15) << id;
  }
}

TEST(BodiesAgainstNaif, Radii) {
  const auto path = ASTRONAV_SHARED_DATA("ephemeris/pck00011.tpc");
  const std::string kernel = read(path);
  for (const int id : kCentres) {
    const auto radii = text_kernel_value(kernel, id, "RADII");
    ASSERT_EQ(radii.size(), 3U) << id;
    const auto constants = body_constants(BodyId{id}).value();
    EXPECT_DOUBLE_EQ(constants.equatorial_radius_m, radii[0] * 1e3) << id;
    EXPECT_NEAR(constants.mean_radius_m, std::cbrt(radii[0] * radii[1] * radii[2]) * 1e3, 1e-3) << id;
  }
}

TEST(Bodies, AnUnknownBodyHasNoConstants) {
  const auto constants = body_constants(BodyId{401});
  ASSERT_FALSE(constants);
  EXPECT_EQ(constants.error().code, ErrorCode::not_found);
}

}  // namespace
}  // namespace astronav
