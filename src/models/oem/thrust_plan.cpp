// SPDX-License-Identifier: Apache-2.0
#include "models/oem/thrust_plan.h"

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <iterator>

#include <fmt/format.h>

namespace astronav {
namespace {

constexpr std::string_view kHead = "begin_tdb,end_tdb,force_n,specific_impulse_s,x,y,z,mass_kg";
constexpr std::size_t kColumns = 8;
constexpr double kMassAgreement = 1e-6;

std::string_view trimmed(std::string_view s) {
  const std::size_t first = s.find_first_not_of(" \t\r");
  if (first == std::string_view::npos) return {};
  return s.substr(first, s.find_last_not_of(" \t\r") - first + 1);
}

Result<double> number(std::string_view s, const std::string& where) {
  double value = 0.0;
  const auto [end, ec] = std::from_chars(s.data(), s.data() + s.size(), value);
  if (ec != std::errc{} || end != s.data() + s.size() || !std::isfinite(value)) {
    return fail(ErrorCode::corrupt_data, "'{s}' is not a number", {}, where, s);
  }
  return value;
}

Result<std::array<std::string_view, kColumns>> columns(std::string_view line, const std::string& where) {
  std::array<std::string_view, kColumns> out;
  for (std::size_t i = 0; i < kColumns; ++i) {
    const std::size_t comma = line.find(',');
    if ((comma == std::string_view::npos) != (i + 1 == kColumns)) {
      return fail(ErrorCode::corrupt_data, "expected {0} columns: {s}", {static_cast<double>(kColumns)}, where, kHead);
    }
    out[i] = trimmed(line.substr(0, comma));
    if (comma != std::string_view::npos) line.remove_prefix(comma + 1);
  }
  return out;
}

}  // namespace

const ThrustArc* ThrustPlan::at(Epoch epoch) const {
  const auto after =
      std::upper_bound(arcs.begin(), arcs.end(), epoch, [](Epoch e, const ThrustArc& a) { return e < a.begin; });
  if (after == arcs.begin() || epoch >= std::prev(after)->end) return nullptr;
  return &*std::prev(after);
}

Epoch ThrustPlan::next_change(Epoch epoch, Epoch limit) const {
  const auto arc =
      std::upper_bound(arcs.begin(), arcs.end(), epoch, [](Epoch e, const ThrustArc& a) { return e < a.end; });
  if (arc == arcs.end()) return limit;
  return std::min(limit, epoch < arc->begin ? arc->begin : arc->end);
}

double ThrustPlan::mass_at_kg(Epoch epoch) const {
  double mass = mass_kg;
  for (const ThrustArc& arc : arcs) {
    if (epoch <= arc.begin) break;
    mass -= arc.mass_flow_kg_s() * (std::min(epoch, arc.end) - arc.begin).seconds();
  }
  return mass;
}

double ThrustPlan::delta_v_m_s() const {
  double mass = mass_kg, sum = 0.0;
  for (const ThrustArc& arc : arcs) {
    const double after = mass - arc.mass_flow_kg_s() * (arc.end - arc.begin).seconds();
    sum += arc.specific_impulse_s * kStandardGravity * std::log(mass / after);
    mass = after;
  }
  return sum;
}

Result<void> check(const ThrustPlan& plan) {
  if (!(plan.mass_kg > 0.0) || !std::isfinite(plan.mass_kg)) {
    return fail(ErrorCode::invalid_argument, "the mass, {0} kg, must be above zero", {plan.mass_kg});
  }
  for (std::size_t i = 0; i < plan.arcs.size(); ++i) {
    const ThrustArc& arc = plan.arcs[i];
    const double n = static_cast<double>(i + 1);
    if (!(arc.force_n > 0.0) || !(arc.specific_impulse_s > 0.0) || !std::isfinite(arc.force_n) ||
        !std::isfinite(arc.specific_impulse_s)) {
      return fail(ErrorCode::invalid_argument, "thrust arc {0}: force ({1} N) and impulse ({2} s) must be above zero",
                  {n, arc.force_n, arc.specific_impulse_s});
    }
    if (std::abs(arc.direction_N.squaredNorm() - 1.0) > 1e-9 || arc.direction_N.hasNaN()) {
      return fail(ErrorCode::invalid_argument, "thrust arc {0}: its direction is no unit vector", {n});
    }
    if (arc.end <= arc.begin) return fail(ErrorCode::invalid_argument, "thrust arc {0} ends before it begins", {n});
    if (i > 0 && arc.begin < plan.arcs[i - 1].end) {
      return fail(ErrorCode::invalid_argument, "thrust arc {0} begins before the one before it has ended", {n});
    }
  }
  if (!plan.arcs.empty() && !(plan.mass_at_kg(plan.arcs.back().end) > 0.0)) {
    return fail(ErrorCode::invalid_argument, "the plan needs more propellant than the {0} kg that there are",
                {plan.mass_kg});
  }
  return {};
}

Result<ThrustPlan> parse_thrust_plan(std::string_view text, std::string_view name_for_errors) {
  ThrustPlan plan;
  bool head_seen = false;
  std::string where;
  for (int line_number = 1; !text.empty(); ++line_number) {
    const std::string_view raw = text.substr(0, text.find('\n'));
    text.remove_prefix(std::min(raw.size() + 1, text.size()));
    const std::string_view line = trimmed(raw);
    if (line.empty() || line.front() == '#') continue;
    where = fmt::format("{}:{}", name_for_errors, line_number);
    if (!head_seen) {
      if (line != kHead) return fail(ErrorCode::corrupt_data, "not a thrust plan: expected {s}", {}, where, kHead);
      head_seen = true;
      continue;
    }
    const auto column = columns(line, where);
    if (!column) return forward(column);
    ThrustArc arc;
    for (int i = 0; i < 2; ++i) {
      const auto epoch = Epoch::parse((*column)[i], TimeScale::tdb);
      if (!epoch) return forward(epoch, where);
      (i == 0 ? arc.begin : arc.end) = *epoch;
    }
    std::array<double, 6> v{};
    for (std::size_t i = 0; i < v.size(); ++i) {
      const auto x = number((*column)[i + 2], where);
      if (!x) return forward(x);
      v[i] = *x;
    }
    arc.force_n = v[0];
    arc.specific_impulse_s = v[1];
    const Vec3 direction(v[2], v[3], v[4]);
    if (!(std::abs(direction.norm() - 1.0) < 1e-6)) {
      return fail(ErrorCode::corrupt_data, "the direction has length {0}, not 1", {direction.norm()}, where);
    }
    arc.direction_N = direction.normalized();
    if (plan.arcs.empty()) plan.mass_kg = v[5];
    const double expected = plan.mass_at_kg(arc.begin);
    plan.arcs.push_back(arc);
    if (const auto ok = check(plan); !ok) {
      Error error = ok.error();
      error.code = ErrorCode::corrupt_data;
      error.where = FixedText<200>(where);
      return tl::unexpected<Error>(error);
    }
    if (!(std::abs(v[5] - expected) <= kMassAgreement * expected)) {
      return fail(ErrorCode::corrupt_data, "the mass is {0} kg, but {1} kg are left by the arcs before",
                  {v[5], expected}, where);
    }
  }
  if (!head_seen) {
    return fail(ErrorCode::corrupt_data, "the file is empty; expected {s}", {}, fmt::format("{}:1", name_for_errors),
                kHead);
  }
  return plan;
}

std::string to_text(const ThrustPlan& plan) {
  fmt::memory_buffer buffer;
  const auto out = std::back_inserter(buffer);
  fmt::format_to(out, "{}\n", kHead);
  for (const ThrustArc& arc : plan.arcs) {
    const auto iso = [](Epoch e) { return e.iso(TimeScale::tdb, 9, false); };
    fmt::format_to(out, "{},{},{},{},{:.12f},{:.12f},{:.12f},{:.9f}\n", iso(arc.begin), iso(arc.end), arc.force_n,
                   arc.specific_impulse_s, arc.direction_N.x(), arc.direction_N.y(), arc.direction_N.z(),
                   plan.mass_at_kg(arc.begin));
  }
  return fmt::to_string(buffer);
}

}  // namespace astronav
