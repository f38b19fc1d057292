// SPDX-License-Identifier: Apache-2.0
#include "foundation/math/random.h"

#include <array>
#include <cmath>
#include <vector>

#include <gtest/gtest.h>

#include "foundation/math/statistics.h"

namespace astronav {
namespace {

TEST(Random, StreamsDependOnEveryPartOfTheirName) {
  const StreamId id{.seed = 1, .sample = 2, .image = 3, .purpose = "read noise"};
  const std::uint64_t first = RandomStream(id).next();
  EXPECT_EQ(RandomStream(id).next(), first);
  EXPECT_NE(RandomStream({2, 2, 3, "read noise"}).next(), first);
  EXPECT_NE(RandomStream({1, 3, 3, "read noise"}).next(), first);
  EXPECT_NE(RandomStream({1, 2, 4, "read noise"}).next(), first);
  EXPECT_NE(RandomStream({1, 2, 3, "shot noise"}).next(), first);
  EXPECT_NE(RandomStream({2, 1, 3, "read noise"}).next(), RandomStream({1, 2, 3, "read noise"}).next());
}

// Chi-square of binned draws against the law; false-alarm probability 1e-4 each.
TEST(Random, NormalFollowsItsLaw) {
  RandomStream r({.seed = 5, .purpose = "normal"});
  constexpr int n = 200000;
  constexpr int bins = 50;
  std::array<double, bins> count{};
  for (int i = 0; i < n; ++i) {
    const double p = 0.5 * std::erfc(-r.normal() / std::sqrt(2.0));
    ++count[static_cast<std::size_t>(std::min(bins - 1, static_cast<int>(p * bins)))];
  }
  double chi2 = 0.0;
  for (const double c : count) chi2 += std::pow(c - n / double{bins}, 2) / (n / double{bins});
  EXPECT_GT(chi_square_exceedance(chi2, bins - 1), 1e-4);
}

TEST(Random, PoissonFollowsItsLawAtSmallAndLargeMeans) {
  for (const double m : {0.3, 4.0, 9.9, 10.1, 60.0, 3000.0}) {
    RandomStream r({.seed = 6, .image = static_cast<std::uint64_t>(m * 10), .purpose = "poisson"});
    constexpr int n = 100000;
    std::vector<double> draws(n);
    for (double& d : draws) d = static_cast<double>(r.poisson(m));
    const double sigma_mean = std::sqrt(m / n);
    const double variance = std::pow(standard_deviation(draws), 2);
    EXPECT_NEAR(mean(draws), m, 4.5 * sigma_mean) << m;
    // Variance of the sample variance: (mu4 - sigma^4)/n with mu4 = m + 3 m^2.
    EXPECT_NEAR(variance, m, 4.5 * std::sqrt((m + 2.0 * m * m) / n)) << m;
  }
}

TEST(Statistics, QuantilesOfTheLaws) {
  EXPECT_NEAR(chi_square_quantile(0.9973, 2), 11.829, 1e-3);
  EXPECT_NEAR(chi_square_exceedance(11.829, 2), 0.0027, 1e-6);
  EXPECT_NEAR(normal_quantile(0.975), 1.959964, 1e-6);
  const Band band = chi_square_mean_band(0.95, 6, 21);
  EXPECT_NEAR(band.lo, 4.61, 0.01);
  EXPECT_NEAR(band.hi, 7.57, 0.01);
  const std::array<double, 4> values{4.0, 1.0, 3.0, 2.0};
  EXPECT_DOUBLE_EQ(median(values), 2.5);
  EXPECT_DOUBLE_EQ(mean(values), 2.5);
}

}  // namespace
}  // namespace astronav
