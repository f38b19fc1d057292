// SPDX-License-Identifier: Apache-2.0
// Statistics: quantiles and probabilities of the laws that tests and reports use (on Boost.Math), and plain summaries.
#pragma once

#include <span>

#include "foundation/math/linear.h"

namespace astronav {

// Quantile of chi-square with `degrees` > 0 at probability p in (0, 1), and the probability of exceeding x.
double chi_square_quantile(double p, double degrees);
double chi_square_exceedance(double x, double degrees);
double normal_quantile(double p);

struct Band {
  double lo = 0.0;
  double hi = 0.0;
  bool contains(double x) const { return x >= lo && x <= hi; }
};

// Two-sided band that holds the mean of `count` independent chi-square values of `degrees` with probability p.
Band chi_square_mean_band(double p, double degrees, double count);

// e' P^-1 e of a position and a velocity, whose variances differ by ten orders of magnitude: by the correlation matrix.
double normalised_square(const Vec6& e, const Mat6& P);

double mean(std::span<const double> values);
double rms(std::span<const double> values);
double standard_deviation(std::span<const double> values);  // about the mean, n - 1
// Linear interpolation between order statistics; q in [0, 1]; NaN for no values.
double quantile(std::span<const double> values, double q);
double median(std::span<const double> values);

}  // namespace astronav
