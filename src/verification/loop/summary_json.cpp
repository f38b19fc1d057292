// SPDX-License-Identifier: Apache-2.0
// Summary to and from summary.json.
#include <nlohmann/json.hpp>

#include "verification/loop/attitude_summary.h"
#include "verification/loop/summary.h"
#include "verification/loop/summary_figures.h"

namespace astronav::loop {
namespace {

using Json = nlohmann::ordered_json;  // NaN is written as null

Json figures_json(const ErrorFigures& f) {
  return {{"final_rss", f.final_rss},
          {"steady_rms_rss", f.steady_rms_rss},
          {"steady_3sigma_axis", f.steady_3sigma_axis},
          {"formal_3sigma_axis", f.formal_3sigma_axis}};
}

Json errors_json(const ErrorSummary& e) {
  Json out = figures_json(e);
  out["end_of_coast"] = figures_json(e.end_of_coast);
  return out;
}

Json start_json(const StartSummary& s) {
  Json out = {
      {"from", s.from}, {"cycle", s.cycle}, {"surveys", s.surveys}, {"pictures", s.pictures}, {"planets", s.planets}};
  for (const auto& [name, value] : kStartFigures) out[name] = s.*value;
  return out;
}

double real(const Json& j) {
  return j.is_null() ? kNoFigure : j.get<double>();
}

ErrorFigures figures_from(const Json& j) {
  ErrorFigures f;
  f.final_rss = real(j.at("final_rss"));
  f.steady_rms_rss = real(j.at("steady_rms_rss"));
  for (std::size_t i = 0; i < 3; ++i) {
    f.steady_3sigma_axis[i] = real(j.at("steady_3sigma_axis").at(i));
    f.formal_3sigma_axis[i] = real(j.at("formal_3sigma_axis").at(i));
  }
  return f;
}

ErrorSummary errors_from(const Json& j) {
  ErrorSummary e;
  static_cast<ErrorFigures&>(e) = figures_from(j);
  e.end_of_coast = figures_from(j.at("end_of_coast"));
  return e;
}

StartSummary start_from(const Json& j) {
  StartSummary s;
  s.from = j.at("from").get<std::string>();
  s.cycle = j.at("cycle").get<int>();
  s.surveys = j.at("surveys").get<int>();
  s.pictures = j.at("pictures").get<int>();
  s.planets = j.at("planets").get<std::vector<std::string>>();
  for (const auto& [name, value] : kStartFigures) s.*value = real(j.at(name));
  return s;
}

Band band_from(const Json& j) {
  return {real(j.at(0)), real(j.at(1))};
}

}  // namespace

std::string to_json(const Summary& s, int indent) {
  const Json j = {
      {"level", s.level},
      {"seed", s.seed},
      {"sample", s.sample},
      {"version", s.version},
      {"runs", s.runs},
      {"cycles", s.cycles},
      {"images", s.images},
      {"duration_days", s.duration_days},
      {"start", start_json(s.start)},
      {"position_error_km", errors_json(s.position_error_km)},
      {"velocity_error_m_s", errors_json(s.velocity_error_m_s)},
      {"nees_mean", s.nees_mean},
      {"nees_band_95", Json::array({s.nees_band_95.lo, s.nees_band_95.hi})},
      {"nis_mean", s.nis_mean},
      {"nis_band_95", Json::array({s.nis_band_95.lo, s.nis_band_95.hi})},
      {"vision",
       {{"attitude_success_rate", s.vision.attitude_success_rate},
        {"planet_success_rate", s.vision.planet_success_rate},
        {"false_planets", s.vision.false_planets},
        {"centroid_error_px_1sigma", s.vision.centroid_error_px_1sigma},
        {"planet_error_px_1sigma", s.vision.planet_error_px_1sigma},
        {"attitude_error_arcsec_1sigma",
         {{"cross", s.vision.attitude_cross_arcsec_1sigma}, {"roll", s.vision.attitude_roll_arcsec_1sigma}}}}},
      {"attitude_filter", attitude_filter_json(s.attitude_filter)},
      {"time_ms_per_image", {{"median", s.image_ms_median}, {"p99", s.image_ms_p99}}},
      {"time_ms",
       {{"render", s.stage_ms.render},
        {"centroid", s.stage_ms.centroid},
        {"identify", s.stage_ms.identify},
        {"planets", s.stage_ms.planets},
        {"propagate", s.stage_ms.propagate},
        {"update", s.stage_ms.update}}},
      {"peak_memory_mb", s.peak_memory_mb},
      {"wall_s", s.wall_s},
      {"counts",
       {{"steady_windows", s.steady_count},
        {"coasts", s.coast_count},
        {"nees_effective", s.nees_effective_count},
        {"measurements_accepted", s.nis_count},
        {"measurements_edited", s.edited_count},
        {"centroid_components", s.centroid_count},
        {"planets", s.planet_count},
        {"attitudes", s.attitude_count}}},
  };
  return j.dump(indent);
}

Result<Summary> summary_from_json(std::string_view text, std::string_view name_for_errors) {
  try {
    const Json j = Json::parse(text);
    Summary s;
    s.level = j.at("level").get<std::string>();
    s.version = j.at("version").get<std::string>();
    s.seed = j.at("seed").get<std::uint64_t>();
    s.sample = j.at("sample").get<std::uint64_t>();
    s.runs = j.at("runs").get<int>();
    s.cycles = j.at("cycles").get<int>();
    s.images = j.at("images").get<int>();
    s.duration_days = real(j.at("duration_days"));
    s.start = start_from(j.at("start"));
    s.position_error_km = errors_from(j.at("position_error_km"));
    s.velocity_error_m_s = errors_from(j.at("velocity_error_m_s"));
    s.nees_mean = real(j.at("nees_mean"));
    s.nees_band_95 = band_from(j.at("nees_band_95"));
    s.nis_mean = real(j.at("nis_mean"));
    s.nis_band_95 = band_from(j.at("nis_band_95"));
    const Json& v = j.at("vision");
    s.vision.attitude_success_rate = real(v.at("attitude_success_rate"));
    s.vision.planet_success_rate = real(v.at("planet_success_rate"));
    s.vision.false_planets = v.at("false_planets").get<int>();
    s.vision.centroid_error_px_1sigma = real(v.at("centroid_error_px_1sigma"));
    s.vision.planet_error_px_1sigma = real(v.at("planet_error_px_1sigma"));
    s.vision.attitude_cross_arcsec_1sigma = real(v.at("attitude_error_arcsec_1sigma").at("cross"));
    s.vision.attitude_roll_arcsec_1sigma = real(v.at("attitude_error_arcsec_1sigma").at("roll"));
    s.attitude_filter = attitude_filter_from(j.at("attitude_filter"));
    s.image_ms_median = real(j.at("time_ms_per_image").at("median"));
    s.image_ms_p99 = real(j.at("time_ms_per_image").at("p99"));
    const Json& t = j.at("time_ms");
    s.stage_ms = {real(t.at("render")),  real(t.at("centroid")),  real(t.at("identify")),
                  real(t.at("planets")), real(t.at("propagate")), real(t.at("update"))};
    s.peak_memory_mb = real(j.at("peak_memory_mb"));
    s.wall_s = real(j.at("wall_s"));
    const Json& c = j.at("counts");
    s.steady_count = c.at("steady_windows").get<int>();
    s.coast_count = c.at("coasts").get<int>();
    s.nees_effective_count = real(c.at("nees_effective"));
    s.nis_count = c.at("measurements_accepted").get<int>();
    s.edited_count = c.at("measurements_edited").get<int>();
    s.centroid_count = c.at("centroid_components").get<int>();
    s.planet_count = c.at("planets").get<int>();
    s.attitude_count = c.at("attitudes").get<int>();
    return s;
  } catch (const nlohmann::json::exception& e) {
    return fail(ErrorCode::corrupt_data, "not a summary: {s}", {}, name_for_errors, e.what());
  }
}

}  // namespace astronav::loop
