// SPDX-License-Identifier: Apache-2.0
#include "simulator/trajectory/trajectory.h"

#include <cmath>
#include <thread>
#include <vector>

#include <gtest/gtest.h>

#include "support/shipped_ephemeris.h"

namespace astronav::trajectory {
namespace {

const Ephemeris& ephemeris() {
  return testing::shipped_ephemeris();
}
Epoch day(double d) {
  return Epoch::parse("2027-01-01T00:00:00 TDB").value() + Duration::days(d);
}

TEST(Trajectory, OfABodyOfTheEphemeris) {
  const auto mars = from_ephemeris(ephemeris(), body::mars);
  ASSERT_TRUE(mars) << describe(mars.error());
  const State s = (*mars)->state(day(3.0)).value();
  EXPECT_EQ(s.p_m, ephemeris().state(body::mars_barycenter, body::solar_system_barycenter, day(3.0))->p_m);
  EXPECT_LE((*mars)->begin(), Epoch::parse("2000-01-02T00:00:00 TDB").value());
  EXPECT_GE((*mars)->end(), Epoch::parse("2049-12-31T00:00:00 TDB").value());
  EXPECT_TRUE((*mars)->state((*mars)->begin()));
  EXPECT_TRUE((*mars)->state((*mars)->end()));
  const auto late = (*mars)->state((*mars)->end() + Duration::seconds(1.0));
  ASSERT_FALSE(late);
  EXPECT_EQ(late.error().code, ErrorCode::out_of_range);
  EXPECT_FALSE(from_ephemeris(ephemeris(), BodyId{-98765}));
}

// The interpolation against the ephemeris it was sampled from. Mercury in steps of a day; the error of a polynomial of
// degree 7 is p^(8) h^8 (9/256)^2... / 8!, below a metre there.
TEST(Trajectory, InterpolatesAnOem) {
  const auto mercury = from_ephemeris(ephemeris(), body::mercury_barycenter).value();
  const auto oem = to_oem(*mercury, day(0.0), day(88.3), Duration::days(1.0));
  ASSERT_TRUE(oem) << describe(oem.error());
  EXPECT_EQ(oem->epochs.size(), 90u);
  EXPECT_EQ(oem->epochs.back(), day(88.3));
  const auto read = parse_oem(to_text(*oem), "memory");
  ASSERT_TRUE(read) << describe(read.error());
  const auto interpolated = from_oem(*read, nullptr);
  ASSERT_TRUE(interpolated) << describe(interpolated.error());
  double worst = 0.0, worst_velocity = 0.0;
  for (double d = 0.0; d <= 88.3; d += 0.0517) {
    const State a = (*interpolated)->state(day(d)).value();
    const State b = mercury->state(day(d)).value();
    worst = std::max(worst, (a.p_m - b.p_m).norm());
    worst_velocity = std::max(worst_velocity, (a.v_m_s - b.v_m_s).norm());
  }
  EXPECT_LT(worst, 1.0);
  EXPECT_LT(worst_velocity, 1e-4);
  // At the nodes, what the file says.
  EXPECT_EQ((*interpolated)->state(read->epochs[7])->p_m, read->states[7].p_m);
  EXPECT_EQ((*interpolated)->state(read->epochs.back())->v_m_s, read->states.back().v_m_s);
  EXPECT_EQ((*interpolated)->state(day(-0.1)).error().code, ErrorCode::out_of_range);
  EXPECT_EQ((*interpolated)->state(day(88.4)).error().code, ErrorCode::out_of_range);
}

TEST(Trajectory, IsExactForPolynomialsOfDegreeSeven) {
  // Two nodes carry a cubic, three a quintic, four degree seven: x = t^degree about the nodes' middle.
  for (const int nodes : {2, 3, 4, 9}) {
    const int degree = std::min(2 * nodes - 1, 7);
    Oem oem;
    const auto at = [degree](double t) {
      return State{{std::pow(t / 1e4, degree) * 1e6, 1.0, t}, {degree * std::pow(t / 1e4, degree - 1) * 1e2, 0.0, 1.0}};
    };
    const double uneven[] = {-2e4, -1.1e4, 1e3, 1.7e4, 2.2e4, 3.9e4, 4.4e4, 5e4, 6.1e4};
    for (int i = 0; i < nodes; ++i) {
      oem.epochs.push_back(Epoch::tdb_seconds(uneven[i]));
      oem.states.push_back(at(uneven[i]));
    }
    const auto t = from_oem(oem, nullptr);
    ASSERT_TRUE(t);
    for (double s = uneven[0]; s <= uneven[nodes - 1]; s += 777.0) {
      const State got = (*t)->state(Epoch::tdb_seconds(s)).value();
      const double scale = 1e-12 * std::pow(6.1, degree) * 1e6;
      EXPECT_NEAR(got.p_m.x(), at(s).p_m.x(), scale) << nodes << " nodes at " << s;
      EXPECT_NEAR(got.v_m_s.x(), at(s).v_m_s.x(), scale) << nodes << " nodes at " << s;
      EXPECT_NEAR(got.p_m.z(), s, 1e-8);
    }
  }
}

TEST(Trajectory, RefersAnOemToTheBarycentre) {
  Oem oem;
  oem.center = body::mars_barycenter;
  for (int i = 0; i < 5; ++i) {
    oem.epochs.push_back(day(i));
    oem.states.push_back({{1e7, 0.0, 0.0}, Vec3::Zero()});
  }
  EXPECT_FALSE(from_oem(oem, nullptr));
  const auto t = from_oem(oem, &ephemeris());
  ASSERT_TRUE(t) << describe(t.error());
  const State mars = ephemeris().state(body::mars_barycenter, body::solar_system_barycenter, day(1.5)).value();
  const State s = (*t)->state(day(1.5)).value();
  EXPECT_LT((s.p_m - mars.p_m - Vec3(1e7, 0.0, 0.0)).norm(), 1e-3);
  EXPECT_LT((s.v_m_s - mars.v_m_s).norm(), 1e-9);

  oem.useable_begin = day(1.0);
  oem.useable_end = day(3.0);
  const auto useable = from_oem(oem, &ephemeris()).value();
  EXPECT_EQ(useable->begin(), day(1.0));
  EXPECT_FALSE(useable->state(day(0.5)));
  EXPECT_TRUE(useable->state(day(3.0)));

  Oem one;
  one.epochs = {day(0.0)};
  one.states = {State{}};
  EXPECT_FALSE(from_oem(one, nullptr));
}

TEST(Trajectory, ServesSeveralThreads) {
  const auto mars = from_ephemeris(ephemeris(), body::mars_barycenter).value();
  const auto shared = from_oem(to_oem(*mars, day(0.0), day(100.0), Duration::days(1.0)).value(), nullptr).value();
  std::vector<double> sums(4);
  std::vector<std::thread> threads;
  for (double& sum : sums) {
    threads.emplace_back([&sum, &shared] {
      for (int i = 0; i < 2000; ++i) sum += shared->state(day(0.05 * i)).value().p_m.x();
    });
  }
  for (std::thread& t : threads) t.join();
  for (const double sum : sums) EXPECT_EQ(sum, sums[0]);
}

TEST(Trajectory, RefusesAbsurdSampling) {
  const auto mars = from_ephemeris(ephemeris(), body::mars_barycenter).value();
  EXPECT_FALSE(to_oem(*mars, day(0.0), day(1.0), Duration{}));
  EXPECT_FALSE(to_oem(*mars, day(1.0), day(0.0), Duration::days(1.0)));
  EXPECT_FALSE(to_oem(*mars, day(0.0), day(100.0), Duration::nanoseconds(1)));
  EXPECT_FALSE(to_oem(*mars, day(0.0), day(20000.0), Duration::days(1.0)));
}

}  // namespace
}  // namespace astronav::trajectory
