// SPDX-License-Identifier: Apache-2.0
// The shipped star catalogue against original lines of the Hipparcos main catalogue (ESA 1997, I/239), at their epoch.
#include <cmath>
#include <cstdlib>
#include <string>
#include <unordered_map>
#include <vector>

#include <gtest/gtest.h>

#include "foundation/files/mapped_file.h"
#include "foundation/math/rotation.h"
#include "foundation/math/statistics.h"
#include "models/stars/catalogue.h"
#include "models/stars/gzip.h"
#include "models/stars/tables.h"
#include "models/stars/writer.h"
#include "support/shared_data.h"

namespace astronav {
namespace {

const Epoch kJ1991_25 = Epoch::tdb_seconds(-8.75 * 365.25 * 86400.0);

struct Original {
  std::uint32_t hip = 0;
  double v = 0;
  Vec3 direction_N = Vec3::Zero();  // at J1991.25; zero where the line has none
  int components = 1;
  bool pair = false;  // solved as a double star: position angle, separation and difference of Hp are given
  // Of a pair closer than 10 arcsec: where its light is. The line's own place is that of the first component, except
  // where it says that it is the photocentre already.
  Vec3 light_N = Vec3::Zero();
};

std::vector<Original> original_lines(const std::string& text) {
  std::vector<Original> lines;
  for (std::size_t begin = 0; begin < text.size(); begin = text.find('\n', begin) + 1) {
    // Fixed columns of the catalogue's documentation: HIP 9-14, V 42-46, RA 52-63, Dec 65-76.
    const auto column = [&](std::size_t first, std::size_t last) {
      return std::strtod(text.substr(begin + first - 1, last - first + 1).c_str(), nullptr);
    };
    if (column(42, 46) == 0.0) continue;  // HIP 120412 has neither V nor solution
    Original line{.hip = static_cast<std::uint32_t>(column(9, 14)), .v = column(42, 46)};
    if (text[begin + 51 + 3] == '.')
      line.direction_N = direction_from_radec(column(52, 63) * kDegree, column(65, 76) * kDegree);
    line.components = static_cast<int>(column(344, 345));
    const double angle_rad = column(356, 358) * kDegree, separation = column(360, 366), d_hp = column(374, 378);
    line.pair = separation > 0.0 && !line.direction_N.isZero();
    line.light_N = line.direction_N;
    if (line.pair && separation < 10.0 && text[begin + 77] != '*') {
      const auto [east, north] = east_north(line.direction_N);
      const double share = 1.0 / (1.0 + std::pow(10.0, 0.4 * d_hp));
      line.light_N += share * separation * kArcsecond * (std::sin(angle_rad) * east + std::cos(angle_rad) * north);
      line.light_N.normalize();
    }
    lines.push_back(line);
  }
  return lines;
}

std::unordered_map<std::uint32_t, std::size_t> index_by_number(const StarCatalogue& catalogue) {
  std::unordered_map<std::uint32_t, std::size_t> index;
  for (std::size_t i = 0; i < catalogue.size(); ++i) index[catalogue.star(i).id] = i;
  return index;
}

struct Differences {
  std::vector<double> place_mas;
  std::vector<double> v_mag;
};

Differences differences(const StarCatalogue& catalogue, const std::vector<Original>& lines, Vec3 Original::*place) {
  const auto index = index_by_number(catalogue);
  Differences result;
  for (const Original& line : lines) {
    const auto at = index.find(line.hip);
    if (at == index.end()) {
      ADD_FAILURE() << "HIP " << line.hip << " is missing";
      continue;
    }
    const Star star = catalogue.star(at->second);
    result.v_mag.push_back(std::abs(star.v_mag - line.v));
    if (line.direction_N.isZero()) continue;
    result.place_mas.push_back(angle_between(star_direction(star, kJ1991_25, Vec3::Zero()), line.*place) /
                               kMilliarcsecond);
  }
  return result;
}

std::string shared_lines(const std::filesystem::path& path) {
  return gunzip(MappedFile::open(path).value().bytes()).value();
}

TEST(StarsAgainstHipparcos, ShippedCatalogueAgreesWithTheOriginalLines) {
  const auto path = ASTRONAV_SHARED_DATA("stars/hip_main_V6.6.dat.gz");
  const auto lines = original_lines(shared_lines(path));
  ASSERT_EQ(lines.size(), 9932u);
  const auto file = MappedFile::open(home_directory() / "data/hipparcos.stars").value();
  const StarCatalogue catalogue = StarCatalogue::open(file.bytes()).value();
  std::vector<Original> single, pairs;
  for (const Original& line : lines) {
    if (line.pair) pairs.push_back(line);
    if (line.components <= 1 && !line.pair) single.push_back(line);
  }
  const Differences found = differences(catalogue, single, &Original::direction_N);
  RecordProperty("median_mas", std::to_string(median(found.place_mas)));
  RecordProperty("p99_mas", std::to_string(quantile(found.place_mas, 0.99)));
  ASSERT_GE(found.place_mas.size(), 8600u);
  EXPECT_LE(median(found.place_mas), 15.0);
  EXPECT_LE(quantile(found.place_mas, 0.99), 300.0);
  EXPECT_LE(quantile(found.place_mas, 1.0), 1000.0);
  EXPECT_LE(median(found.v_mag), 0.01);
  EXPECT_LE(quantile(found.v_mag, 0.999), 0.011);

  // Double stars stand where their light is. Components are known to 0.05 mag, and they have moved since 1991.
  const Differences light = differences(catalogue, pairs, &Original::light_N);
  const Differences first = differences(catalogue, pairs, &Original::direction_N);
  ASSERT_GE(light.place_mas.size(), 1100u);
  EXPECT_LE(median(light.place_mas), 60.0);
  EXPECT_LE(quantile(light.place_mas, 0.95), 300.0);
  EXPECT_LE(quantile(light.place_mas, 0.99), 600.0);
  EXPECT_GE(quantile(first.place_mas, 0.95), 1200.0);  // the first component alone would not do
  EXPECT_LE(quantile(light.v_mag, 0.999), 0.011);
}

// Total light as the eye sees it (published magnitudes of pairs): Castor 1.58 at its centre of light, Mizar 2.03, alpha
// Centauri -0.27, gamma Leonis 2.01, Albireo 2.90.
TEST(StarsAgainstHipparcos, NamedDoubleStarsBlendAsInACamera) {
  const auto file = MappedFile::open(home_directory() / "data/hipparcos.stars").value();
  const StarCatalogue catalogue = StarCatalogue::open(file.bytes()).value();
  struct Case {
    std::uint32_t hip;
    double radius_arcsec, v;
    std::size_t stars;
  };
  for (const Case& c : {Case{36850, 60.0, 1.58, 1}, Case{65378, 60.0, 2.03, 2}, Case{71683, 60.0, -0.27, 2},
                        Case{50583, 60.0, 2.01, 1}, Case{95947, 60.0, 2.90, 2}, Case{61941, 60.0, 2.74, 1}}) {
    const Star star = catalogue.star(catalogue.find(c.hip).value());
    std::vector<std::uint32_t> near(10);
    near.resize(catalogue.cone(star.direction_N, c.radius_arcsec * kArcsecond, 7.0, near));
    EXPECT_EQ(near.size(), c.stars) << c.hip;
    double light = 0.0;
    for (const std::uint32_t i : near) light += std::pow(10.0, -0.4 * static_cast<double>(catalogue.star(i).v_mag));
    EXPECT_NEAR(-2.5 * std::log10(light), c.v, 0.05) << c.hip;
  }
}

TEST(StarsAgainstHipparcos, ImportedLinesComeBackAtTheirEpoch) {
  const auto path = ASTRONAV_SHARED_DATA("stars/hip_main_V6.6.dat.gz");
  const auto lines = original_lines(shared_lines(path));
  const auto table = read_star_table(MappedFile::open(path).value().bytes());
  ASSERT_TRUE(table) << describe(table.error());
  EXPECT_EQ(table->skipped, 1u);
  const std::string bytes = write_star_catalogue(table->stars, "import").value();
  const auto catalogue = StarCatalogue::open(std::as_bytes(std::span(bytes)));
  ASSERT_TRUE(catalogue) << describe(catalogue.error());
  EXPECT_EQ(catalogue->size(), lines.size());
  const Differences found = differences(*catalogue, lines, &Original::direction_N);
  // Rounding to 0.1 mas and, over 8.75 years, to 0.005 mas/yr.
  EXPECT_LE(quantile(found.place_mas, 1.0), 0.2);
  EXPECT_LE(quantile(found.v_mag, 1.0), 1e-6);
}

}  // namespace
}  // namespace astronav
