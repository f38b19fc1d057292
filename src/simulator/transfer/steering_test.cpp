// SPDX-License-Identifier: Apache-2.0
#include "simulator/transfer/steering.h"

#include <cmath>

#include <Eigen/Dense>
#include <gtest/gtest.h>

#include "foundation/math/random.h"

namespace astronav::transfer {
namespace {

std::vector<Control> random_controls(int count, RandomStream& random) {
  std::vector<Control> out(count);
  for (Control& c : out) {
    for (int i = 0; i < 18; ++i) c.effect(i / 3, i % 3) = 0.1 * random.normal();
  }
  return out;
}
Vec6 reached(const std::vector<Control>& controls, const std::vector<Vec3>& u) {
  Vec6 sum = Vec6::Zero();
  for (std::size_t i = 0; i < u.size(); ++i) sum += controls[i].effect * u[i];
  return sum;
}
double cost(const std::vector<Vec3>& u, double s) {
  double sum = 0.0;
  for (const Vec3& v : u) sum += (1.0 - s) * v.norm() + 0.5 * s * v.squaredNorm();
  return sum;
}

// Without a limit the least energy is the least norm, which is known: B'(BB')^-1 goal.
TEST(Steering, LeastEnergyIsLeastNorm) {
  RandomStream random(StreamId{.purpose = "steering"});
  const auto controls = random_controls(20, random);
  Vec6 goal;
  goal << 0.1, -0.2, 0.05, 0.1, 0.02, -0.1;
  Eigen::Matrix<double, 6, 60> b;
  for (int i = 0; i < 20; ++i) b.middleCols<3>(3 * i) = controls[i].effect;
  const Eigen::Matrix<double, 60, 1> least = b.transpose() * (b * b.transpose()).ldlt().solve(goal);
  const auto s = steer(controls, goal, 1.0, Vec6::Zero());
  ASSERT_TRUE(s) << describe(s.error());
  for (int i = 0; i < 20; ++i) EXPECT_LT((s->controls[i] - least.segment<3>(3 * i)).norm(), 1e-7);
}

// Against all comers: any other admissible control that reaches the goal costs more.
TEST(Steering, IsTheCheapest) {
  RandomStream random(StreamId{.purpose = "steering, cheapest"});
  for (const double smoothing : {1.0, 0.3, 0.02}) {
    const auto controls = random_controls(30, random);
    Vec6 goal;
    for (int i = 0; i < 6; ++i) goal[i] = 0.25 * random.normal();
    Vec6 costate = Vec6::Zero();
    for (double s = 1.0; s > smoothing; s *= 0.5) costate = steer(controls, goal, s, costate)->costate;
    const auto s = steer(controls, goal, smoothing, costate);
    ASSERT_TRUE(s) << describe(s.error());
    EXPECT_LT((reached(controls, s->controls) - goal).norm(), 1e-6);
    for (const Vec3& u : s->controls) EXPECT_LE(u.norm(), 1.0 + 1e-12);
    // Moves that keep the goal: random ones, with the least-norm answer to what they change taken off.
    Eigen::MatrixXd b(6, 90);
    for (int i = 0; i < 30; ++i) b.middleCols(3 * i, 3) = controls[i].effect;
    for (int trial = 0; trial < 300; ++trial) {
      Eigen::VectorXd move(90);
      for (int i = 0; i < 90; ++i) move[i] = random.normal();
      move -= b.transpose() * (b * b.transpose()).ldlt().solve(b * move);
      move *= std::pow(10.0, random.uniform(-3.0, -1.0));
      std::vector<Vec3> other = s->controls;
      bool admissible = true;
      for (int i = 0; i < 30; ++i) {
        other[i] += move.segment<3>(3 * i);
        admissible = admissible && other[i].norm() <= 1.0;
      }
      if (!admissible) continue;
      EXPECT_GE(cost(other, smoothing), cost(s->controls, smoothing) - 1e-9);
    }
  }
}

// Little propellant means bangs and coasts: nearly all controls are at one end.
TEST(Steering, LittlePropellantIsBangBang) {
  RandomStream random(StreamId{.purpose = "steering, bang"});
  const auto controls = random_controls(100, random);
  Vec6 goal = Vec6::Constant(1.0);
  Vec6 costate = Vec6::Zero();
  for (double s = 1.0; s > 0.01; s *= 0.5) {
    const auto r = steer(controls, goal, s, costate);
    ASSERT_TRUE(r) << describe(r.error());
    costate = r->costate;
  }
  int between = 0, on = 0;
  const auto last = steer(controls, goal, 0.01, costate);
  ASSERT_TRUE(last);
  for (const Vec3& u : last->controls) {
    between += u.norm() > 0.02 && u.norm() < 0.98;
    on += u.norm() >= 0.98;
  }
  EXPECT_LE(between, 8);
  EXPECT_GT(on, 3);
  EXPECT_LT(on, 90);
}

TEST(Steering, SaysWhatIsOutOfReach) {
  RandomStream random(StreamId{.purpose = "steering, reach"});
  const auto controls = random_controls(5, random);
  const auto s = steer(controls, Vec6::Constant(100.0), 1.0, Vec6::Zero());
  ASSERT_FALSE(s);
  EXPECT_EQ(s.error().code, ErrorCode::not_converged);
}

}  // namespace
}  // namespace astronav::transfer
