// SPDX-License-Identifier: Apache-2.0
#include "onboard/navigation/factorised_covariance.h"

#include <cmath>

#include <gtest/gtest.h>

#include "foundation/math/random.h"

namespace astronav::navigation {
namespace {

StateMatrix random_covariance(RandomStream& random) {
  StateMatrix a;
  for (double& x : a.reshaped()) x = random.normal();
  StateVector scale;
  for (double& x : scale) x = std::pow(10.0, random.uniform(-5.0, 2.0));
  return scale.asDiagonal() * (a * a.transpose()) * scale.asDiagonal();
}

// Largest difference, in units of the standard deviations of `truth`.
double relative_difference(const StateMatrix& m, const StateMatrix& truth) {
  const StateVector inverse = truth.diagonal().cwiseSqrt().cwiseInverse();
  return (inverse.asDiagonal() * (m - truth) * inverse.asDiagonal()).cwiseAbs().maxCoeff();
}

TEST(FactorisedCovariance, IsTheMatrixItCameFrom) {
  RandomStream random({.seed = 1, .purpose = "factorise"});
  for (int i = 0; i < 20; ++i) {
    const StateMatrix P = random_covariance(random);
    EXPECT_LT(relative_difference(factorise(P)->dense(), P), 1e-12);
  }
  StateMatrix indefinite = StateMatrix::Identity();
  indefinite(0, 1) = indefinite(1, 0) = 1.5;
  EXPECT_FALSE(factorise(indefinite));
  StateMatrix singular = StateMatrix::Identity();
  singular(5, 5) = 0.0;  // a state that is known exactly
  EXPECT_EQ(factorise(singular)->dense(), singular);
}

StateMatrix with_phi(const StateMatrix& P, const Eigen::Matrix<double, kDynamicStates, kDynamicStates>& phi) {
  StateMatrix full = StateMatrix::Identity();
  full.topLeftCorner<kDynamicStates, kDynamicStates>() = phi;
  return full * P * full.transpose();
}

TEST(FactorisedCovariance, TimeUpdateIsPhiPPhiPlusQ) {
  RandomStream random({.seed = 2, .purpose = "time update"});
  for (int i = 0; i < 20; ++i) {
    const StateMatrix P = random_covariance(random);
    Transition t;
    for (double& x : t.phi.reshaped()) x = random.normal();
    for (double& x : t.n.reshaped()) x = random.normal();
    for (double& x : t.q) x = random.uniform();
    FactorisedCovariance factors = factorise(P).value();
    time_update(factors, t);
    StateMatrix expected = with_phi(P, t.phi);
    expected.topLeftCorner<kDynamicStates, kDynamicStates>() += t.n * t.q.asDiagonal() * t.n.transpose();
    EXPECT_LT(relative_difference(factors.dense(), expected), 1e-10);
  }
}

TEST(FactorisedCovariance, MeasurementUpdateIsJosephs) {
  RandomStream random({.seed = 3, .purpose = "measurement update"});
  for (int i = 0; i < 20; ++i) {
    const StateMatrix P = random_covariance(random);
    StateVector h;
    for (double& x : h) x = random.normal();
    const double r = random.uniform(0.1, 10.0);
    FactorisedCovariance factors = factorise(P).value();
    measurement_update(factors, h, r);
    const StateVector k = P * h / (h.dot(P * h) + r);
    const StateMatrix rest = StateMatrix::Identity() - k * h.transpose();
    EXPECT_LT(relative_difference(factors.dense(), rest * P * rest.transpose() + r * k * k.transpose()), 1e-8);
  }
}

TEST(FactorisedCovariance, TakesAnOuterProduct) {
  RandomStream random({.seed = 4, .purpose = "outer product"});
  for (int i = 0; i < 20; ++i) {
    const StateMatrix P = random_covariance(random);
    StateVector a;
    for (double& x : a) x = random.normal();
    a[3 + i % 5] = 0.0;
    const double weight = random.uniform(0.0, 10.0);
    FactorisedCovariance factors = factorise(P).value();
    add_outer_product(factors, a, weight);
    EXPECT_LT(relative_difference(factors.dense(), P + weight * a * a.transpose()), 1e-10);
  }
  FactorisedCovariance nothing;  // states of variance zero come to life
  const StateVector a = StateVector::LinSpaced(-1.0, 3.0);
  add_outer_product(nothing, a, 2.0);
  EXPECT_LT((nothing.dense() - 2.0 * a * a.transpose()).norm(), 1e-13);
}

// A state of which a 1e-20th of its sigma is left, and a new one comes in: what it shared with others is theirs now.
TEST(FactorisedCovariance, ForgetsByDecayAsItForgetsAtOnce) {
  RandomStream random({.seed = 5, .purpose = "forget"});
  for (const int state : {0, 6, index::bias, kStates - 1}) {
    const StateMatrix P = random_covariance(random);
    StateMatrix expected = P;
    expected.row(state).setZero();
    expected.col(state).setZero();
    const double variance = P(state, state);
    FactorisedCovariance decayed = factorise(P).value(), forgotten = decayed;
    StateVector factor = StateVector::Ones();
    factor[state] = 1e-20;
    scale(decayed, factor);
    forget(forgotten, state);
    EXPECT_EQ(forgotten.d[state], 0.0);
    for (FactorisedCovariance* factors : {&decayed, &forgotten})
      add_outer_product(*factors, StateVector::Unit(state), variance);
    expected(state, state) = variance;
    EXPECT_LT(relative_difference(decayed.dense(), expected), 1e-10) << state;
    EXPECT_LT(relative_difference(forgotten.dense(), expected), 1e-10) << state;
  }
}

TEST(FactorisedCovariance, ScalesRowsAndColumns) {
  RandomStream random({.seed = 6, .purpose = "scale"});
  const StateMatrix P = random_covariance(random);
  StateVector s;
  for (double& x : s) x = random.normal();
  FactorisedCovariance factors = factorise(P).value();
  scale(factors, s);
  EXPECT_LT(relative_difference(factors.dense(), s.asDiagonal() * P * s.asDiagonal()), 1e-12);
}

}  // namespace
}  // namespace astronav::navigation
