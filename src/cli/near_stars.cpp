// SPDX-License-Identifier: Apache-2.0
#include "cli/near_stars.h"

#include <algorithm>
#include <cmath>
#include <string_view>
#include <utility>

#include <fmt/format.h>

#include "cli/inputs.h"
#include "foundation/files/mapped_file.h"
#include "foundation/math/rotation.h"

namespace astronav::cli {

Result<std::vector<ListedStar>> read_near_stars(const std::string& path) {
  const auto file = MappedFile::open(path);
  if (!file) return forward(file);
  const auto cells_of = [](const std::string& line) {
    std::vector<std::string> cells(1);
    for (const char c : line) {
      if (c == ',')
        cells.emplace_back();
      else if (c != '\r')
        cells.back() += c;
    }
    return cells;
  };
  std::vector<std::string> lines(1);
  for (const char c : file->text()) {
    if (c == '\n')
      lines.emplace_back();
    else
      lines.back() += c;
  }
  const std::vector<std::string> titles = cells_of(lines.front());
  const char* needed[] = {"epoch_jyear", "ra_deg", "dec_deg", "parallax_mas", "pm_ra_cosdec_mas_yr", "pm_dec_mas_yr"};
  for (const char* title : needed) {
    if (std::find(titles.begin(), titles.end(), title) == titles.end())
      return fail(ErrorCode::invalid_argument, "no list of stars: its first line names no column '{s}'", {}, path,
                  title);
  }
  std::vector<ListedStar> stars;
  for (std::size_t n = 1; n < lines.size(); ++n) {
    if (lines[n].find_first_not_of(" \r") == std::string::npos) continue;
    const std::vector<std::string> cells = cells_of(lines[n]);
    const std::string where = fmt::format("{}:{}", path, n + 1);
    const auto cell = [&](std::string_view title) -> std::string {
      const auto at = std::find(titles.begin(), titles.end(), title);
      const auto column = static_cast<std::size_t>(at - titles.begin());
      return column < cells.size() ? cells[column] : std::string();
    };
    const auto number = [&](std::string_view title) -> Result<double> {
      const auto value = parse_numbers(cell(title), 1, 1, title);
      if (!value) return forward(value, where);
      return value->front();
    };
    double values[6];
    for (int k = 0; k < 6; ++k) {
      const auto value = number(needed[k]);
      if (!value) return forward(value);
      values[k] = *value;
    }
    if (!(std::abs(values[2]) <= 90.0 && std::abs(values[0] - 2000.0) < 1000.0))
      return fail(ErrorCode::invalid_argument, "no such place or epoch: dec_deg {0}, epoch_jyear {1}",
                  {values[2], values[0]}, where);
    const auto optional = [&](std::string_view title, double otherwise) {
      const auto value = number(title);
      return value ? *value : otherwise;
    };
    ListedStar named;
    named.name = cell("name");
    const Vec3 place = direction_from_radec(values[1] * kDegree, values[2] * kDegree);
    const EastNorth then = east_north(place);
    const Vec3 motion = (values[4] * then.east + values[5] * then.north) * kMilliarcsecond;
    const Vec3 moved = place + motion * (2000.0 - values[0]);
    Star& star = named.star;
    star.direction_N = moved.normalized();
    const EastNorth axes = east_north(star.direction_N);
    star.pm_ra_cosdec_rad_yr = motion.dot(axes.east) / moved.norm();
    star.pm_dec_rad_yr = motion.dot(axes.north) / moved.norm();
    star.parallax_rad = values[3] * kMilliarcsecond;
    star.v_mag = static_cast<float>(optional("v_mag", 10.0));
    star.b_v = static_cast<float>(optional("b_v", kUnknownColour));
    named.v_i = optional("v_i", kUnknownColour);
    stars.push_back(std::move(named));
  }
  return stars;
}

}  // namespace astronav::cli
