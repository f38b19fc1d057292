// SPDX-License-Identifier: Apache-2.0
#include "simulator/dynamics/unmodelled.h"

#include <algorithm>
#include <cmath>

namespace astronav::dynamics {

Result<UnmodelledAcceleration> UnmodelledAcceleration::draw(const UnmodelledSettings& settings, Epoch begin, Epoch end,
                                                            RandomStream& stream) {
  if (!std::isfinite(settings.sigma_m_s2) || settings.sigma_m_s2 < 0.0) {
    return fail(ErrorCode::invalid_argument, "the sigma of the unmodelled acceleration, {0} m/s^2, is not zero or more",
                {settings.sigma_m_s2});
  }
  if (settings.tau <= Duration{} || settings.grid <= Duration{}) {
    return fail(ErrorCode::invalid_argument,
                "correlation time ({0} s) and grid ({1} s) of the unmodelled acceleration must be above zero",
                {settings.tau.seconds(), settings.grid.seconds()});
  }
  if (end < begin) return fail(ErrorCode::invalid_argument, "the unmodelled acceleration ends before it begins");
  UnmodelledAcceleration out;
  if (settings.sigma_m_s2 == 0.0) return out;
  out.begin_ = begin;
  out.grid_ = settings.grid;
  const std::int64_t intervals =
      ((end - begin).nanoseconds() + settings.grid.nanoseconds() - 1) / settings.grid.nanoseconds();
  constexpr std::int64_t kMost = 10'000'000;
  if (intervals > kMost) {
    return fail(ErrorCode::limit_exceeded, "the unmodelled acceleration has {0} intervals; at most {1} are allowed",
                {static_cast<double>(intervals), static_cast<double>(kMost)});
  }
  const double phi = std::exp(-settings.grid.seconds() / settings.tau.seconds());
  const double step_sigma = settings.sigma_m_s2 * std::sqrt(1.0 - phi * phi);
  const auto normal3 = [&stream] {
    const double x = stream.normal();
    const double y = stream.normal();
    return Vec3(x, y, stream.normal());
  };
  out.values_.reserve(static_cast<std::size_t>(intervals) + 1);
  out.values_.push_back(settings.sigma_m_s2 * normal3());
  for (std::int64_t i = 0; i < intervals; ++i) out.values_.push_back(phi * out.values_.back() + step_sigma * normal3());
  return out;
}

Vec3 UnmodelledAcceleration::at(Epoch epoch) const {
  if (values_.empty() || epoch < begin_) return Vec3::Zero();
  const std::int64_t elapsed = (epoch - begin_).nanoseconds();
  const auto interval = static_cast<std::size_t>(elapsed / grid_.nanoseconds());
  const std::int64_t inside = elapsed % grid_.nanoseconds();
  if (interval + 1 >= values_.size()) {
    return interval + 1 == values_.size() && inside == 0 ? values_.back() : Vec3(Vec3::Zero());
  }
  const double fraction = static_cast<double>(inside) / static_cast<double>(grid_.nanoseconds());
  return (1.0 - fraction) * values_[interval] + fraction * values_[interval + 1];
}

Epoch UnmodelledAcceleration::next_knot(Epoch epoch, Epoch limit) const {
  if (values_.empty()) return limit;
  const bool forward = limit >= epoch;
  const std::int64_t grid = grid_.nanoseconds();
  const std::int64_t elapsed = (epoch - begin_).nanoseconds();
  const auto last = static_cast<std::int64_t>(values_.size()) - 1;
  std::int64_t knot = elapsed / grid;
  if (elapsed < 0 && elapsed % grid != 0) --knot;  // the floor
  if (forward) {
    knot = std::max<std::int64_t>(knot + 1, 0);
    if (knot > last) return limit;
    return std::min(begin_ + grid_ * knot, limit);
  }
  if (elapsed % grid == 0) --knot;
  knot = std::min(knot, last);
  if (knot < 0) return limit;
  return std::max(begin_ + grid_ * knot, limit);
}

}  // namespace astronav::dynamics
