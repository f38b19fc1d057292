// SPDX-License-Identifier: Apache-2.0
#include <cmath>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "cli/answers.h"
#include "cli/command.h"
#include "cli/commands.h"
#include "cli/inputs.h"
#include "cli/validators.h"
#include "models/aberration/aberration.h"
#include "models/photometry/photometry.h"
#include "models/photometry/small_bodies.h"

namespace astronav::cli {
namespace {

using Json = nlohmann::ordered_json;

struct Options {
  std::string body;
  std::string from = "earth";
  std::vector<std::string> epochs;
  std::string correction = "lt+s";
  int iterations = -1;
  std::vector<std::string> kernels;
  std::string law;
  bool json = false;
};

struct Question {
  BodyId body;
  BodyId from;
  bool light_time;
  bool aberration;
  int iterations;
  std::optional<PhaseLaw> law;  // of a small body
};

struct Answer {
  Epoch epoch;
  State relative;
  double light_time_s = 0.0;
  RaDec place;
  // Of planets, the Moon and small bodies; where there is no law for the phase the magnitude stays empty.
  bool has_brightness = false;
  std::optional<double> v_mag;
  double phase_angle_rad = 0.0;
  std::optional<double> sun_elongation_rad;
};

// From velocities a little apart; at the ends of a kernel from one side.
Vec3 acceleration(const Ephemeris& ephemeris, BodyId body, Epoch epoch) {
  const Duration step = Duration::seconds(30.0);
  auto before = ephemeris.state(body, body::solar_system_barycenter, epoch - step);
  auto after = ephemeris.state(body, body::solar_system_barycenter, epoch + step);
  const auto now = ephemeris.state(body, body::solar_system_barycenter, epoch);
  double span = 2.0 * step.seconds();
  if (!before || !after) span = step.seconds();
  if (!before) before = now;
  if (!after) after = now;
  return before && after ? Vec3((after->v_m_s - before->v_m_s) / span) : Vec3::Zero();
}

// The body as `question.from` sees it (or as it is, without corrections).
Result<LightTime> look(const Ephemeris& ephemeris, BodyId body, const Question& question, const State& observer,
                       Epoch epoch) {
  auto seen = light_time(ephemeris, body, observer, epoch, question.light_time ? question.iterations : 0);
  if (!seen || !question.aberration) return seen;
  const ApparentMotion apparent = aberrate_motion(seen->relative.p_m, seen->relative.v_m_s, observer.v_m_s,
                                                  acceleration(ephemeris, question.from, epoch));
  seen->relative = {apparent.p_m, apparent.v_m_s};
  return seen;
}

// The planet whose magnitude law holds for a centre or a barycentre.
std::optional<BodyId> planet_of(BodyId id) {
  if (id.value >= 1 && id.value <= 9 && id != body::earth_moon_barycenter) return BodyId{id.value * 100 + 99};
  if (id == body::moon || id == body::earth || barycenter_of(id)) return id;
  return std::nullopt;
}

// Without corrections only the way between the two bodies counts: a kernel may not reach to the barycentre at all.
Result<Answer> geometric(const Ephemeris& ephemeris, const Question& question, Epoch epoch) {
  const auto relative = ephemeris.state(question.body, question.from, epoch);
  if (!relative) return forward(relative);
  Answer out;
  out.relative = *relative;
  out.light_time_s = relative->p_m.norm() / kSpeedOfLight;
  return out;
}

Result<Answer> apparent(const Ephemeris& ephemeris, const Question& question, Epoch epoch) {
  const auto observer = ephemeris.state(question.from, body::solar_system_barycenter, epoch);
  if (!observer) return forward(observer);
  const auto seen = look(ephemeris, question.body, question, *observer, epoch);
  if (!seen) return forward(seen);
  Answer out;
  out.relative = seen->relative;
  out.light_time_s = seen->light_time_s;
  return out;
}

void add_brightness(const Ephemeris& ephemeris, const Question& question, Answer& out) {
  const auto planet = planet_of(question.body);
  if (!planet && !question.law) return;
  const Epoch epoch = out.epoch;
  const auto observer = ephemeris.state(question.from, body::solar_system_barycenter, epoch);
  const Epoch departure = question.light_time ? epoch - Duration::seconds(out.light_time_s) : epoch;
  const auto from_sun = ephemeris.state(question.body, body::sun, departure);
  const auto there = ephemeris.state(question.body, body::solar_system_barycenter, departure);
  if (!observer || !from_sun || !there) return;  // a kernel without the Sun
  const Illumination geometry{from_sun->p_m, there->p_m - observer->p_m, departure};
  out.has_brightness = true;
  out.phase_angle_rad = phase_angle(geometry);
  const Result<double> magnitude =
      question.law ? small_body_v_magnitude(*question.law, geometry) : planet_v_magnitude(*planet, geometry);
  if (magnitude && std::isfinite(*magnitude)) out.v_mag = *magnitude;
  if (question.from == body::sun) return;
  const auto sun = look(ephemeris, body::sun, question, *observer, epoch);
  if (sun) out.sun_elongation_rad = angle_between(sun->relative.p_m, out.relative.p_m);
}

Result<Answer> answer(const Ephemeris& ephemeris, const Question& question, Epoch epoch) {
  auto out = question.light_time ? apparent(ephemeris, question, epoch) : geometric(ephemeris, question, epoch);
  if (!out) return out;
  out->epoch = epoch;
  out->place = radec_from_direction(out->relative.p_m);
  add_brightness(ephemeris, question, *out);
  return out;
}

Json optional_number(const std::optional<double>& v, double unit = 1.0) {
  return v ? Json(*v / unit) : Json(nullptr);
}

void print_json(const Question& question, const std::string& correction, const Answer& a) {
  Json out;
  out["body"] = title(question.body);
  out["from"] = title(question.from);
  out["epoch_tdb"] = a.epoch.iso(TimeScale::tdb, 6, false);
  out["epoch_utc"] = a.epoch.iso(TimeScale::utc, 6, false);
  out["correction"] = correction;
  out["position_km"] = xyz(a.relative.p_m, 1e3);
  out["velocity_km_s"] = xyz(a.relative.v_m_s, 1e3);
  out["distance_km"] = a.relative.p_m.norm() / 1e3;
  out["ra_deg"] = a.place.ra_rad / kDegree;
  out["dec_deg"] = a.place.dec_rad / kDegree;
  out["light_time_s"] = a.light_time_s;
  if (a.has_brightness) {
    out["magnitude_v"] = optional_number(a.v_mag);
    out["phase_angle_deg"] = a.phase_angle_rad / kDegree;
    out["sun_elongation_deg"] = optional_number(a.sun_elongation_rad, kDegree);
  }
  fmt::print("{}\n", out.dump());
}

std::string column(const std::optional<double>& v, double unit, int decimals) {
  return v ? fmt::format("{:.{}f}", *v / unit, decimals) : "-";
}

void print_table(const Question& question, const std::string& correction, const std::vector<Answer>& answers) {
  fmt::print("{} from {}, ICRF, correction {}\n", title(question.body), title(question.from), correction);
  const bool brightness = !answers.empty() && answers.front().has_brightness;
  fmt::print("{:<23} {:>11} {:>11} {:>18} {:>14}{}\n", "TDB", "RA deg", "Dec deg", "distance km", "light time s",
             brightness ? fmt::format(" {:>7} {:>9} {:>9}", "V", "phase", "elongation") : "");
  for (const Answer& a : answers) {
    fmt::print("{:<23} {:>11.6f} {:>11.6f} {:>18.3f} {:>14.6f}", a.epoch.iso(TimeScale::tdb, 3, false),
               a.place.ra_rad / kDegree, a.place.dec_rad / kDegree, a.relative.p_m.norm() / 1e3, a.light_time_s);
    if (brightness)
      fmt::print(" {:>7} {:>9.3f} {:>9}", column(a.v_mag, 1.0, 3), a.phase_angle_rad / kDegree,
                 column(a.sun_elongation_rad, kDegree, 3));
    fmt::print("\n");
  }
  if (answers.size() != 1) return;
  const Vec3 p = answers.front().relative.p_m / 1e3, v = answers.front().relative.v_m_s / 1e3;
  fmt::print("position km    {:>20.6f} {:>20.6f} {:>20.6f}\nvelocity km/s  {:>20.9f} {:>20.9f} {:>20.9f}\n", p.x(),
             p.y(), p.z(), v.x(), v.y(), v.z());
}

// `H,G` or `H,G1,G2`, or the law that is known of the body.
Result<std::optional<PhaseLaw>> law_of(BodyId body, const std::string& text) {
  if (text.empty()) {
    const SmallBody* const known = known_small_body(body);
    return known != nullptr ? std::optional(known->law) : std::nullopt;
  }
  const auto numbers = parse_numbers(text, 2, 3, "H,G or H,G1,G2");
  if (!numbers) return forward(numbers, "--law");
  PhaseLaw law{.h = (*numbers)[0], .g1 = (*numbers)[1]};
  if (numbers->size() == 3) law.g2 = (*numbers)[2];
  return std::optional(law);
}

Result<int> run(const Options& options) {
  const auto body_asked = parse_body(options.body);
  if (!body_asked) return forward(body_asked);
  const auto from_asked = parse_body(options.from);
  if (!from_asked) return forward(from_asked, "--from");
  const auto epochs = parse_epochs(options.epochs);
  if (!epochs) return forward(epochs);
  const auto law = law_of(*body_asked, options.law);
  if (!law) return forward(law);
  const auto kernels = open_kernels_for(options.kernels, {*body_asked, *from_asked}, epochs->front());
  if (!kernels) return forward(kernels);
  const Ephemeris& ephemeris = (*kernels)->ephemeris;
  const auto body = ephemeris.resolve(*body_asked);
  if (!body) return forward(body);
  const auto from = ephemeris.resolve(*from_asked);
  if (!from) return forward(from, "--from");
  if (*body == *from)
    return fail(ErrorCode::invalid_argument, "'{s}' cannot be seen from itself: give another --from", {}, {},
                title(*body));
  const Question question{*body, *from, options.correction != "none", options.correction == "lt+s", options.iterations,
                          *law};
  // All or nothing: an epoch outside the kernels is bad input, and then nothing has been printed.
  std::vector<Answer> answers;
  answers.reserve(epochs->size());
  for (const Epoch epoch : *epochs) {
    const auto one = answer(ephemeris, question, epoch);
    if (!one) return forward(one);
    answers.push_back(*one);
  }
  if (options.json) {
    for (const Answer& one : answers) print_json(question, options.correction, one);
  } else {
    print_table(question, options.correction, answers);
  }
  return 0;
}

}  // namespace

void add_ephemeris(CLI::App& app, Invocation& invocation) {
  auto options = std::make_shared<Options>();
  CLI::App* sub = app.add_subcommand("ephemeris", "state of a body as another sees it: place, distance, brightness");
  sub->footer(
      "Without --kernel the planets, Sun and Moon of DE405 from 2000 to 2050 are used; they also\n"
      "complete kernels that hold an asteroid or a spacecraft alone.\n"
      "Example:\n  astronav ephemeris mars --from earth --epoch '2028-03-01T12:00:00 TDB'");
  sub->add_option("body", options->body, "name or NAIF number")->required();
  sub->add_option("--from", options->from, "observing body")->capture_default_str();
  sub->add_option("--epoch", options->epochs,
                  "ISO 8601 (UTC without scale), or START/STOP/STEP (10d, 1h, 60s); repeatable")
      ->required()
      ->allow_extra_args(false);
  sub->add_option("--correction", options->correction, "none, lt (light time) or lt+s (and stellar aberration)")
      ->check(CLI::IsMember({"none", "lt", "lt+s"}))
      ->capture_default_str();
  sub->add_option("--iterations", options->iterations, "of the light time; 1 is SPICE's LT (default: to convergence)")
      ->check(number_within(1, 10));
  sub->add_option("--kernel", options->kernels, "SPK files in place of DE405; later ones take precedence");
  sub->add_option("--law", options->law, "H,G or H,G1,G2 of a small body (default: what is known of it)");
  sub->add_flag("--json", options->json, "one JSON object an epoch");
  sub->callback([options, &invocation] { invocation.action = [options] { return run(*options); }; });
}

}  // namespace astronav::cli
