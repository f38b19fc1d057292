// SPDX-License-Identifier: Apache-2.0
#include "simulator/transfer/steering.h"

#include <algorithm>
#include <cmath>

#include <Eigen/Cholesky>

#include "foundation/base/check.h"

namespace astronav::transfer {
namespace {

constexpr double kFreeWeight = 1e-3;  // of |u|^2/2 of a control that costs nothing

// Length of the best control for a primer of length p, what it is worth, and how it grows with p.
struct Best {
  double length = 0.0;
  double gain = 0.0;  // p length - cost, >= 0
  double slope = 0.0;
};
Best best(const Control& c, double p, double smoothing) {
  const double linear = c.weight * (1.0 - smoothing);
  const double square = c.weight > 0.0 ? c.weight * smoothing : kFreeWeight;
  Best out;
  out.length = std::clamp((p - linear) / square, 0.0, c.limit);
  out.gain = (p - linear) * out.length - 0.5 * square * out.length * out.length;
  out.slope = out.length > 0.0 && out.length < c.limit ? 1.0 / square : 0.0;
  return out;
}

// The dual at a costate: its value (to be made large), gradient, and minus its second derivatives.
struct Dual {
  double value = 0.0;
  Vec6 gradient = Vec6::Zero();
  Mat6 curvature = Mat6::Zero();
};
Dual evaluate(const std::vector<Control>& controls, const Vec6& goal, double smoothing, const Vec6& costate) {
  Dual out;
  out.value = -costate.dot(goal);
  out.gradient = -goal;
  for (const Control& c : controls) {
    const Vec3 primer = -c.effect.transpose() * costate;
    const double p = primer.norm();
    const Best b = best(c, p, smoothing);
    if (p == 0.0 && (smoothing == 1.0 || c.weight == 0.0) && c.limit > 0.0) {
      // Where the climb begins, a control without a cost of its length grows alike in all directions.
      out.curvature += c.effect * c.effect.transpose() / (c.weight > 0.0 ? c.weight : kFreeWeight);
    }
    if (b.length == 0.0) continue;
    const Vec3 along = primer / p;
    out.value -= b.gain;
    out.gradient += b.length * c.effect * along;
    const Mat3 m = b.slope * along * along.transpose() + b.length / p * (Mat3::Identity() - along * along.transpose());
    out.curvature += c.effect * m * c.effect.transpose();
  }
  return out;
}

}  // namespace

Result<Steering> steer(const std::vector<Control>& controls, const Vec6& goal, double smoothing, const Vec6& costate) {
  ASTRONAV_CHECK(smoothing > 0.0 && smoothing <= 1.0);
  constexpr int kMostIterations = 400;
  constexpr double kTolerance = 1e-9;
  Vec6 lambda = costate;
  Dual now = evaluate(controls, goal, smoothing, lambda);
  double damping = 1e-9;  // relative to the curvature
  for (int i = 0; i < kMostIterations && now.gradient.norm() > kTolerance; ++i) {
    const double size = std::max(now.curvature.trace(), 1e-12);
    const Mat6 damped = now.curvature + damping * size * Mat6::Identity();
    const Vec6 step = damped.ldlt().solve(now.gradient);
    const Dual next = evaluate(controls, goal, smoothing, lambda + step);
    // A concave function whose gradient shrinks along the step also counts: near the top values differ by rounding.
    const bool climbs = next.value > now.value || (next.value >= now.value - 1e-12 * std::abs(now.value) &&
                                                   next.gradient.norm() < now.gradient.norm());
    if (climbs && step.allFinite()) {
      lambda += step;
      now = next;
      damping = std::max(damping * 0.2, 1e-12);
    } else {
      damping *= 10.0;
      if (damping > 1e12) break;
    }
  }
  if (!(now.gradient.norm() <= 1e3 * kTolerance)) {
    return fail(ErrorCode::not_converged, "the thrust does not suffice for this transfer");
  }
  Steering out;
  out.costate = lambda;
  for (const Control& c : controls) {
    const Vec3 primer = -c.effect.transpose() * lambda;
    const double p = primer.norm();
    const double length = best(c, p, smoothing).length;
    out.controls.push_back(length > 0.0 ? Vec3(length / p * primer) : Vec3(Vec3::Zero()));
  }
  return out;
}

}  // namespace astronav::transfer
