// SPDX-License-Identifier: Apache-2.0
#include "onboard/vision/regions.h"

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <limits>
#include <type_traits>

namespace astronav::vision {
namespace {

constexpr std::size_t kMaxRuns = 65536;
constexpr int kBlock = 64;  // pixels looked at together: a bit of a word each

constexpr Window kNowhere{std::numeric_limits<int>::max(), std::numeric_limits<int>::max(), -1, -1};

void widen(Window& window, int u0, int v, int u1) {
  window.u0 = std::min(window.u0, u0);
  window.u1 = std::max(window.u1, u1);
  window.v0 = std::min(window.v0, v);
  window.v1 = std::max(window.v1, v);
}

// One threshold for all pixels of a row, or one for each.
template <typename T>
struct Constant {
  T threshold;
  bool any(const T* row, int begin) const {
    T largest = std::numeric_limits<T>::lowest();
    for (int i = 0; i < kBlock; ++i) largest = row[begin + i] > largest ? row[begin + i] : largest;
    return largest > threshold;
  }
  bool operator()(const T* row, int u) const { return row[u] > threshold; }
};
template <typename T>
struct Varying {
  const float* threshold;
  bool any(const T* row, int begin) const {
    float most = -1.0f;
    for (int i = begin; i < begin + kBlock; ++i) {
      const float over = static_cast<float>(row[i]) - threshold[i];
      most = over > most ? over : most;
    }
    return most > 0.0f;
  }
  bool operator()(const T* row, int u) const { return static_cast<float>(row[u]) > threshold[u]; }
};

// Bit i: pixel begin + i is above. A byte each at first, which compilers do by the vector; then eight bytes of 0 and 1
// at once, which a product moves side by side into its top byte.
template <typename T, typename Above>
std::uint64_t bits_above(const T* row, int begin, int count, Above above) {
  std::array<std::uint8_t, kBlock> bytes{};
  if (count == kBlock) {
    for (int i = 0; i < kBlock; ++i) bytes[static_cast<std::size_t>(i)] = above(row, begin + i);
  } else {
    for (int i = 0; i < count; ++i) bytes[static_cast<std::size_t>(i)] = above(row, begin + i);
  }
  constexpr std::uint64_t kGather =
      std::endian::native == std::endian::little ? 0x0102040810204080u : 0x8040201008040201u;
  const auto words = std::bit_cast<std::array<std::uint64_t, kBlock / 8>>(bytes);
  std::uint64_t bits = 0;
  for (std::size_t w = 0; w < words.size(); ++w) bits |= (words[w] * kGather >> 56) << (8 * w);
  return bits;
}

// No processor guesses where the next square lies: rows are called from memory before they are needed.
constexpr int kRowsAhead = 8;
template <typename T>
void fetch_ahead(ImageView<const T> image, const Attention& attention, int v) {
  constexpr int kLinePx = 64 / sizeof(T);
  if (v >= image.height()) return;
  const T* row = image.row(v);
  for (int block = attention.next_block(v, 0); block >= 0; block = attention.next_block(v, block + 1)) {
    for (int u = 0; u < kBlock; u += kLinePx) __builtin_prefetch(row + block * kBlock + u);
  }
}

}  // namespace

Window grown(const Window& window, int margin, int width, int height) {
  return {std::max(window.u0 - margin, 0), std::max(window.v0 - margin, 0), std::min(window.u1 + margin, width - 1),
          std::min(window.v1 + margin, height - 1)};
}

Regions::Regions() {
  runs_.reserve(kMaxRuns);
  region_of_run_.reserve(kMaxRuns);
  regions_.reserve(kMaxRegions);
}

template <typename T>
void Regions::add_run(ImageView<const T> image, const Search& search, int v, int u0, int u1) {
  if (runs_.size() == kMaxRuns) {
    overflowed_ = true;
    return;
  }
  const T* row = image.row(v);
  double sum = 0.0;
  T peak = row[u0];
  for (int u = u0; u <= u1; ++u) {
    sum += static_cast<double>(row[u]);
    peak = std::max(peak, row[u]);
  }
  // The saturated part of the run: its wings may reach far beyond.
  int s0 = u0, s1 = u0 - 1;
  if (static_cast<double>(peak) >= search.saturation_dn) {
    s1 = u1;
    while (static_cast<double>(row[s0]) < search.saturation_dn) ++s0;
    while (static_cast<double>(row[s1]) < search.saturation_dn) --s1;
  }
  const int middle = (u0 + u1) / 2;
  const double under =
      search.background.even()
          ? search.level.background_dn
          : search.background.at({static_cast<double>(middle), static_cast<double>(v)}).under(middle, v);
  runs_.push_back({static_cast<std::int32_t>(runs_.size()), static_cast<std::int16_t>(v), static_cast<std::int16_t>(u0),
                   static_cast<std::int16_t>(u1), static_cast<std::int16_t>(s0), static_cast<std::int16_t>(s1),
                   static_cast<float>(sum - under * (u1 - u0 + 1)),
                   static_cast<float>(static_cast<double>(peak) - under),
                   search.attention != nullptr && !search.attention->covers({u0 - 1, v - 1, u1 + 1, v + 1})});
}

std::int32_t Regions::root(std::int32_t run) {
  while (runs_[run].parent != run) {
    runs_[run].parent = runs_[runs_[run].parent].parent;
    run = runs_[run].parent;
  }
  return run;
}

// Runs of neighbouring rows that touch, corners included, belong together.
void Regions::join_rows(std::size_t above_first, std::size_t above_last, std::size_t first, std::size_t last) {
  std::size_t above = above_first;
  for (std::size_t run = first; run < last; ++run) {
    while (above < above_last && runs_[above].u1 + 1 < runs_[run].u0) ++above;
    for (std::size_t other = above; other < above_last && runs_[other].u0 <= runs_[run].u1 + 1; ++other) {
      const std::int32_t a = root(static_cast<std::int32_t>(other)), b = root(static_cast<std::int32_t>(run));
      runs_[std::max(a, b)].parent = std::min(a, b);
    }
  }
}

template <typename T, typename Above>
void Regions::collect_row(ImageView<const T> image, const Search& search, int v, Above above) {
  const T* row = image.row(v);
  int start = -1;  // of a run that is not at its end
  for (int block = 0; block < image.width(); block += kBlock) {
    if (search.attention != nullptr) {
      const int next = search.attention->next_block(v, block / kBlock);
      if (start >= 0 && next != block / kBlock) {
        add_run(image, search, v, start, block - 1);
        start = -1;
      }
      if (next < 0) return;
      block = next * kBlock;
    }
    const int count = std::min(kBlock, image.width() - block);
    const std::uint64_t looked_at =
        search.attention == nullptr ? ~std::uint64_t{0} : search.attention->bits(v, block / kBlock);
    std::uint64_t bright = 0;
    if (count < kBlock || above.any(row, block)) bright = bits_above(row, block, count, above) & looked_at;
    if (start >= 0) {
      const int more = std::countr_one(bright);
      if (more == kBlock) continue;
      add_run(image, search, v, start, block + more - 1);
      start = -1;
      bright &= bright + 1;  // without the lowest ones
    }
    while (bright != 0) {
      const int first = std::countr_zero(bright), length = std::countr_one(bright >> first);
      if (first + length == kBlock) {
        start = block + first;
        break;
      }
      add_run(image, search, v, block + first, block + first + length - 1);
      bright &= bright + (std::uint64_t{1} << first);
    }
  }
  if (start >= 0) add_run(image, search, v, start, image.width() - 1);
}

template <typename T>
void Regions::grow(ImageView<const T> image, const Search& search) {
  overflowed_ = false;
  runs_.clear();
  T constant;
  if constexpr (std::is_integral_v<T>) {
    const double largest = std::numeric_limits<T>::max();
    constant = static_cast<T>(std::clamp(std::floor(search.level.threshold_dn), 0.0, largest));
  } else {
    constant = static_cast<T>(search.level.threshold_dn);
  }
  std::size_t above_first = 0, above_last = 0;
  for (int v = 0; v < image.height() && !overflowed_; ++v) {
    const std::size_t first = runs_.size();
    if (search.attention != nullptr) fetch_ahead(image, *search.attention, v + kRowsAhead);
    if (search.background.even()) {
      collect_row(image, search, v, Constant<T>{constant});
    } else {
      const auto line = search.background.threshold_row(v, search.threshold_sigma, search.threshold_dn, image.width());
      collect_row(image, search, v, Varying<T>{line.data()});
    }
    const std::size_t last = runs_.size();
    join_rows(above_first, above_last, first, last);
    above_first = first;
    above_last = last;
  }
  collect_regions();
}

template void Regions::grow<std::uint8_t>(ImageView<const std::uint8_t>, const Search&);
template void Regions::grow<std::uint16_t>(ImageView<const std::uint16_t>, const Search&);
template void Regions::grow<float>(ImageView<const float>, const Search&);

void Regions::collect_regions() {
  regions_.clear();
  region_of_run_.clear();
  for (std::size_t i = 0; i < runs_.size(); ++i) {
    const Run& run = runs_[i];
    const std::int32_t parent = root(static_cast<std::int32_t>(i));
    std::int32_t index;
    if (parent == static_cast<std::int32_t>(i)) {
      if (regions_.size() == kMaxRegions) {
        overflowed_ = true;
        return;
      }
      index = static_cast<std::int32_t>(regions_.size());
      regions_.push_back({.box = kNowhere, .saturated_box = kNowhere});
    } else {
      index = region_of_run_[parent];
    }
    region_of_run_.push_back(index);
    Region& region = regions_[index];
    widen(region.box, run.u0, run.v, run.u1);
    region.pixels += run.u1 - run.u0 + 1;
    region.cut |= run.cut;
    region.sum += run.sum;
    region.peak = std::max(region.peak, static_cast<double>(run.peak));
    if (run.s0 <= run.s1) {
      region.saturated = true;
      widen(region.saturated_box, run.s0, run.v, run.s1);
    }
  }
}

}  // namespace astronav::vision
