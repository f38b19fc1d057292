// SPDX-License-Identifier: Apache-2.0
// Random bits by the thousand: eight xoshiro256++ (Blackman & Vigna 2021) side by side, written so that a compiler
// makes vector instructions of them. As with RandomStream, a draw depends on the stream's name and its place in it
// alone.
#pragma once

#include <array>
#include <cstdint>
#include <span>

#include "foundation/math/random.h"

namespace astronav {

class RandomBlock {
 public:
  explicit RandomBlock(const StreamId& id);

  // Independent words of 32 random bits. What is left of the last sixteen is thrown away.
  void fill(std::span<std::uint32_t> out);

 private:
  static constexpr int kLanes = 8;
  using Lanes = std::uint64_t __attribute__((vector_size(8 * kLanes)));  // GCC and Clang, on every processor

  std::array<std::uint64_t, 4 * kLanes> state_{};
};

}  // namespace astronav
