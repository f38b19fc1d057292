// SPDX-License-Identifier: Apache-2.0
#include "simulator/dynamics/propagation.h"

#include <chrono>
#include <cmath>

#include <Eigen/Geometry>
#include <fmt/format.h>
#include <gtest/gtest.h>

#include "foundation/files/mapped_file.h"

namespace astronav::dynamics {
namespace {

constexpr double kSunGm = 1.32712440041e20;

Result<Vec3> sun_alone(Epoch, const State& s) {
  return Vec3(-kSunGm / std::pow(s.p_m.norm(), 3) * s.p_m);
}

// Perihelion at 1 AU of an ellipse with aphelion at 1.5 AU.
State perihelion() {
  const double a = 1.25 * kAstronomicalUnit;
  return {{kAstronomicalUnit, 0.0, 0.0}, {0.0, std::sqrt(kSunGm * (2.0 / kAstronomicalUnit - 1.0 / a)), 0.0}};
}
double period_s() {
  return 2.0 * kPi * std::sqrt(std::pow(1.25 * kAstronomicalUnit, 3) / kSunGm);
}

double energy(const State& s) {
  return 0.5 * s.v_m_s.squaredNorm() - kSunGm / s.p_m.norm();
}

// Kepler's equation, solved here: the place at a time since perihelion.
Vec3 kepler(double t) {
  const double a = 1.25 * kAstronomicalUnit, e = 0.2;
  const double mean = std::sqrt(kSunGm / (a * a * a)) * t;
  double ecc = mean;
  for (int i = 0; i < 30; ++i) ecc -= (ecc - e * std::sin(ecc) - mean) / (1.0 - e * std::cos(ecc));
  return {a * (std::cos(ecc) - e), a * std::sqrt(1.0 - e * e) * std::sin(ecc), 0.0};
}

TEST(Propagation, KeepsTheLawsOfTwoBodies) {
  const Epoch end = Epoch() + Duration::seconds(period_s());
  const auto arc = propagate(AccelerationField(sun_alone), perihelion(), Epoch(), end);
  ASSERT_TRUE(arc) << describe(arc.error());
  const State last = arc->at(end).value();
  EXPECT_LT((last.p_m - kepler((end - Epoch()).seconds())).norm(), 0.05) << "after a whole revolution";
  for (const Arc::Node& n : arc->nodes()) {
    EXPECT_NEAR(energy(n.state) / energy(perihelion()), 1.0, 1e-13);
    const Vec3 h = n.state.p_m.cross(n.state.v_m_s), h0 = perihelion().p_m.cross(perihelion().v_m_s);
    EXPECT_LT((h - h0).norm() / h0.norm(), 1e-13);
  }
  EXPECT_LT(arc->nodes().size(), 1000u);
}

TEST(Propagation, IsContinuousOutput) {
  const Epoch end = Epoch() + Duration::days(300.0);
  const auto arc = propagate(AccelerationField(sun_alone), perihelion(), Epoch(), end);
  ASSERT_TRUE(arc);
  double worst = 0.0, worst_velocity = 0.0;
  for (int i = 0; i <= 3000; ++i) {
    const double t = 300.0 * 86400.0 * i / 3000.0 - (i == 3000 ? 0.0 : -1234.5);
    const Epoch e = Epoch::tdb_seconds(t);
    if (e > end) continue;
    const State s = arc->at(e).value();
    worst = std::max(worst, (s.p_m - kepler(e.tdb_seconds())).norm());
    worst_velocity = std::max(worst_velocity, std::abs(energy(s) - energy(perihelion())) / s.v_m_s.norm());
  }
  EXPECT_LT(worst, 0.05);
  EXPECT_LT(worst_velocity, 1e-6);
  EXPECT_FALSE(arc->at(end + Duration::nanoseconds(1)));
  EXPECT_FALSE(arc->at(Epoch() - Duration::nanoseconds(1)));
  EXPECT_EQ(arc->at(end + Duration::days(1.0)).error().code, ErrorCode::out_of_range);
}

// The circular restricted problem of Earth and Moon, in inertial axes: neither energy nor angular momentum is kept, but
// Jacobi's constant is. The spacecraft goes round the Earth in resonance with the Moon (3:1 or so) for two years, with
// passes at half of the Moon's distance.
TEST(Propagation, KeepsJacobisConstant) {
  const double gm_earth = 3.986004e14, gm_moon = 4.902800e12, distance = 384400e3;
  const double gm = gm_earth + gm_moon, share = gm_moon / gm;
  const double rate = std::sqrt(gm / std::pow(distance, 3));
  const auto places = [&](Epoch e) {
    const double angle = rate * e.tdb_seconds();
    const Vec3 line(std::cos(angle), std::sin(angle), 0.0);
    return std::pair<Vec3, Vec3>(-share * distance * line, (1.0 - share) * distance * line);
  };
  const AccelerationField field = [&](Epoch e, const State& s) -> Result<Vec3> {
    const auto [earth, moon] = places(e);
    const Vec3 a = earth - s.p_m, b = moon - s.p_m;
    return Vec3(gm_earth / std::pow(a.norm(), 3) * a + gm_moon / std::pow(b.norm(), 3) * b);
  };
  const auto potential = [&](Epoch e, const State& s) {
    const auto [earth, moon] = places(e);
    return -gm_earth / (earth - s.p_m).norm() - gm_moon / (moon - s.p_m).norm();
  };
  const auto jacobi = [&](Epoch e, const State& s) {
    return -s.v_m_s.squaredNorm() - 2.0 * potential(e, s) + 2.0 * rate * s.p_m.cross(s.v_m_s).z();
  };
  const State start{{-100000e3, 0.0, 5000e3}, {0.0, -2300.0, 100.0}};
  const Epoch end = Epoch() + Duration::days(730.0);
  const auto arc = propagate(field, start, Epoch(), end);
  ASSERT_TRUE(arc) << describe(arc.error());
  double worst = 0.0, lowest = 0.0, highest = -1e30;
  double nearest = 1e30;
  for (double day = 0.0; day <= 730.0; day += 0.1) {
    const Epoch e = Epoch() + Duration::days(day);
    const State s = arc->at(e).value();
    worst = std::max(worst, std::abs(jacobi(e, s) / jacobi(Epoch(), start) - 1.0));
    const double energy_now = 0.5 * s.v_m_s.squaredNorm() + potential(e, s);
    lowest = std::min(lowest, energy_now);
    highest = std::max(highest, energy_now);
    nearest = std::min(nearest, (places(e).second - s.p_m).norm());
  }
  double worst_node = 0.0;
  for (const Arc::Node& n : arc->nodes()) {
    worst_node = std::max(worst_node, std::abs(jacobi(n.epoch, n.state) / jacobi(Epoch(), start) - 1.0));
  }
  RecordProperty("worst", fmt::format("{:.2e}", worst));
  RecordProperty("worst_node", fmt::format("{:.2e}", worst_node));
  EXPECT_LT(worst_node, 1e-11);
  EXPECT_LT(worst, 2e-9) << "between nodes";
  EXPECT_GT((highest - lowest) / std::abs(lowest), 1e-3) << "the Moon does work";
  EXPECT_LT(nearest, 0.6 * distance);
}

TEST(Propagation, GoesThereAndBack) {
  const Epoch end = Epoch() + Duration::days(300.0);
  const auto there = propagate(AccelerationField(sun_alone), perihelion(), Epoch(), end);
  ASSERT_TRUE(there);
  const auto back = propagate(AccelerationField(sun_alone), there->nodes().back().state, end, Epoch());
  ASSERT_TRUE(back);
  EXPECT_EQ(back->begin(), Epoch());
  EXPECT_EQ(back->end(), end);
  EXPECT_LT((back->nodes().front().state.p_m - perihelion().p_m).norm(), 0.1);
}

// A pass 10,000 km from the centre of the Earth, where steps must shrink and grow again: energy at every place asked
// for, not only at the nodes. A millimetre of interpolation error over steps of 100 s allows 10 to 20 um/s at 9.5 km/s.
TEST(Propagation, FollowsACloseFlyby) {
  const double gm = 3.986004e14;
  const AccelerationField earth = [gm](Epoch, const State& s) -> Result<Vec3> {
    return Vec3(-gm / std::pow(s.p_m.norm(), 3) * s.p_m);
  };
  const State start{{1e7, 0.0, 0.0}, {0.0, std::sqrt(2.0 * gm / 1e7 + 3190.0 * 3190.0), 0.0}};
  const auto away = propagate(earth, start, Epoch(), Epoch() + Duration::days(-5.0));
  ASSERT_TRUE(away);
  const auto arc = propagate(earth, away->nodes().front().state, away->begin(), Epoch() + Duration::days(5.0));
  ASSERT_TRUE(arc);
  EXPECT_LT((arc->at(Epoch()).value().p_m - start.p_m).norm(), 1.0);
  const double e0 = 0.5 * 3190.0 * 3190.0;
  for (double t = -20000.0; t < 20000.0; t += 37.0) {
    const State s = arc->at(Epoch::tdb_seconds(t)).value();
    EXPECT_NEAR(0.5 * s.v_m_s.squaredNorm() - gm / s.p_m.norm(), e0, 0.2) << t;
  }
}

TEST(Propagation, SaysSoWhenItFallsIntoAPointMass) {
  const auto fall =
      propagate(AccelerationField(sun_alone), {{1e9, 0.0, 0.0}, Vec3::Zero()}, Epoch(), Epoch() + Duration::days(10.0));
  ASSERT_FALSE(fall);
  EXPECT_EQ(fall.error().code, ErrorCode::not_converged);
  const State broken{{std::nan(""), 0.0, 0.0}, Vec3::Zero()};
  EXPECT_EQ(propagate(AccelerationField(sun_alone), broken, Epoch(), Epoch() + Duration::days(1.0)).error().code,
            ErrorCode::invalid_argument);
}

TEST(Propagation, OverNoTimeIsTheStart) {
  const auto arc = propagate(AccelerationField(sun_alone), perihelion(), Epoch(), Epoch());
  ASSERT_TRUE(arc);
  EXPECT_EQ(arc->at(Epoch()).value().p_m, perihelion().p_m);
}

struct Kernel {
  MappedFile file = MappedFile::open(home_directory() / "data/de405_2000_2050.bsp").value();
  Ephemeris ephemeris = Ephemeris::open(file.bytes()).value();
};

// 300 days under all forces, unmodelled acceleration included; truth is the same with 100 times tighter tolerances and
// an eighth of the step.
TEST(Propagation, IsGoodToCentimetresOver300Days) {
  const Kernel kernel;
  const Epoch begin = Epoch::parse("2026-11-12T00:00:00 TDB").value();
  const Epoch end = begin + Duration::days(300.0);
  RandomStream stream(StreamId{.seed = 1, .purpose = "unmodelled acceleration"});
  const auto forces = ForceModel::create(
      kernel.ephemeris, {}, UnmodelledAcceleration::draw({.sigma_m_s2 = 1e-8}, begin, end, stream).value());
  ASSERT_TRUE(forces) << describe(forces.error());
  State start = kernel.ephemeris.state(body::earth, body::solar_system_barycenter, begin).value();
  start.v_m_s *= 1.1;
  start.p_m += 1e9 * start.v_m_s.normalized();
  const auto usual = propagate(*forces, start, begin, end);
  const auto tight =
      propagate(*forces, start, begin, end,
                {.position_tolerance_m = 5e-4, .velocity_tolerance_m_s = 1e-12, .max_step = Duration::days(0.125)});
  ASSERT_TRUE(usual && tight);
  EXPECT_GT(tight->nodes().size(), usual->nodes().size());
  double worst = 0.0;
  for (double day = 0.0; day <= 300.0; day += 0.37) {
    const Epoch e = begin + Duration::days(day);
    worst = std::max(worst, (usual->at(e).value().p_m - tight->at(e).value().p_m).norm());
  }
  RecordProperty("worst_m", std::to_string(worst));
  EXPECT_LT(worst, 0.05);
}

// The Schwarzschild term turns Mercury's perihelion by 42.98 arcsec a century.
TEST(Propagation, TurnsMercurysPerihelion) {
  const Kernel kernel;
  const Epoch begin = Epoch::parse("2027-01-01T00:00:00 TDB").value();
  const auto forces = ForceModel::create(kernel.ephemeris, {.bodies = {}, .srp_cr_area_over_mass_m2_kg = 0.0});
  ASSERT_TRUE(forces);
  const auto sun = [&](Epoch e) { return kernel.ephemeris.state(body::sun, body::solar_system_barycenter, e).value(); };
  // Heliocentric motion: the Sun's pull, and the relativistic term at the Sun's place of the date.
  const AccelerationField field = [&](Epoch e, const State& s) -> Result<Vec3> {
    const State sun_O = sun(e);
    const auto relativity = forces->acceleration(e, {s.p_m + sun_O.p_m, s.v_m_s + sun_O.v_m_s});
    if (!relativity) return forward(relativity);
    return Vec3(-kSunGm / std::pow(s.p_m.norm(), 3) * s.p_m + *relativity);
  };
  const double a = 57.909e9, e = 0.20563;
  const State start{{a * (1.0 - e), 0.0, 0.0}, {0.0, std::sqrt(kSunGm / a * (1.0 + e) / (1.0 - e)), 0.0}};
  const Duration span = Duration::days(2.0 * 365.25);
  const auto arc = propagate(field, start, begin, begin + span);
  ASSERT_TRUE(arc) << describe(arc.error());
  const auto perihelion_angle = [](const State& s) {
    const Vec3 h = s.p_m.cross(s.v_m_s);
    const Vec3 ecc = s.v_m_s.cross(h) / kSunGm - s.p_m.normalized();
    return std::atan2(ecc.y(), ecc.x());
  };
  // Within a revolution the osculating perihelion swings: taken at successive perihelia, found by r.v = 0.
  const double period = 2.0 * kPi * std::sqrt(a * a * a / kSunGm);
  const int turns = 8;
  double low = turns * period - 20000.0, high = turns * period + 20000.0;
  for (int i = 0; i < 60; ++i) {
    const double middle = 0.5 * (low + high);
    const State s = arc->at(begin + Duration::seconds(middle)).value();
    (s.p_m.dot(s.v_m_s) < 0.0 ? low : high) = middle;
  }
  const State s = arc->at(begin + Duration::seconds(low)).value();
  const double turned = (perihelion_angle(s) - perihelion_angle(start)) / kArcsecond;
  EXPECT_NEAR(turned / (turns * period) * 36525.0 * 86400.0, 42.98, 0.05);
}

}  // namespace
}  // namespace astronav::dynamics
