// SPDX-License-Identifier: Apache-2.0
// SPK types 8, 9, 12, 13, 18 and 19: polynomials through the states around the moment, of Lagrange (each component by
// itself) or of Hermite (positions with their derivatives).
#include <algorithm>
#include <array>
#include <cmath>

#include "models/ephemeris/spk_segment.h"

namespace astronav::spk {
namespace {

// The states from which one moment is interpolated.
struct Window {
  std::size_t first = 0;
  int count = 0;
  std::array<double, kMaxWindow> since{};  // of each state: the moment minus its epoch, s
};

// The polynomial through values (Lagrange), or through values and slopes (Hermite), and its derivative, at the moment:
// Neville's scheme, a Hermite node counting twice.
struct Value {
  Vec3 value;
  Vec3 slope;
};
template <typename Get>
Value interpolate(const Window& window, bool hermite, Get get) {
  std::array<Value, 2 * kMaxWindow> table;
  std::array<double, 2 * kMaxWindow> since;
  const int n = hermite ? 2 * window.count : window.count;
  for (int i = 0; i < n; ++i) {
    const int state = hermite ? i / 2 : i;
    since[i] = window.since[state];
    table[i] = {get(state, 0), Vec3::Zero()};
  }
  for (int m = 1; m < n; ++m) {
    for (int i = 0; i + m < n; ++i) {
      Value& low = table[i];
      const Value& high = table[i + 1];
      if (hermite && m == 1 && i % 2 == 0) {
        const Vec3 slope = get(i / 2, 1);
        low = {low.value + slope * since[i], slope};
        continue;
      }
      const double over = 1.0 / (since[i] - since[i + m]);  // the epochs' difference
      low.slope = (high.value - low.value + since[i] * high.slope - since[i + m] * low.slope) * over;
      low.value = (since[i] * high.value - since[i + m] * low.value) * over;
    }
  }
  return table[0];
}

// `count` states stand from the word `states` on, `size` words each; their epochs from the word `epochs` on, or at
// equal steps.
struct Table {
  std::size_t states = 0;
  std::size_t size = 6;
  std::size_t count = 0;
  std::size_t epochs = 0;
  bool equal_steps = false;
  double init_s = 0.0;
  double step_s = 0.0;
  int window = 0;
  bool hermite = false;
  bool cut_window = false;  // at the ends: smaller windows (types 18 and 19) instead of shifted ones
};

Window choose(const Words& words, const Table& table, Moment at) {
  const auto since = [&](std::size_t i) {
    if (!table.equal_steps) return at.since(words[table.epochs + i]);
    return at.since(table.init_s) - static_cast<double>(i) * table.step_s;
  };
  const auto last = static_cast<std::int64_t>(table.count) - 1;
  std::int64_t low = 0;  // the last state not after the moment
  if (table.equal_steps) {
    low = static_cast<std::int64_t>(std::clamp(at.since(table.init_s) / table.step_s, 0.0, static_cast<double>(last)));
  } else {
    low = static_cast<std::int64_t>(times_before(words, table.epochs, table.count, at, true)) - 1;
  }
  low = std::clamp<std::int64_t>(low, 0, std::max<std::int64_t>(last - 1, 0));
  // An even window has as many states on either side; an odd one is about the nearest.
  const std::int64_t half = table.window / 2;
  std::int64_t first = low + 1 - half;
  if (table.window % 2 == 1) {
    const bool upper = low < last && std::abs(since(static_cast<std::size_t>(low + 1))) <
                                         std::abs(since(static_cast<std::size_t>(low)));
    first = low + (upper ? 1 : 0) - half;
  }
  std::int64_t end = first + table.window;
  if (table.cut_window) {
    first = std::max<std::int64_t>(first, 0);
    end = std::min<std::int64_t>(end, last + 1);
  } else {
    first = std::clamp<std::int64_t>(first, 0, last + 1 - table.window);
    end = first + table.window;
  }
  Window out;
  out.first = static_cast<std::size_t>(first);
  out.count = static_cast<int>(end - first);
  for (int i = 0; i < out.count; ++i) out.since[i] = since(out.first + static_cast<std::size_t>(i));
  return out;
}

StateKm evaluate(const Words& words, const Table& table, Moment at) {
  const Window window = choose(words, table, at);
  const auto vector = [&](std::size_t offset) {
    return [&words, &table, first = window.first, offset](int state, int derivative) {
      return words.vector(table.states + (first + static_cast<std::size_t>(state)) * table.size + offset +
                          3 * static_cast<std::size_t>(derivative));
    };
  };
  if (table.hermite && table.size == 6) {
    const Value position = interpolate(window, true, vector(0));
    return {position.value, position.slope};
  }
  // Velocities of their own: with accelerations where there are twelve numbers.
  return {interpolate(window, table.hermite, vector(0)).value,
          interpolate(window, table.hermite, vector(table.hermite ? 6 : 3)).value};
}

// A piece of type 19, or a whole segment of type 18: packets, epochs, every hundredth epoch; subtype, window and N.
Result<Table> piece(const Words& words, const Ephemeris::Segment& segment, std::size_t begin, std::size_t end) {
  const auto size_in_words = static_cast<double>(end - begin);
  if (end - begin < 3)
    return daf::corrupt("byte {0}: a piece of {1} words has no room for its directory", byte_of(segment, begin),
                        size_in_words);
  const double subtype = words[end - 3], window = words[end - 2], count = words[end - 1];
  if (!daf::is_count(subtype, 0, 2))
    return daf::corrupt("byte {0}: subtype {1}; 0, 1 and 2 are read", byte_of(segment, end - 3), subtype);
  const double size = subtype == 0 ? 12 : 6;
  if (!daf::is_count(count, 1, size_in_words) ||
      count * (size + 1) + std::floor((count - 1.0) / 100.0) + 3 != size_in_words)
    return daf::corrupt("byte {0}: {1} packets do not fill a piece of {2} words", byte_of(segment, end - 1), count,
                        size_in_words);
  if (!daf::is_count(window, 1, kMaxWindow))
    return daf::corrupt("byte {0}: a window of {1} states; {2} is the most", byte_of(segment, end - 2), window,
                        kMaxWindow);
  Table out;
  out.states = begin;
  out.size = static_cast<std::size_t>(size);
  out.count = static_cast<std::size_t>(count);
  out.epochs = begin + out.count * out.size;
  out.window = static_cast<int>(window);
  out.hermite = subtype != 1;
  out.cut_window = true;
  return out;
}

// Type 19, from its end: number of pieces, what to take at a border, where the pieces (and after them the borders)
// begin, counted from 1.
struct Pieces {
  std::size_t count = 0;
  bool later_at_border = false;
  std::size_t pointers = 0;
  std::size_t borders = 0;
};

Result<Pieces> pieces(const Words& words, const Ephemeris::Segment& segment) {
  const std::size_t size = word_count(segment);
  const double count = words[size - 1];
  if (size < 8 || !daf::is_count(count, 1, static_cast<double>(size)) || 2.0 * count + 4.0 > static_cast<double>(size))
    return daf::corrupt("byte {0}: {1} pieces are not in a segment of {2} words", byte_of(segment, size - 1), count,
                        static_cast<double>(size));
  Pieces out;
  out.count = static_cast<std::size_t>(count);
  out.later_at_border = words[size - 2] > 0.0;
  out.pointers = size - 2 - (out.count + 1);
  const double borders = words[out.pointers + out.count];
  if (!daf::is_count(borders, 2, static_cast<double>(out.pointers)) ||
      borders + static_cast<double>(out.count) > static_cast<double>(out.pointers))
    return daf::corrupt("byte {0}: the borders of the pieces cannot begin at word {1}",
                        byte_of(segment, out.pointers + out.count), borders);
  out.borders = static_cast<std::size_t>(borders) - 1;
  return out;
}

Result<Table> piece_number(const Words& words, const Ephemeris::Segment& segment, const Pieces& all, std::size_t i) {
  const double begin = words[all.pointers + i], end = words[all.pointers + i + 1];
  if (!daf::is_count(begin, 1, static_cast<double>(all.borders)) ||
      !daf::is_count(end, begin + 1, static_cast<double>(all.borders + 1)))
    return daf::corrupt("byte {0}: a piece cannot reach from word {1} to {2}", byte_of(segment, all.pointers + i),
                        begin, end);
  return piece(words, segment, static_cast<std::size_t>(begin) - 1, static_cast<std::size_t>(end) - 1);
}

}  // namespace

Result<void> check_pieces(const Words& words, const Ephemeris::Segment& segment) {
  if (segment.type == 18) {
    const auto whole = piece(words, segment, 0, word_count(segment));
    if (!whole) return forward(whole);
    return {};
  }
  const auto all = pieces(words, segment);
  if (!all) return forward(all);
  for (std::size_t i = 0; i < all->count; ++i) {
    if (const auto one = piece_number(words, segment, *all, i); !one) return forward(one);
  }
  return {};
}

Result<StateKm> interpolated_states(const Words& words, const Ephemeris::Segment& segment, Moment at) {
  Table table;
  table.count = static_cast<std::size_t>(segment.record_count);
  table.epochs = 6 * table.count;
  table.equal_steps = segment.type == 8 || segment.type == 12;
  table.init_s = segment.init_s;
  table.step_s = segment.interval_s;
  table.window = segment.window;
  table.hermite = segment.type == 12 || segment.type == 13;
  return evaluate(words, table, at);
}

Result<StateKm> interpolated_pieces(const Words& words, const Ephemeris::Segment& segment, Moment at) {
  if (segment.type == 18) {
    const auto whole = piece(words, segment, 0, word_count(segment));
    if (!whole) return forward(whole);
    return evaluate(words, *whole, at);
  }
  const auto all = pieces(words, segment);
  if (!all) return forward(all);
  const std::size_t before = times_before(words, all->borders, all->count + 1, at, all->later_at_border);
  const auto table = piece_number(words, segment, *all, std::clamp<std::size_t>(before, 1, all->count) - 1);
  if (!table) return forward(table);
  return evaluate(words, *table, at);
}

}  // namespace astronav::spk
