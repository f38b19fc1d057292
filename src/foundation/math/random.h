// SPDX-License-Identifier: Apache-2.0
// Named random streams: a draw depends on (seed, sample, image, purpose) alone, never on threads, shards or order.
//
//   RandomStream noise(StreamId{.seed = 1, .sample = 3, .image = 1200, .purpose = "read noise"});
//
// The generator is xoshiro256++ (Blackman & Vigna 2021), its state filled by SplitMix64 from a hash of the name.
#pragma once

#include <array>
#include <cstdint>
#include <string_view>

namespace astronav {

struct StreamId {
  std::uint64_t seed = 1;
  std::uint64_t sample = 0;
  std::uint64_t image = 0;
  std::string_view purpose;
};

class RandomStream {
 public:
  using result_type = std::uint64_t;  // a UniformRandomBitGenerator, for what the standard library offers

  explicit RandomStream(const StreamId& id);

  static constexpr std::uint64_t min() { return 0; }
  static constexpr std::uint64_t max() { return ~std::uint64_t{0}; }
  std::uint64_t operator()() { return next(); }

  std::uint64_t next() {
    const std::uint64_t result = rotl(s_[0] + s_[3], 23) + s_[0];
    const std::uint64_t t = s_[1] << 17;
    s_[2] ^= s_[0];
    s_[3] ^= s_[1];
    s_[1] ^= s_[2];
    s_[0] ^= s_[3];
    s_[2] ^= t;
    s_[3] = rotl(s_[3], 45);
    return result;
  }

  // In [0, 1), 53 bits.
  double uniform() { return static_cast<double>(next() >> 11) * 0x1.0p-53; }
  double uniform(double min, double max) { return min + (max - min) * uniform(); }
  // Standard normal (Marsaglia's polar method).
  double normal();
  double normal(double mean, double sigma) { return mean + sigma * normal(); }
  // Poisson with the given mean, exact at every mean (inversion below 10, Hormann's PTRS 1993 above).
  std::uint64_t poisson(double mean);

 private:
  static std::uint64_t rotl(std::uint64_t x, int k) { return (x << k) | (x >> (64 - k)); }
  std::array<std::uint64_t, 4> s_{};
  double spare_ = 0.0;
  bool has_spare_ = false;
};

}  // namespace astronav
