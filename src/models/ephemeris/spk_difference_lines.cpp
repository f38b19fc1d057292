// SPDX-License-Identifier: Apache-2.0
// SPK types 1 and 21: modified divided differences, the output of JPL's integrators (Krogh 1974, "Changing stepsize in
// the integration of differential equations using modified divided differences", Lecture Notes in Mathematics 362).
#include <algorithm>
#include <array>
#include <cmath>

#include "models/ephemeris/spk_segment.h"

namespace astronav::spk {
namespace {

constexpr std::size_t kMaxOrder = 25;

}  // namespace

// A line holds the reference epoch, the stepsizes g, position and velocity at the epoch interleaved, the differences of
// the acceleration for each axis, the largest order plus 1, and the orders of the axes plus 1.
Result<StateKm> difference_lines(const Words& words, const Ephemeris::Segment& segment, Moment at) {
  const auto count = static_cast<std::size_t>(segment.record_count);
  const auto size = static_cast<std::size_t>(segment.record_doubles);
  const std::size_t order = (size - 11) / 4;
  // The line whose final epoch is the first at or after the moment.
  const std::size_t line = std::min(times_before(words, count * size, count, at, false), count - 1) * size;
  const std::size_t steps = line + 1, reference = steps + order, differences = reference + 6,
                    orders = differences + 3 * order;
  std::array<std::size_t, 4> used{};  // of all axes together, then of each
  for (std::size_t i = 0; i < 4; ++i) {
    const double n = words[orders + i];
    if (!daf::is_count(n, i == 0 ? 2 : 0, static_cast<double>(order + (i == 0 ? 1 : 0))))
      return daf::corrupt("byte {0}: a difference line of order {1}, but there is room for {2}",
                          byte_of(segment, orders + i), n, static_cast<double>(order));
    used[i] = static_cast<std::size_t>(n);
    if (used[i] > used[0])
      return daf::corrupt("byte {0}: an axis of higher order than the line", byte_of(segment, orders + i));
  }

  const double delta = at.since(words[line]);
  // Factors of the recurrence between the integrals of successive orders.
  std::array<double, kMaxOrder + 2> fc{}, wc{}, w{};
  fc[0] = 1.0;
  double tp = delta;
  for (std::size_t j = 0; j + 2 < used[0]; ++j) {
    const double g = words[steps + j];
    if (g == 0.0) return daf::corrupt("byte {0}: a stepsize of 0", byte_of(segment, steps + j));
    fc[j + 1] = tp / g;
    wc[j] = delta / g;
    tp = delta + g;
  }
  for (std::size_t j = 0; j < used[0]; ++j) w[j] = 1.0 / static_cast<double>(j + 1);
  // First down to the double integrals, for the position; one more round gives the single ones, for the velocity.
  std::size_t ks = used[0] - 1;
  std::size_t rounds = 0;
  const auto integrate = [&] {
    for (std::size_t j = 0; j < rounds; ++j) w[j + ks] = fc[j + 1] * w[j + ks - 1] - wc[j] * w[j + ks];
  };
  while (ks >= 2) {
    ++rounds;
    integrate();
    --ks;
  }
  const auto sum = [&](std::size_t axis) {
    double out = 0.0;
    for (std::size_t j = used[axis + 1]; j-- > 0;) out += words[differences + axis * order + j] * w[j + ks];
    return out;
  };
  StateKm out;
  for (std::size_t axis = 0; axis < 3; ++axis) {
    out.p[static_cast<Eigen::Index>(axis)] =
        words[reference + 2 * axis] + delta * (words[reference + 2 * axis + 1] + delta * sum(axis));
  }
  integrate();
  --ks;
  for (std::size_t axis = 0; axis < 3; ++axis)
    out.v[static_cast<Eigen::Index>(axis)] = words[reference + 2 * axis + 1] + delta * sum(axis);
  return out;
}

}  // namespace astronav::spk
