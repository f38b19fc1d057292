// SPDX-License-Identifier: Apache-2.0
#include "simulator/transfer/encounter.h"

#include <cmath>

#include <gtest/gtest.h>

#include "foundation/math/random.h"
#include "simulator/dynamics/propagation.h"
#include "simulator/transfer/ballistic.h"
#include "support/shipped_ephemeris.h"

namespace astronav::transfer {
namespace {

constexpr double kEarthGm = 398600.4415e9;
constexpr double kMarsGm = 42828.375e9;

// Davis' example (Interplanetary Mission Design, University of Colorado), which GMAT gives as well: B.R 10606.21042874,
// B.T 45892.32379544 km.
TEST(BPlane, DavisExample) {
  const State s{1e3 * Vec3(546507.344255845, -527978.380486028, 531109.066836708),
                1e3 * Vec3(-4.9220589268733, 5.36316523097915, -5.22166308425181)};
  const auto b = b_plane(s, kEarthGm);
  ASSERT_TRUE(b) << describe(b.error());
  EXPECT_NEAR(b->b_r_m, 10606.21042874e3, 0.01);
  EXPECT_NEAR(b->b_t_m, 45892.32379544e3, 0.01);
  EXPECT_GT(b->time_to_pericentre_s, 28.0 * 3600.0);
  EXPECT_LT(b->time_to_pericentre_s, 29.0 * 3600.0);
  EXPECT_NEAR(b->R_BN.determinant(), 1.0, 1e-12);
}

State approach() {
  // A million kilometres before Mars, 2.6 km/s, aimed some thousands of kilometres beside it.
  const Vec3 in = Vec3(0.8, 0.5, -0.33).normalized();
  const Vec3 side = in.cross(Vec3(0.1, 0.2, 1.0)).normalized();
  return {-1e9 * in + 9e6 * side, 2600.0 * in};
}
dynamics::AccelerationField mars() {
  return [](Epoch, const State& s) -> Result<Vec3> { return Vec3(-kMarsGm / std::pow(s.p_m.norm(), 3) * s.p_m); };
}

// B is a constant of the hyperbola, and the pericentre comes when it says.
TEST(BPlane, StaysAsTheSpacecraftComesNearer) {
  const auto first = b_plane(approach(), kMarsGm);
  ASSERT_TRUE(first);
  const Epoch end = Epoch() + Duration::seconds(first->time_to_pericentre_s + 7200.0);
  const auto arc = dynamics::propagate(mars(), approach(), Epoch(), end);
  ASSERT_TRUE(arc) << describe(arc.error());
  for (const auto& node : arc->nodes()) {
    const auto now = b_plane(node.state, kMarsGm);
    ASSERT_TRUE(now);
    EXPECT_NEAR(now->b_t_m, first->b_t_m, 1.0);
    EXPECT_NEAR(now->b_r_m, first->b_r_m, 1.0);
    EXPECT_NEAR((node.epoch - Epoch()).seconds() + now->time_to_pericentre_s, first->time_to_pericentre_s, 1e-3);
  }
  const State peri = arc->at(Epoch() + Duration::seconds(first->time_to_pericentre_s)).value();
  EXPECT_NEAR(peri.p_m.dot(peri.v_m_s) / (peri.p_m.norm() * peri.v_m_s.norm()), 0.0, 1e-6);
  EXPECT_NEAR(peri.p_m.norm(), osculating(approach(), kMarsGm).pericentre_m, 10.0);
}

// The ellipse against 4,000 flights with drawn errors: each element of the covariance has a relative scatter of 2.2 %,
// the limits are 5 of that (false alarms below 1e-5 in all).
TEST(BPlane, EllipseIsWhatFlightsScatterTo) {
  RandomStream random(StreamId{.seed = 2, .purpose = "b-plane"});
  Mat6 root = Mat6::Zero();
  for (int i = 0; i < 6; ++i) {
    for (int k = 0; k <= i; ++k) root(i, k) = random.normal() * (i < 3 ? 2e4 : 0.05);
  }
  const Mat6 covariance = root * root.transpose();
  const auto e = b_plane_error(approach(), covariance, kMarsGm);
  ASSERT_TRUE(e) << describe(e.error());
  Mat3 scatter = Mat3::Zero();
  const int count = 4000;
  for (int i = 0; i < count; ++i) {
    Vec6 n;
    for (int k = 0; k < 6; ++k) n[k] = random.normal();
    n = root * n;
    const auto b = b_plane({approach().p_m + n.head<3>(), approach().v_m_s + n.tail<3>()}, kMarsGm);
    ASSERT_TRUE(b);
    const Vec3 d(b->b_t_m - e->at.b_t_m, b->b_r_m - e->at.b_r_m, b->time_to_pericentre_s - e->at.time_to_pericentre_s);
    scatter += d * d.transpose() / count;
  }
  const Vec3 sigma = e->covariance.diagonal().cwiseSqrt();
  EXPECT_LT(((scatter - e->covariance).array() / (sigma * sigma.transpose()).array()).abs().maxCoeff(), 0.11);
  EXPECT_GE(e->semi_major_m, e->semi_minor_m);
  // The ellipse says the same as the matrix.
  const Vec2 major(std::cos(e->angle_rad), std::sin(e->angle_rad));
  const Mat2 p = e->covariance.topLeftCorner<2, 2>();
  EXPECT_NEAR(std::sqrt(major.dot(p * major)) / e->semi_major_m, 1.0, 1e-9);
  EXPECT_NEAR(std::sqrt(p.determinant()) / (e->semi_major_m * e->semi_minor_m), 1.0, 1e-9);
}

// From 30 days before Mars, under all forces: B.T and B.R of flights that begin elsewhere differ as the ellipse says.
TEST(BPlane, ArrivalFromAfar) {
  const Ephemeris& ephemeris = testing::shipped_ephemeris();
  const Epoch departure = Epoch::parse("2026-11-09T00:00:00 TDB").value();
  const auto design = design_ballistic(ephemeris, body::earth, body::mars, departure, Duration::days(300.0));
  ASSERT_TRUE(design);
  const Epoch from = design->arrival - Duration::days(30.0), to = design->arrival - Duration::days(0.5);
  const State state = design->arc.at(from).value();
  const auto forces = dynamics::ForceModel::create(ephemeris);
  Mat6 covariance = Mat6::Zero();
  covariance.diagonal() << 1e8, 4e8, 2e8, 1e-4, 2e-4, 1e-4;  // 10 to 20 km, 1 cm/s
  covariance(0, 3) = covariance(3, 0) = 30.0;
  const auto e = arrival_error(*forces, ephemeris, body::mars, from, state, covariance, to);
  ASSERT_TRUE(e) << describe(e.error());
  EXPECT_NEAR(std::hypot(e->at.b_t_m, e->at.b_r_m), design->miss_distance_m, 0.2 * design->miss_distance_m);
  EXPECT_NEAR(e->at.v_infinity_m_s, design->v_infinity_arrival_m_s.norm(), 20.0);
  // It passes when the B-plane says, and so near.
  const Epoch later = design->arrival + Duration::days(5.0);
  const auto passes = closest_approach(*forces, ephemeris, body::mars, from, state, later);
  ASSERT_TRUE(passes) << describe(passes.error());
  EXPECT_NEAR((*passes - to).seconds(), e->at.time_to_pericentre_s, 600.0);
  EXPECT_EQ(closest_approach(*forces, ephemeris, body::mars, from, state, to).error().code, ErrorCode::not_found);
  // Coasting straight on, 1 cm/s and 10 to 20 km become 27 to 40 km; Mars bends that little at this distance.
  EXPECT_GT(e->semi_minor_m, 20e3);
  EXPECT_LT(e->semi_major_m, 60e3);
  // One drawn error, flown: the shift of B against the derivative of that direction, by a covariance of rank one.
  Vec6 d;
  d << 1e4, -2e4, 1e4, 0.01, 0.01, -0.01;
  const auto along = arrival_error(*forces, ephemeris, body::mars, from, state, d * d.transpose(), to);
  const State moved{state.p_m + d.head<3>(), state.v_m_s + d.tail<3>()};
  const auto there = arrival_error(*forces, ephemeris, body::mars, from, moved, covariance, to);
  ASSERT_TRUE(along && there);
  EXPECT_NEAR(std::abs(there->at.b_t_m - e->at.b_t_m), std::sqrt(along->covariance(0, 0)), 100.0);
  EXPECT_NEAR(std::abs(there->at.b_r_m - e->at.b_r_m), std::sqrt(along->covariance(1, 1)), 100.0);
}

TEST(BPlane, RefusesWhatIsNoHyperbola) {
  EXPECT_FALSE(b_plane({Vec3(1e7, 0.0, 0.0), Vec3(0.0, 1000.0, 0.0)}, kMarsGm)) << "an ellipse";
  EXPECT_FALSE(b_plane({Vec3(1e9, 0.0, 0.0), Vec3(-3000.0, 0.0, 0.0)}, kMarsGm)) << "a fall straight down";
  EXPECT_FALSE(b_plane({Vec3::Zero(), Vec3(0.0, 1000.0, 0.0)}, kMarsGm));
}

}  // namespace
}  // namespace astronav::transfer
