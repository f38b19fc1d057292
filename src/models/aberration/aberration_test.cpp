// SPDX-License-Identifier: Apache-2.0
#include "models/aberration/aberration.h"

#include <cmath>

#include <erfa.h>
#include <gtest/gtest.h>

#include "foundation/math/random.h"

namespace astronav {
namespace {

constexpr double kC = 299792458.0;

Vec3 random_direction(RandomStream& random) {
  return Vec3(random.normal(), random.normal(), random.normal()).normalized();
}

// eraAb adds the potential of the Sun; an observer 1e12 au away from it does not feel that.
TEST(Aberration, AgreesWithErfa) {
  RandomStream random(StreamId{.seed = 1, .purpose = "aberration against erfa"});
  for (const double speed : {3e3, 3e4, 1e5, 3e7, 2e8}) {
    for (int i = 0; i < 200; ++i) {
      Vec3 direction = random_direction(random);
      const Vec3 velocity = speed * random_direction(random);
      Vec3 beta = velocity / kC;
      Vec3 expected;
      eraAb(direction.data(), beta.data(), 1e12, std::sqrt(1.0 - beta.squaredNorm()), expected.data());
      EXPECT_LT((aberrate(direction, velocity) - expected).norm(), 1e-12) << speed;
    }
  }
}

TEST(Aberration, ForManyDirectionsIsTheSame) {
  RandomStream random(StreamId{.seed = 3, .purpose = "aberration for many"});
  for (const double speed : {0.0, 3e4, 1e5, 3e7, 2e8}) {
    for (int i = 0; i < 100; ++i) {
      const Vec3 direction = random_direction(random);
      const Vec3 velocity = speed * random_direction(random);
      const Vec3 along = random.uniform(0.5, 2.0) * direction;
      const auto [x, y, z] = Aberration(velocity).apparent(along.x(), along.y(), along.z());
      const Vec3 apparent(x, y, z);
      EXPECT_LT((apparent - aberrate(direction, velocity)).norm(), 1e-15) << speed;
      EXPECT_NEAR(apparent.norm(), 1.0, 1e-15);
    }
  }
}

// The angle from the apex of motion, in closed form: tan(theta'/2) = sqrt((1-beta)/(1+beta)) tan(theta/2).
TEST(Aberration, AgreesWithTheHalfAngleFormula) {
  for (const double beta : {1e-4, 0.1, 0.9}) {
    for (double theta = 0.1; theta < 3.1; theta += 0.3) {
      const Vec3 seen = aberrate({std::cos(theta), std::sin(theta), 0.0}, {beta * kC, 0.0, 0.0});
      const double expected = 2.0 * std::atan(std::sqrt((1.0 - beta) / (1.0 + beta)) * std::tan(theta / 2.0));
      EXPECT_NEAR(std::atan2(seen.y(), seen.x()), expected, 1e-14) << beta << " " << theta;
    }
  }
}

TEST(Aberration, InverseUndoesIt) {
  RandomStream random(StreamId{.seed = 2, .purpose = "aberration inverse"});
  for (int i = 0; i < 500; ++i) {
    const Vec3 direction = random_direction(random);
    const Vec3 velocity = random.uniform(0.0, 1e8) * random_direction(random);
    EXPECT_LT((unaberrate(aberrate(direction, velocity), velocity) - direction).norm(), 2e-15);
  }
}

TEST(Aberration, NothingHappensAtRest) {
  const Vec3 direction(0.6, 0.0, 0.8);
  EXPECT_EQ(aberrate(direction, Vec3::Zero()), direction);
  EXPECT_EQ(aberrate_first_order(direction, Vec3::Zero()), direction);
}

// What the first order leaves out is at most beta^2 / 2 (docs/theory/light-time-and-aberration.md eq. 4).
TEST(Aberration, FirstOrderIsGoodToBetaSquared) {
  RandomStream random(StreamId{.seed = 3, .purpose = "aberration first order"});
  double worst = 0.0;
  for (int i = 0; i < 2000; ++i) {
    const Vec3 direction = random_direction(random);
    const Vec3 velocity = 3e4 * random_direction(random);
    worst = std::max(worst, (aberrate(direction, velocity) - aberrate_first_order(direction, velocity)).norm());
  }
  const double beta2 = (3e4 / kC) * (3e4 / kC);
  EXPECT_LT(worst, 0.5 * beta2);
  EXPECT_GT(worst, 0.1 * beta2);
}

// Derivative of f at x by central differences.
template <typename F>
Mat3 numerical(const F& f, const Vec3& x, double h) {
  Mat3 m;
  for (int i = 0; i < 3; ++i) {
    const Vec3 step = h * Vec3::Unit(i);
    m.col(i) = (f(Vec3(x + step)) - f(Vec3(x - step))) / (2.0 * h);
  }
  return m;
}

TEST(Aberration, DerivativesAgreeWithDifferences) {
  RandomStream random(StreamId{.seed = 4, .purpose = "aberration derivatives"});
  for (const double speed : {3e4, 3e7, 2e8}) {
    for (int i = 0; i < 50; ++i) {
      const Vec3 s = random_direction(random);
      const Vec3 v = speed * random_direction(random);
      Mat3 by_direction, by_velocity;
      aberrate(s, v, &by_direction, &by_velocity);
      const Mat3 tangent = Mat3::Identity() - s * s.transpose();
      const Mat3 ds = numerical([&](const Vec3& x) { return aberrate(x.normalized(), v); }, s, 1e-5);
      const Mat3 dv = numerical([&](const Vec3& x) { return aberrate(s, x); }, v, 1e-5 * kC);
      EXPECT_LT((by_direction * tangent - ds).norm(), 1e-8 * (1.0 + ds.norm())) << speed;
      EXPECT_LT((by_velocity - dv).norm() * kC, 1e-7 * (1.0 + dv.norm() * kC)) << speed;
    }
  }
}

TEST(Aberration, FirstOrderDerivativesAgreeWithDifferences) {
  const Vec3 s = Vec3(1.0, -2.0, 0.5).normalized();
  const Vec3 v(2e4, 1e4, -2.5e4);
  const auto raw = [](const Vec3& d, const Vec3& velocity) {
    const Vec3 beta = velocity / kC;
    return Vec3(d + beta - d * d.dot(beta));
  };
  Mat3 by_direction, by_velocity;
  aberrate_first_order(s, v, &by_direction, &by_velocity);
  EXPECT_LT((by_direction - numerical([&](const Vec3& x) { return raw(x, v); }, s, 1e-5)).norm(), 1e-10);
  EXPECT_LT((by_velocity - numerical([&](const Vec3& x) { return raw(s, x); }, v, 1e3)).norm() * kC, 1e-9);
}

TEST(Aberration, RateIsTheDerivativeOfTheApparentPlace) {
  const Vec3 p0(1.2e11, -0.7e11, 0.2e11), v(-2.1e4, 1.3e4, 3e3);
  const Vec3 observer_v(1.5e4, 2.4e4, 1e3), observer_a(4e-3, -3e-3, 1e-3);
  const auto at = [&](double t) { return aberrate_motion(p0 + t * v, v, observer_v + t * observer_a, observer_a); };
  const double h = 100.0;
  const Vec3 difference = (at(h).p_m - at(-h).p_m) / (2.0 * h);
  EXPECT_LT((at(0.0).v_m_s - difference).norm(), 1e-5);
  EXPECT_NEAR(at(0.0).p_m.norm(), p0.norm(), 1e-3);
}

}  // namespace
}  // namespace astronav
