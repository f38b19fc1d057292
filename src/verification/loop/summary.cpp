// SPDX-License-Identifier: Apache-2.0
#include "verification/loop/summary.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <fmt/format.h>
#include <fmt/ranges.h>
#include <nlohmann/json.hpp>

#include "verification/loop/attitude_summary.h"

namespace astronav::loop {
namespace {

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
constexpr double kSunGm = 1.32712440041279419e20;  // m3/s2, DE440

double ratio(double a, double b) {
  return b > 0.0 ? a / b : kNan;
}
double root_mean(double sum2, double count) {
  return count > 0.0 ? std::sqrt(sum2 / count) : kNan;
}

// Errors and formal sigmas of three components, `offset` 0 for position and 3 for velocity, in the unit of `scale`.
ErrorFigures error_figures(std::span<const Event* const> steady, const Event* last, int offset, double scale) {
  const auto error = [&](const Event& e) -> Vec3 {
    return (offset == 0 ? Vec3(e.estimate.p_m - e.truth.p_m) : Vec3(e.estimate.v_m_s - e.truth.v_m_s)) * scale;
  };
  ErrorFigures out;
  out.final_rss = last == nullptr ? kNan : error(*last).norm();
  Vec3 sum2 = Vec3::Zero();
  Vec3 formal2 = Vec3::Zero();
  for (const Event* e : steady) {
    sum2 += error(*e).cwiseAbs2();
    formal2 += e->covariance.diagonal().segment<3>(offset) * scale * scale;
  }
  const auto count = static_cast<double>(steady.size());
  out.steady_rms_rss = root_mean(sum2.sum(), count);
  for (int i = 0; i < 3; ++i) {
    out.steady_3sigma_axis[static_cast<std::size_t>(i)] = 3.0 * root_mean(sum2[i], count);
    out.formal_3sigma_axis[static_cast<std::size_t>(i)] = 3.0 * root_mean(formal2[i], count);
  }
  return out;
}

// A mission that found its start late settles late.
int first_steady(const Records& records) {
  return records.start.cycle + kFirstSteadyCycle;
}

std::vector<const Event*> steady_events(const Records& records, EventKind kind, const Event** last = nullptr) {
  std::vector<const Event*> out;
  for (const Event& e : records.events) {
    if (e.kind != kind) continue;
    if (last != nullptr) *last = &e;
    if (e.cycle >= first_steady(records)) out.push_back(&e);
  }
  return out;
}

Band mean_band(double degrees, double count) {
  return count > 0.0 ? chi_square_mean_band(0.95, degrees, count) : Band{kNan, kNan};
}

// State transition matrix of the Sun's gravity along the straight line of truth between two events (the curvature of
// the path over a cycle changes the gradient by less than the correlation is known).
Mat6 transition(const Event& from, const Event& to) {
  const double total = (to.epoch - from.epoch).seconds();
  const int steps = std::max(1, static_cast<int>(std::ceil(total / 43200.0)));
  const double dt = total / steps;
  const auto derivative = [&](double t, const Mat6& phi) {
    const Vec3 p = from.truth.p_m + (to.truth.p_m - from.truth.p_m) * (total > 0.0 ? t / total : 0.0);
    const double r2 = p.squaredNorm();
    const double r = std::sqrt(r2);
    const Mat3 gradient = kSunGm / (r2 * r) * (3.0 / r2 * p * p.transpose() - Mat3::Identity());
    Mat6 out;
    out.topRows<3>() = phi.bottomRows<3>();
    out.bottomRows<3>() = gradient * phi.topRows<3>();
    return out;
  };
  Mat6 phi = Mat6::Identity();
  for (int k = 0; k < steps; ++k) {
    const double t = k * dt;
    const Mat6 k1 = derivative(t, phi);
    const Mat6 k2 = derivative(t + 0.5 * dt, phi + 0.5 * dt * k1);
    const Mat6 k3 = derivative(t + 0.5 * dt, phi + 0.5 * dt * k2);
    const Mat6 k4 = derivative(t + dt, phi + dt * k3);
    phi += dt / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4);
  }
  return phi;
}

// L^-1 with P = L L', of a covariance whose position and velocity parts differ by many orders of magnitude.
Mat6 whitener(const Mat6& covariance) {
  const Vec6 scale = covariance.diagonal().cwiseSqrt().cwiseInverse();
  const Mat6 correlation = scale.asDiagonal() * covariance * scale.asDiagonal();
  return Mat6(correlation.llt().matrixL()).inverse() * scale.asDiagonal();
}

}  // namespace

double effective_windows(const Records& records) {
  struct Window {
    const Event* end;
    const Event* coast_end = nullptr;  // of the coast that follows
  };
  std::vector<Window> windows;
  for (const Event& e : records.events) {
    if (e.cycle < first_steady(records)) continue;
    if (e.kind == EventKind::cycle_end) windows.push_back({&e});
    if (e.kind == EventKind::coast_end && !windows.empty()) windows.back().coast_end = &e;
  }
  const std::size_t n = windows.size();
  if (n == 0) return 0.0;
  // step[k]: how the whitened error of window k enters that of window k + 1.
  std::vector<Mat6> step;
  for (std::size_t k = 0; k + 1 < n; ++k) {
    const Event* prior = windows[k].coast_end;
    if (prior == nullptr) {
      step.push_back(Mat6::Zero());
      continue;
    }
    const Event& from = *windows[k].end;
    const Event& to = *windows[k + 1].end;
    const Mat6 through_window = transition(*prior, to);
    const Mat6 before = through_window * prior->covariance * through_window.transpose();
    const Mat6 whiten_before = whitener(before);
    const Mat6 keep = to.covariance * whiten_before.transpose() * whiten_before;  // I - K H
    const Mat6 colour_from = whitener(from.covariance).inverse();
    step.push_back(whitener(to.covariance) * keep * through_window * transition(from, *prior) * colour_from);
  }
  // Variance of the mean of n NEES values, each of variance 12.
  double sum = 6.0 * static_cast<double>(n);
  for (std::size_t j = 0; j < n; ++j) {
    Mat6 correlation = Mat6::Identity();
    for (std::size_t k = j + 1; k < n; ++k) {
      correlation = step[k - 1] * correlation;
      sum += 2.0 * correlation.squaredNorm();
    }
  }
  const double count = static_cast<double>(n);
  return std::clamp(6.0 * count * count / sum, 1.0, count);
}

Epoch day_zero(const Records& records) {
  return records.end > records.begin || records.events.empty() ? records.begin : records.events.front().epoch;
}

namespace {

StartSummary summarize(const StartRecord& start) {
  StartSummary s;
  s.from = start.from;
  s.cycle = start.cycle + 1;
  s.surveys = start.surveys;
  s.pictures = start.pictures;
  for (const BodyId body : start.named) s.planets.emplace_back(body_name(body));
  const bool surveyed = start.surveys > 0;
  s.survey_error_km = surveyed ? start.survey_error_m.norm() * 1e-3 : kNan;
  s.survey_sigma_km = surveyed ? std::sqrt(start.survey_covariance_m2.trace()) * 1e-3 : kNan;
  s.position_error_km = start.error.head<3>().norm() * 1e-3;
  s.velocity_error_m_s = start.error.tail<3>().norm();
  s.position_sigma_km = std::sqrt(start.covariance.topLeftCorner<3, 3>().trace()) * 1e-3;
  s.velocity_sigma_m_s = std::sqrt(start.covariance.bottomRightCorner<3, 3>().trace());
  return s;
}

}  // namespace

Summary summarize(const Records& records) {
  Summary s;
  s.start = summarize(records.start);
  s.level = records.level;
  s.version = records.version;
  s.seed = records.seed;
  s.sample = records.sample;
  s.cycles = records.cycles;
  s.images = records.images;
  s.duration_days = records.duration_days;
  s.peak_memory_mb = records.peak_memory_mb;
  s.wall_s = records.wall_s;

  const Event* last_cycle = nullptr;
  const Event* last_coast = nullptr;
  const auto steady = steady_events(records, EventKind::cycle_end, &last_cycle);
  const auto coast = steady_events(records, EventKind::coast_end, &last_coast);
  s.steady_count = static_cast<int>(steady.size());
  s.coast_count = static_cast<int>(coast.size());
  static_cast<ErrorFigures&>(s.position_error_km) = error_figures(steady, last_cycle, 0, 1e-3);
  static_cast<ErrorFigures&>(s.velocity_error_m_s) = error_figures(steady, last_cycle, 3, 1.0);
  s.position_error_km.end_of_coast = error_figures(coast, last_coast, 0, 1e-3);
  s.velocity_error_m_s.end_of_coast = error_figures(coast, last_coast, 3, 1.0);

  double nees = 0.0;
  for (const Event* e : steady) nees += e->nees;
  // Without noise errors say nothing of a covariance.
  const bool noisy = records.level != "cov";
  s.nees_mean = noisy ? ratio(nees, s.steady_count) : kNan;
  s.nees_effective_count = effective_windows(records);
  s.nees_band_95 = mean_band(6.0, s.nees_effective_count);

  double nis = 0.0;
  double centroid2 = 0.0, planet2 = 0.0, cross2 = 0.0, roll2 = 0.0;
  int attitudes = 0, planets = 0;
  for (const Event& e : records.events) {
    if (e.kind != EventKind::image) continue;
    if (e.accepted) {
      nis += e.nis;
      ++s.nis_count;
    } else if (e.planet_found && !e.for_start) {
      ++s.edited_count;
    }
    centroid2 += e.centroid_error_sum2_px2;
    s.centroid_count += e.centroid_error_count;
    if (e.attitude_found && !e.attitude_wrong) {
      ++attitudes;
      cross2 += e.attitude_error_rad.head<2>().squaredNorm();
      roll2 += e.attitude_error_rad.z() * e.attitude_error_rad.z();
    }
    if (e.planet_found && e.planet_false) ++s.vision.false_planets;
    if (e.planet_found && !e.planet_false) {
      ++planets;
      planet2 += e.planet_error_px.squaredNorm();
    }
  }
  s.nis_mean = noisy ? ratio(nis, s.nis_count) : kNan;
  s.nis_band_95 = mean_band(2.0, s.nis_count);
  s.attitude_count = attitudes;
  s.planet_count = planets;
  const bool pictures = records.level == "sil";
  s.vision.attitude_success_rate = pictures ? ratio(attitudes, records.images) : kNan;
  s.vision.planet_success_rate = pictures ? ratio(planets, records.images) : kNan;
  s.vision.centroid_error_px_1sigma = root_mean(centroid2, s.centroid_count);
  s.vision.planet_error_px_1sigma = noisy ? root_mean(planet2, 2.0 * planets) : kNan;
  s.vision.attitude_cross_arcsec_1sigma = pictures ? root_mean(cross2, 2.0 * attitudes) / kArcsecond : kNan;
  s.vision.attitude_roll_arcsec_1sigma = pictures ? root_mean(roll2, attitudes) / kArcsecond : kNan;

  s.attitude_filter = summarize_attitude_filter(records);

  s.image_ms_median = median(records.image_ms);
  s.image_ms_p99 = quantile(records.image_ms, 0.99);
  const StageTimes& t = records.stage_ms_sum;
  const double images = records.images;
  s.stage_ms = {ratio(t.render, images),  ratio(t.centroid, images),  ratio(t.identify, images),
                ratio(t.planets, images), ratio(t.propagate, images), ratio(t.update, images)};
  return s;
}

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

// The figures of a start, by their names in summary.json.
struct StartFigure {
  const char* name;
  double StartSummary::*value;
};
constexpr StartFigure kStartFigures[] = {{"survey_error_km", &StartSummary::survey_error_km},
                                         {"survey_sigma_km", &StartSummary::survey_sigma_km},
                                         {"position_error_km", &StartSummary::position_error_km},
                                         {"position_sigma_km", &StartSummary::position_sigma_km},
                                         {"velocity_error_m_s", &StartSummary::velocity_error_m_s},
                                         {"velocity_sigma_m_s", &StartSummary::velocity_sigma_m_s}};

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
  return j.is_null() ? kNan : j.get<double>();
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
