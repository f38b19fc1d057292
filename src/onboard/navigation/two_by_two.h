// SPDX-License-Identifier: Apache-2.0
// Covariances of a pixel.
#pragma once

#include <algorithm>
#include <cmath>

#include "foundation/math/linear.h"

namespace astronav::navigation {

inline bool is_covariance(const Mat2& m) {
  return m.allFinite() && m(0, 0) > 0.0 && m.determinant() > 0.0;
}

inline double smaller_eigenvalue(const Mat2& m) {
  const double half_trace = 0.5 * m.trace();
  return half_trace - std::sqrt(std::max(half_trace * half_trace - m.determinant(), 0.0));
}

inline double quadratic(const Vec2& v, const Mat2& m) {
  return v.dot(m.inverse() * v);
}

}  // namespace astronav::navigation
