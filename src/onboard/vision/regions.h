// SPDX-License-Identifier: Apache-2.0
// Regions: pixels above the threshold, grown over 8 neighbours in one pass (runs of pixels and union-find). Internal to
// this folder. Allocates in its constructor and never again.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "foundation/image/image.h"
#include "onboard/vision/attention.h"
#include "onboard/vision/background.h"

namespace astronav::vision {

struct Region {
  Window box;
  int pixels = 0;
  bool saturated = false;
  bool cut = false;              // touches pixels that are not looked at
  double sum = 0.0, peak = 0.0;  // above the background
  Window saturated_box;
};

class Regions {
 public:
  static constexpr std::size_t kMaxRegions = 8192;
  Regions();

  // More runs or regions than there is room for: the threshold is too low for this frame, and the rest is left out.
  struct Search {
    const Background& background;
    FrameLevel level;
    double threshold_sigma;  // above the background in its noise
    double threshold_dn;     // above the background; used instead where > 0
    double saturation_dn;
    const Attention* attention = nullptr;  // nullptr: everywhere
  };
  template <typename T>
  void grow(ImageView<const T> image, const Search& search);

  std::span<const Region> all() const { return regions_; }
  bool overflowed() const { return overflowed_; }

 private:
  struct Run {
    std::int32_t parent;
    std::int16_t v, u0, u1;  // inclusive
    std::int16_t s0, s1;     // of the saturated pixels; s0 > s1 where there are none
    float sum, peak;         // above the background
    bool cut;
  };
  template <typename T, typename Above>
  void collect_row(ImageView<const T> image, const Search& search, int v, Above above);
  template <typename T>
  void add_run(ImageView<const T> image, const Search& search, int v, int u0, int u1);
  void join_rows(std::size_t above_first, std::size_t above_last, std::size_t first, std::size_t last);
  std::int32_t root(std::int32_t run);
  void collect_regions();

  bool overflowed_ = false;
  std::vector<Run> runs_;
  std::vector<std::int32_t> region_of_run_;
  std::vector<Region> regions_;
};

// A window with a margin, cut to the image.
Window grown(const Window& window, int margin, int width, int height);

}  // namespace astronav::vision
