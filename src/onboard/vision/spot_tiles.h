// SPDX-License-Identifier: Apache-2.0
// Spots and predicted stars are kept by tiles of the picture, so that neighbours are found at once.
#pragma once

#include <algorithm>
#include <cstddef>

namespace astronav::vision {

inline constexpr int kTilePx = 32;
inline constexpr std::size_t kMaxStarsJudged = 1024;

inline int tile(double px, int tiles) {
  return std::clamp(static_cast<int>(px) / kTilePx, 0, tiles - 1);
}

}  // namespace astronav::vision
