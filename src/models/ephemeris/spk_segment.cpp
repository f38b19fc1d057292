// SPDX-License-Identifier: Apache-2.0
#include "models/ephemeris/spk_segment.h"

#include <algorithm>
#include <cmath>

namespace astronav::spk {
namespace {

using daf::corrupt;
using daf::is_count;

// The last `count` words of a segment, where its directory stands.
Result<std::size_t> directory_at(const Ephemeris::Segment& segment, std::size_t count) {
  const std::size_t words = word_count(segment);
  if (words < count)
    return corrupt("byte {0}: a segment of {1} words has no room for its directory", segment.first_byte,
                   static_cast<double>(words));
  return words - count;
}

Result<void> check_interval(const Ephemeris::Segment& segment, std::size_t at) {
  if (!std::isfinite(segment.init_s))
    return corrupt("byte {0}: the first epoch of the records is not a number", byte_of(segment, at));
  if (!(segment.interval_s > 0.0) || !std::isfinite(segment.interval_s))
    return corrupt("byte {0}: the interval of a record is {1} s", byte_of(segment, at + 1), segment.interval_s);
  return {};
}

// Records at equal intervals have to cover the time that the summary promises.
Result<void> check_cover(const Ephemeris::Segment& segment, std::size_t at, double intervals) {
  const double slack = 1e-3 * segment.interval_s;
  const double end = segment.init_s + segment.interval_s * intervals;
  if (segment.begin_tdb_s < segment.init_s - slack || segment.end_tdb_s > end + slack)
    return corrupt("byte {0}: the records end before the time that the segment promises", byte_of(segment, at));
  return {};
}

// `records` of `size` words, and `rest` words after them.
Result<void> check_size(Ephemeris::Segment& segment, std::size_t at, double records, double size, double rest) {
  const auto most = static_cast<double>(word_count(segment));
  if (!is_count(records, 1, most) || records * size + rest != most)
    return corrupt("byte {0}: {1} records do not fill a segment of {2} words", byte_of(segment, at), records, most);
  segment.record_count = static_cast<int>(records);
  segment.record_doubles = static_cast<int>(size);
  return {};
}

// Epochs stand behind the records, and every hundredth of them again. SPICE leaves the last out if it is a hundredth.
double with_epochs(double records) {
  return records + std::floor((records - 1.0) / 100.0);
}

// Types 2 and 3: MID, RADIUS and the coefficients of each record; INIT, INTLEN, RSIZE and N at the end.
Result<void> chebyshev_layout(const Words& words, Ephemeris::Segment& segment) {
  const auto at = directory_at(segment, 4);
  if (!at) return forward(at);
  segment.init_s = words[*at];
  segment.interval_s = words[*at + 1];
  if (const auto good = check_interval(segment, *at); !good) return good;
  const double size = words[*at + 2];
  const int series = segment.type == 2 ? 3 : 6;
  if (!is_count(size, 2 + series, static_cast<double>(word_count(segment))) ||
      static_cast<std::int64_t>(size - 2) % series != 0)
    return corrupt("byte {0}: a record cannot have {1} words", byte_of(segment, *at + 2), size);
  if (const auto good = check_size(segment, *at + 3, words[*at + 3], size, 4); !good) return good;
  return check_cover(segment, *at, segment.record_count);
}

// Type 20: velocity coefficients and the position at the middle, for each axis; DSCALE, TSCALE, INITJD, INITFR, INTLEN
// (days), RSIZE and N at the end.
Result<void> velocity_layout(const Words& words, Ephemeris::Segment& segment) {
  const auto at = directory_at(segment, 7);
  if (!at) return forward(at);
  constexpr double kJ2000 = 2451545.0;
  segment.init_s = ((words[*at + 2] - kJ2000) + words[*at + 3]) * 86400.0;
  segment.interval_s = words[*at + 4] * 86400.0;
  if (const auto good = check_interval(segment, *at + 3); !good) return good;
  const double size = words[*at + 5];
  if (!is_count(size, 6, static_cast<double>(word_count(segment))) || static_cast<std::int64_t>(size) % 3 != 0)
    return corrupt("byte {0}: a record cannot have {1} words", byte_of(segment, *at + 5), size);
  if (!(words[*at] > 0.0) || !(words[*at + 1] > 0.0))
    return corrupt("byte {0}: the units of length and time must be positive", byte_of(segment, *at));
  if (const auto good = check_size(segment, *at + 6, words[*at + 6], size, 7); !good) return good;
  return check_cover(segment, *at + 2, segment.record_count);
}

// Types 1 and 21: difference lines, their final epochs, every hundredth epoch; for 21 the order; N.
Result<void> difference_layout(const Words& words, Ephemeris::Segment& segment) {
  const std::size_t tail = segment.type == 1 ? 1 : 2;
  const auto at = directory_at(segment, tail);
  if (!at) return forward(at);
  const double order = segment.type == 1 ? 15.0 : words[*at];
  constexpr double kMaxOrder = 25;  // SPICE's
  if (!is_count(order, 1, kMaxOrder))
    return corrupt("byte {0}: a difference line of order {1}; at most {2} is read", byte_of(segment, *at), order,
                   kMaxOrder);
  const double count = words[*at + tail - 1];
  // SPICE counts the directory by N / 100: a last hundredth is in it.
  const double directory = std::floor(count / 100.0);
  const double size = 4.0 * order + 11.0;
  if (const auto good = check_size(segment, *at + tail - 1, count, size + 1.0, directory + static_cast<double>(tail));
      !good)
    return good;
  segment.record_doubles = static_cast<int>(size);
  return {};
}

// Types 8 and 12: states at equal steps; first epoch, step, window - 1 and N at the end.
Result<void> equal_steps_layout(const Words& words, Ephemeris::Segment& segment) {
  const auto at = directory_at(segment, 4);
  if (!at) return forward(at);
  segment.init_s = words[*at];
  segment.interval_s = words[*at + 1];
  if (const auto good = check_interval(segment, *at); !good) return good;
  const double window = words[*at + 2] + 1.0;
  if (const auto good = check_size(segment, *at + 3, words[*at + 3], 6, 4); !good) return good;
  if (!is_count(window, 1, std::min(kMaxWindow, segment.record_count)))
    return corrupt("byte {0}: a window of {1} states; {2} is the most", byte_of(segment, *at + 2), window,
                   std::min(kMaxWindow, segment.record_count));
  segment.window = static_cast<int>(window);
  return check_cover(segment, *at, segment.record_count - 1);
}

// Types 5, 9 and 13: states, their epochs, every hundredth epoch; GM (5) or window - 1; N. For 18 see piece_layout.
Result<void> epochs_layout(const Words& words, Ephemeris::Segment& segment) {
  const auto at = directory_at(segment, 2);
  if (!at) return forward(at);
  const double count = words[*at + 1];
  const double epochs = with_epochs(count) - count;
  if (const auto good = check_size(segment, *at + 1, count, 7, epochs + 2); !good) return good;
  segment.record_doubles = 6;
  if (segment.type == 5) {
    if (!(words[*at] > 0.0) || !std::isfinite(words[*at]))
      return corrupt("byte {0}: GM is {1}", byte_of(segment, *at), words[*at]);
    return {};
  }
  const double window = words[*at] + 1.0;
  if (!is_count(window, 1, std::min(kMaxWindow, segment.record_count)))
    return corrupt("byte {0}: a window of {1} states; {2} is the most", byte_of(segment, *at), window,
                   std::min(kMaxWindow, segment.record_count));
  segment.window = static_cast<int>(window);
  return {};
}

Result<void> fixed_layout(const Ephemeris::Segment& segment, std::size_t words) {
  if (word_count(segment) == words) return {};
  return corrupt("byte {0}: the segment has {1} words instead of {2}", segment.first_byte,
                 static_cast<double>(word_count(segment)), static_cast<double>(words));
}

}  // namespace

std::size_t times_before(const Words& words, std::size_t first, std::size_t count, Moment at, bool or_at) {
  std::size_t low = 0;
  while (count > 0) {
    const std::size_t half = count / 2;
    const double since = at.since(words[first + low + half]);
    if (since > 0.0 || (or_at && since == 0.0)) {
      low += half + 1;
      count -= half + 1;
    } else {
      count = half;
    }
  }
  return low;
}

Result<void> read_layout(std::span<const std::byte> file, Ephemeris::Segment& segment) {
  const Words words(file, segment);
  switch (segment.type) {
    case 1:
    case 21:
      return difference_layout(words, segment);
    case 2:
    case 3:
      return chebyshev_layout(words, segment);
    case 5:
    case 9:
    case 13:
      return epochs_layout(words, segment);
    case 8:
    case 12:
      return equal_steps_layout(words, segment);
    case 15:
      return fixed_layout(segment, 16);
    case 17:
      return fixed_layout(segment, 12);
    case 18:
    case 19:
      return check_pieces(words, segment);
    case 20:
      return velocity_layout(words, segment);
    default:
      return {};
  }
}

Result<void> evaluate(std::span<const std::byte> file, const Ephemeris::Segment& segment, Epoch epoch, State& out) {
  const Words words(file, segment);
  const Moment at(epoch);
  const auto state = [&]() -> Result<StateKm> {
    switch (segment.type) {
      case 1:
      case 21:
        return difference_lines(words, segment, at);
      case 2:
      case 3:
        return chebyshev_positions(file, segment, at);
      case 5:
        return discrete_conics(words, segment, at);
      case 8:
      case 9:
      case 12:
      case 13:
        return interpolated_states(words, segment, at);
      case 15:
        return precessing_conic(words, segment, at);
      case 17:
        return equinoctial_elements(words, segment, at);
      case 18:
      case 19:
        return interpolated_pieces(words, segment, at);
      case 20:
        return chebyshev_velocities(words, segment, at);
      default:
        return fail(ErrorCode::unsupported,
                    "SPK type {0} (body {1}, segment at byte {2}) is not read; 1, 2, 3, 5, 8, 9, 12, 13, 15, 17 to 21 "
                    "are",
                    {static_cast<double>(segment.type), static_cast<double>(segment.target.value),
                     static_cast<double>(segment.first_byte), 0});
    }
  }();
  if (!state) return forward(state);
  out = {state->p * 1e3, state->v * 1e3};
  return {};
}

}  // namespace astronav::spk
