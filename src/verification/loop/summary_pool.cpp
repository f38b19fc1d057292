// SPDX-License-Identifier: Apache-2.0
// Several runs' figures made one.
#include <algorithm>
#include <cmath>

#include "foundation/base/check.h"
#include "verification/loop/attitude_summary.h"
#include "verification/loop/summary.h"
#include "verification/loop/summary_figures.h"

namespace astronav::loop {
namespace {

// Mean of `field` over the runs, weighted; what is not a number is left out.
template <typename Field, typename Weight>
double weighted_mean(std::span<const Summary> runs, Field&& field, Weight&& weight) {
  double sum = 0.0;
  double weights = 0.0;
  for (const Summary& run : runs) {
    const double value = field(run);
    const double w = weight(run);
    if (std::isnan(value) || !(w > 0.0)) continue;
    sum += w * value;
    weights += w;
  }
  return ratio(sum, weights);
}

template <typename Field, typename Weight>
double weighted_rms(std::span<const Summary> runs, Field&& field, Weight&& weight) {
  const auto squared = [&](const Summary& run) {
    const double v = field(run);
    return v * v;
  };
  return std::sqrt(weighted_mean(runs, squared, weight));
}

template <typename Figures, typename Weight>
ErrorFigures pool_figures(std::span<const Summary> runs, Figures&& figures, Weight&& weight) {
  ErrorFigures out;
  const auto one = [](const Summary&) { return 1.0; };
  out.final_rss = weighted_rms(
      runs, [&](const Summary& r) { return figures(r).final_rss; }, one);
  out.steady_rms_rss = weighted_rms(
      runs, [&](const Summary& r) { return figures(r).steady_rms_rss; }, weight);
  for (std::size_t i = 0; i < 3; ++i) {
    out.steady_3sigma_axis[i] = weighted_rms(
        runs, [&](const Summary& r) { return figures(r).steady_3sigma_axis[i]; }, weight);
    out.formal_3sigma_axis[i] = weighted_rms(
        runs, [&](const Summary& r) { return figures(r).formal_3sigma_axis[i]; }, weight);
  }
  return out;
}

StartSummary pool_starts(std::span<const Summary> runs) {
  StartSummary s;
  s.from = runs[0].start.from;
  for (const Summary& r : runs) {
    s.cycle = std::max(s.cycle, r.start.cycle);
    s.surveys += r.start.surveys;
    s.pictures += r.start.pictures;
    for (const std::string& planet : r.start.planets)
      if (std::find(s.planets.begin(), s.planets.end(), planet) == s.planets.end()) s.planets.push_back(planet);
  }
  for (const auto& [name, value] : kStartFigures) {
    s.*value = weighted_rms(
        runs, [member = value](const Summary& r) { return r.start.*member; }, [](const Summary&) { return 1.0; });
  }
  return s;
}

}  // namespace

Summary pool(std::span<const Summary> runs) {
  ASTRONAV_CHECK(!runs.empty());
  Summary s;
  s.level = runs[0].level;
  s.version = runs[0].version;
  s.seed = runs[0].seed;
  s.sample = runs[0].sample;
  s.runs = 0;
  for (const Summary& r : runs) {
    s.runs += r.runs;
    s.cycles += r.cycles;
    s.images += r.images;
    s.duration_days += r.duration_days;
    s.peak_memory_mb = std::max(s.peak_memory_mb, r.peak_memory_mb);
    s.wall_s += r.wall_s;
    s.steady_count += r.steady_count;
    s.coast_count += r.coast_count;
    s.nees_effective_count += r.nees_effective_count;
    s.nis_count += r.nis_count;
    s.edited_count += r.edited_count;
    s.centroid_count += r.centroid_count;
    s.planet_count += r.planet_count;
    s.attitude_count += r.attitude_count;
    s.vision.false_planets += r.vision.false_planets;
  }
  s.start = pool_starts(runs);
  const auto steady = [](const Summary& r) { return static_cast<double>(r.steady_count); };
  const auto coast = [](const Summary& r) { return static_cast<double>(r.coast_count); };
  const auto images = [](const Summary& r) { return static_cast<double>(r.images); };
  const auto attitudes = [](const Summary& r) { return static_cast<double>(r.attitude_count); };
  const auto at = [&](auto member, auto weight) { return weighted_mean(runs, member, weight); };

  static_cast<ErrorFigures&>(s.position_error_km) = pool_figures(
      runs, [](const Summary& r) -> const ErrorFigures& { return r.position_error_km; }, steady);
  static_cast<ErrorFigures&>(s.velocity_error_m_s) = pool_figures(
      runs, [](const Summary& r) -> const ErrorFigures& { return r.velocity_error_m_s; }, steady);
  s.position_error_km.end_of_coast = pool_figures(
      runs, [](const Summary& r) -> const ErrorFigures& { return r.position_error_km.end_of_coast; }, coast);
  s.velocity_error_m_s.end_of_coast = pool_figures(
      runs, [](const Summary& r) -> const ErrorFigures& { return r.velocity_error_m_s.end_of_coast; }, coast);

  s.nees_mean = at([](const Summary& r) { return r.nees_mean; }, steady);
  s.nees_band_95 = mean_band(6.0, s.nees_effective_count);
  s.nis_mean = at([](const Summary& r) { return r.nis_mean; },
                  [](const Summary& r) { return static_cast<double>(r.nis_count); });
  s.nis_band_95 = mean_band(2.0, s.nis_count);

  s.vision.attitude_success_rate = at([](const Summary& r) { return r.vision.attitude_success_rate; }, images);
  s.vision.planet_success_rate = at([](const Summary& r) { return r.vision.planet_success_rate; }, images);
  s.vision.centroid_error_px_1sigma = weighted_rms(
      runs, [](const Summary& r) { return r.vision.centroid_error_px_1sigma; },
      [](const Summary& r) { return static_cast<double>(r.centroid_count); });
  s.vision.planet_error_px_1sigma = weighted_rms(
      runs, [](const Summary& r) { return r.vision.planet_error_px_1sigma; },
      [](const Summary& r) { return static_cast<double>(r.planet_count); });
  s.vision.attitude_cross_arcsec_1sigma = weighted_rms(
      runs, [](const Summary& r) { return r.vision.attitude_cross_arcsec_1sigma; }, attitudes);
  s.vision.attitude_roll_arcsec_1sigma = weighted_rms(
      runs, [](const Summary& r) { return r.vision.attitude_roll_arcsec_1sigma; }, attitudes);

  s.attitude_filter = pool_attitude_filter(runs);

  std::vector<double> medians;
  for (const Summary& r : runs) {
    if (!std::isnan(r.image_ms_median)) medians.push_back(r.image_ms_median);
  }
  s.image_ms_median = median(medians);
  s.image_ms_p99 = at([](const Summary& r) { return r.image_ms_p99; }, images);
  s.stage_ms = {at([](const Summary& r) { return r.stage_ms.render; }, images),
                at([](const Summary& r) { return r.stage_ms.centroid; }, images),
                at([](const Summary& r) { return r.stage_ms.identify; }, images),
                at([](const Summary& r) { return r.stage_ms.planets; }, images),
                at([](const Summary& r) { return r.stage_ms.propagate; }, images),
                at([](const Summary& r) { return r.stage_ms.update; }, images)};
  return s;
}

}  // namespace astronav::loop
