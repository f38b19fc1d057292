// SPDX-License-Identifier: Apache-2.0
// Pooled figures with confidence intervals.
#include "foundation/math/statistics.h"

#include <algorithm>
#include <cmath>
#include <map>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "foundation/files/mapped_file.h"
#include "foundation/math/random.h"
#include "verification/campaign/campaign.h"

namespace astronav::campaign {
namespace {

using Json = nlohmann::ordered_json;

constexpr int kResamples = 1000;

std::vector<loop::Summary> flown_summaries(const Outcome& outcome) {
  std::vector<loop::Summary> out;
  for (const Sample& sample : outcome.samples) {
    if (sample.flown()) out.push_back(sample.summary);
  }
  return out;
}

double worst_ratio(const loop::ErrorSummary& e) {
  double worst = 0.0;
  for (std::size_t i = 0; i < 3; ++i) worst = std::max(worst, e.steady_3sigma_axis[i] / e.formal_3sigma_axis[i]);
  return worst;
}

// The figures that get an interval.
Json figures(const loop::Summary& summary) {
  const Json all = Json::parse(loop::to_json(summary, -1));
  Json out;
  for (const char* key : {"position_error_km", "velocity_error_m_s", "nees_mean", "nis_mean", "vision"})
    out[key] = all[key];
  return out;
}

Json confidence(const std::vector<loop::Summary>& runs) {
  if (runs.size() < 3) return nullptr;
  std::map<std::string, std::vector<double>> draws;
  RandomStream random(StreamId{.seed = 1, .purpose = "campaign bootstrap"});
  std::vector<loop::Summary> resampled(runs.size());
  for (int b = 0; b < kResamples; ++b) {
    for (loop::Summary& r : resampled)
      r = runs[static_cast<std::size_t>(random.uniform() * static_cast<double>(runs.size()))];
    const Json flat = figures(loop::pool(resampled)).flatten();
    for (const auto& [path, value] : flat.items()) {
      if (value.is_number()) draws[path].push_back(value.get<double>());
    }
  }
  // "/position_error_km/steady_3sigma_axis/0" stays where it was, as a pair.
  Json out = figures(loop::pool(runs));
  for (const auto& [path, values] : draws) {
    out[Json::json_pointer(path)] = {quantile(values, 0.025), quantile(values, 0.975)};
  }
  return out;
}

std::string cell(double v) {
  return std::isnan(v) ? "" : fmt::format("{:.6g}", v);
}

// Means over the samples, window by window.
std::vector<WindowStatistics> window_statistics(const Outcome& outcome) {
  struct Sum {
    double nees = 0.0, nis = 0.0;
    int count = 0, nis_count = 0;
    std::map<std::string, int> beacons;
  };
  std::map<std::pair<int, int>, Sum> sums;
  for (const Sample& sample : outcome.samples) {
    for (const WindowConsistency& w : sample.consistency) {
      if (std::isnan(w.nees)) continue;
      Sum& sum = sums[{w.cycle, w.window}];
      sum.nees += w.nees;
      ++sum.count;
      ++sum.beacons[w.beacon];
      if (std::isnan(w.nis)) continue;
      sum.nis += w.nis;
      ++sum.nis_count;
    }
  }
  std::vector<WindowStatistics> out;
  for (const auto& [key, sum] : sums) {
    const auto most = std::max_element(sum.beacons.begin(), sum.beacons.end(),
                                       [](const auto& a, const auto& b) { return a.second < b.second; });
    out.push_back({.cycle = key.first,
                   .window = key.second,
                   .beacon = most->first,
                   .samples = sum.count,
                   .nees_mean = sum.nees / sum.count,
                   .nees_band_95 = chi_square_mean_band(0.95, 6.0, sum.count),
                   .nis_mean = sum.nis_count > 0 ? sum.nis / sum.nis_count : std::nan("")});
  }
  return out;
}

}  // namespace

Result<Statistics> statistics(const Outcome& outcome) {
  const auto runs = flown_summaries(outcome);
  if (runs.empty()) {
    return fail(ErrorCode::not_converged, "none of {0} samples flew; the first said: {s}",
                {static_cast<double>(outcome.samples.size())}, "",
                outcome.samples.empty() ? "nothing" : outcome.samples.front().error);
  }
  Statistics s;
  s.pooled = loop::pool(runs);
  s.flown = static_cast<int>(runs.size());
  s.failed = static_cast<int>(outcome.samples.size() - runs.size());
  for (const loop::Summary& r : runs) {
    s.worst_position_ratio = std::max(s.worst_position_ratio, worst_ratio(r.position_error_km));
    s.worst_velocity_ratio = std::max(s.worst_velocity_ratio, worst_ratio(r.velocity_error_m_s));
    s.nis_inside_band += r.nis_band_95.contains(r.nis_mean);
    s.nees_inside_band += r.nees_band_95.contains(r.nees_mean);
  }
  s.windows = window_statistics(outcome);
  double sum = 0.0;
  int count = 0;
  for (const WindowStatistics& w : s.windows) {
    sum += w.nees_mean * w.samples;
    count += w.samples;
    s.windows_inside_band += w.nees_band_95.contains(w.nees_mean);
  }
  s.nees_all_windows = count > 0 ? sum / count : std::nan("");
  return s;
}

std::string summary_json(const Outcome& outcome, const Statistics& s) {
  Json j = Json::parse(loop::to_json(s.pooled, -1));
  j.erase("seed");
  j.erase("sample");
  j["first_seed"] = outcome.identity.first_seed;
  j["samples"] = {{"flown", s.flown},
                  {"failed", s.failed},
                  {"nis_inside_band", s.nis_inside_band},
                  {"nees_inside_band", s.nees_inside_band}};
  j["worst_ratio_to_formal"] = {{"position", s.worst_position_ratio}, {"velocity", s.worst_velocity_ratio}};
  j["windows"] = {{"count", s.windows.size()},
                  {"nees_mean", s.nees_all_windows},
                  {"nees_inside_band", s.windows_inside_band}};
  j["confidence_95"] = confidence(flown_summaries(outcome));
  j["confidence_method"] =
      fmt::format("bootstrap over whole samples, {} resamples, 2.5 % and 97.5 % percentiles", kResamples);
  return j.dump(2);
}

std::string samples_csv(const Outcome& outcome) {
  std::string out = "seed,status,cycles,images";
  for (const char* what : {"steady_3sigma", "formal_3sigma", "coast_3sigma"}) {
    for (const char* unit : {"km", "m_s"}) {
      for (const char* axis : {"x", "y", "z"}) out += fmt::format(",{}_{}_{}", what, axis, unit);
    }
  }
  out +=
      ",position_final_rss_km,velocity_final_rss_m_s,nees_mean,nees_band_lo,nees_band_hi,nis_mean,nis_band_lo,nis_band_"
      "hi,"
      "attitude_success_rate,planet_success_rate,false_planets,centroid_error_px,planet_error_px,image_ms_median,wall_"
      "s,error\n";
  for (const Sample& sample : outcome.samples) {
    if (!sample.flown()) {
      std::string error = sample.error;
      std::replace(error.begin(), error.end(), '"', '\'');
      out += fmt::format("{},failed{}\"{}\"\n", sample.seed, std::string(36, ','), error);
      continue;
    }
    const loop::Summary& s = sample.summary;
    out += fmt::format("{},flown,{},{}", sample.seed, s.cycles, s.images);
    const loop::ErrorSummary& p = s.position_error_km;
    const loop::ErrorSummary& v = s.velocity_error_m_s;
    for (const auto* axes : {&p.steady_3sigma_axis, &v.steady_3sigma_axis, &p.formal_3sigma_axis, &v.formal_3sigma_axis,
                             &p.end_of_coast.steady_3sigma_axis, &v.end_of_coast.steady_3sigma_axis}) {
      for (const double x : *axes) out.append(",").append(cell(x));
    }
    for (const double x :
         {p.final_rss, v.final_rss, s.nees_mean, s.nees_band_95.lo, s.nees_band_95.hi, s.nis_mean, s.nis_band_95.lo,
          s.nis_band_95.hi, s.vision.attitude_success_rate, s.vision.planet_success_rate,
          static_cast<double>(s.vision.false_planets), s.vision.centroid_error_px_1sigma,
          s.vision.planet_error_px_1sigma, s.image_ms_median, s.wall_s}) {
      out.append(",").append(cell(x));
    }
    out += ",\n";
  }
  return out;
}

std::string windows_csv(const Statistics& s) {
  std::string out = "cycle,window,beacon,samples,nees_mean,nees_band_lo,nees_band_hi,nis_mean\n";
  for (const WindowStatistics& w : s.windows) {
    out += fmt::format("{},{},{},{},{},{},{},{}\n", w.cycle, w.window, w.beacon, w.samples, cell(w.nees_mean),
                       cell(w.nees_band_95.lo), cell(w.nees_band_95.hi), cell(w.nis_mean));
  }
  return out;
}

std::string to_text(const Outcome& outcome, const Statistics& s) {
  std::string out = loop::to_text(s.pooled);
  out += fmt::format(
      "  {} samples flown{}; NIS inside its band in {}, NEES in {}; worst sample at {:.2f} (position) and {:.2f} "
      "(velocity) of its own bound\n",
      s.flown, s.failed > 0 ? fmt::format(", {} failed", s.failed) : "", s.nis_inside_band, s.nees_inside_band,
      s.worst_position_ratio, s.worst_velocity_ratio);
  if (s.flown > 1 && !s.windows.empty()) {
    out += fmt::format("  window by window, over the samples: NEES inside its band in {} of {}, mean of all {:.2f}\n",
                       s.windows_inside_band, s.windows.size(), s.nees_all_windows);
  }
  for (const Sample& sample : outcome.samples) {
    if (!sample.flown()) out += fmt::format("  seed {} failed: {}\n", sample.seed, sample.error);
  }
  return out;
}

Result<void> write_files(const std::filesystem::path& folder, const Outcome& outcome, const Statistics& s) {
  std::error_code error;
  std::filesystem::create_directories(folder, error);
  if (error) return fail(ErrorCode::io_failure, "cannot make the folder: {s}", {}, folder.string(), error.message());
  if (auto ok = write_file(folder / "samples.csv", samples_csv(outcome)); !ok) return ok;
  if (auto ok = write_file(folder / "windows.csv", windows_csv(s)); !ok) return ok;
  return write_file(folder / "summary.json", summary_json(outcome, s) + "\n");
}

}  // namespace astronav::campaign
