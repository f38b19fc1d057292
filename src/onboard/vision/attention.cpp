// SPDX-License-Identifier: Apache-2.0
#include "onboard/vision/attention.h"

#include <algorithm>
#include <bit>
#include <cmath>

namespace astronav::vision {

Attention::Attention(int width, int height)
    : width_(width), height_(height), blocks_((width + kBlockPx - 1) / kBlockPx), used_words_(blocks_ / 64 + 1) {
  const int bands = (height + kBandRows - 1) / kBandRows;
  words_.resize(static_cast<std::size_t>(bands * blocks_));
  used_.resize(static_cast<std::size_t>(bands * used_words_));
}

void Attention::clear() {
  std::fill(words_.begin(), words_.end(), std::uint64_t{0});
  std::fill(used_.begin(), used_.end(), std::uint64_t{0});
  area_px_ = 0.0;
}

std::uint64_t Attention::columns(int block, int u0, int u1) {
  const int first = std::max(u0 - block * kBlockPx, 0), last = std::min(u1 - block * kBlockPx, kBlockPx - 1);
  return ~std::uint64_t{0} >> (kBlockPx - 1 - last + first) << first;
}

void Attention::add(Pixel middle, double reach_px) {
  const auto first = [&](double at, int size) {
    return static_cast<int>(std::ceil(std::clamp(at - reach_px, 0.0, static_cast<double>(size))));
  };
  const auto last = [&](double at, int size) {
    return static_cast<int>(std::floor(std::clamp(at + reach_px, -1.0, size - 1.0)));
  };
  const int u0 = first(middle.u, width_), u1 = last(middle.u, width_);
  const int v0 = first(middle.v, height_), v1 = last(middle.v, height_);
  if (u0 > u1 || v0 > v1) return;
  for (int band = v0 / kBandRows; band <= v1 / kBandRows; ++band) {
    const int rows = std::min(kBandRows, height_ - band * kBandRows);
    for (int block = u0 / kBlockPx; block <= u1 / kBlockPx; ++block) {
      std::uint64_t& word = words_[static_cast<std::size_t>(band * blocks_ + block)];
      const std::uint64_t more = columns(block, u0, u1) & ~word;
      word |= more;
      area_px_ += std::popcount(more) * rows;
      used_[static_cast<std::size_t>(band * used_words_ + block / 64)] |= std::uint64_t{1} << (block % 64);
    }
  }
}

bool Attention::covers(const Window& window) const {
  const int u0 = std::max(window.u0, 0), u1 = std::min(window.u1, width_ - 1);
  const int v0 = std::max(window.v0, 0), v1 = std::min(window.v1, height_ - 1);
  for (int band = v0 / kBandRows; band <= v1 / kBandRows; ++band) {
    for (int block = u0 / kBlockPx; block <= u1 / kBlockPx; ++block) {
      if ((columns(block, u0, u1) & ~words_[static_cast<std::size_t>(band * blocks_ + block)]) != 0) return false;
    }
  }
  return true;
}

}  // namespace astronav::vision
