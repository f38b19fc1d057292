// SPDX-License-Identifier: Apache-2.0
// The DAF container of SPK kernels, after NAIF's "DAF Required Reading": records of 1024 bytes, words of 8 bytes.
// Private to this folder.
#pragma once

#include <bit>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <span>
#include <vector>

#include "foundation/base/error.h"
#include "models/ephemeris/ephemeris.h"

namespace astronav::daf {

inline constexpr std::size_t kWordBytes = 8;

template <bool Swap>
double load_double(const std::byte* at) {
  std::uint64_t bits;
  std::memcpy(&bits, at, sizeof bits);
  if constexpr (Swap) bits = __builtin_bswap64(bits);
  return std::bit_cast<double>(bits);
}
inline double load_double(const std::byte* at, bool swap) {
  return swap ? load_double<true>(at) : load_double<false>(at);
}

inline tl::unexpected<Error> corrupt(const char* text, std::size_t byte, double number = 0.0, double number2 = 0.0) {
  return fail(ErrorCode::corrupt_data, text, {static_cast<double>(byte), number, number2, 0.0});
}

// A whole number held in a double, as DAF and SPK hold counts.
inline bool is_count(double value, double min, double max) {
  return value >= min && value <= max && value == std::floor(value);
}

// Appends what a kernel's summaries list. Every address is checked against the file's size.
Result<void> read_segments(std::span<const std::byte> file, int kernel, std::vector<Ephemeris::Segment>& segments);

}  // namespace astronav::daf
