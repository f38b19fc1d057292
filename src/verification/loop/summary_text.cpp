// SPDX-License-Identifier: Apache-2.0
// Summary for people.
#include <cmath>

#include <fmt/format.h>
#include <fmt/ranges.h>

#include "verification/loop/attitude_summary.h"
#include "verification/loop/summary.h"

namespace astronav::loop {
namespace {

std::string figure(double v, const char* unit) {
  if (std::isnan(v)) return "-";
  const double size = std::abs(v);
  const int decimals = size >= 100.0 ? 0 : size >= 10.0 ? 1 : size >= 1.0 ? 2 : 3;
  return fmt::format("{:.{}f}{}{}", v, decimals, *unit == '\0' ? "" : " ", unit);
}

std::string axes(const std::array<double, 3>& v) {
  return fmt::format("{} / {} / {}", figure(v[0], ""), figure(v[1], ""), figure(v[2], ""));
}

std::string start_in_words(const Summary& s) {
  const StartSummary& start = s.start;
  return fmt::format(
      "  Start from nothing: {} picture{} of the ecliptic{} showed {}; first place off by {} ({} by its own sigma), "
      "velocity by {} ({})",
      start.pictures, start.pictures == 1 ? "" : "s", s.runs > 1 ? fmt::format(" in {} runs", s.runs) : "",
      fmt::join(start.planets, ", "), figure(start.position_error_km, "km"), figure(start.position_sigma_km, "km"),
      figure(start.velocity_error_m_s, "m/s"), figure(start.velocity_sigma_m_s, "m/s"));
}

std::string consistency(double mean, const Band& band) {
  if (std::isnan(mean) || std::isnan(band.lo)) return "unknown";
  return mean > band.hi ? "overconfident" : mean < band.lo ? "underconfident" : "consistent";
}

}  // namespace

std::string in_words(const Summary& s) {
  if (s.steady_count == 0) {
    return fmt::format(
        "The mission flew {:.0f} days with {} navigation cycles: too few for a steady state, which is read from "
        "the fourth cycle on.",
        s.duration_days / s.runs, s.cycles / s.runs);
  }
  if (s.level == "cov") {
    return fmt::format(
        "Without noise and random errors: once settled, the filter's covariance says {} and {} (3 sigma, worst axis); "
        "what its models leave out moves the estimate by {} and {}. {} sights were flown without images.",
        figure(s.position_error_km.worst_formal_axis(), "km"), figure(s.velocity_error_m_s.worst_formal_axis(), "m/s"),
        figure(s.position_error_km.worst_axis(), "km"), figure(s.velocity_error_m_s.worst_axis(), "m/s"), s.images);
  }
  std::string out = fmt::format(
      "Once settled, the spacecraft knew its place to {} and its velocity to {} (3 sigma, worst axis){}; its own error "
      "bars said {} "
      "and {}. ",
      figure(s.position_error_km.worst_axis(), "km"), figure(s.velocity_error_m_s.worst_axis(), "m/s"),
      s.runs > 1 ? fmt::format(", over {} runs", s.runs) : "", figure(s.position_error_km.worst_formal_axis(), "km"),
      figure(s.velocity_error_m_s.worst_formal_axis(), "m/s"));
  if (!std::isnan(s.position_error_km.end_of_coast.steady_rms_rss)) {
    out += fmt::format("At the end of each long coast it was {}. ",
                       figure(s.position_error_km.end_of_coast.worst_axis(), "km"));
  }
  if (!std::isnan(s.nees_mean) && !std::isnan(s.nees_band_95.lo)) {
    out +=
        fmt::format("The errors are {} the filter says they are. ", s.nees_mean > s.nees_band_95.hi   ? "larger than"
                                                                    : s.nees_mean < s.nees_band_95.lo ? "smaller than"
                                                                                                      : "as large as");
  }
  if (!std::isnan(s.vision.attitude_success_rate)) {
    const int wrong = s.vision.false_planets;
    out += fmt::format("Of {} images, {:.4g} % gave an attitude and {:.4g} % the planet; {} false planet{} accepted.",
                       s.images, 100.0 * s.vision.attitude_success_rate, 100.0 * s.vision.planet_success_rate,
                       wrong == 0 ? "no" : fmt::format("{}", wrong), wrong > 1 ? "s were" : " was");
  } else {
    out += fmt::format("{} sights were flown without images.", s.images);
  }
  return out;
}

std::string to_text(const Summary& s) {
  std::string out = in_words(s) + "\n\n";
  if (s.start.from == "survey") out += start_in_words(s) + "\n";
  const auto row = [&](const char* label, const ErrorFigures& p, const ErrorFigures& v) {
    out +=
        fmt::format("  {:<26} {:>26} km   {:>26} m/s\n", label, axes(p.steady_3sigma_axis), axes(v.steady_3sigma_axis));
    out += fmt::format("  {:<26} {:>26} km   {:>26} m/s\n", "  the filter's own bound", axes(p.formal_3sigma_axis),
                       axes(v.formal_3sigma_axis));
  };
  if (s.steady_count > 0) {
    out += fmt::format("  {:<26} {:>26}      {:>26}\n", "3 sigma, x / y / z", "position", "velocity");
    row("after the second window", s.position_error_km, s.velocity_error_m_s);
    if (s.coast_count > 0)
      row("at the end of a coast", s.position_error_km.end_of_coast, s.velocity_error_m_s.end_of_coast);
  }
  out += fmt::format("  NEES {} in [{}, {}] ({}), NIS {} in [{}, {}] ({})\n", figure(s.nees_mean, ""),
                     figure(s.nees_band_95.lo, ""), figure(s.nees_band_95.hi, ""),
                     consistency(s.nees_mean, s.nees_band_95), figure(s.nis_mean, ""), figure(s.nis_band_95.lo, ""),
                     figure(s.nis_band_95.hi, ""), consistency(s.nis_mean, s.nis_band_95));
  if (!std::isnan(s.vision.attitude_success_rate)) {
    out += fmt::format("  stars {}, planets {}, attitude {} across and {} in roll (1 sigma)\n",
                       figure(s.vision.centroid_error_px_1sigma, "px"), figure(s.vision.planet_error_px_1sigma, "px"),
                       figure(s.vision.attitude_cross_arcsec_1sigma, "arcsec"),
                       figure(s.vision.attitude_roll_arcsec_1sigma, "arcsec"));
    if (const std::string attitude = attitude_filter_in_words(s.attitude_filter); !attitude.empty())
      out += attitude + "\n";
    out += fmt::format("  {} an image onboard (99 %: {}); ", figure(s.image_ms_median, "ms"),
                       figure(s.image_ms_p99, "ms"));
  } else {
    out += "  ";
  }
  out += fmt::format("{} in all, {} of memory\n", figure(s.wall_s, "s"), figure(s.peak_memory_mb, "MB"));
  return out;
}

}  // namespace astronav::loop
