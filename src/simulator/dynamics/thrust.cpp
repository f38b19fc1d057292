// SPDX-License-Identifier: Apache-2.0
#include "simulator/dynamics/thrust.h"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <utility>

#include "simulator/dynamics/kicks.h"

namespace astronav::dynamics {

Result<ThrustHistory> ThrustHistory::fly(ThrustPlan plan, const ThrustErrors& errors, Epoch begin, Epoch end,
                                         RandomStream& stream) {
  if (const auto ok = check(plan); !ok) return forward(ok);
  if (!(errors.magnitude_sigma >= 0.0) || !(errors.pointing_sigma_rad >= 0.0) ||
      !std::isfinite(errors.magnitude_sigma) || !std::isfinite(errors.pointing_sigma_rad)) {
    return fail(ErrorCode::invalid_argument, "the errors of thrust ({0}, {1} rad) must be zero or more",
                {errors.magnitude_sigma, errors.pointing_sigma_rad});
  }
  ThrustHistory out;
  out.errors_ = errors;
  if (errors.magnitude_sigma > 0.0 || errors.pointing_sigma_rad > 0.0) {
    auto drawn =
        UnmodelledAcceleration::draw({.sigma_m_s2 = 1.0, .tau = errors.tau, .grid = errors.grid}, begin, end, stream);
    if (!drawn) return forward(drawn);
    out.unit_errors_ = std::move(*drawn);
  }
  out.plan_ = std::move(plan);
  double mass = out.plan_.mass_kg;
  for (const ThrustArc& arc : out.plan_.arcs) {
    if (out.knots_.empty() || out.knots_.back() != arc.begin) {
      out.knots_.push_back(arc.begin);
      out.masses_.push_back({arc.begin, mass});
    }
    out.knots_.push_back(arc.end);
    for (Epoch e = arc.begin; e < arc.end;) {
      const Epoch next = out.unit_errors_.next_knot(e, arc.end);
      mass -= out.burnt_kg(arc, e, next);
      out.masses_.push_back({next, mass});
      e = next;
    }
  }
  return out;
}

Result<ThrustHistory> ThrustHistory::as_planned(ThrustPlan plan) {
  RandomStream unused(StreamId{});
  return fly(std::move(plan), {}, Epoch(), Epoch(), unused);
}

double ThrustHistory::magnitude_n(const ThrustArc& arc, Epoch epoch) const {
  return arc.force_n * (1.0 + errors_.magnitude_sigma * unit_errors_.at(epoch).x());
}

// Between knots the force is linear in time: its mean is that of the ends.
double ThrustHistory::burnt_kg(const ThrustArc& arc, Epoch from, Epoch to) const {
  const double mean = 0.5 * (magnitude_n(arc, from) + magnitude_n(arc, to));
  return arc.mass_flow_kg_s() * mean / arc.force_n * (to - from).seconds();
}

Vec3 ThrustHistory::force_N_n(Epoch epoch) const {
  const ThrustArc* arc = plan_.at(epoch);
  if (arc == nullptr) return Vec3::Zero();
  const Vec3& u = arc->direction_N;
  // The errors are the same on every pair of axes across the thrust.
  const Vec3 e1 = u.unitOrthogonal();
  const Vec3 angles = errors_.pointing_sigma_rad * unit_errors_.at(epoch);
  return magnitude_n(*arc, epoch) * (u + angles.y() * e1 + angles.z() * u.cross(e1)).normalized();
}

double ThrustHistory::mass_kg(Epoch epoch) const {
  if (masses_.empty()) return plan_.mass_kg;
  const auto after =
      std::upper_bound(masses_.begin(), masses_.end(), epoch, [](Epoch e, const MassAt& m) { return e < m.epoch; });
  if (after == masses_.begin()) return masses_.front().mass_kg;
  const MassAt& before = *std::prev(after);
  const ThrustArc* arc = plan_.at(epoch);
  if (arc == nullptr) return before.mass_kg;
  return before.mass_kg - burnt_kg(*arc, before.epoch, epoch);
}

Epoch ThrustHistory::next_knot(Epoch epoch, Epoch limit) const {
  const Epoch end = next_of(knots_, epoch, limit);
  // Errors matter inside arcs alone.
  const Epoch just_ahead = limit >= epoch ? epoch : epoch - Duration::nanoseconds(1);
  return plan_.at(just_ahead) == nullptr ? end : unit_errors_.next_knot(epoch, end);
}

}  // namespace astronav::dynamics
