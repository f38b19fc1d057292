// SPDX-License-Identifier: Apache-2.0
// P = U diag(d) U', U upper triangular with ones on the diagonal: a covariance that stays symmetric and positive
// whatever is done to it. A state of variance zero has its unit vector as column of U and costs nothing.
//
// G. J. Bierman, Factorization Methods for Discrete Sequential Estimation, 1977, chapters III, V and VI.
#pragma once

#include "foundation/base/error.h"
#include "onboard/navigation/state.h"

namespace astronav::navigation {

struct FactorisedCovariance {
  StateMatrix u = StateMatrix::Identity();
  StateVector d = StateVector::Zero();
  StateMatrix dense() const;
};
// invalid_argument where P is not positive semidefinite (to 1e-12 of its diagonal).
Result<FactorisedCovariance> factorise(const StateMatrix& P);

// What a step does to the covariance of the states that move the spacecraft: P <- phi P phi' + n diag(q) n', with the
// identity for all others.
inline constexpr int kNoiseColumns = 19;
struct Transition {
  Eigen::Matrix<double, kDynamicStates, kDynamicStates> phi;
  Eigen::Matrix<double, kDynamicStates, kNoiseColumns> n;
  Eigen::Matrix<double, kNoiseColumns, 1> q;
};
// Thornton 1976: modified weighted Gram-Schmidt.
void time_update(FactorisedCovariance& P, const Transition& transition);
// P + weight a a' with a weight that is not negative (Agee & Turner 1972).
void add_outer_product(FactorisedCovariance& P, const StateVector& a, double weight);
// S P S with S = diag(s), s not zero.
void scale(FactorisedCovariance& P, const StateVector& s);
// The state becomes a known number: its row and column of P are zero.
void forget(FactorisedCovariance& P, int state);
// One scalar measurement h' x with variance r > 0 (Bierman).
void measurement_update(FactorisedCovariance& P, const StateVector& h, double r);

}  // namespace astronav::navigation
