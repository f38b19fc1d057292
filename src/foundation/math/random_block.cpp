// SPDX-License-Identifier: Apache-2.0
#include "foundation/math/random_block.h"

#include <cstring>

namespace astronav {

RandomBlock::RandomBlock(const StreamId& id) {
  RandomStream seeds(id);
  for (auto& word : state_) word = seeds.next();
}

void RandomBlock::fill(std::span<std::uint32_t> out) {
  std::array<Lanes, 4> s;
  std::memcpy(s.data(), state_.data(), sizeof(s));
  const auto rotl = [](Lanes x, int k) { return (x << k) | (x >> (64 - k)); };
  const auto step = [&] {
    const Lanes words = rotl(s[0] + s[3], 23) + s[0];
    const Lanes t = s[1] << 17;
    s[2] ^= s[0];
    s[3] ^= s[1];
    s[1] ^= s[2];
    s[0] ^= s[3];
    s[2] ^= t;
    s[3] = rotl(s[3], 45);
    return words;
  };
  constexpr std::size_t kWords = 2 * kLanes;
  std::size_t i = 0;
  for (; i + kWords <= out.size(); i += kWords) {
    const Lanes words = step();
    std::memcpy(out.data() + i, &words, sizeof(words));
  }
  if (i < out.size()) {
    const Lanes words = step();
    std::memcpy(out.data() + i, &words, (out.size() - i) * sizeof(std::uint32_t));
  }
  std::memcpy(state_.data(), s.data(), sizeof(s));
}

}  // namespace astronav
