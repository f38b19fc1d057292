// SPDX-License-Identifier: Apache-2.0
#include "verification/report/report.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <utility>
#include <vector>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "foundation/math/statistics.h"
#include "foundation/raster/raster.h"
#include "verification/report/assets.h"
#include "verification/scenario/scenario.h"

namespace astronav::report {
namespace {

using Json = nlohmann::ordered_json;
using loop::Event;
using loop::EventKind;

constexpr std::size_t kFrameBudget = 4'500'000;  // bytes of base64 in one file

// Rounded to six significant digits, so that the page stays small; NaN becomes null.
Json short_number(double v) {
  if (!std::isfinite(v)) return nullptr;
  if (v == 0.0) return 0;
  const double unit = std::pow(10.0, std::floor(std::log10(std::abs(v))) - 5.0);
  const double rounded = std::round(v / unit) * unit;
  return std::stod(fmt::format("{:.6g}", rounded));
}

struct Axes {  // three columns
  std::array<Json, 3> columns{Json::array(), Json::array(), Json::array()};
  void add(const Vec3& v) {
    for (int i = 0; i < 3; ++i) columns[static_cast<std::size_t>(i)].push_back(short_number(v[i]));
  }
  Json take() { return Json::array({std::move(columns[0]), std::move(columns[1]), std::move(columns[2])}); }
};

std::string base64(std::string_view bytes) {
  static constexpr std::string_view kAlphabet = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  std::string out;
  out.reserve((bytes.size() + 2) / 3 * 4);
  for (std::size_t i = 0; i < bytes.size(); i += 3) {
    std::uint32_t group = 0;
    for (std::size_t k = 0; k < 3; ++k) {
      group = group << 8 | (i + k < bytes.size() ? static_cast<unsigned char>(bytes[i + k]) : 0u);
    }
    for (std::size_t k = 0; k < 4; ++k) {
      out += i + k <= bytes.size() ? kAlphabet[group >> (18 - 6 * k) & 63u] : '=';
    }
  }
  return out;
}

std::string escape_html(std::string_view text) {
  std::string out;
  for (const char c : text) {
    if (c == '<') {
      out += "&lt;";
    } else if (c == '&') {
      out += "&amp;";
    } else {
      out += c;
    }
  }
  return out;
}

// JSON inside a <script> element: no "<" may be left.
std::string script_safe(const Json& json) {
  const std::string text = json.dump(-1, ' ', false, Json::error_handler_t::replace);
  std::string out;
  out.reserve(text.size() + 64);
  for (const char c : text) {
    if (c == '<') {
      out += "\\u003c";
    } else {
      out += c;
    }
  }
  return out;
}

std::string page(std::string_view title, const Json& data) {
  const std::pair<std::string_view, std::string> parts[] = {
      {"{{title}}", escape_html(title)},
      {"{{uplot_css}}", std::string(assets::kUplotStyle)},
      {"{{style}}", std::string(assets::kStyle)},
      {"{{data}}", script_safe(data)},
      {"{{uplot_js}}", std::string(assets::kUplotScript)},
      {"{{script}}", std::string(assets::kScript)},
  };
  std::string out;
  std::string_view rest = assets::kPage;
  for (const auto& [place, text] : parts) {  // in the order of the page
    const std::size_t at = rest.find(place);
    ASTRONAV_CHECK(at != std::string_view::npos);
    out.append(rest.substr(0, at)).append(text);
    rest.remove_prefix(at + place.size());
  }
  return out.append(rest);
}

double day(const loop::Records& records, Epoch epoch) {
  return (epoch - loop::day_zero(records)).days();
}

Json bounds95(double degrees) {
  return Json::array({chi_square_quantile(0.025, degrees), chi_square_quantile(0.975, degrees)});
}

std::string beacon_name(BodyId id) {
  const std::string_view known = body_name(id);
  std::string name = known.empty() ? fmt::format("{}", id.value) : std::string(known);
  if (const auto end = name.find(" barycenter"); end != std::string::npos) name.resize(end);
  return name;
}

Json error_columns(const loop::Records& records) {
  Json days = Json::array();
  Axes position, position_sigma, velocity, velocity_sigma;
  double steady_day = std::nan("");
  double last_day = -1e300;
  for (const Event& e : records.events) {
    if (e.kind == EventKind::survey_image) continue;  // no estimate yet
    double t = std::round(day(records, e.epoch) * 1e5) / 1e5;
    if (t < last_day) continue;  // charts need increasing days
    last_day = t;
    if (e.kind == EventKind::cycle_end && e.cycle >= loop::kFirstSteadyCycle && std::isnan(steady_day)) steady_day = t;
    days.push_back(t);
    position.add((e.estimate.p_m - e.truth.p_m) * 1e-3);
    velocity.add(e.estimate.v_m_s - e.truth.v_m_s);
    const Vec6 sigma = e.covariance.diagonal().cwiseSqrt();
    position_sigma.add(sigma.head<3>() * 1e-3);
    velocity_sigma.add(sigma.tail<3>());
  }
  return {{"day", std::move(days)},
          {"position", position.take()},
          {"position_sigma", position_sigma.take()},
          {"velocity", velocity.take()},
          {"velocity_sigma", velocity_sigma.take()},
          {"steadyDay", std::isnan(steady_day) ? Json(nullptr) : Json(steady_day)}};
}

Json image_columns(const loop::Records& records) {
  Json index = Json::array(), days = Json::array(), bodies = Json::array(), stars = Json::array(),
       centroid = Json::array();
  std::array<Json, 2> innovation{Json::array(), Json::array()}, sigma{Json::array(), Json::array()},
      planet_error{Json::array(), Json::array()};
  Axes attitude_error, attitude_sigma, foretold_error, foretold_sigma;
  for (const Event& e : records.events) {
    if (e.kind != EventKind::image) continue;
    index.push_back(e.image);
    days.push_back(short_number(day(records, e.epoch)));
    bodies.push_back(beacon_name(e.body));
    for (std::size_t k = 0; k < 2; ++k) {
      const int i = static_cast<int>(k);
      innovation[k].push_back(e.accepted ? short_number(e.innovation_px[i]) : Json(nullptr));
      sigma[k].push_back(e.accepted ? short_number(std::sqrt(e.innovation_covariance_px2(i, i))) : Json(nullptr));
      planet_error[k].push_back(e.planet_found ? short_number(e.planet_error_px[i]) : Json(nullptr));
    }
    const double nan = std::nan("");
    attitude_error.add(e.attitude_found ? Vec3(e.attitude_error_rad / kArcsecond) : Vec3::Constant(nan));
    attitude_sigma.add(e.attitude_found ? Vec3(e.attitude_sigma_rad / kArcsecond) : Vec3::Constant(nan));
    const loop::AttitudeRecord& a = e.attitude;
    foretold_error.add(a.foretold ? Vec3(a.error_rad / kArcsecond) : Vec3::Constant(nan));
    foretold_sigma.add(a.foretold ? Vec3(a.sigma_rad / kArcsecond) : Vec3::Constant(nan));
    stars.push_back(e.stars_matched);
    centroid.push_back(e.centroid_error_count > 0
                           ? short_number(std::sqrt(e.centroid_error_sum2_px2 / e.centroid_error_count))
                           : Json(nullptr));
  }
  return {{"index", std::move(index)},
          {"day", std::move(days)},
          {"body", std::move(bodies)},
          {"innovation", Json::array({std::move(innovation[0]), std::move(innovation[1])})},
          {"innovation_sigma", Json::array({std::move(sigma[0]), std::move(sigma[1])})},
          {"planet_error", Json::array({std::move(planet_error[0]), std::move(planet_error[1])})},
          {"attitude_error", attitude_error.take()},
          {"attitude_sigma", attitude_sigma.take()},
          {"foretold_error", foretold_error.take()},
          {"foretold_sigma", foretold_sigma.take()},
          {"stars", std::move(stars)},
          {"centroid", std::move(centroid)}};
}

// Mean NIS of each tracking window with the 95 % band of such a mean.
Json window_columns(const loop::Records& records) {
  struct Window {
    double day = 0.0;
    std::string body;
    double nis = 0.0;
    int count = 0;
  };
  std::map<std::pair<int, int>, Window> windows;
  for (const Event& e : records.events) {
    if (e.kind != EventKind::image || !e.accepted) continue;
    Window& w = windows[{e.cycle, e.window}];
    if (w.count == 0) {
      w.day = day(records, e.epoch);
      w.body = beacon_name(e.body);
    }
    w.nis += e.nis;
    ++w.count;
  }
  Json index = Json::array(), days = Json::array(), bodies = Json::array(), nis = Json::array(), lo = Json::array(),
       hi = Json::array();
  for (const auto& [key, w] : windows) {
    const Band band = chi_square_mean_band(0.95, 2.0, w.count);
    index.push_back(2 * key.first + key.second);
    days.push_back(short_number(w.day));
    bodies.push_back(w.body);
    nis.push_back(short_number(w.nis / w.count));
    lo.push_back(short_number(band.lo));
    hi.push_back(short_number(band.hi));
  }
  return {{"index", index}, {"day", days}, {"body", bodies}, {"nis", nis}, {"lo", lo}, {"hi", hi}};
}

Json vector_au(const Vec3& p) {
  Json out = Json::array();
  for (int i = 0; i < 3; ++i) out.push_back(std::round(p[i] / kAstronomicalUnit * 1e6) / 1e6);
  return out;
}

Json beacon_list(const loop::Records& records) {
  Json out = Json::array();
  for (const loop::BeaconChoice& choice : records.beacons) {
    Json candidates = Json::array();
    for (const auto& c : choice.candidates) {
      candidates.push_back({{"name", beacon_name(c.body)},
                            {"v_mag", short_number(c.v_mag)},
                            {"sun_elongation_deg", short_number(c.sun_elongation_deg)},
                            {"distance_km", short_number(c.distance_km)},
                            {"visible", c.visible},
                            {"why_not", c.why_not}});
    }
    out.push_back({{"day", short_number(day(records, choice.epoch))},
                   {"first", beacon_name(choice.first)},
                   {"second", beacon_name(choice.second)},
                   {"figure_of_merit_km", short_number(choice.figure_of_merit_km)},
                   {"candidates", std::move(candidates)}});
  }
  return out;
}

// For the picture: one point per cycle end, coast sample and coast end.
Json orbit(const loop::Records& records) {
  Json days = Json::array(), truth = Json::array(), error = Json::array(), planets = Json::array();
  double last = -1e300;
  double steady_error = 0.0;
  double reach = 0.0;
  for (const Event& e : records.events) {
    const double t = day(records, e.epoch);
    if (e.kind == EventKind::image || e.kind == EventKind::survey_image || e.kind == EventKind::window_end || t <= last)
      continue;
    last = t;
    days.push_back(short_number(t));
    truth.push_back(vector_au(e.truth.p_m));
    Json d = Json::array();
    for (int i = 0; i < 3; ++i) d.push_back(short_number((e.estimate.p_m[i] - e.truth.p_m[i]) / kAstronomicalUnit));
    error.push_back(std::move(d));
    if (e.cycle >= loop::kFirstSteadyCycle)
      steady_error = std::max(steady_error, (e.estimate.p_m - e.truth.p_m).norm() / kAstronomicalUnit);
    reach = std::max(reach, e.truth.p_m.norm() / kAstronomicalUnit);
  }
  for (int planet = 1; planet <= 8; ++planet) {
    const auto& track = records.planet_tracks_m[planet];
    if (track.size() < 2) continue;
    Json points = Json::array();
    for (const Vec3& p : track) points.push_back(vector_au(p));
    planets.push_back({{"name", planet == 3 ? "earth" : beacon_name(BodyId{planet})}, {"track", std::move(points)}});
  }
  const bool spanned = records.end > records.begin;
  const double first = days.empty() ? 0.0 : days.front().get<double>();
  return {{"day", std::move(days)},
          {"truth", std::move(truth)},
          {"error", std::move(error)},
          {"planets", std::move(planets)},
          {"beacons", beacon_list(records)},
          {"begin", spanned ? 0.0 : first},
          {"span", std::max(1e-3, spanned ? (records.end - records.begin).days() : last - first)},
          {"exaggerate", steady_error > 0.0 ? std::clamp(0.12 / steady_error, 1.0, 1e5) : 1.0}};
}

Json frame_list(const loop::Records& records) {
  Json out = Json::array();
  std::size_t total = 0;
  for (const loop::KeptFrame& frame : records.frames) {
    if (frame.pixels.width() == 0) continue;
    const Image<std::uint8_t> bright = brighten(frame.pixels.view());
    const auto png = encode_png8(bright.view());
    if (!png) continue;
    std::string text = base64(*png);
    if (total + text.size() > kFrameBudget) continue;
    total += text.size();
    Json marks = Json::array();
    for (const auto& mark : frame.marks) {
      marks.push_back({{"u", std::round(mark.pixel.u * 1000) / 1000},
                       {"v", std::round(mark.pixel.v * 1000) / 1000},
                       {"radius", short_number(mark.radius_px)},
                       {"kind", mark.kind},
                       {"label", mark.label}});
    }
    out.push_back({{"epoch", frame.epoch.iso(TimeScale::tdb, 0)},
                   {"beacon", beacon_name(frame.beacon)},
                   {"width", frame.pixels.width()},
                   {"height", frame.pixels.height()},
                   {"png", std::move(text)},
                   {"marks", std::move(marks)}});
  }
  return out;
}

Json histogram(std::span<const double> values, int bins, double lo, double hi) {
  Json centers = Json::array(), counts = Json::array();
  std::vector<int> count(static_cast<std::size_t>(bins), 0);
  const double width = (hi - lo) / bins;
  if (!(width > 0.0)) return {{"centers", centers}, {"counts", counts}};
  for (const double v : values) {
    if (v >= lo && v <= hi) ++count[std::min(static_cast<std::size_t>((v - lo) / width), count.size() - 1)];
  }
  for (int i = 0; i < bins; ++i) {
    centers.push_back(short_number(lo + (i + 0.5) * width));
    counts.push_back(count[static_cast<std::size_t>(i)]);
  }
  return {{"centers", std::move(centers)}, {"counts", std::move(counts)}};
}

std::string mission_name(std::string_view scenario_toml) {
  const auto draft = scenario::Draft::parse(scenario_toml, "scenario");
  const auto s = draft ? draft->resolve(1) : Result<scenario::Scenario>(forward(draft));
  return s && !s->mission.name.empty() ? s->mission.name : "mission";
}

}  // namespace

Image<std::uint8_t> brighten(ImageView<const std::uint16_t> frame) {
  std::vector<double> sample;
  const int step = std::max(1, frame.width() * frame.height() / 40000);
  for (int i = 0; i < frame.width() * frame.height(); i += step)
    sample.push_back(frame(i % frame.width(), i / frame.width()));
  const double background = median(sample);
  for (double& v : sample) v = std::abs(v - background);
  const double noise = std::max(1.0, 1.4826 * median(sample));
  // The noise is kept just visible; a pixel of 400 sigma is white.
  const double white = std::asinh(400.0 / 6.0);
  Image<std::uint8_t> out(frame.width(), frame.height());
  for (int v = 0; v < frame.height(); ++v) {
    for (int u = 0; u < frame.width(); ++u) {
      const double x = std::max(0.0, (frame(u, v) - background) / noise - 1.0);
      out(u, v) = static_cast<std::uint8_t>(std::lround(std::min(255.0, 8.0 + 247.0 * std::asinh(x / 6.0) / white)));
    }
  }
  return out;
}

std::string mission_html(const loop::Records& records, const loop::Summary& summary) {
  const std::string name = mission_name(records.scenario_toml);
  Json cycle_days = Json::array(), nees = Json::array();
  for (const Event& e : records.events) {
    if (e.kind != EventKind::cycle_end) continue;
    cycle_days.push_back(short_number(day(records, e.epoch)));
    nees.push_back(short_number(e.nees));
  }
  const double fastest = records.image_ms.empty() ? 0.0 : quantile(records.image_ms, 0.0);
  const double slowest = records.image_ms.empty() ? 0.0 : quantile(records.image_ms, 0.995);
  const Epoch begin = loop::day_zero(records);
  const Epoch end = records.end > records.begin ? records.end
                    : records.events.empty()    ? begin
                                                : records.events.back().epoch;
  const Json data = {
      {"kind", "mission"},
      {"title", name},
      {"words", loop::in_words(summary)},
      {"span_text", fmt::format("{} to {}, {:.0f} days", begin.iso(TimeScale::tdb, 0, false).substr(0, 10),
                                end.iso(TimeScale::tdb, 0, false).substr(0, 10), summary.duration_days)},
      {"summary", Json::parse(loop::to_json(summary, -1))},
      {"errors", error_columns(records)},
      {"cycle", {{"day", std::move(cycle_days)}, {"nees", std::move(nees)}}},
      {"nees_bounds", bounds95(6.0)},
      {"window", window_columns(records)},
      {"images", image_columns(records)},
      {"orbit", orbit(records)},
      {"beacons", beacon_list(records)},
      {"frames", frame_list(records)},
      {"image_ms", histogram(records.image_ms, 40, fastest, slowest)},
      {"scenario", records.scenario_toml},
  };
  return page(fmt::format("astronav: {}, {}, seed {}", name, summary.level, summary.seed), data);
}

std::string campaign_html(const campaign::Outcome& outcome, const campaign::Statistics& statistics) {
  Json runs = Json::array(), samples = Json::array(), failed = Json::array();
  std::array<std::vector<double>, 3> normalised;
  // The mean bound of the filters, cycle by cycle of the first run that flew.
  std::vector<campaign::WindowError> formal;
  std::vector<int> formal_count;
  double steady_day = std::nan("");
  for (const campaign::Sample& sample : outcome.samples) {
    if (!sample.flown()) {
      failed.push_back({{"seed", sample.seed}, {"error", sample.error}});
      continue;
    }
    samples.push_back(Json::parse(loop::to_json(sample.summary, -1)));
    Json days = Json::array();
    Axes position, velocity;
    for (std::size_t k = 0; k < sample.windows.size(); ++k) {
      const campaign::WindowError& w = sample.windows[k];
      days.push_back(std::round(w.day * 1e4) / 1e4);
      position.add(Vec3(w.position_km[0], w.position_km[1], w.position_km[2]));
      velocity.add(Vec3(w.velocity_m_s[0], w.velocity_m_s[1], w.velocity_m_s[2]));
      if (k >= formal.size()) {
        formal.push_back({.day = w.day});
        formal_count.push_back(0);
      }
      ++formal_count[k];
      if (k == static_cast<std::size_t>(loop::kFirstSteadyCycle) && std::isnan(steady_day)) steady_day = w.day;
      for (std::size_t i = 0; i < 3; ++i) {
        formal[k].position_sigma_km[i] += w.position_sigma_km[i] * w.position_sigma_km[i];
        formal[k].velocity_sigma_m_s[i] += w.velocity_sigma_m_s[i] * w.velocity_sigma_m_s[i];
        if (k >= static_cast<std::size_t>(loop::kFirstSteadyCycle))
          normalised[i].push_back(w.position_km[i] / w.position_sigma_km[i]);
      }
    }
    runs.push_back({{"seed", sample.seed},
                    {"day", std::move(days)},
                    {"position", position.take()},
                    {"velocity", velocity.take()}});
  }
  Json formal_days = Json::array();
  Axes position_sigma, velocity_sigma;
  for (std::size_t k = 0; k < formal.size(); ++k) {
    formal_days.push_back(std::round(formal[k].day * 1e4) / 1e4);
    Vec3 p, v;
    for (std::size_t i = 0; i < 3; ++i) {
      p[static_cast<int>(i)] = std::sqrt(formal[k].position_sigma_km[i] / formal_count[k]);
      v[static_cast<int>(i)] = std::sqrt(formal[k].velocity_sigma_m_s[i] / formal_count[k]);
    }
    position_sigma.add(p);
    velocity_sigma.add(v);
  }
  constexpr int kBins = 32;
  Json normalised_json, counts = Json::array(), expected = Json::array();
  for (std::size_t i = 0; i < 3; ++i) {
    Json bins = histogram(normalised[i], kBins, -4.0, 4.0);
    normalised_json["centers"] = bins["centers"];
    counts.push_back(bins["counts"]);
  }
  for (int i = 0; i < kBins; ++i) {
    const double x = -4.0 + (i + 0.5) * 8.0 / kBins;
    expected.push_back(short_number(static_cast<double>(normalised[0].size()) * 8.0 / kBins * std::exp(-0.5 * x * x) /
                                    std::sqrt(2.0 * kPi)));
  }
  normalised_json["counts"] = std::move(counts);
  normalised_json["expected"] = std::move(expected);
  const Json summary = Json::parse(campaign::summary_json(outcome, statistics));
  const Json data = {
      {"kind", "campaign"},
      {"title", outcome.identity.name},
      {"words", loop::in_words(statistics.pooled)},
      {"first_seed", outcome.identity.first_seed},
      {"summary", summary},
      {"confidence", summary["confidence_95"]},
      {"confidence_method", summary["confidence_method"]},
      {"runs", std::move(runs)},
      {"samples", std::move(samples)},
      {"failed", std::move(failed)},
      {"formal",
       {{"day", std::move(formal_days)},
        {"position_sigma", position_sigma.take()},
        {"velocity_sigma", velocity_sigma.take()},
        {"steadyDay", short_number(steady_day)}}},
      {"normalised", std::move(normalised_json)},
      {"scenario", outcome.identity.scenario_toml},
  };
  return page(fmt::format("astronav: campaign {}, {}", outcome.identity.name, outcome.identity.level), data);
}

}  // namespace astronav::report
