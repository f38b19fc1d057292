// SPDX-License-Identifier: Apache-2.0
// The known word that a misspelt one was probably meant to be: "did you mean ...?"
#pragma once

#include <cstddef>
#include <functional>
#include <iterator>
#include <string_view>

namespace astronav {

// Levenshtein's distance: bytes put in, left out or replaced. Only the first kLongestWord bytes of each word count, so
// that hostile input costs no time; nothing is allocated.
inline constexpr std::size_t kLongestWord = 64;
std::size_t edit_distance(std::string_view a, std::string_view b);

// Iterator to the item of `known` whose word (`word_of(item)`) is nearest, the first of several; the end of nothing.
template <typename Range, typename Projection = std::identity>
auto nearest_word(std::string_view word, const Range& known, Projection word_of = {}) {
  auto nearest = std::begin(known);
  auto least = static_cast<std::size_t>(-1);
  for (auto it = std::begin(known); it != std::end(known); ++it) {
    const std::size_t distance = edit_distance(word, word_of(*it));
    if (distance >= least) continue;
    nearest = it;
    least = distance;
  }
  return nearest;
}

}  // namespace astronav
