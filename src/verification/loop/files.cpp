// SPDX-License-Identifier: Apache-2.0
#include "verification/loop/files.h"

#include <cmath>
#include <iterator>
#include <string>
#include <utility>

#include <fmt/format.h>

#include "foundation/files/mapped_file.h"

namespace astronav::loop {

std::string_view name(EventKind kind) {
  switch (kind) {
    case EventKind::survey_image:
      return "survey_image";
    case EventKind::image:
      return "image";
    case EventKind::window_end:
      return "window_end";
    case EventKind::cycle_end:
      return "cycle_end";
    case EventKind::coast_end:
      return "coast_end";
    case EventKind::coast_sample:
      return "coast_sample";
  }
  return "";
}

namespace {

// Of an image: what the attitude filter knew of it; empty fields for what it did not.
std::string attitude_columns(const Event& e) {
  const AttitudeRecord& a = e.attitude;
  const auto three = [](bool known, const Vec3& v, double scale) {
    return known ? fmt::format(",{:.4f},{:.4f},{:.4f}", v.x() * scale, v.y() * scale, v.z() * scale) : ",,,";
  };
  std::string out = fmt::format(",{:d}", e.by_prior);
  out += three(a.foretold, a.error_rad, 1.0 / kArcsecond) + three(a.foretold, a.sigma_rad, 1.0 / kArcsecond);
  out += a.foretold ? fmt::format(",{:.4f},{:d}", a.nees, a.after_slew) : ",,";
  out += a.accepted || a.restarted ? fmt::format(",{:.4f},{:d}", a.nis, a.restarted) : ",,";
  const double degrees_an_hour = 3600.0 / kDegree;
  return out + three(a.knows_bias, a.bias_error_rad_s, degrees_an_hour) +
         three(a.knows_bias, a.bias_sigma_rad_s, degrees_an_hour);
}

}  // namespace

std::string records_csv(const Records& records) {
  static constexpr const char* kHeader =
      "epoch_tdb,days,kind,cycle,window,image,body,"
      "truth_x_km,truth_y_km,truth_z_km,truth_vx_km_s,truth_vy_km_s,truth_vz_km_s,"
      "estimate_x_km,estimate_y_km,estimate_z_km,estimate_vx_km_s,estimate_vy_km_s,estimate_vz_km_s,"
      "error_x_km,error_y_km,error_z_km,error_vx_m_s,error_vy_m_s,error_vz_m_s,"
      "sigma_x_km,sigma_y_km,sigma_z_km,sigma_vx_m_s,sigma_vy_m_s,sigma_vz_m_s,nees,"
      "attitude_found,attitude_wrong,planet_found,planet_false,accepted,"
      "innovation_u_px,innovation_v_px,innovation_sigma_u_px,innovation_sigma_v_px,nis,"
      "planet_error_u_px,planet_error_v_px,planet_sigma_u_px,planet_sigma_v_px,planet_repeating_px,"
      "attitude_error_x_arcsec,attitude_error_y_arcsec,attitude_error_z_arcsec,"
      "attitude_sigma_x_arcsec,attitude_sigma_y_arcsec,attitude_sigma_z_arcsec,"
      "attitude_repeating_x_arcsec,attitude_repeating_y_arcsec,attitude_repeating_z_arcsec,"
      "stars_matched,spots,centroid_rms_px,attitude_by_prior,"
      "foretold_error_x_arcsec,foretold_error_y_arcsec,foretold_error_z_arcsec,"
      "foretold_sigma_x_arcsec,foretold_sigma_y_arcsec,foretold_sigma_z_arcsec,foretold_nees,"
      "foretold_after_slew,attitude_nis,attitude_restarted,"
      "gyro_bias_error_x_deg_h,gyro_bias_error_y_deg_h,gyro_bias_error_z_deg_h,"
      "gyro_bias_sigma_x_deg_h,gyro_bias_sigma_y_deg_h,gyro_bias_sigma_z_deg_h\n";
  fmt::memory_buffer out;
  const auto to = std::back_inserter(out);
  fmt::format_to(to, "{}", kHeader);
  const auto three = [&](const Vec3& v, double scale, const char* format) {
    for (int i = 0; i < 3; ++i) fmt::format_to(to, fmt::runtime(format), v[i] * scale);
  };
  for (const Event& e : records.events) {
    fmt::format_to(to, "{},{:.6f},{},{},{},{},{}", e.epoch.iso(TimeScale::tdb, 3, false),
                   (e.epoch - day_zero(records)).days(), name(e.kind), e.cycle, e.window,
                   e.image >= 0 ? fmt::format("{}", e.image) : "", e.body.value != 0 ? body_name(e.body) : "");
    three(e.truth.p_m, 1e-3, ",{:.6f}");
    three(e.truth.v_m_s, 1e-3, ",{:.9f}");
    if (e.kind == EventKind::survey_image) {
      // No estimate yet, no planet that anybody looked for, and no gyro.
      const std::string no_estimate(20, ','), no_planet(23, ','), no_gyro(17, ',');
      fmt::format_to(to, "{}{:d},{:d}{}{},{},{}\n", no_estimate, e.attitude_found, e.attitude_wrong, no_planet,
                     e.stars_matched, e.spots, no_gyro);
      continue;
    }
    three(e.estimate.p_m, 1e-3, ",{:.6f}");
    three(e.estimate.v_m_s, 1e-3, ",{:.9f}");
    three(e.estimate.p_m - e.truth.p_m, 1e-3, ",{:.6f}");
    three(e.estimate.v_m_s - e.truth.v_m_s, 1.0, ",{:.6f}");
    const Vec6 sigma = e.covariance.diagonal().cwiseSqrt();
    three(sigma.head<3>(), 1e-3, ",{:.6f}");
    three(sigma.tail<3>(), 1.0, ",{:.6f}");
    fmt::format_to(to, ",{:.4f}", e.nees);
    if (e.kind == EventKind::image) {
      const Vec2 innovation_sigma = e.innovation_covariance_px2.diagonal().cwiseSqrt();
      fmt::format_to(
          to, ",{:d},{:d},{:d},{:d},{:d},{:.5f},{:.5f},{:.5f},{:.5f},{:.4f},{:.5f},{:.5f},{:.5f},{:.5f},{:.5f}",
          e.attitude_found, e.attitude_wrong, e.planet_found, e.planet_false, e.accepted, e.innovation_px.x(),
          e.innovation_px.y(), innovation_sigma.x(), innovation_sigma.y(), e.nis, e.planet_error_px.x(),
          e.planet_error_px.y(), e.planet_sigma_px.x(), e.planet_sigma_px.y(), e.planet_repeating_px);
      three(e.attitude_error_rad, 1.0 / kArcsecond, ",{:.4f}");
      three(e.attitude_sigma_rad, 1.0 / kArcsecond, ",{:.4f}");
      three(e.attitude_repeating_rad, 1.0 / kArcsecond, ",{:.4f}");
      fmt::format_to(to, ",{},{},", e.stars_matched, e.spots);
      if (e.centroid_error_count > 0) {
        fmt::format_to(to, "{:.5f}", std::sqrt(e.centroid_error_sum2_px2 / e.centroid_error_count));
      }
      fmt::format_to(to, "{}", attitude_columns(e));
    } else {
      fmt::format_to(to, "{}", std::string(44, ','));
    }
    fmt::format_to(to, "\n");
  }
  return fmt::to_string(out);
}

namespace {

Oem states_of(const Records& records, State Event::*which, const char* object) {
  Oem oem;
  oem.object_name = object;
  for (std::size_t i = 0; i < records.events.size(); ++i) {
    const Event& e = records.events[i];
    if (e.kind == EventKind::survey_image) continue;
    if (i + 1 < records.events.size() && records.events[i + 1].epoch <= e.epoch) continue;  // epochs must increase
    oem.epochs.push_back(e.epoch);
    oem.states.push_back(e.*which);
  }
  return oem;
}

}  // namespace

Oem estimate_oem(const Records& records) {
  Oem oem = states_of(records, &Event::estimate, "ASTRONAV ESTIMATE");
  for (const Event& e : records.events) {
    if (e.kind == EventKind::image || e.kind == EventKind::survey_image) continue;
    if (!oem.covariances.empty() && oem.covariances.back().epoch == e.epoch) oem.covariances.pop_back();
    oem.covariances.push_back({e.epoch, e.covariance});
  }
  return oem;
}

Oem truth_oem(const Records& records) {
  return states_of(records, &Event::truth, "ASTRONAV TRUTH");
}

Result<void> write_files(const std::filesystem::path& folder, const Records& records, const Summary& summary) {
  std::error_code error;
  std::filesystem::create_directories(folder, error);
  if (error) return fail(ErrorCode::io_failure, "cannot make the folder: {s}", {}, folder.string(), error.message());
  const std::pair<const char*, std::string> files[] = {
      {"summary.json", to_json(summary) + "\n"},         {"estimate.oem", to_text(estimate_oem(records))},
      {"truth.oem", to_text(truth_oem(records))},        {"records.csv", records_csv(records)},
      {"scenario.resolved.toml", records.scenario_toml},
  };
  for (const auto& [file, text] : files) {
    if (auto ok = write_file(folder / file, text); !ok) return ok;
  }
  if (records.smoothed.empty()) return {};
  return write_file(folder / "smoothed.oem", to_text(estimate_oem(afterwards(records))));
}

}  // namespace astronav::loop
