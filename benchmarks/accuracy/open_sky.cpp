// SPDX-License-Identifier: Apache-2.0
// Real pictures solved with nothing known, against the plate solutions that astrometry.net finds: one JSON object a
// picture, then medians. Usage: open_sky_accuracy FOLDER [WORD]: the folder of truth.csv; pictures whose name holds it.
#include <algorithm>
#include <cmath>
#include <ctime>
#include <filesystem>
#include <fstream>
#include <map>
#include <sstream>
#include <string>
#include <vector>

#include <fmt/format.h>

#include "foundation/files/mapped_file.h"
#include "foundation/math/rotation.h"
#include "foundation/math/statistics.h"
#include "verification/opensky/solver.h"

namespace {

using namespace astronav;

struct Truth {
  std::string image;
  bool solved = false;
  Vec3 center_N;
  double roll_rad = 0.0, tolerance_arcsec = 0.0, tolerance_roll_deg = 0.0;
};

std::vector<Truth> read_truth(const std::filesystem::path& path) {
  std::ifstream in(path);
  std::string line;
  std::getline(in, line);
  std::vector<Truth> rows;
  while (std::getline(in, line)) {
    std::vector<std::string> cells;
    std::istringstream cut(line);
    for (std::string cell; std::getline(cut, cell, ',');) cells.push_back(cell);
    if (cells.size() < 15) continue;
    const auto number = [&](std::size_t i) { return cells[i].empty() ? 0.0 : std::stod(cells[i]); };
    rows.push_back({cells[0], cells[3] == "1", direction_from_radec(number(4) * kDegree, number(5) * kDegree),
                    number(6) * kDegree, number(13), number(14)});
  }
  return rows;
}

}  // namespace

int main(int argc, char** argv) {
  if (argc < 2) {
    fmt::print(stderr, "usage: open_sky_accuracy FOLDER [WORD]\n");
    return 2;
  }
  const std::filesystem::path folder = argv[1];
  const auto file = MappedFile::open(home_directory() / "data/hipparcos.stars");
  if (!file) return 1;
  const auto catalogue = StarCatalogue::open(file->bytes());
  if (!catalogue) return 1;
  opensky::Solver solver(*catalogue);
  std::map<std::string, std::vector<double>> errors;
  std::vector<double> times, large;  // processor time
  int wrong = 0;
  for (const Truth& truth : read_truth(folder / "truth.csv")) {
    if (argc > 2 && truth.image.find(argv[2]) == std::string::npos) continue;
    const auto picture = read_picture(folder / truth.image);
    if (!picture) return 1;
    // Twice: the second time the lists of stars are there.
    const auto first = solver.solve(*picture, {});
    const std::clock_t begin = std::clock();
    const auto solution = solver.solve(*picture, {});
    const double cpu_ms = 1e3 * static_cast<double>(std::clock() - begin) / CLOCKS_PER_SEC;
    if (!solution) {
      fmt::print("{{\"image\": \"{}\", \"status\": \"no_match\", \"message\": \"{}\"}}\n", truth.image,
                 describe(solution.error()));
      continue;
    }
    const Pointing seen = opensky::center_pointing(*solution);
    const double off = angle_between(direction_from_radec(seen.ra_rad, seen.dec_rad), truth.center_N) / kArcsecond;
    const double roll = std::abs(std::remainder(seen.roll_rad - truth.roll_rad, 2.0 * kPi)) / kDegree;
    const bool right = !truth.solved || (off <= truth.tolerance_arcsec && roll <= truth.tolerance_roll_deg);
    wrong += !right;
    if (truth.solved) errors[std::filesystem::path(truth.image).parent_path().string()].push_back(off);
    const opensky::SolveTimes& t = solution->time_ms;
    times.push_back(cpu_ms);
    if (picture->pixels.width() * picture->pixels.height() > 1'200'000) large.push_back(cpu_ms);
    fmt::print(
        "{{\"image\": \"{}\", \"status\": \"{}\", \"off_arcsec\": {:.1f}, \"roll_off_deg\": {:.3f}, \"stars\": {}, "
        "\"spots\": {}, \"rms_px\": {:.3f}, \"fov_h_deg\": {:.3f}, \"chance\": {:.1g}, \"first_ms\": {:.0f}, "
        "\"lists_ms\": {:.0f}, \"cpu_ms\": {:.1f}, \"ms\": {:.1f}, \"centroid_ms\": {:.1f}, \"identify_ms\": {:.1f}, "
        "\"attitude_ms\": {:.1f}}}\n",
        truth.image, right ? "right" : "WRONG", off, roll, solution->stars.size(), solution->detected,
        solution->attitude.residual_rms_px, solution->attitude.intrinsics.field_of_view_horizontal_rad() / kDegree,
        solution->attitude.chance_probability, first ? first->time_ms.total : -1.0, first ? first->time_ms.lists : -1.0,
        cpu_ms, t.total, t.centroid, t.identify, t.attitude);
  }
  for (const auto& [group, values] : errors)
    fmt::print("{{\"name\": \"open_sky_off_arcsec\", \"folder\": \"{}\", \"pictures\": {}, \"median\": {:.2f}}}\n",
               group, values.size(), median(values));
  const auto say = [](const char* name, const std::vector<double>& ms) {
    if (!ms.empty())
      fmt::print("{{\"name\": \"{}\", \"pictures\": {}, \"median\": {:.1f}, \"largest\": {:.1f}}}\n", name, ms.size(),
                 median(ms), *std::max_element(ms.begin(), ms.end()));
  };
  say("open_sky_blind_cpu_ms", times);
  say("open_sky_blind_cpu_ms_megapixels", large);  // 1.2 to 1.5 megapixels
  fmt::print("{{\"name\": \"open_sky_wrong\", \"value\": {}}}\n", wrong);
  return wrong == 0 ? 0 : 1;
}
