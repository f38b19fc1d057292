// SPDX-License-Identifier: Apache-2.0
#include "simulator/transfer/lambert.h"

#include <cmath>

#include <Eigen/Geometry>
#include <gtest/gtest.h>

#include "foundation/files/mapped_file.h"
#include "foundation/math/random.h"
#include "simulator/dynamics/propagation.h"

namespace astronav::transfer {
namespace {

// Vallado, Fundamentals of Astrodynamics, example 7-5.
TEST(Lambert, ValladoExample7_5) {
  const auto v = lambert({15945.34e3, 0.0, 0.0}, {12214.83899e3, 10249.46731e3, 0.0}, 76.0 * 60.0, 398600.4418e9);
  ASSERT_TRUE(v) << describe(v.error());
  EXPECT_LT((v->v1_m_s - Vec3(2058.913, 2915.965, 0.0)).norm(), 0.01);
  EXPECT_LT((v->v2_m_s - Vec3(-3451.565, 910.315, 0.0)).norm(), 0.01);
}

// Curtis, Orbital Mechanics for Engineering Students, example 5.2.
TEST(Lambert, CurtisExample5_2) {
  const auto v = lambert({5000e3, 10000e3, 2100e3}, {-14600e3, 2500e3, 7000e3}, 3600.0, 398600e9);
  ASSERT_TRUE(v) << describe(v.error());
  EXPECT_LT((v->v1_m_s - Vec3(-5992.5, 1925.4, 3245.6)).norm(), 0.15);
  EXPECT_LT((v->v2_m_s - Vec3(-3312.5, -4196.6, -385.29)).norm(), 0.15);
}

// A quarter of a circular orbit, and three quarters of it with the pole reversed.
TEST(Lambert, CircularOrbit) {
  const double r = 1e10, gm = 1e20, speed = std::sqrt(gm / r), quarter = 0.5 * kPi * r / speed;
  const auto near = lambert({r, 0.0, 0.0}, {0.0, r, 0.0}, quarter, gm);
  ASSERT_TRUE(near);
  EXPECT_LT((near->v1_m_s - Vec3(0.0, speed, 0.0)).norm(), 1e-9 * speed);
  EXPECT_LT((near->v2_m_s - Vec3(-speed, 0.0, 0.0)).norm(), 1e-9 * speed);
  const auto far = lambert({r, 0.0, 0.0}, {0.0, r, 0.0}, 3.0 * quarter, gm, -Vec3::UnitZ());
  ASSERT_TRUE(far);
  EXPECT_LT((far->v1_m_s - Vec3(0.0, -speed, 0.0)).norm(), 1e-9 * speed);
}

TEST(Lambert, Parabola) {
  // From the pericentre q of a parabola to its semi-latus rectum: Barker's time is 4/3 sqrt(2 q^3/GM).
  const double q = 1e10, gm = 1e20;
  const auto v = lambert({q, 0.0, 0.0}, {0.0, 2.0 * q, 0.0}, 4.0 / 3.0 * std::sqrt(2.0 * q * q * q / gm), gm);
  ASSERT_TRUE(v);
  EXPECT_LT((v->v1_m_s - Vec3(0.0, std::sqrt(2.0 * gm / q), 0.0)).norm(), 1e-9 * std::sqrt(2.0 * gm / q));
}

// Any geometry and time: the integrated two-body motion arrives, on an arc below one revolution, and prograde.
TEST(Lambert, IntegratedMotionArrives) {
  const double gm = 1.32712440041e20;
  RandomStream random(StreamId{.seed = 2, .purpose = "lambert"});
  const dynamics::AccelerationField field = [gm](Epoch, const State& s) -> Result<Vec3> {
    return Vec3(-gm / std::pow(s.p_m.norm(), 3) * s.p_m);
  };
  int arcs = 0;
  for (int i = 0; i < 300; ++i) {
    const auto place = [&random] {
      const Vec3 u(random.normal(), random.normal(), random.normal());
      return Vec3(u.normalized() * kAstronomicalUnit * random.uniform(0.4, 5.0));
    };
    const Vec3 p1 = place(), p2 = place();
    const double time = std::pow(10.0, random.uniform(6.0, 9.0));
    const auto v = lambert(p1, p2, time, gm);
    ASSERT_TRUE(v) << describe(v.error());
    EXPECT_GT(p1.cross(v->v1_m_s).z(), 0.0);
    EXPECT_NEAR(p1.cross(v->v1_m_s).norm() / p2.cross(v->v2_m_s).norm(), 1.0, 1e-9);
    const double energy = 0.5 * v->v1_m_s.squaredNorm() - gm / p1.norm();
    if (energy < 0.0) {
      EXPECT_LT(time, 2.0 * kPi * gm * std::pow(-2.0 * energy, -1.5) * (1.0 + 1e-9));
    }
    // Arcs that pass the Sun too close lose digits in the integration, not in Lambert's problem.
    const Vec3 h = p1.cross(v->v1_m_s);
    const double pericentre = h.squaredNorm() / gm / (1.0 + (v->v1_m_s.cross(h) / gm - p1.normalized()).norm());
    if (pericentre < 0.1 * kAstronomicalUnit) continue;
    ++arcs;
    const auto arc = dynamics::propagate(field, {p1, v->v1_m_s}, Epoch(), Epoch() + Duration::seconds(time),
                                         {.max_step = Duration::days(20.0)});
    ASSERT_TRUE(arc) << describe(arc.error());
    const State& last = arc->nodes().back().state;
    EXPECT_LT((last.p_m - p2).norm(), 1e-8 * (p2.norm() + time * v->v2_m_s.norm())) << "arc " << i;
    EXPECT_LT((last.v_m_s - v->v2_m_s).norm(), 1e-7 * v->v2_m_s.norm()) << "arc " << i;
  }
  EXPECT_GT(arcs, 150);
}

TEST(Lambert, RefusesWhatHasNoAnswer) {
  const Vec3 a(1e11, 0.0, 0.0), b(0.0, 1e11, 0.0);
  EXPECT_FALSE(lambert(a, -a, 1e7, 1e20)) << "opposite: no plane";
  EXPECT_FALSE(lambert(a, 2.0 * a, 1e7, 1e20)) << "in line";
  EXPECT_FALSE(lambert(a, b, 0.0, 1e20));
  EXPECT_FALSE(lambert(a, b, -1.0, 1e20));
  EXPECT_FALSE(lambert(a, b, std::nan(""), 1e20));
  EXPECT_FALSE(lambert(Vec3::Zero(), b, 1e7, 1e20));
  EXPECT_FALSE(lambert(a, Vec3(0.0, 0.0, 1e11), 1e7, 1e20)) << "a plane through the pole";
}

// The arcs of the literature's campaigns; their v-infinity were computed independently (km/s, from other ephemerides).
TEST(Lambert, EarthToMars) {
  const auto file = MappedFile::open(home_directory() / "data/de405_2000_2050.bsp").value();
  const auto ephemeris = Ephemeris::open(file.bytes()).value();
  const auto leg = lambert_leg(ephemeris, body::earth, body::mars, Epoch::parse("2026-11-09T00:00:00 TDB").value(),
                               Duration::days(300.0));
  ASSERT_TRUE(leg) << describe(leg.error());
  EXPECT_NEAR(leg->v_infinity_departure_m_s.norm(), 3190.0, 30.0);
  EXPECT_NEAR(leg->v_infinity_arrival_m_s.norm(), 2570.0, 30.0);
  EXPECT_DOUBLE_EQ(leg->c3_m2_s2(), leg->v_infinity_departure_m_s.squaredNorm());
  // Mars Science Laboratory was launched on 2011-11-26 and arrived on 2012-08-06, with a C3 of about 10 to 11 km^2/s^2.
  const Epoch msl = Epoch::parse("2011-11-26T15:02:00").value();
  const auto curiosity =
      lambert_leg(ephemeris, body::earth, body::mars, msl, Epoch::parse("2012-08-06T05:17:57").value() - msl);
  ASSERT_TRUE(curiosity);
  EXPECT_NEAR(curiosity->c3_m2_s2() * 1e-6, 10.8, 1.0);
  const auto late = lambert_leg(ephemeris, body::earth, body::mars, Epoch::parse("2049-11-09T00:00:00 TDB").value(),
                                Duration::days(3000.0));
  ASSERT_FALSE(late);
  EXPECT_EQ(late.error().code, ErrorCode::out_of_range);
}

}  // namespace
}  // namespace astronav::transfer
