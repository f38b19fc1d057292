// SPDX-License-Identifier: Apache-2.0
#include "simulator/dynamics/unmodelled.h"

#include <cmath>

#include <gtest/gtest.h>

namespace astronav::dynamics {
namespace {

Epoch when() {
  return Epoch::parse("2027-03-01T00:00:00 TDB").value();
}

TEST(UnmodelledAcceleration, IsTheSameForTheSameSeed) {
  const UnmodelledSettings settings{.sigma_m_s2 = 1e-8};
  const auto draw = [&](std::uint64_t seed, double days) {
    RandomStream stream(StreamId{.seed = seed, .purpose = "unmodelled acceleration"});
    return UnmodelledAcceleration::draw(settings, when(), when() + Duration::days(days), stream).value();
  };
  const auto a = draw(1, 100.0), b = draw(1, 300.0), c = draw(2, 100.0);
  const Epoch later = when() + Duration::days(33.3);
  EXPECT_EQ(a.at(later), b.at(later)) << "the span does not matter";
  EXPECT_NE(a.at(later), c.at(later));
  EXPECT_EQ(a.at(when() - Duration::seconds(1.0)), Vec3::Zero());
  EXPECT_EQ(a.at(when() + Duration::days(101.0)), Vec3::Zero());
  EXPECT_NE(a.at(when() + Duration::days(100.0)), Vec3::Zero());
  // Linear between the knots.
  const Epoch knot = when() + Duration::days(10.0);
  const Vec3 half = 0.5 * (a.at(knot) + a.at(knot + Duration::days(0.25)));
  EXPECT_LT((a.at(knot + Duration::days(0.125)) - half).norm(), 1e-20);
}

TEST(UnmodelledAcceleration, Knots) {
  RandomStream stream(StreamId{.purpose = "knots"});
  const auto a =
      UnmodelledAcceleration::draw({.sigma_m_s2 = 1.0}, when(), when() + Duration::days(1.0), stream).value();
  const auto day = [](double d) { return when() + Duration::days(d); };
  EXPECT_EQ(a.next_knot(day(0.0), day(9.0)), day(0.25));
  EXPECT_EQ(a.next_knot(day(0.1), day(9.0)), day(0.25));
  EXPECT_EQ(a.next_knot(day(0.1), day(0.2)), day(0.2));
  EXPECT_EQ(a.next_knot(day(-5.0), day(9.0)), day(0.0));
  EXPECT_EQ(a.next_knot(day(1.0), day(9.0)), day(9.0));
  EXPECT_EQ(a.next_knot(day(9.0), day(-9.0)), day(1.0));
  EXPECT_EQ(a.next_knot(day(0.5), day(-9.0)), day(0.25));
  EXPECT_EQ(a.next_knot(day(0.6), day(-9.0)), day(0.5));
  EXPECT_EQ(a.next_knot(day(0.0), day(-9.0)), day(-9.0));
  EXPECT_EQ(UnmodelledAcceleration().next_knot(day(0.0), day(9.0)), day(9.0));
}

// Variance and correlation of an Ornstein-Uhlenbeck process. 3 x 20,000 values at half the correlation time: about
// 15,000 independent ones, so sigma^2 has a standard deviation of 1.0 to 1.2 % and the correlation of 0.007; the limits
// are 5 of them (false alarms below 1e-5).
TEST(UnmodelledAcceleration, HasItsVarianceAndCorrelation) {
  RandomStream stream(StreamId{.seed = 3, .purpose = "statistics"});
  const UnmodelledSettings settings{.sigma_m_s2 = 2e-8, .tau = Duration::days(5.0), .grid = Duration::days(2.5)};
  const int count = 20000;
  const auto a = UnmodelledAcceleration::draw(settings, when(), when() + settings.grid * count, stream).value();
  double square = 0.0, product = 0.0;
  Vec3 before = a.at(when());
  for (int i = 1; i <= count; ++i) {
    const Vec3 now = a.at(when() + settings.grid * i);
    square += now.squaredNorm() / (3.0 * count);
    product += now.dot(before) / (3.0 * count);
    before = now;
  }
  EXPECT_NEAR(square / 4e-16, 1.0, 0.06);
  EXPECT_NEAR(product / square, std::exp(-0.5), 0.035);
}

TEST(UnmodelledAcceleration, RefusesNonsense) {
  RandomStream stream(StreamId{});
  EXPECT_FALSE(UnmodelledAcceleration::draw({.sigma_m_s2 = -1.0}, when(), when(), stream));
  EXPECT_FALSE(UnmodelledAcceleration::draw({.sigma_m_s2 = std::nan("")}, when(), when(), stream));
  EXPECT_FALSE(UnmodelledAcceleration::draw({.sigma_m_s2 = 1.0, .tau = Duration{}}, when(), when(), stream));
  EXPECT_FALSE(UnmodelledAcceleration::draw({.sigma_m_s2 = 1.0}, when(), when() - Duration::days(1.0), stream));
  EXPECT_FALSE(UnmodelledAcceleration::draw({}, when(), when(), stream)->active());
}

}  // namespace
}  // namespace astronav::dynamics
