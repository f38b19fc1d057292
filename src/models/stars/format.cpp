// SPDX-License-Identifier: Apache-2.0
#include "models/stars/format.h"

#include <array>
#include <cstring>

namespace astronav::star_file {
namespace {

// Table k advances the remainder by one byte followed by k zero bytes: eight lookups take eight bytes at once.
constexpr auto kTables = [] {
  std::array<std::array<std::uint32_t, 256>, 8> tables{};
  for (std::uint32_t i = 0; i < 256; ++i) {
    std::uint32_t r = i;
    for (int bit = 0; bit < 8; ++bit) r = (r >> 1) ^ ((r & 1u) != 0 ? 0xEDB88320u : 0u);
    tables[0][i] = r;
  }
  for (std::size_t k = 1; k < tables.size(); ++k) {
    for (std::size_t i = 0; i < 256; ++i) {
      const std::uint32_t r = tables[k - 1][i];
      tables[k][i] = (r >> 8) ^ tables[0][r & 0xFFu];
    }
  }
  return tables;
}();

}  // namespace

std::uint32_t crc32(std::span<const std::byte> bytes) {
  std::uint32_t r = ~0u;
  std::size_t i = 0;
  for (; i + 8 <= bytes.size(); i += 8) {
    std::uint64_t word = 0;
    std::memcpy(&word, bytes.data() + i, 8);
    word ^= r;
    r = 0;
    for (std::size_t k = 0; k < 8; ++k) r ^= kTables[7 - k][(word >> (8 * k)) & 0xFFu];
  }
  for (; i < bytes.size(); ++i) r = (r >> 8) ^ kTables[0][(r ^ std::to_integer<std::uint32_t>(bytes[i])) & 0xFFu];
  return ~r;
}

}  // namespace astronav::star_file
