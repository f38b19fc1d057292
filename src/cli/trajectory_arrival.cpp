// SPDX-License-Identifier: Apache-2.0
// astronav trajectory arrival: the B-plane that a spacecraft is heading for, and its error ellipse.
#include <algorithm>
#include <cmath>
#include <memory>
#include <string>
#include <vector>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "cli/answers.h"
#include "cli/inputs.h"
#include "cli/trajectory_design.h"
#include "cli/validators.h"
#include "foundation/files/mapped_file.h"
#include "simulator/trajectory/trajectory.h"
#include "simulator/transfer/encounter.h"

namespace astronav::cli {
namespace {

using Json = nlohmann::ordered_json;

struct ArrivalOptions {
  std::string file;
  std::string body = "mars";
  double days = 30.0;
  double cr_area_mass = 0.026;
  std::vector<std::string> kernels;
  bool json = false;
};

Result<int> run_arrival(const ArrivalOptions& options) {
  const auto body = parse_body(options.body);
  if (!body) return forward(body, "--body");
  const auto kernels = open_kernels(options.kernels);
  if (!kernels) return forward(kernels);
  const Ephemeris& ephemeris = (*kernels)->ephemeris;
  const auto file = MappedFile::open(options.file);
  if (!file) return forward(file, options.file);
  const auto oem = parse_oem(file->text(), options.file);
  if (!oem) return forward(oem);
  if (oem->covariances.empty())
    return fail(ErrorCode::invalid_argument, "the message holds no covariance", {}, options.file);
  const auto trajectory = trajectory::from_oem(*oem, &ephemeris);
  if (!trajectory) return forward(trajectory, options.file);
  const OemCovariance& last = oem->covariances.back();
  const auto state = (*trajectory)->state(last.epoch);
  if (!state) return forward(state, options.file);

  dynamics::ForceSettings settings;
  settings.srp_cr_area_over_mass_m2_kg = options.cr_area_mass;
  const auto forces = dynamics::ForceModel::create(ephemeris, settings);
  if (!forces) return forward(forces);
  const auto passes = transfer::closest_approach(*forces, ephemeris, *body, last.epoch, *state,
                                                 last.epoch + Duration::days(options.days));
  if (!passes) return forward(passes, options.file);
  const auto e = transfer::arrival_error(*forces, ephemeris, *body, last.epoch, *state, last.covariance, *passes);
  if (!e) return forward(e, options.file);
  const double time_sigma_s = std::sqrt(std::max(e->covariance(2, 2), 0.0));
  const Epoch pericentre = *passes + Duration::seconds(e->at.time_to_pericentre_s);
  if (options.json) {
    fmt::print("{}\n", Json{{"body", title(*body)},
                            {"known_at_tdb", tdb(last.epoch)},
                            {"pericentre_tdb", tdb(pericentre)},
                            {"b_t_km", e->at.b_t_m * 1e-3},
                            {"b_r_km", e->at.b_r_m * 1e-3},
                            {"v_infinity_km_s", e->at.v_infinity_m_s * 1e-3},
                            {"sigma_major_km", e->semi_major_m * 1e-3},
                            {"sigma_minor_km", e->semi_minor_m * 1e-3},
                            {"angle_deg", e->angle_rad / kDegree},
                            {"sigma_time_s", time_sigma_s}}
                           .dump());
    return 0;
  }
  fmt::print("{}, as known at {} TDB\n", title(*body), tdb(last.epoch));
  fmt::print("pericentre        {} TDB +- {:.1f} s (3 sigma)\n", tdb(pericentre), 3.0 * time_sigma_s);
  fmt::print("B.T, B.R          {:.1f}, {:.1f} km; v-infinity {:.4f} km/s\n", e->at.b_t_m * 1e-3, e->at.b_r_m * 1e-3,
             e->at.v_infinity_m_s * 1e-3);
  fmt::print("error ellipse     {:.1f} by {:.1f} km (3 sigma), major axis {:.1f} degrees from T towards R\n",
             3e-3 * e->semi_major_m, 3e-3 * e->semi_minor_m, e->angle_rad / kDegree);
  return 0;
}

}  // namespace

void add_trajectory_arrival(CLI::App& trajectory, Invocation& invocation) {
  auto o = std::make_shared<ArrivalOptions>();
  CLI::App* app = trajectory.add_subcommand("arrival", "the B-plane ahead and its error ellipse");
  app->footer("Example:\n  astronav trajectory arrival runs/earth-mars-ballistic-mil-seed1/estimate.oem --body mars");
  app->add_option("file", o->file, "OEM with covariance; its last one is taken")->required();
  app->add_option("--body", o->body, "the planet that is passed")->capture_default_str();
  app->add_option("--days", o->days, "how far ahead to look")->capture_default_str()->check(number_within(0.1, 1e4));
  app->add_option("--cr-area-mass", o->cr_area_mass, "CR A/m, m2/kg")
      ->capture_default_str()
      ->check(number_within(0.0, 100.0));
  app->add_option("--kernel", o->kernels, "SPK files in place of DE405; later ones take precedence");
  app->add_flag("--json", o->json, "one JSON object");
  app->callback([o, &invocation] { invocation.action = [o] { return run_arrival(*o); }; });
}

}  // namespace astronav::cli
