// SPDX-License-Identifier: Apache-2.0
// Thrust and kicks: what is drawn, and what a trajectory makes of it.
#include <algorithm>
#include <cmath>

#include <gtest/gtest.h>

#include "simulator/dynamics/propagation.h"
#include "support/shipped_ephemeris.h"

namespace astronav::dynamics {
namespace {

Epoch day(double d) {
  return Epoch::parse("2027-01-01T00:00:00 TDB").value() + Duration::days(d);
}
RandomStream stream(std::uint64_t seed = 1) {
  return RandomStream(StreamId{.seed = seed, .purpose = "events"});
}
ThrustPlan plan(double days) {
  return {.mass_kg = 22.0, .arcs = {{day(1), day(1.0 + days), 1.9e-3, 3000.0, Vec3(2.0, 3.0, 6.0) / 7.0}}};
}
ForceSettings nothing() {
  return {.bodies = {}, .relativity = false, .srp_cr_area_over_mass_m2_kg = 0.0};
}
const Ephemeris& ephemeris() {
  return testing::shipped_ephemeris();
}

TEST(Kicks, AreDrawnAsAsked) {
  RandomStream random = stream();
  const auto kicks = Kicks::draw({}, day(0), day(30000), random);
  ASSERT_TRUE(kicks) << describe(kicks.error());
  const auto& list = kicks->list();
  // One every 3 days; the sum of n pauses scatters by 1.15 days sqrt(n).
  const double n = static_cast<double>(list.size());
  EXPECT_NEAR(n, 10000.0, 200.0);
  double smallest = 1.0, largest = 0.0, mean = 0.0;
  Vec3 direction = Vec3::Zero(), squares = Vec3::Zero();
  for (std::size_t i = 0; i < list.size(); ++i) {
    const double size = list[i].delta_v_N_m_s.norm();
    smallest = std::min(smallest, size);
    largest = std::max(largest, size);
    mean += size / n;
    direction += list[i].delta_v_N_m_s / size / n;
    squares += (list[i].delta_v_N_m_s / size).cwiseAbs2() / n;
    if (i == 0) continue;
    const double pause = (list[i].begin - list[i - 1].begin).days();
    EXPECT_GE(pause, 1.0);
    EXPECT_LE(pause, 5.0);
  }
  EXPECT_GE(smallest, 2e-3);
  EXPECT_LE(largest, 13e-3);
  // Limits of 5 standard deviations: false alarms below 1e-5.
  EXPECT_NEAR(mean, 7.5e-3, 5.0 * 3.18e-3 / std::sqrt(n));
  EXPECT_LT(direction.cwiseAbs().maxCoeff(), 5.0 * std::sqrt(1.0 / 3.0 / n));
  EXPECT_LT((squares - Vec3::Constant(1.0 / 3.0)).cwiseAbs().maxCoeff(), 5.0 * 0.3 / std::sqrt(n));
  RandomStream again = stream(), other = stream(2);
  const auto fewer = Kicks::draw({}, day(0), day(50), again);
  EXPECT_EQ(fewer->list().back().delta_v_N_m_s, list[fewer->list().size() - 1].delta_v_N_m_s)
      << "a shorter span has the same kicks";
  EXPECT_NE(Kicks::draw({}, day(0), day(50), other)->list().front().begin, list.front().begin);
}

TEST(Kicks, RefuseNonsense) {
  RandomStream random = stream();
  EXPECT_FALSE(Kicks::draw({.smallest_m_s = 2.0, .largest_m_s = 1.0}, day(0), day(9), random));
  EXPECT_FALSE(Kicks::draw({.smallest_m_s = -2.0}, day(0), day(9), random));
  EXPECT_FALSE(Kicks::draw({.largest_m_s = std::nan("")}, day(0), day(9), random));
  EXPECT_FALSE(Kicks::draw({.shortest_pause = Duration::seconds(60.0)}, day(0), day(9), random));
  EXPECT_FALSE(Kicks::draw({.longest_pause = Duration::days(0.5)}, day(0), day(9), random));
  EXPECT_FALSE(Kicks::draw({}, day(9), day(0), random));
  EXPECT_FALSE(Kicks::at_times({{day(1), Vec3::UnitX()}, {day(1) + Duration::seconds(59.0), Vec3::UnitX()}}));
  EXPECT_FALSE(Kicks::at_times({{day(1), Vec3::UnitX()}}, Duration{}));
}

// A kick changes the velocity by what it says, there and back, and the output between the nodes knows it.
TEST(Propagation, FollowsKicks) {
  const auto kicks = Kicks::at_times({{day(1), {0.01, 0.0, 0.0}}, {day(2.5), {0.0, -0.004, 0.003}}});
  ASSERT_TRUE(kicks);
  const auto forces =
      ForceModel::create(ephemeris(), nothing(), Events{.unmodelled = {}, .thrust = {}, .kicks = *kicks});
  ASSERT_TRUE(forces);
  const State start{Vec3::Zero(), {100.0, 0.0, 0.0}};
  const auto arc = propagate(*forces, start, day(0), day(4));
  ASSERT_TRUE(arc) << describe(arc.error());
  EXPECT_LT((arc->at(day(1)).value().v_m_s - start.v_m_s).norm(), 1e-12);
  const Epoch middle = day(1) + Duration::seconds(30.0), after = day(1) + Duration::seconds(60.0);
  EXPECT_LT((arc->at(middle).value().v_m_s - Vec3(100.005, 0.0, 0.0)).norm(), 1e-9);
  EXPECT_LT((arc->at(after).value().v_m_s - Vec3(100.01, 0.0, 0.0)).norm(), 1e-12);
  EXPECT_LT((arc->at(day(4)).value().v_m_s - Vec3(100.01, -0.004, 0.003)).norm(), 1e-12);
  // As if each had come all at once in its middle.
  const Vec3 far = 4 * 86400.0 * start.v_m_s + (3 * 86400.0 - 30.0) * Vec3(0.01, 0.0, 0.0) +
                   (1.5 * 86400.0 - 30.0) * Vec3(0.0, -0.004, 0.003);
  EXPECT_LT((arc->at(day(4)).value().p_m - far).norm(), 1e-6);
  const auto back = propagate(*forces, arc->nodes().back().state, day(4), day(0));
  ASSERT_TRUE(back);
  EXPECT_LT((back->nodes().front().state.p_m - start.p_m).norm(), 1e-6);
  EXPECT_LT((back->at(middle).value().v_m_s - arc->at(middle).value().v_m_s).norm(), 1e-11);
}

// Tsiolkovsky: in empty space the speed gained is c ln(m0/m), the way c t (1 - m/(m0-m) ln(m0/m)).
TEST(Propagation, ObeysTheRocketEquation) {
  auto thrust = ThrustHistory::as_planned(plan(200.0));
  ASSERT_TRUE(thrust) << describe(thrust.error());
  const auto forces =
      ForceModel::create(ephemeris(), nothing(), Events{.unmodelled = {}, .thrust = *thrust, .kicks = {}});
  ASSERT_TRUE(forces);
  const auto arc = propagate(*forces, State{Vec3::Zero(), Vec3::Zero()}, day(0), day(300));
  ASSERT_TRUE(arc) << describe(arc.error());
  const double c = 3000.0 * 9.80665, burn = 200 * 86400.0, used = 1.9e-3 / c * burn;
  const double ratio = std::log(22.0 / (22.0 - used));
  EXPECT_NEAR(forces->mass_kg(day(300)), 22.0 - used, 1e-12);
  EXPECT_NEAR(forces->mass_kg(day(101)), 22.0 - 0.5 * used, 1e-12);
  const Vec3 u = Vec3(2.0, 3.0, 6.0) / 7.0;
  EXPECT_LT((arc->nodes().back().state.v_m_s - c * ratio * u).norm(), 1e-8);
  EXPECT_NEAR(plan(200.0).delta_v_m_s(), c * ratio, 1e-9);
  const double way = c * burn * (1.0 - (22.0 - used) / used * ratio);
  EXPECT_LT((arc->at(day(201)).value().p_m - way * u).norm(), 0.01);
  EXPECT_LT(arc->at(day(1)).value().p_m.norm(), 1e-9) << "nothing happens before the arc";
}

// Errors of execution have their size: 3 axes, correlation 1 day, 20,000 days; sigma is known to 1 %, the limits are 6
// %.
TEST(Thrust, ErrorsHaveTheirSize) {
  RandomStream random = stream();
  const ThrustErrors errors{.magnitude_sigma = 0.005, .pointing_sigma_rad = 0.3 * kDegree};
  ThrustPlan endless = plan(20000.0);
  endless.mass_kg = 1e4;
  const auto thrust = ThrustHistory::fly(endless, errors, day(0), day(20001), random);
  ASSERT_TRUE(thrust) << describe(thrust.error());
  const Vec3 u = endless.arcs[0].direction_N;
  double magnitude = 0.0, angle = 0.0, mean = 0.0;
  const int count = 19999;
  for (int i = 0; i < count; ++i) {
    const Vec3 force = thrust->force_N_n(day(2.0 + i));
    magnitude += std::pow(force.norm() / 1.9e-3 - 1.0, 2) / count;
    mean += (force.norm() / 1.9e-3 - 1.0) / count;
    angle += std::pow(force.cross(u).norm() / force.norm(), 2) / 2.0 / count;
  }
  EXPECT_NEAR(std::sqrt(magnitude) / 0.005, 1.0, 0.06);
  EXPECT_NEAR(std::sqrt(angle) / (0.3 * kDegree), 1.0, 0.06);
  // Propellant follows the force: the mean of the samples is that of the whole within 4e-5 (1 sigma 6e-6 or so).
  const double used = (1e4 - thrust->mass_kg(day(20001))) / (1.9e-3 / (3000.0 * 9.80665) * 20000 * 86400.0);
  EXPECT_NEAR(used, 1.0 + mean, 1e-4);
  EXPECT_EQ(thrust->force_N_n(day(0.5)), Vec3::Zero());
  EXPECT_EQ(thrust->next_knot(day(0.0), day(9)), day(1)) << "errors make no knots outside the arcs";
  EXPECT_EQ(thrust->next_knot(day(1.0), day(9)), day(1.125));
  EXPECT_FALSE(ThrustHistory::fly(plan(1.0), {.magnitude_sigma = -1.0}, day(0), day(9), random));
  EXPECT_FALSE(ThrustHistory::fly({.mass_kg = -1.0, .arcs = {}}, {}, day(0), day(9), random));
}

// The engine runs its tank down while it bends the orbit: with errors, forwards and backwards must agree.
TEST(Propagation, GoesThereAndBackWithEverything) {
  RandomStream random = stream();
  Events events;
  events.unmodelled = UnmodelledAcceleration::draw({.sigma_m_s2 = 1e-8}, day(0), day(60), random).value();
  events.thrust =
      ThrustHistory::fly(plan(20.3), {.magnitude_sigma = 0.005, .pointing_sigma_rad = 0.005}, day(0), day(60), random)
          .value();
  events.kicks = Kicks::draw({}, day(0), day(60), random).value();
  ForceSettings settings;
  settings.plates = box_wing({0.2, 0.2, 0.3}, 0.3, 0.3, 0.6, Vec3::UnitY(), 0.1, 0.1);
  settings.attitude = sun_pointing(Vec3::UnitX(), Vec3::UnitZ());
  const auto forces = ForceModel::create(ephemeris(), settings, events);
  ASSERT_TRUE(forces) << describe(forces.error());
  State start = ephemeris().state(body::earth, body::solar_system_barycenter, day(0)).value();
  start.p_m += 1e9 * start.v_m_s.normalized();
  start.v_m_s *= 1.1;
  const auto there = propagate(*forces, start, day(0), day(60));
  ASSERT_TRUE(there) << describe(there.error());
  const auto back = propagate(*forces, there->nodes().back().state, day(60), day(0));
  ASSERT_TRUE(back);
  EXPECT_LT((back->nodes().front().state.p_m - start.p_m).norm(), 0.2);
  double worst = 0.0;
  for (double d = 0.0; d <= 60.0; d += 0.0371) {
    worst = std::max(worst, (there->at(day(d)).value().p_m - back->at(day(d)).value().p_m).norm());
  }
  EXPECT_LT(worst, 0.2);
  const auto quiet = propagate(*ForceModel::create(ephemeris(), settings), start, day(0), day(60));
  EXPECT_GT((quiet->at(day(60)).value().p_m - there->at(day(60)).value().p_m).norm(), 1e8);
}

TEST(Forces, PlatesInPlaceOfTheSphere) {
  // A black sphere of 22 kg with 0.026 m2/kg, and a black array of the same area that faces the Sun.
  ForceSettings sphere = nothing(), plates = nothing();
  sphere.srp_cr_area_over_mass_m2_kg = 0.026;
  plates.plates = {{.area_m2 = 0.026 * 22.0, .hinge_B = Vec3::UnitZ()}};
  plates.attitude = sun_pointing(Vec3::UnitX(), Vec3::UnitZ());
  State s = ephemeris().state(body::mars, body::solar_system_barycenter, day(0)).value();
  const Vec3 a = ForceModel::create(ephemeris(), sphere)->acceleration(day(0), s).value();
  const Vec3 b = ForceModel::create(ephemeris(), plates)->acceleration(day(0), s).value();
  EXPECT_LT((a - b).norm() / a.norm(), 1e-12);
  plates.attitude = {};
  EXPECT_FALSE(ForceModel::create(ephemeris(), plates));
}

}  // namespace
}  // namespace astronav::dynamics
