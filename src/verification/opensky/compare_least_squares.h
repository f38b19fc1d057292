// SPDX-License-Identifier: Apache-2.0
// Least squares with few parameters and numerical derivatives (Levenberg 1944, Marquardt 1963).
#pragma once

#include <algorithm>
#include <cmath>

#include <Eigen/Cholesky>
#include <Eigen/Core>

namespace astronav::opensky {

// Changes `x` so that |residuals(x)| becomes smallest and returns its square. `residuals` takes x and gives a vector
// whose length does not change. `steps`: for the differences, one for each parameter, of the size in which it matters.
template <typename Residuals>
double least_squares(const Residuals& residuals, Eigen::VectorXd& x, const Eigen::VectorXd& steps,
                     int max_iterations = 20) {
  Eigen::VectorXd r = residuals(x);
  double cost = r.squaredNorm();
  double damping = 1e-3;
  for (int iteration = 0; iteration < max_iterations; ++iteration) {
    Eigen::MatrixXd J(r.size(), x.size());
    for (Eigen::Index k = 0; k < x.size(); ++k) {
      Eigen::VectorXd up = x, down = x;
      up[k] += steps[k];
      down[k] -= steps[k];
      J.col(k) = (residuals(up) - residuals(down)) / (2.0 * steps[k]);
    }
    const Eigen::MatrixXd normal = J.transpose() * J;
    const Eigen::VectorXd gradient = J.transpose() * r;
    bool better = false;
    double gain = 0.0;
    for (int trial = 0; trial < 8 && !better; ++trial) {
      Eigen::MatrixXd damped = normal;
      damped.diagonal() += damping * normal.diagonal() + Eigen::VectorXd::Constant(x.size(), 1e-30);
      const Eigen::VectorXd next = x - damped.ldlt().solve(gradient);
      const Eigen::VectorXd next_r = residuals(next);
      const double next_cost = next_r.squaredNorm();
      if (next_cost < cost) {
        gain = cost - next_cost;
        x = next;
        r = next_r;
        cost = next_cost;
        damping = std::max(damping * 0.1, 1e-12);
        better = true;
      } else {
        damping *= 10.0;
      }
    }
    if (!better || gain <= 1e-8 * cost) break;
  }
  return cost;
}

}  // namespace astronav::opensky
