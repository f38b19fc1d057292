// SPDX-License-Identifier: Apache-2.0
#include "foundation/math/statistics.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <vector>

#include <Eigen/Cholesky>
#include <boost/math/distributions/chi_squared.hpp>
#include <boost/math/distributions/normal.hpp>

#include "foundation/base/check.h"

namespace astronav {

double chi_square_quantile(double p, double degrees) {
  ASTRONAV_CHECK(p > 0.0 && p < 1.0 && degrees > 0.0);
  return boost::math::quantile(boost::math::chi_squared(degrees), p);
}

double chi_square_exceedance(double x, double degrees) {
  if (!(x > 0.0)) return 1.0;
  return boost::math::cdf(boost::math::complement(boost::math::chi_squared(degrees), x));
}

double normal_quantile(double p) {
  ASTRONAV_CHECK(p > 0.0 && p < 1.0);
  return boost::math::quantile(boost::math::normal(), p);
}

Band chi_square_mean_band(double p, double degrees, double count) {
  const double total = degrees * count;
  return {chi_square_quantile(0.5 * (1.0 - p), total) / count, chi_square_quantile(0.5 * (1.0 + p), total) / count};
}

double normalised_square(const Vec6& e, const Mat6& P) {
  const Vec6 scale = P.diagonal().cwiseSqrt();
  const Mat6 correlation = scale.cwiseInverse().asDiagonal() * P * scale.cwiseInverse().asDiagonal();
  const Vec6 normalised = e.cwiseQuotient(scale);
  return normalised.dot(correlation.ldlt().solve(normalised));
}

double mean(std::span<const double> values) {
  double sum = 0.0;
  for (const double v : values) sum += v;
  return sum / static_cast<double>(values.size());
}

double rms(std::span<const double> values) {
  double sum = 0.0;
  for (const double v : values) sum += v * v;
  return std::sqrt(sum / static_cast<double>(values.size()));
}

double standard_deviation(std::span<const double> values) {
  const double m = mean(values);
  double sum = 0.0;
  for (const double v : values) sum += (v - m) * (v - m);
  return std::sqrt(sum / (static_cast<double>(values.size()) - 1.0));
}

double quantile(std::span<const double> values, double q) {
  if (values.empty()) return std::numeric_limits<double>::quiet_NaN();
  std::vector<double> sorted(values.begin(), values.end());
  std::sort(sorted.begin(), sorted.end());
  const double place = std::clamp(q, 0.0, 1.0) * static_cast<double>(sorted.size() - 1);
  const auto below = static_cast<std::size_t>(place);
  const std::size_t above = std::min(below + 1, sorted.size() - 1);
  return sorted[below] + (place - static_cast<double>(below)) * (sorted[above] - sorted[below]);
}

double median(std::span<const double> values) {
  return quantile(values, 0.5);
}

}  // namespace astronav
