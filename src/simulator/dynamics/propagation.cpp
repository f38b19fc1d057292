// SPDX-License-Identifier: Apache-2.0
#include "simulator/dynamics/propagation.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <optional>
#include <utility>

#include <boost/numeric/odeint/stepper/runge_kutta_fehlberg78.hpp>
#include <fmt/format.h>

#include "foundation/base/check.h"

namespace astronav::dynamics {
namespace {

using Array6 = std::array<double, 6>;

// What counts as a jump of the acceleration: its effect over a day is a few millimetres.
constexpr double kJump_m_s2 = 1e-12;
constexpr Duration kInside = Duration::nanoseconds(1);

// The quintic between two nodes, as powers of the time since the first.
struct Quintic {
  Vec3 p, v, half_a, c3, c4, c5;

  Quintic(const Arc::Node& n0, const Arc::Node& n1) {
    const double h = (n1.epoch - n0.epoch).seconds();
    p = n0.state.p_m;
    v = n0.state.v_m_s;
    half_a = 0.5 * n0.acceleration_m_s2;
    const Vec3 dp = (n1.state.p_m - p - v * h - half_a * (h * h)) / (h * h * h);
    const Vec3 dv = (n1.state.v_m_s - v - n0.acceleration_m_s2 * h) / (h * h);
    const Vec3 da = (n1.acceleration_m_s2 - n0.acceleration_m_s2) / h;
    c3 = 10.0 * dp - 4.0 * dv + 0.5 * da;
    c4 = (-15.0 * dp + 7.0 * dv - da) / h;
    c5 = (6.0 * dp - 3.0 * dv + 0.5 * da) / (h * h);
  }
  State state(double s) const {
    return {p + s * (v + s * (half_a + s * (c3 + s * (c4 + s * c5)))),
            v + s * (2.0 * half_a + s * (3.0 * c3 + s * (4.0 * c4 + s * 5.0 * c5)))};
  }
  Vec3 acceleration(double s) const { return 2.0 * half_a + s * (6.0 * c3 + s * (12.0 * c4 + s * 20.0 * c5)); }
};

Array6 to_array(const State& s) {
  return {s.p_m.x(), s.p_m.y(), s.p_m.z(), s.v_m_s.x(), s.v_m_s.y(), s.v_m_s.z()};
}
State to_state(const Array6& x) {
  return {{x[0], x[1], x[2]}, {x[3], x[4], x[5]}};
}

// `knot(e, to)` is the next epoch on the way from e to `to` at which the field is not smooth; no step crosses one. The
// field may jump there, so a step asks for it a nanosecond inside its ends.
template <typename Knot>
Result<Arc> integrate(const AccelerationField& field, const Knot& knot, const State& start, Epoch from, Epoch to,
                      const PropagationSettings& settings) {
  ASTRONAV_CHECK(settings.position_tolerance_m > 0.0 && settings.velocity_tolerance_m_s > 0.0);
  ASTRONAV_CHECK(settings.min_step > Duration{} && settings.max_step >= settings.min_step);
  if (!start.p_m.allFinite() || !start.v_m_s.allFinite()) {
    return fail(ErrorCode::invalid_argument, "the state to start from is not finite");
  }
  const auto first_acceleration = field(from, start);
  if (!first_acceleration) return forward(first_acceleration);
  std::vector<Arc::Node> nodes{{from, start, *first_acceleration}};

  // Odeint wants a function that cannot fail: the first error is kept, and the step thrown away.
  std::optional<Error> field_error;
  Epoch origin, first_inside, last_inside;
  const auto inside = [&](Epoch e, const State& s) { return field(std::clamp(e, first_inside, last_inside), s); };
  const auto system = [&](const Array6& x, Array6& dxdt, double s) {
    const auto a = inside(origin + Duration::seconds(s), to_state(x));
    if (!a && !field_error) field_error = a.error();
    const Vec3 value = a ? *a : Vec3(Vec3::Zero());
    dxdt = {x[3], x[4], x[5], value.x(), value.y(), value.z()};
  };

  boost::numeric::odeint::runge_kutta_fehlberg78<Array6> stepper;
  const bool forwards = to >= from;
  Duration step = settings.max_step;
  bool at_knot = true;
  while (nodes.back().epoch != to) {
    Arc::Node node = nodes.back();
    const Epoch limit = knot(node.epoch, to);
    const Duration room = forwards ? limit - node.epoch : node.epoch - limit;
    const bool whole_room = step >= room;
    const Duration used = whole_room ? room : step;
    const Duration signed_step = forwards ? used : -used;
    const double h = signed_step.seconds();

    origin = node.epoch;
    const Duration margin = used > kInside * 2 ? kInside : Duration{};
    first_inside = std::min(node.epoch, node.epoch + signed_step) + margin;
    last_inside = std::max(node.epoch, node.epoch + signed_step) - margin;
    if (at_knot) {
      const auto ahead = inside(node.epoch, node.state);
      if (!ahead) return forward(ahead);
      const bool jump = (*ahead - node.acceleration_m_s2).norm() > kJump_m_s2;
      node.acceleration_m_s2 = *ahead;
      if (jump && nodes.size() > 1) nodes.push_back(node);
      if (jump) nodes.back() = node;
    }
    const Array6 x = to_array(node.state);
    Array6 next{}, error{};
    stepper.do_step(system, x, 0.0, next, h, error);
    if (field_error) return tl::unexpected<Error>(*field_error);
    Arc::Node candidate{node.epoch + signed_step, to_state(next), {}};
    const auto acceleration = inside(candidate.epoch, candidate.state);
    if (!acceleration) return forward(acceleration);
    candidate.acceleration_m_s2 = *acceleration;

    const double step_error = std::max(Vec3(error[0], error[1], error[2]).norm() / settings.position_tolerance_m,
                                       Vec3(error[3], error[4], error[5]).norm() / settings.velocity_tolerance_m_s);
    // A sixth derivative M leaves M h^6/46080 in the position half-way, and M h^4/1920 in the acceleration.
    const Quintic quintic(node, candidate);
    const Duration half = Duration::nanoseconds(signed_step.nanoseconds() / 2);
    const auto middle = inside(node.epoch + half, quintic.state(half.seconds()));
    if (!middle) return forward(middle);
    const double defect = (*middle - quintic.acceleration(half.seconds())).norm();
    const double interpolation_error = defect * h * h / 24.0 / settings.position_tolerance_m;

    const bool accepted = step_error <= 1.0 && interpolation_error <= 1.0;  // false for NaN
    at_knot = accepted && whole_room;
    if (accepted) nodes.push_back(candidate);
    double scale = 0.9 * std::min(std::pow(std::max(step_error, 1e-16), -1.0 / 8.0),
                                  std::pow(std::max(interpolation_error, 1e-16), -1.0 / 6.0));
    scale = std::isfinite(scale) ? std::clamp(scale, 0.2, accepted ? 4.0 : 0.9) : 0.2;
    // A step cut short by a knot says little about the next one.
    const Duration proposal = std::min(Duration::seconds(used.seconds() * scale), settings.max_step);
    step = accepted && whole_room ? std::max(step, proposal) : proposal;
    if (step < settings.min_step) {
      return fail(ErrorCode::not_converged,
                  "the step of integration fell below {0} s at {s}: a fall into a point mass?",
                  {settings.min_step.seconds()}, {}, node.epoch.iso());
    }
  }
  if (!forwards) std::reverse(nodes.begin(), nodes.end());
  return Arc(std::move(nodes));
}

}  // namespace

Arc::Arc(std::vector<Node> nodes) : nodes_(std::move(nodes)) {
  ASTRONAV_CHECK(!nodes_.empty());
  ASTRONAV_CHECK(std::adjacent_find(nodes_.begin(), nodes_.end(),
                                    [](const Node& a, const Node& b) { return a.epoch > b.epoch; }) == nodes_.end());
}

Result<State> Arc::at(Epoch epoch) const {
  if (epoch < begin() || epoch > end()) {
    return fail(ErrorCode::out_of_range, "the trajectory does not cover {s}", {}, {},
                fmt::format("{}; it runs from {} to {}", epoch.iso(), begin().iso(), end().iso()));
  }
  const auto next =
      std::upper_bound(nodes_.begin(), nodes_.end(), epoch, [](Epoch e, const Node& n) { return e < n.epoch; });
  const Node& before = *std::prev(next);
  if (before.epoch == epoch) return before.state;
  return Quintic(before, *next).state((epoch - before.epoch).seconds());
}

Result<Arc> propagate(const ForceModel& forces, const State& start, Epoch from, Epoch to,
                      const PropagationSettings& settings) {
  return integrate([&forces](Epoch e, const State& s) { return forces.acceleration(e, s); },
                   [&forces](Epoch e, Epoch limit) { return forces.next_knot(e, limit); }, start, from, to, settings);
}

Result<Arc> propagate(const AccelerationField& field, const State& start, Epoch from, Epoch to,
                      const PropagationSettings& settings) {
  return integrate(
      field, [](Epoch, Epoch limit) { return limit; }, start, from, to, settings);
}

}  // namespace astronav::dynamics
