// SPDX-License-Identifier: Apache-2.0
#include "onboard/vision/background.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <type_traits>

namespace astronav::vision {
namespace {

constexpr double kClip = 4.0;        // sigma
constexpr double kLeastNoise = 0.3;  // DN: that of rounding is 0.29
constexpr double kUneven = 2.0;      // chi-square of the tiles' means per degree of freedom; 1.0 +- 0.1 where even
constexpr int kColumnRows = 64;

struct Clipped {
  double mean = 0.0, sigma = 0.0;
};
// Mean and spread of what lies within four sigma; `mean` and `sigma` are the start. The mean, not the median: noise of
// half a DN leaves a median that is a whole one.
Clipped clipped(std::span<const float> samples, Clipped start, double least_sigma, int passes = 4) {
  constexpr std::size_t kSums = 16;  // side by side
  Clipped found = start;
  const auto origin = static_cast<float>(start.mean);
  for (int pass = 0; pass < passes; ++pass) {
    std::array<float, kSums> n{}, sum{}, sum2{};
    const auto middle = static_cast<float>(found.mean - start.mean);
    const auto reach = static_cast<float>(kClip * found.sigma + 0.5);
    const auto take = [&](float x, std::size_t lane) {
      const float d = x - origin;
      const float one = std::abs(d - middle) <= reach ? 1.0f : 0.0f;
      n[lane] += one;
      sum[lane] += one * d;
      sum2[lane] += one * d * d;
    };
    std::size_t i = 0;
    for (; i + kSums <= samples.size(); i += kSums) {
      for (std::size_t lane = 0; lane < kSums; ++lane) take(samples[i + lane], lane);
    }
    for (; i < samples.size(); ++i) take(samples[i], 0);
    const auto total = [](const std::array<float, kSums>& lanes) {
      double t = 0.0;
      for (const float lane : lanes) t += static_cast<double>(lane);
      return t;
    };
    const double count = total(n);
    if (count == 0.0) break;
    const double off = total(sum) / count;
    found.mean = start.mean + off;
    found.sigma = std::max(std::sqrt(std::max(total(sum2) / count - off * off, 0.0)), least_sigma);
  }
  return found;
}

// Median, and a sigma from the quartile below it: sources do not reach it. Where pixels are so coarse that both are
// one number, from all below. Reorders the samples.
Clipped robust(std::span<float> samples, double least_sigma) {
  const auto begin = samples.begin();
  const auto middle = begin + static_cast<std::ptrdiff_t>(samples.size() / 2);
  std::nth_element(begin, middle, samples.end());
  const auto quarter = begin + static_cast<std::ptrdiff_t>(samples.size() / 4);
  const double median = static_cast<double>(*middle);
  std::nth_element(begin, quarter, middle);
  double sigma = 1.4826 * (median - static_cast<double>(*quarter));
  if (sigma <= 0.0) {
    double sum2 = 0.0;
    for (auto x = begin; x != quarter; ++x) sum2 += std::pow(static_cast<double>(*x) - median, 2);
    sigma = std::sqrt(2.0 * sum2 / static_cast<double>(samples.size()));
  }
  return {median, std::max(sigma, least_sigma)};
}

template <typename T>
double least_noise(double level) {
  return std::is_integral_v<T> ? kLeastNoise : std::max(1e-9, 1e-6 * std::abs(level));
}

}  // namespace

Background::Background(int max_width) {
  nodes_.resize(kTiles * kTiles);
  columns_.resize(static_cast<std::size_t>(max_width));
  row_.reserve(std::max<std::size_t>(static_cast<std::size_t>(max_width), 4096));
  samples_.reserve(kMaxSamples + static_cast<std::size_t>(max_width));
}

void Background::set(const FrameLevel& level) {
  level_ = level;
  mapped_ = columned_ = false;
}

// Whole rows, spread over the frame: pixels spread one by one would fetch all of it from memory.
template <typename T>
FrameLevel Background::measure_even(ImageView<const T> image, std::size_t samples) {
  const auto width = static_cast<std::size_t>(image.width());
  rows_ = std::clamp(static_cast<int>(samples / width), 1, image.height());
  step_ = 1;
  while (width * static_cast<std::size_t>(rows_) > samples * static_cast<std::size_t>(step_)) ++step_;
  const auto per_row = static_cast<std::size_t>((image.width() + step_ - 1) / step_);
  samples_.resize(static_cast<std::size_t>(rows_) * per_row);
  for (int r = 0; r < rows_; ++r) {
    const T* row = image.row(row_of(r, image.height()));
    float* to = samples_.data() + static_cast<std::size_t>(r) * per_row;
    for (std::size_t i = 0; i < per_row; ++i) {
      const auto x = static_cast<float>(row[i * static_cast<std::size_t>(step_)]);
      if constexpr (std::is_integral_v<T>)
        to[i] = x;
      else
        to[i] = std::isfinite(x) ? x : 0.0f;
    }
  }
  // The start from about a thousand of them.
  row_.clear();
  const std::size_t every = std::max<std::size_t>(1, samples_.size() / 1024);
  for (std::size_t i = 0; i < samples_.size(); i += every) row_.push_back(samples_[i]);
  const double least = least_noise<T>(static_cast<double>(row_.front()));
  const Clipped start = clipped(row_, robust(row_, least), least, 3);
  const Clipped found = clipped(samples_, start, least, 1);
  return {found.mean, found.sigma, 0.0};
}

int Background::row_of(int sample, int height) const {
  return (2 * sample + 1) * height / (2 * rows_);
}

// Whether the means of the tiles scatter more than the noise lets them.
bool Background::is_uneven(int height) const {
  struct Sum {
    double n = 0.0, sum = 0.0;
  };
  constexpr std::size_t kEvery = 4;
  std::array<Sum, kTiles * kTiles> tiles{};
  const double reach = kClip * level_.noise_dn + 0.5;
  const std::size_t per_row = samples_.size() / static_cast<std::size_t>(rows_);
  double n = 0.0, sum = 0.0, sum2 = 0.0;
  for (int r = 0; r < rows_; ++r) {
    const float* row = samples_.data() + static_cast<std::size_t>(r) * per_row;
    Sum* const tile_row = tiles.data() + row_of(r, height) * kTiles / height * kTiles;
    for (std::size_t column = 0; column < kTiles; ++column) {
      double in_tile = 0.0, light = 0.0, light2 = 0.0;
      for (std::size_t i = per_row * column / kTiles; i < per_row * (column + 1) / kTiles; i += kEvery) {
        const double d = static_cast<double>(row[i]) - level_.background_dn;
        const double one = std::abs(d) <= reach ? 1.0 : 0.0;
        in_tile += one;
        light += one * d;
        light2 += one * d * d;
      }
      tile_row[column].n += in_tile;
      tile_row[column].sum += light;
      n += in_tile;
      sum += light;
      sum2 += light2;
    }
  }
  const double mean = sum / std::max(1.0, n);
  double between = 0.0;
  int filled = 0;
  for (const Sum& tile : tiles) {
    if (tile.n < 4.0) continue;
    between += (tile.sum - tile.n * mean) * (tile.sum / tile.n - mean);
    ++filled;
  }
  const double within = std::max(0.0, sum2 - n * mean * mean - between);
  const double degrees = n - filled;
  return filled > 16 && degrees > filled && between / (filled - 1) > kUneven * within / degrees;
}

template <typename T>
Background::Node Background::measure_tile(ImageView<const T> image, int column, int row) {
  const int u0 = image.width() * column / kTiles, u1 = image.width() * (column + 1) / kTiles;
  const int v0 = image.height() * row / kTiles, v1 = image.height() * (row + 1) / kTiles;
  const int step_u = std::max(1, (u1 - u0) / 16), step_v = std::max(1, (v1 - v0) / 16);
  samples_.clear();
  for (int v = v0; v < v1; v += step_v) {
    const T* pixels = image.row(v);
    for (int u = u0; u < u1; u += step_u) {
      const auto x = static_cast<float>(pixels[u]);
      if (std::isfinite(x)) samples_.push_back(x);
    }
  }
  if (samples_.empty()) return {};
  const Clipped start = robust(samples_, least_noise<T>(static_cast<double>(samples_.front())));
  const Clipped level = clipped(samples_, start, least_noise<T>(start.mean));
  // The noise from differences of neighbours, which no slope reaches.
  samples_.clear();
  const double reach = kClip * level.sigma + 0.5;
  for (int v = v0; v < v1; v += step_v) {
    const T* pixels = image.row(v);
    for (int u = u0; u < u1; u += step_u) {
      const int beside = u + 1 < u1 ? u + 1 : u - 1;
      const double a = static_cast<double>(pixels[u]) - level.mean,
                   b = static_cast<double>(pixels[beside]) - level.mean;
      if (std::abs(a) <= reach && std::abs(b) <= reach) samples_.push_back(static_cast<float>(a - b));
    }
  }
  const double root2 = std::sqrt(2.0);
  const Clipped differences = clipped(samples_, {0.0, root2 * level.sigma}, root2 * least_noise<T>(level.mean));
  return {static_cast<float>(level.mean), static_cast<float>(differences.sigma / root2)};
}

template <typename T>
FrameLevel Background::measure_map(ImageView<const T> image) {
  tile_width_ = static_cast<double>(image.width()) / kTiles;
  tile_height_ = static_cast<double>(image.height()) / kTiles;
  for (int row = 0; row < kTiles; ++row) {
    for (int column = 0; column < kTiles; ++column) nodes_[row * kTiles + column] = measure_tile(image, column, row);
  }
  // 256 samples tell a tile's noise to 5 %; with its neighbours it is known three times as well.
  std::array<float, kTiles * kTiles> smooth{};
  for (int row = 0; row < kTiles; ++row) {
    for (int column = 0; column < kTiles; ++column) {
      float sum = 0.0f, n = 0.0f;
      for (int r = std::max(0, row - 1); r <= std::min(kTiles - 1, row + 1); ++r) {
        for (int c = std::max(0, column - 1); c <= std::min(kTiles - 1, column + 1); ++c, n += 1.0f)
          sum += nodes_[r * kTiles + c].noise;
      }
      smooth[static_cast<std::size_t>(row * kTiles + column)] = sum / n;
    }
  }
  for (std::size_t i = 0; i < nodes_.size(); ++i) nodes_[i].noise = smooth[i];
  const auto middle_of = [&](auto&& value) {
    samples_.clear();
    for (const Node& node : nodes_) samples_.push_back(value(node));
    const auto middle = samples_.begin() + static_cast<std::ptrdiff_t>(samples_.size() / 2);
    std::nth_element(samples_.begin(), middle, samples_.end());
    return static_cast<double>(*middle);
  };
  FrameLevel level;
  level.background_dn = middle_of([](const Node& n) { return n.background; });
  level.noise_dn = middle_of([](const Node& n) { return n.noise; });
  return level;
}

template <typename T>
FrameLevel Background::measure(ImageView<const T> image, std::size_t samples) {
  ASTRONAV_CHECK_OP(samples, <=, kMaxSamples);
  ASTRONAV_CHECK_OP(static_cast<std::size_t>(image.width()), <=, columns_.size());
  columned_ = false;
  level_ = measure_even(image, samples);
  mapped_ = std::min(image.width(), image.height()) >= 8 * kTiles && is_uneven(image.height());
  if (mapped_) level_ = measure_map(image);
  return level_;
}

template <typename T>
void Background::measure_columns(ImageView<const T> image) {
  const int step = std::max(1, image.height() / kColumnRows);
  std::array<float, kColumnRows> column;
  for (int u = 0; u < image.width(); ++u) {
    std::size_t count = 0;
    for (int v = step / 2; v < image.height() && count < column.size(); v += step) {
      // Quantised pixels have no fine median: the mean of the lower half would lean, that of the middle half does not.
      const LocalLevel here = at({static_cast<double>(u), static_cast<double>(v)});
      column[count++] = static_cast<float>(static_cast<double>(image(u, v)) - here.background_dn);
    }
    std::sort(column.begin(), column.begin() + static_cast<std::ptrdiff_t>(count));
    double sum = 0.0, n = 0.0;
    for (std::size_t i = count / 4; i < count - count / 4; ++i, n += 1.0) sum += static_cast<double>(column[i]);
    const double middle = sum / std::max(1.0, n);
    // The mean of the middle half of 64 scatters by 0.14 of the noise: less than that is nothing.
    columns_[static_cast<std::size_t>(u)] = middle > 0.5 * level_.noise_dn ? static_cast<float>(middle) : 0.0f;
  }
  columned_ = true;
}

Background::Between Background::between(double at, double tile) const {
  const double x = at / tile - 0.5;
  const int node = std::clamp(static_cast<int>(std::floor(x)), 0, kTiles - 2);
  // Half a tile beyond the outermost node and no farther.
  return {node, std::clamp(x - node, -0.5, 1.5)};
}

LocalLevel Background::at(Pixel pixel) const {
  LocalLevel here{.at = pixel, .background_dn = level_.background_dn, .noise_dn = level_.noise_dn};
  if (columned_) here.columns_dn = columns_.data();
  if (!mapped_) return here;
  const Between u = between(pixel.u + 0.5, tile_width_), v = between(pixel.v + 0.5, tile_height_);
  const Node* const top = nodes_.data() + v.node * kTiles + u.node;
  const Node* const bottom = top + kTiles;
  const auto mix = [&](float Node::*value) {
    const double a = static_cast<double>(top[0].*value), b = static_cast<double>(top[1].*value);
    const double c = static_cast<double>(bottom[0].*value), d = static_cast<double>(bottom[1].*value);
    return std::array<double, 3>{(a + u.t * (b - a)) * (1.0 - v.t) + (c + u.t * (d - c)) * v.t,
                                 (b - a) * (1.0 - v.t) + (d - c) * v.t, (c - a) * (1.0 - u.t) + (d - b) * u.t};
  };
  const auto background = mix(&Node::background);
  here.background_dn = background[0];
  here.slope_u_dn = background[1] / tile_width_;
  here.slope_v_dn = background[2] / tile_height_;
  // Beyond the outermost nodes the line may lead below nothing.
  here.noise_dn = std::max(mix(&Node::noise)[0], 0.5 * static_cast<double>(std::min(top[0].noise, bottom[1].noise)));
  return here;
}

std::span<const float> Background::threshold_row(int v, double sigma, double threshold_dn, int width) const {
  const auto over = [&](const LocalLevel& here) {
    return here.background_dn + (threshold_dn > 0.0 ? threshold_dn : sigma * here.noise_dn);
  };
  const double row = v;
  row_.resize(static_cast<std::size_t>(width));
  if (!mapped_) {
    std::fill_n(row_.begin(), width, static_cast<float>(over(at({0.0, row}))));
  } else {
    // Straight between the nodes' columns.
    int begin = 0;
    for (int node = 0; node + 1 < kTiles; ++node) {
      const double left = (node + 0.5) * tile_width_ - 0.5, right = left + tile_width_;
      const int end = node + 2 == kTiles ? width : std::min(width, static_cast<int>(std::ceil(right)));
      const double at_left = over(at({left, row})), slope = (over(at({right, row})) - at_left) / tile_width_;
      for (int u = begin; u < end; ++u)
        row_[static_cast<std::size_t>(u)] = static_cast<float>(at_left + slope * (u - left));
      begin = end;
    }
  }
  if (columned_) {
    for (int u = 0; u < width; ++u) row_[static_cast<std::size_t>(u)] += columns_[static_cast<std::size_t>(u)];
  }
  return {row_.data(), static_cast<std::size_t>(width)};
}

#define ASTRONAV_BACKGROUND_OF(T)                                              \
  template FrameLevel Background::measure<T>(ImageView<const T>, std::size_t); \
  template void Background::measure_columns<T>(ImageView<const T>);
ASTRONAV_BACKGROUND_OF(std::uint8_t)
ASTRONAV_BACKGROUND_OF(std::uint16_t)
ASTRONAV_BACKGROUND_OF(float)
#undef ASTRONAV_BACKGROUND_OF

}  // namespace astronav::vision
