// SPDX-License-Identifier: Apache-2.0
#include "models/stars/astrometry_index.h"

#include <bit>
#include <charconv>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <limits>
#include <optional>
#include <string_view>

namespace astronav {
namespace {

constexpr std::size_t kBlockBytes = 2880;
constexpr std::size_t kCardBytes = 80;
constexpr std::uint32_t kFirstRunningNumber = 1'000'000'000;

tl::unexpected<Error> corrupt(const char* text, std::size_t byte, double number = 0.0, double number2 = 0.0) {
  return fail(ErrorCode::corrupt_data, text, {static_cast<double>(byte), number, number2, 0.0});
}

// What counts in the header of a table.
struct Header {
  std::size_t end = 0;  // where the data begin
  double bitpix = 8.0;
  double axes = 0.0;
  double width = 0.0;
  double rows = 0.0;
  double extra = 0.0;
  std::string_view column;
  std::string_view endian;
};

std::string_view text_value(std::string_view card) {
  const std::size_t first = card.find('\'');
  if (first == std::string_view::npos) return {};
  const std::size_t last = card.find('\'', first + 1);
  std::string_view value = card.substr(first + 1, last == std::string_view::npos ? last : last - first - 1);
  while (value.ends_with(' ')) value.remove_suffix(1);
  return value;
}

double number_value(std::string_view card) {
  std::string_view value = card.substr(10);
  value.remove_prefix(std::min(value.find_first_not_of(' '), value.size()));
  double out = std::numeric_limits<double>::quiet_NaN();
  std::from_chars(value.data(), value.data() + value.size(), out);
  return out;
}

Result<Header> read_header(std::span<const std::byte> file, std::size_t begin) {
  Header header;
  for (std::size_t at = begin; at + kCardBytes <= file.size(); at += kCardBytes) {
    const std::string_view card(reinterpret_cast<const char*>(file.data()) + at, kCardBytes);
    const std::string_view key = card.substr(0, 8);
    if (key == "END     ") {
      header.end = begin + ((at - begin) / kBlockBytes + 1) * kBlockBytes;
      return header;
    }
    if (key == "BITPIX  ") header.bitpix = number_value(card);
    if (key == "NAXIS   ") header.axes = number_value(card);
    if (key == "NAXIS1  ") header.width = number_value(card);
    if (key == "NAXIS2  ") header.rows = number_value(card);
    if (key == "PCOUNT  ") header.extra = number_value(card);
    if (key == "TTYPE1  ") header.column = text_value(card);
    if (key == "ENDIAN  ") header.endian = text_value(card);
  }
  return corrupt("byte {0}: a FITS header without END", begin);
}

bool is_size(double v) {
  return v >= 0.0 && v <= 1e12 && v == std::floor(v);
}

// A table's data, and how wide its rows are.
struct Table {
  std::size_t at = 0;
  std::size_t width = 0;
  std::size_t rows = 0;
};

struct Tables {
  std::optional<Table> range, places, magnitudes;
  bool swap_bytes = false;  // of the tree; FITS columns are big-endian by their own law
};

Result<Tables> find_tables(std::span<const std::byte> file) {
  constexpr bool kLittle = std::endian::native == std::endian::little;
  Tables out;
  std::size_t begin = 0;
  // Every round goes on by a block or more.
  while (begin + kBlockBytes <= file.size()) {
    const auto header = read_header(file, begin);
    if (!header) return forward(header);
    double size = 0.0;
    if (header->axes == 2.0) {
      if (header->bitpix != 8.0 || !is_size(header->width) || !is_size(header->rows) || !is_size(header->extra))
        return fail(ErrorCode::unsupported, "byte {0}: not a binary table of FITS",
                    {static_cast<double>(begin), 0, 0, 0});
      size = header->width * header->rows + header->extra;
    } else if (header->axes != 0.0) {
      return fail(ErrorCode::unsupported, "byte {0}: an image; an index of astrometry.net holds tables only",
                  {static_cast<double>(begin), 0, 0, 0});
    }
    if (static_cast<double>(header->end) + size > static_cast<double>(file.size()))
      return corrupt("byte {0}: {1} bytes of data should follow, but the file ends at {2}", header->end, size,
                     static_cast<double>(file.size()));
    if (!header->endian.empty()) {
      const bool little = header->endian == "04:03:02:01";
      if (!little && header->endian != "01:02:03:04")
        return fail(ErrorCode::unsupported, "byte {0}: byte order '{s}'", {static_cast<double>(begin), 0, 0, 0}, {},
                    header->endian);
      out.swap_bytes = little != kLittle;
    }
    const Table table{header->end, static_cast<std::size_t>(header->width), static_cast<std::size_t>(header->rows)};
    if (header->column == "kdtree_range_stars") out.range = table;
    if (header->column == "kdtree_data_stars") out.places = table;
    if (header->column == "MAG_VT") out.magnitudes = table;
    begin = header->end + (static_cast<std::size_t>(size) + kBlockBytes - 1) / kBlockBytes * kBlockBytes;
  }
  return out;
}

template <typename T>
T load(const std::byte* at, bool swap) {
  std::byte raw[sizeof(T)];
  for (std::size_t i = 0; i < sizeof(T); ++i) raw[i] = at[swap ? sizeof(T) - 1 - i : i];
  return std::bit_cast<T>(raw);
}

}  // namespace

bool is_fits(std::span<const std::byte> bytes) {
  constexpr std::string_view kMagic = "SIMPLE  =";
  return bytes.size() >= kMagic.size() && std::memcmp(bytes.data(), kMagic.data(), kMagic.size()) == 0;
}

Result<std::vector<Star>> read_astrometry_index(std::span<const std::byte> file) {
  const auto tables = find_tables(file);
  if (!tables) return forward(tables);
  if (!tables->range || !tables->places || !tables->magnitudes)
    return fail(ErrorCode::unsupported,
                "a FITS file, but no index of astrometry.net with the magnitudes of Tycho-2 (table '{s}' is missing)",
                {}, {}, !tables->range ? "kdtree_range_stars" : (!tables->places ? "kdtree_data_stars" : "MAG_VT"));
  const Table &range = *tables->range, &places = *tables->places, &magnitudes = *tables->magnitudes;
  if (range.width != 8 || range.rows != 7 || places.width != 12 || magnitudes.width != 4 ||
      places.rows != magnitudes.rows || places.rows > kFirstRunningNumber)
    return corrupt("byte {0}: {1} places and {2} magnitudes do not belong together", places.at,
                   static_cast<double>(places.rows), static_cast<double>(magnitudes.rows));
  double low[3];
  for (std::size_t k = 0; k < 3; ++k) low[k] = load<double>(file.data() + range.at + 8 * k, tables->swap_bytes);
  const double units = load<double>(file.data() + range.at + 48, tables->swap_bytes);
  if (!(units > 0.0)) return corrupt("byte {0}: the scale of the places is {1}", range.at + 48, units);

  constexpr bool kBigEndian = std::endian::native == std::endian::big;
  std::vector<Star> stars;
  stars.reserve(places.rows);
  for (std::size_t i = 0; i < places.rows; ++i) {
    Star star;
    for (std::size_t k = 0; k < 3; ++k) {
      const auto unit = load<std::uint32_t>(file.data() + places.at + 12 * i + 4 * k, tables->swap_bytes);
      star.direction_N[static_cast<Eigen::Index>(k)] = low[k] + unit / units;
    }
    const double length = star.direction_N.norm();
    if (!(std::abs(length - 1.0) < 1e-6))
      return corrupt("byte {0}: the star has no unit vector for its direction", places.at + 12 * i);
    star.direction_N /= length;
    const auto vt = static_cast<double>(load<float>(file.data() + magnitudes.at + 4 * i, !kBigEndian));
    if (!(vt > -5.0 && vt < 30.0)) return corrupt("byte {0}: a magnitude of {1}", magnitudes.at + 4 * i, vt);
    star.id = kFirstRunningNumber + static_cast<std::uint32_t>(i);
    star.v_mag = static_cast<float>(vt - kVtMinusV);
    star.b_v = std::numeric_limits<float>::quiet_NaN();
    stars.push_back(star);
  }
  return stars;
}

}  // namespace astronav
