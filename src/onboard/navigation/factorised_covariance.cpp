// SPDX-License-Identifier: Apache-2.0
#include "onboard/navigation/factorised_covariance.h"

#include <cmath>

namespace astronav::navigation {

StateMatrix FactorisedCovariance::dense() const {
  return u * d.asDiagonal() * u.transpose();
}

Result<FactorisedCovariance> factorise(const StateMatrix& P) {
  FactorisedCovariance out;
  StateMatrix rest = P;
  for (int j = kStates - 1; j >= 0; --j) {
    double d = rest(j, j);
    if (!(d >= -1e-12 * P(j, j)) || !std::isfinite(d))
      return fail(ErrorCode::invalid_argument, "covariance is not positive: pivot {1} at state {0}",
                  {static_cast<double>(j), d});
    // What is left of a variance after rounding is none.
    if (d <= 1e-14 * P(j, j)) d = 0.0;
    out.d[j] = d;
    if (d == 0.0) continue;
    out.u.col(j).head(j) = rest.col(j).head(j) / d;
    for (int k = 0; k < j; ++k) rest.col(k).head(k + 1) -= out.u(k, j) * d * out.u.col(j).head(k + 1);
  }
  return out;
}

void time_update(FactorisedCovariance& P, const Transition& transition) {
  constexpr int n = kDynamicStates;
  // With the states in this order the factor of the others stays as it is, and their columns are carried along.
  for (int j = n; j < kStates; ++j)
    if (P.d[j] > 0.0) P.u.col(j).head<n>() = (transition.phi * P.u.col(j).head<n>()).eval();

  // A column here is a row of [phi U, n]; those of weight zero are left out, and the rest filled up to whole registers.
  constexpr int kLanes = 8;
  constexpr int kMostColumns = (n + kNoiseColumns + kLanes - 1) / kLanes * kLanes;
  Eigen::Matrix<double, kMostColumns, n> w;
  Eigen::Matrix<double, kMostColumns, 1> weights, weighted;
  const Eigen::Matrix<double, n, n> spread = transition.phi * P.u.topLeftCorner<n, n>();
  int columns = 0;
  const auto take = [&](const auto& column, double weight) {
    if (!(weight > 0.0)) return;
    w.row(columns) = column.transpose();
    weights[columns++] = weight;
  };
  for (int j = 0; j < n; ++j) take(spread.col(j), P.d[j]);
  for (int j = 0; j < kNoiseColumns; ++j) take(transition.n.col(j), transition.q[j]);
  for (; columns % kLanes != 0; ++columns) {
    w.row(columns).setZero();
    weights[columns] = 0.0;
  }

  P.u.topLeftCorner<n, n>().setIdentity();
  for (int j = n - 1; j >= 0; --j) {
    weighted.head(columns) = w.col(j).head(columns).cwiseProduct(weights.head(columns));
    const double d = weighted.head(columns).dot(w.col(j).head(columns));
    P.d[j] = d;
    if (!(d > 0.0)) continue;
    for (int i = 0; i < j; ++i) {
      const double u = w.col(i).head(columns).dot(weighted.head(columns)) / d;
      P.u(i, j) = u;
      w.col(i).head(columns) -= u * w.col(j).head(columns);
    }
  }
}

void add_outer_product(FactorisedCovariance& P, const StateVector& a, double weight) {
  StateVector rest = a;
  for (int j = kStates - 1; j >= 0 && weight > 0.0; --j) {
    const double own = rest[j];
    if (own == 0.0) continue;
    const double d = P.d[j] + weight * own * own;
    if (!(d > 0.0)) continue;  // too small to be squared
    // Written without the difference that loses everything where a state is nearly all new.
    const double share = P.d[j] / d, gain = weight * own / d;
    for (int i = 0; i < j; ++i) {
      const double u = P.u(i, j), before = rest[i];
      rest[i] -= own * u;
      P.u(i, j) = share * u + gain * before;
    }
    weight *= share;
    P.d[j] = d;
  }
}

void scale(FactorisedCovariance& P, const StateVector& s) {
  for (int j = 0; j < kStates; ++j) {
    P.u.col(j).head(j).array() *= s.head(j).array() * (1.0 / s[j]);
    P.d[j] *= s[j] * s[j];
  }
}

void forget(FactorisedCovariance& P, int state) {
  StateVector shared = StateVector::Zero();
  shared.head(state) = P.u.col(state).head(state);
  const double weight = P.d[state];
  P.u.row(state).tail(kStates - state).setZero();
  P.u.col(state) = StateVector::Unit(state);
  P.d[state] = 0.0;
  add_outer_product(P, shared, weight);
}

void measurement_update(FactorisedCovariance& P, const StateVector& h, double r) {
  StateVector gain = StateVector::Zero();  // times the innovation's variance
  double alpha = r;
  for (int j = 0; j < kStates; ++j) {
    if (!(P.d[j] > 0.0)) continue;
    const double f = P.u.col(j).head(j + 1).dot(h.head(j + 1));
    if (f == 0.0) continue;
    const double b = P.d[j] * f;
    const double before = alpha;
    alpha += f * b;
    P.d[j] *= before / alpha;
    const double lambda = -f / before;
    for (int i = 0; i < j; ++i) {
      const double u = P.u(i, j);
      P.u(i, j) = u + lambda * gain[i];
      gain[i] += b * u;
    }
    gain[j] = b;
  }
}

}  // namespace astronav::navigation
