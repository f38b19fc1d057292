// SPDX-License-Identifier: Apache-2.0
// Optimal steering of a linear system by bounded vectors: the inner problem of the low-thrust design.
//
//   minimise  sum_i w_i [ (1 - s) |u_i| + s |u_i|^2 / 2 ]    over |u_i| <= limit_i,  such that  sum_i B_i u_i = goal
//
// s = 1 is least energy, s -> 0 least propellant. It is solved in its dual, the six costates of the goal: with the
// primer vector p_i = -B_i' lambda of each control, u_i points along p_i and is as long as |p_i| makes worth its while
// (docs/theory/dynamics.md, "Low thrust"). The dual is concave and once differentiable: Newton's method climbs it.
#pragma once

#include <vector>

#include <Eigen/Core>

#include "foundation/base/error.h"
#include "foundation/math/linear.h"

namespace astronav::transfer {

using Mat63 = Eigen::Matrix<double, 6, 3>;

struct Control {
  Mat63 effect = Mat63::Zero();  // B_i, non-dimensional
  double limit = 1.0;            // 0: stays zero
  double weight = 1.0;           // of its cost; 0: free but for a trace that keeps it unique
};

struct Steering {
  std::vector<Vec3> controls;
  Vec6 costate = Vec6::Zero();
};

// `costate` is where the climb begins. not_converged where the goal is out of reach.
Result<Steering> steer(const std::vector<Control>& controls, const Vec6& goal, double smoothing, const Vec6& costate);

}  // namespace astronav::transfer
