// SPDX-License-Identifier: Apache-2.0
#include "verification/loop/summary.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include <Eigen/Cholesky>
#include <Eigen/LU>

#include "verification/loop/attitude_summary.h"
#include "verification/loop/summary_figures.h"

namespace astronav::loop {
namespace {

constexpr double kSunGm = 1.32712440041279419e20;  // m3/s2, DE440

// Errors and formal sigmas of three components, `offset` 0 for position and 3 for velocity, in the unit of `scale`.
ErrorFigures error_figures(std::span<const Event* const> steady, const Event* last, int offset, double scale) {
  const auto error = [&](const Event& e) -> Vec3 {
    return (offset == 0 ? Vec3(e.estimate.p_m - e.truth.p_m) : Vec3(e.estimate.v_m_s - e.truth.v_m_s)) * scale;
  };
  ErrorFigures out;
  out.final_rss = last == nullptr ? kNoFigure : error(*last).norm();
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

Records afterwards(const Records& records) {
  Records out;
  out.start = records.start;
  out.events = records.smoothed;
  out.begin = records.begin;
  out.end = records.end;
  out.cycles = records.cycles;
  out.duration_days = records.duration_days;
  out.level = records.level;
  out.seed = records.seed;
  out.sample = records.sample;
  out.version = records.version;
  return out;
}

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
  s.survey_error_km = surveyed ? start.survey_error_m.norm() * 1e-3 : kNoFigure;
  s.survey_sigma_km = surveyed ? std::sqrt(start.survey_covariance_m2.trace()) * 1e-3 : kNoFigure;
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
  s.nees_mean = noisy ? ratio(nees, s.steady_count) : kNoFigure;
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
  s.nis_mean = noisy ? ratio(nis, s.nis_count) : kNoFigure;
  s.nis_band_95 = mean_band(2.0, s.nis_count);
  s.attitude_count = attitudes;
  s.planet_count = planets;
  const bool pictures = records.level == "sil";
  s.vision.attitude_success_rate = pictures ? ratio(attitudes, records.images) : kNoFigure;
  s.vision.planet_success_rate = pictures ? ratio(planets, records.images) : kNoFigure;
  s.vision.centroid_error_px_1sigma = root_mean(centroid2, s.centroid_count);
  s.vision.planet_error_px_1sigma = noisy ? root_mean(planet2, 2.0 * planets) : kNoFigure;
  s.vision.attitude_cross_arcsec_1sigma = pictures ? root_mean(cross2, 2.0 * attitudes) / kArcsecond : kNoFigure;
  s.vision.attitude_roll_arcsec_1sigma = pictures ? root_mean(roll2, attitudes) / kArcsecond : kNoFigure;

  s.attitude_filter = summarize_attitude_filter(records);

  s.image_ms_median = median(records.image_ms);
  s.image_ms_p99 = quantile(records.image_ms, 0.99);
  const StageTimes& t = records.stage_ms_sum;
  const double images = records.images;
  s.stage_ms = {ratio(t.render, images),  ratio(t.centroid, images),  ratio(t.identify, images),
                ratio(t.planets, images), ratio(t.propagate, images), ratio(t.update, images)};
  return s;
}

}  // namespace astronav::loop
