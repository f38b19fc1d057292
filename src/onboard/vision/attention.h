// SPDX-License-Identifier: Apache-2.0
// Attention: which pixels of a frame are looked at where it is known what to expect. A bit for each column, in bands of
// eight rows. Allocates in its constructor and never again.
#pragma once

#include <bit>
#include <cstdint>
#include <vector>

#include "models/camera/camera.h"
#include "onboard/vision/psf_fit.h"

namespace astronav::vision {

class Attention {
 public:
  Attention(int width, int height);

  void clear();
  // The square of pixels within `reach_px` of a place, and what of its bands lies above and below.
  void add(Pixel middle, double reach_px);

  // Bit i: pixel 64 block + i of the row.
  std::uint64_t bits(int v, int block) const {
    return words_[static_cast<std::size_t>(v / kBandRows * blocks_ + block)];
  }
  // The first block from this one on of which anything is looked at; -1: none.
  int next_block(int v, int block) const {
    const std::uint64_t* const used = used_.data() + v / kBandRows * used_words_;
    for (int word = block / 64; word < used_words_; ++word) {
      const std::uint64_t from = word == block / 64 ? ~std::uint64_t{0} << (block % 64) : ~std::uint64_t{0};
      if ((used[word] & from) != 0) return 64 * word + std::countr_zero(used[word] & from);
    }
    return -1;
  }
  // All of a window that lies within the frame.
  bool covers(const Window& window) const;
  double area_px() const { return area_px_; }

 private:
  static constexpr int kBandRows = 8, kBlockPx = 64;
  // The bits of a block that lie between two columns of the frame.
  static std::uint64_t columns(int block, int u0, int u1);

  int width_, height_, blocks_;
  double area_px_ = 0.0;
  std::vector<std::uint64_t> words_;  // by band and block
  int used_words_;                    // of a band
  std::vector<std::uint64_t> used_;   // by band: bits of the blocks of which anything is looked at
};

}  // namespace astronav::vision
