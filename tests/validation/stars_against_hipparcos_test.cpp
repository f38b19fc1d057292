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

Differences differences(const StarCatalogue& catalogue, const std::vector<Original>& lines) {
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
    result.place_mas.push_back(angle_between(star_direction(star, kJ1991_25, Vec3::Zero()), line.direction_N) /
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
  const Differences found = differences(StarCatalogue::open(file.bytes()).value(), lines);
  ASSERT_EQ(found.place_mas.size(), 9928u);  // four of them have no astrometric solution
  RecordProperty("median_mas", std::to_string(median(found.place_mas)));
  RecordProperty("p99_mas", std::to_string(quantile(found.place_mas, 0.99)));
  EXPECT_LE(median(found.place_mas), 15.0);
  EXPECT_LE(quantile(found.place_mas, 0.99), 300.0);
  EXPECT_LE(quantile(found.place_mas, 1.0), 1000.0);
  EXPECT_LE(median(found.v_mag), 0.01);
  EXPECT_LE(quantile(found.v_mag, 0.999), 0.011);
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
  const Differences found = differences(*catalogue, lines);
  // Rounding to 0.1 mas and, over 8.75 years, to 0.005 mas/yr.
  EXPECT_LE(quantile(found.place_mas, 1.0), 0.2);
  EXPECT_LE(quantile(found.v_mag, 1.0), 1e-6);
}

}  // namespace
}  // namespace astronav
