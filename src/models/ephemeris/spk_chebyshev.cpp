// SPDX-License-Identifier: Apache-2.0
// SPK types 2 and 3 (Chebyshev series of position, and of position and velocity) and 20 (of velocity).
#include <algorithm>
#include <cmath>

#include "models/ephemeris/spk_segment.h"

namespace astronav::spk {
namespace {

using daf::kWordBytes;
using daf::load_double;

// Three series and their derivatives by their argument at s in [-1, 1] (Clenshaw's recurrence), added to the sums.
template <bool Swap>
void chebyshev(const std::byte* coefficients, int count, double s, double value[3], double slope[3]) {
  const std::size_t stride = static_cast<std::size_t>(count) * kWordBytes;
  double b1[3] = {}, b2[3] = {}, d1[3] = {}, d2[3] = {};
  const double s2 = 2.0 * s;
  for (int k = count - 1; k > 0; --k) {
    const std::byte* const at = coefficients + static_cast<std::size_t>(k) * kWordBytes;
    for (std::size_t axis = 0; axis < 3; ++axis) {
      const double d0 = 2.0 * b1[axis] + s2 * d1[axis] - d2[axis];
      const double b0 = load_double<Swap>(at + axis * stride) + s2 * b1[axis] - b2[axis];
      d2[axis] = d1[axis];
      d1[axis] = d0;
      b2[axis] = b1[axis];
      b1[axis] = b0;
    }
  }
  for (std::size_t axis = 0; axis < 3; ++axis) {
    value[axis] = load_double<Swap>(coefficients + axis * stride) + s * b1[axis] - b2[axis];
    slope[axis] = b1[axis] + s * d1[axis] - d2[axis];
  }
}

std::size_t record_at(const Ephemeris::Segment& segment, Moment at) {
  const double position = at.since(segment.init_s) / segment.interval_s;
  const auto index = static_cast<std::size_t>(std::clamp(position, 0.0, segment.record_count - 1.0));
  return index * static_cast<std::size_t>(segment.record_doubles);
}

tl::unexpected<Error> elsewhere(const Ephemeris::Segment& segment, std::size_t word) {
  return daf::corrupt("byte {0}: the record's times do not hold the epoch that the directory puts there",
                      byte_of(segment, word));
}

}  // namespace

Result<StateKm> chebyshev_positions(std::span<const std::byte> file, const Ephemeris::Segment& segment, Moment at) {
  const std::size_t word = record_at(segment, at);
  const std::byte* const record = file.data() + byte_of(segment, word);
  const double radius = load_double(record + 8, segment.swap_bytes);
  const double s = at.since(load_double(record, segment.swap_bytes)) / radius;
  // A directory's interval may be rounded; more than a thousandth outside is another record's time.
  if (!(radius > 0.0) || !(std::abs(s) <= 1.001)) return elsewhere(segment, word);
  const int count = (segment.record_doubles - 2) / (segment.type == 2 ? 3 : 6);
  const std::byte* const coefficients = record + 2 * kWordBytes;
  const auto series = segment.swap_bytes ? chebyshev<true> : chebyshev<false>;
  StateKm out;
  series(coefficients, count, s, out.p.data(), out.v.data());
  if (segment.type == 2) {
    out.v /= radius;
  } else {
    Vec3 unused;
    series(coefficients + 3 * static_cast<std::size_t>(count) * kWordBytes, count, s, out.v.data(), unused.data());
  }
  return out;
}

Result<StateKm> chebyshev_velocities(const Words& words, const Ephemeris::Segment& segment, Moment at) {
  const std::size_t directory = word_count(segment) - 7;
  const double length_km = words[directory];
  const double time_s = words[directory + 1];
  const std::size_t word = record_at(segment, at);
  const double radius = 0.5 * segment.interval_s;
  const double index = static_cast<double>(word) / segment.record_doubles;
  const double s = (at.since(segment.init_s) - (index + 0.5) * segment.interval_s) / radius;
  if (!(std::abs(s) <= 1.001)) return elsewhere(segment, word);
  const std::size_t stride = static_cast<std::size_t>(segment.record_doubles) / 3;
  StateKm out;
  for (std::size_t axis = 0; axis < 3; ++axis) {
    // T_k by recurrence, and its integral from 0: (T_k+1/(k+1) - T_k-1/(k-1))/2 between 0 and s.
    double before = 1.0, now = s;        // T_k-1 and T_k at s
    double before_0 = 1.0, now_0 = 0.0;  // and at 0
    double value = words[word + axis * stride];
    double integral = value * s;
    for (std::size_t k = 1; k + 1 < stride; ++k) {
      const double c = words[word + axis * stride + k];
      const double next = 2.0 * s * now - before, next_0 = -before_0;
      const auto n = static_cast<double>(k);
      value += c * now;
      integral += c * (k == 1 ? 0.5 * s * s : 0.5 * ((next - next_0) / (n + 1.0) - (before - before_0) / (n - 1.0)));
      before = now;
      now = next;
      before_0 = now_0;
      now_0 = next_0;
    }
    const auto i = static_cast<Eigen::Index>(axis);
    out.v[i] = value * length_km / time_s;
    out.p[i] = length_km * (words[word + axis * stride + stride - 1] + integral * radius / time_s);
  }
  return out;
}

}  // namespace astronav::spk
