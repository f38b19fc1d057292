// SPDX-License-Identifier: Apache-2.0
// Is the exposure that the onboard software chooses the best one? A ladder of exposures for planets of several
// magnitudes: forecast and measured error of a window. One JSON object a line. Options: [windows] [images].
#include <cstdlib>

#include <fmt/format.h>

#include "benchmarks/accuracy/arguments.h"
#include "benchmarks/accuracy/exposure_ladder.h"

int main(int argc, char** argv) {
  using namespace astronav;
  const int windows = astronav::accuracy::count_of(argc, argv, 1, "windows", 12);
  const int images = astronav::accuracy::count_of(argc, argv, 2, "images", 12);
  accuracy::ExposureLadder ladder;
  for (const double v_mag : {-5.0, -3.5, -2.0, 0.0, 2.0, 4.0, 5.5}) {
    double chosen = 0.0;
    for (int w = 0; w < windows; ++w) chosen += std::log(ladder.choose(w, v_mag).exposure_s) / windows;
    for (double exposure_s = 0.4; exposure_s > 0.005; exposure_s *= 0.5) {
      accuracy::ExposureRow sum;
      double expected = 0.0, expected_attitude = 0.0, expected_once = 0.0, stars = 0.0, mean2 = 0.0;
      int good = 0;
      for (int w = 0; w < windows; ++w) {
        const accuracy::ExposureRow row = ladder.window(w, v_mag, exposure_s, images);
        sum.images += row.images;
        if (row.images < images / 2) continue;
        ++good;
        mean2 += row.mean_px * row.mean_px;
        sum.scatter_px += row.scatter_px * row.scatter_px;
        sum.attitude_px += row.attitude_px * row.attitude_px;
        expected += row.expected.window_px * row.expected.window_px;
        expected_attitude += row.expected.attitude_px * row.expected.attitude_px;
        expected_once += std::pow(row.expected.planet.sigma_px, 2) + std::pow(row.expected.attitude_px, 2);
        stars += row.expected.stars;
      }
      const double n = std::max(1, good);
      fmt::print(
          "{{\"benchmark\": \"exposure\", \"v_mag\": {}, \"exposure_ms\": {:.2f}, \"chosen_ms\": {:.2f}, \"images\": "
          "{}, "
          "\"stars_expected\": {:.0f}, \"scatter_px\": {:.5f}, \"scatter_expected_px\": {:.5f}, \"attitude_px\": "
          "{:.5f}, "
          "\"attitude_expected_px\": {:.5f}, \"mean_px\": {:.5f}, \"window_expected_px\": {:.5f}}}\n",
          v_mag, 1e3 * exposure_s, 1e3 * std::exp(chosen), sum.images, stars / n, std::sqrt(sum.scatter_px / n),
          std::sqrt(expected_once / n), std::sqrt(sum.attitude_px / n), std::sqrt(expected_attitude / n),
          std::sqrt(mean2 / n), std::sqrt(expected / n));
      std::fflush(stdout);
    }
  }
  return 0;
}
