// SPDX-License-Identifier: Apache-2.0
// The layout of a star catalogue file (docs/formats.md), shared by reader and writer. Little-endian.
#pragma once

#include <bit>
#include <cstddef>
#include <cstdint>
#include <span>

namespace astronav::star_file {

static_assert(std::endian::native == std::endian::little, "catalogue files are read in place");

inline constexpr char kMagic[8] = {'A', 'N', 'A', 'V', 'S', 'T', 'A', 'R'};
inline constexpr std::uint32_t kVersion = 1;
inline constexpr double kEpochYear = 2000.0;
inline constexpr double kDirectionScale = 2147483647.0;
inline constexpr double kMotionUnitMas = 0.01;    // mas/yr
inline constexpr double kParallaxUnitMas = 0.01;  // mas
inline constexpr double kMagnitudeUnit = 0.001;
inline constexpr std::int16_t kUnknownColour = -32768;
inline constexpr std::size_t kChecksummedFrom = 16;

struct Header {
  char magic[8];
  std::uint32_t version;
  std::uint32_t crc32;  // of everything from byte 16 to the end
  std::uint32_t star_count;
  std::uint32_t cell_count;
  double epoch_year;
  char source[32];
};
static_assert(sizeof(Header) == 64);

// A cell is the stars [first, first + count), bright first, all of them inside the cap about `center`.
struct Cell {
  double center[3];
  double cos_radius;
  double sin_radius;
  std::uint32_t first;
  std::uint32_t count;
};
static_assert(sizeof(Cell) == 48);

struct Record {
  std::uint32_t id;
  std::int32_t direction[3];
  std::int32_t pm_ra_cosdec;
  std::int32_t pm_dec;
  std::int32_t parallax;
  std::int16_t v;
  std::int16_t b_v;
};
static_assert(sizeof(Record) == 32);

// CRC-32 of IEEE 802.3 (reflected, 0xEDB88320), the one of zlib and PNG.
std::uint32_t crc32(std::span<const std::byte> bytes);

}  // namespace astronav::star_file
