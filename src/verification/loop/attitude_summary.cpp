// SPDX-License-Identifier: Apache-2.0
#include "verification/loop/attitude_summary.h"

#include <cmath>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "verification/loop/summary_figures.h"

namespace astronav::loop {
namespace {

using Json = nlohmann::ordered_json;

struct MeanSquare {
  double sum2 = 0.0;
  double count = 0.0;
  void add(double square, double weight) {
    if (std::isnan(square) || !(weight > 0.0)) return;
    sum2 += square * weight;
    count += weight;
  }
  double mean() const { return count > 0.0 ? sum2 / count : kNoFigure; }
  double rms() const { return std::sqrt(mean()); }
};

Band band(int count) {
  return count > 0 ? chi_square_mean_band(0.95, 3.0, count) : Band{kNoFigure, kNoFigure};
}

Json band_json(const Band& b) {
  return Json::array({b.lo, b.hi});
}

double real(const Json& j) {
  return j.is_null() ? kNoFigure : j.get<double>();
}

}  // namespace

AttitudeFilterSummary summarize_attitude_filter(const Records& records) {
  AttitudeFilterSummary s;
  MeanSquare cross, roll, slew_cross, slew_roll, nees, nis, bias;
  const Event* last = nullptr;
  int by_prior = 0;
  // The bias as it was known when a cycle's last image was through.
  const auto close_cycle = [&] {
    if (last == nullptr || !last->attitude.knows_bias) return;
    ++s.biases;
    bias.add(last->attitude.bias_error_rad_s.squaredNorm() / 3.0, 1.0);
  };
  for (const Event& e : records.events) {
    if (e.kind != EventKind::image) continue;
    if (last != nullptr && last->cycle != e.cycle) close_cycle();
    last = &e;
    by_prior += e.by_prior && e.attitude_found && !e.attitude_wrong;
    const AttitudeRecord& a = e.attitude;
    if (a.foretold) {
      ++s.foretold;
      s.slews += a.after_slew;
      (a.after_slew ? slew_cross : cross).add(a.error_rad.head<2>().squaredNorm() / 2.0, 1.0);
      (a.after_slew ? slew_roll : roll).add(a.error_rad.z() * a.error_rad.z(), 1.0);
      nees.add(a.nees, 1.0);
    }
    if (a.accepted) {
      ++s.accepted;
      nis.add(a.nis, 1.0);
    }
    s.restarts += a.restarted;
  }
  close_cycle();
  s.by_prior_rate =
      records.level == "sil" && records.images > 0 ? static_cast<double>(by_prior) / records.images : kNoFigure;
  s.cross_arcsec_1sigma = cross.rms() / kArcsecond;
  s.roll_arcsec_1sigma = roll.rms() / kArcsecond;
  s.slew_cross_arcsec_1sigma = slew_cross.rms() / kArcsecond;
  s.slew_roll_arcsec_1sigma = slew_roll.rms() / kArcsecond;
  s.nees_mean = nees.mean();
  s.nees_band_95 = band(s.foretold);
  s.nis_mean = nis.mean();
  s.nis_band_95 = band(s.accepted);
  s.bias_error_deg_h_1sigma = bias.rms() * 3600.0 / kDegree;
  return s;
}

AttitudeFilterSummary pool_attitude_filter(std::span<const Summary> runs) {
  AttitudeFilterSummary s;
  MeanSquare by_prior, cross, roll, slew_cross, slew_roll, nees, nis, bias;
  const auto square = [](double x) { return x * x; };
  for (const Summary& run : runs) {
    const AttitudeFilterSummary& r = run.attitude_filter;
    s.foretold += r.foretold;
    s.slews += r.slews;
    s.accepted += r.accepted;
    s.biases += r.biases;
    s.restarts += r.restarts;
    by_prior.add(r.by_prior_rate, run.images);
    cross.add(square(r.cross_arcsec_1sigma), r.foretold - r.slews);
    roll.add(square(r.roll_arcsec_1sigma), r.foretold - r.slews);
    slew_cross.add(square(r.slew_cross_arcsec_1sigma), r.slews);
    slew_roll.add(square(r.slew_roll_arcsec_1sigma), r.slews);
    nees.add(r.nees_mean, r.foretold);
    nis.add(r.nis_mean, r.accepted);
    bias.add(square(r.bias_error_deg_h_1sigma), r.biases);
  }
  s.by_prior_rate = by_prior.mean();
  s.cross_arcsec_1sigma = cross.rms();
  s.roll_arcsec_1sigma = roll.rms();
  s.slew_cross_arcsec_1sigma = slew_cross.rms();
  s.slew_roll_arcsec_1sigma = slew_roll.rms();
  s.nees_mean = nees.mean();
  s.nees_band_95 = band(s.foretold);
  s.nis_mean = nis.mean();
  s.nis_band_95 = band(s.accepted);
  s.bias_error_deg_h_1sigma = bias.rms();
  return s;
}

nlohmann::ordered_json attitude_filter_json(const AttitudeFilterSummary& s) {
  return {{"by_prior_rate", s.by_prior_rate},
          {"between_images_arcsec_1sigma", {{"cross", s.cross_arcsec_1sigma}, {"roll", s.roll_arcsec_1sigma}}},
          {"after_slew_arcsec_1sigma", {{"cross", s.slew_cross_arcsec_1sigma}, {"roll", s.slew_roll_arcsec_1sigma}}},
          {"nees_mean", s.nees_mean},
          {"nees_band_95", band_json(s.nees_band_95)},
          {"nis_mean", s.nis_mean},
          {"nis_band_95", band_json(s.nis_band_95)},
          {"gyro_bias_error_deg_h_1sigma", s.bias_error_deg_h_1sigma},
          {"restarts", s.restarts},
          {"counts", {{"foretold", s.foretold}, {"slews", s.slews}, {"accepted", s.accepted}, {"biases", s.biases}}}};
}

AttitudeFilterSummary attitude_filter_from(const nlohmann::ordered_json& j) {
  AttitudeFilterSummary s;
  s.by_prior_rate = real(j.at("by_prior_rate"));
  s.cross_arcsec_1sigma = real(j.at("between_images_arcsec_1sigma").at("cross"));
  s.roll_arcsec_1sigma = real(j.at("between_images_arcsec_1sigma").at("roll"));
  s.slew_cross_arcsec_1sigma = real(j.at("after_slew_arcsec_1sigma").at("cross"));
  s.slew_roll_arcsec_1sigma = real(j.at("after_slew_arcsec_1sigma").at("roll"));
  s.nees_mean = real(j.at("nees_mean"));
  s.nees_band_95 = {real(j.at("nees_band_95").at(0)), real(j.at("nees_band_95").at(1))};
  s.nis_mean = real(j.at("nis_mean"));
  s.nis_band_95 = {real(j.at("nis_band_95").at(0)), real(j.at("nis_band_95").at(1))};
  s.bias_error_deg_h_1sigma = real(j.at("gyro_bias_error_deg_h_1sigma"));
  s.restarts = j.at("restarts").get<int>();
  s.foretold = j.at("counts").at("foretold").get<int>();
  s.slews = j.at("counts").at("slews").get<int>();
  s.accepted = j.at("counts").at("accepted").get<int>();
  s.biases = j.at("counts").at("biases").get<int>();
  return s;
}

std::string attitude_filter_in_words(const AttitudeFilterSummary& s) {
  if (s.foretold == 0) return {};
  return fmt::format(
      "  attitude by gyro and frames: {:.4g} % of the images found by it; off by {:.0f} arcsec from image to image and "
      "{:.0f} arcsec after a slew (1 sigma, across), NEES (3) {:.2f} in [{:.2f}, {:.2f}], gyro's bias to {:.2f} "
      "deg/h{}",
      100.0 * s.by_prior_rate, s.cross_arcsec_1sigma, s.slew_cross_arcsec_1sigma, s.nees_mean, s.nees_band_95.lo,
      s.nees_band_95.hi, s.bias_error_deg_h_1sigma,
      s.restarts == 0 ? "" : fmt::format(", begun anew {} time{}", s.restarts, s.restarts == 1 ? "" : "s"));
}

}  // namespace astronav::loop
