// SPDX-License-Identifier: Apache-2.0
#include "models/stars/catalogue.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>

#include "foundation/base/check.h"
#include "models/stars/format.h"

namespace astronav {
namespace {

using star_file::Cell;
using star_file::Header;
using star_file::Record;

// Rounding of the file's numbers: half a unit of 1/(2^31 - 1) in each component, and then some.
constexpr double kDirectionRounding = 1e-9;

// The bytes may lie at any address.
template <typename T>
T read(std::span<const std::byte> bytes, std::size_t offset) {
  T value;
  std::memcpy(&value, bytes.data() + offset, sizeof(T));
  return value;
}

Vec3 center(const Cell& cell) {
  return {cell.center[0], cell.center[1], cell.center[2]};
}
Vec3 scaled_direction(const Record& r) {
  return {static_cast<double>(r.direction[0]), static_cast<double>(r.direction[1]),
          static_cast<double>(r.direction[2])};
}

Star decode(const Record& record) {
  Star star;
  star.id = record.id;
  // One step of Newton's method: the rounded vector's length is off by less than 1e-9.
  const Vec3 d = scaled_direction(record) / star_file::kDirectionScale;
  star.direction_N = d * (1.5 - 0.5 * d.squaredNorm());
  star.pm_ra_cosdec_rad_yr = record.pm_ra_cosdec * (star_file::kMotionUnitMas * kMilliarcsecond);
  star.pm_dec_rad_yr = record.pm_dec * (star_file::kMotionUnitMas * kMilliarcsecond);
  star.parallax_rad = record.parallax * (star_file::kParallaxUnitMas * kMilliarcsecond);
  star.v_mag = static_cast<float>(record.v * star_file::kMagnitudeUnit);
  star.b_v = record.b_v == star_file::kUnknownColour ? std::numeric_limits<float>::quiet_NaN()
                                                     : static_cast<float>(record.b_v * star_file::kMagnitudeUnit);
  return star;
}

std::size_t cell_offset(std::size_t cell) {
  return sizeof(Header) + cell * sizeof(Cell);
}
std::size_t record_offset(std::size_t cells, std::size_t star) {
  return cell_offset(cells) + star * sizeof(Record);
}

Result<Header> check_header(std::span<const std::byte> file) {
  if (file.size() < sizeof(Header)) {
    return fail(ErrorCode::corrupt_data, "a star catalogue begins with {0} bytes of header, but only {1} are there",
                {sizeof(Header), static_cast<double>(file.size())});
  }
  const auto header = read<Header>(file, 0);
  if (std::memcmp(header.magic, star_file::kMagic, sizeof(header.magic)) != 0) {
    return fail(ErrorCode::corrupt_data, "not a star catalogue: byte 0 does not begin with \"ANAVSTAR\"");
  }
  if (header.version != star_file::kVersion) {
    return fail(ErrorCode::unsupported, "star catalogue of version {0} at byte 8; version {1} is read here",
                {static_cast<double>(header.version), static_cast<double>(star_file::kVersion)});
  }
  const std::uint64_t expected = sizeof(Header) + std::uint64_t{header.cell_count} * sizeof(Cell) +
                                 std::uint64_t{header.star_count} * sizeof(Record);
  if (expected != file.size()) {
    return fail(ErrorCode::corrupt_data,
                "{0} stars (byte 16) in {1} cells (byte 20) make a file of {2} bytes, but it has {3}",
                {static_cast<double>(header.star_count), static_cast<double>(header.cell_count),
                 static_cast<double>(expected), static_cast<double>(file.size())});
  }
  if (star_file::crc32(file.subspan(star_file::kChecksummedFrom)) != header.crc32) {
    return fail(ErrorCode::corrupt_data, "the checksum at byte 12 is not that of bytes {0} to {1}",
                {star_file::kChecksummedFrom, static_cast<double>(file.size() - 1)});
  }
  if (header.epoch_year != star_file::kEpochYear) {
    return fail(ErrorCode::unsupported, "star catalogue of epoch {0} at byte 24; J{1} is read here",
                {header.epoch_year, star_file::kEpochYear});
  }
  return header;
}

// Every comparison is written so that a NaN fails it.
Result<void> check_cell(std::span<const std::byte> file, const Header& header, std::size_t index,
                        std::uint64_t expected_first) {
  const std::size_t offset = cell_offset(index);
  const auto cell = read<Cell>(file, offset);
  const bool unit_center = std::abs(center(cell).squaredNorm() - 1.0) < 1e-12;
  const bool unit_radius =
      std::abs(cell.cos_radius * cell.cos_radius + cell.sin_radius * cell.sin_radius - 1.0) < 1e-12 &&
      cell.sin_radius >= 0;
  if (!unit_center || !unit_radius) {
    return fail(ErrorCode::corrupt_data, "the cell at byte {0} is not a cap of the sphere",
                {static_cast<double>(offset)});
  }
  if (cell.first != expected_first || cell.count > header.star_count - expected_first) {
    return fail(ErrorCode::corrupt_data, "the cell at byte {0} holds stars {1} to {2}, but should begin at {3}",
                {static_cast<double>(offset), static_cast<double>(cell.first),
                 static_cast<double>(cell.first) + cell.count - 1.0, static_cast<double>(expected_first)});
  }
  std::int16_t previous_v = std::numeric_limits<std::int16_t>::min();
  for (std::size_t i = cell.first; i < std::size_t{cell.first} + cell.count; ++i) {
    const std::size_t at = record_offset(header.cell_count, i);
    const auto record = read<Record>(file, at);
    const Vec3 direction = scaled_direction(record) / star_file::kDirectionScale;
    const char* complaint = nullptr;
    if (!(std::abs(direction.squaredNorm() - 1.0) < 4 * kDirectionRounding)) {
      complaint = "the star at byte {0} has no unit vector for its direction";
    } else if (!(direction.dot(center(cell)) >= cell.cos_radius - kDirectionRounding)) {
      complaint = "the star at byte {0} lies outside its cell";
    } else if (record.v < previous_v) {
      complaint = "the star at byte {0} is brighter than the one before it in its cell";
    }
    if (complaint != nullptr) return fail(ErrorCode::corrupt_data, complaint, {static_cast<double>(at)});
    previous_v = record.v;
  }
  return {};
}

}  // namespace

Result<StarCatalogue> StarCatalogue::open(std::span<const std::byte> file) {
  const Result<Header> header = check_header(file);
  if (!header) return forward(header);
  std::uint64_t first = 0;
  for (std::size_t i = 0; i < header->cell_count; ++i) {
    if (const Result<void> cell = check_cell(file, *header, i, first); !cell) return forward(cell);
    first += read<Cell>(file, cell_offset(i)).count;
  }
  if (first != header->star_count) {
    return fail(ErrorCode::corrupt_data, "the cells hold {0} stars, but the header at byte 16 says {1}",
                {static_cast<double>(first), static_cast<double>(header->star_count)});
  }
  StarCatalogue catalogue;
  catalogue.bytes_ = file;
  catalogue.cell_count_ = header->cell_count;
  catalogue.size_ = header->star_count;
  return catalogue;
}

std::string_view StarCatalogue::source() const {
  if (bytes_.empty()) return {};
  const char* text = reinterpret_cast<const char*>(bytes_.data()) + offsetof(Header, source);
  return {text, strnlen(text, sizeof(Header::source))};
}

Star StarCatalogue::star(std::size_t index) const {
  ASTRONAV_CHECK_OP(index, <, size_);
  return decode(read<Record>(bytes_, record_offset(cell_count_, index)));
}

std::optional<std::size_t> StarCatalogue::find(std::uint32_t id) const {
  for (std::size_t i = 0; i < size_; ++i) {
    if (read<std::uint32_t>(bytes_, record_offset(cell_count_, i) + offsetof(Record, id)) == id) return i;
  }
  return std::nullopt;
}

template <typename Take>
std::size_t StarCatalogue::search(const Vec3& center_N, double radius_rad, double max_v_mag, Take&& take) const {
  const double radius = std::clamp(radius_rad, 0.0, kPi);
  const double cos_radius = std::cos(radius);
  const double sin_radius = std::sin(radius);
  // Chords instead of cosines: they keep their precision for small radii.
  const double max_chord = 2.0 * std::sin(0.5 * radius) * star_file::kDirectionScale;
  const double max_chord2 = max_chord * max_chord;
  const Vec3 scaled_center = center_N * star_file::kDirectionScale;
  const double faintest = max_v_mag / star_file::kMagnitudeUnit + 1e-6;  // in the file's unit; 1e-6 for 7.000 itself

  std::size_t found = 0;
  for (std::size_t i = 0; i < cell_count_; ++i) {
    const auto cell = read<Cell>(bytes_, cell_offset(i));
    // Beyond the sum of both radii nothing can be shared, unless the sum goes around the sphere.
    const double cos_sum = cos_radius * cell.cos_radius - sin_radius * cell.sin_radius;
    const bool around = sin_radius * cell.cos_radius + cos_radius * cell.sin_radius < 0.0;
    if (!around && center_N.dot(center(cell)) < cos_sum - 2 * kDirectionRounding) continue;
    const std::byte* at = bytes_.data() + record_offset(cell_count_, cell.first);
    for (std::uint32_t k = 0; k < cell.count; ++k, at += sizeof(Record)) {
      Record record;
      std::memcpy(&record, at, sizeof(record));
      if (record.v > faintest) break;
      if ((scaled_direction(record) - scaled_center).squaredNorm() > max_chord2) continue;
      take(found++, cell.first + k, record);
    }
  }
  return found;
}

std::size_t StarCatalogue::cone(const Vec3& center_N, double radius_rad, double max_v_mag,
                                std::span<std::uint32_t> out) const {
  return search(center_N, radius_rad, max_v_mag, [&](std::size_t n, std::uint32_t index, const Record&) {
    if (n < out.size()) out[n] = index;
  });
}

std::size_t StarCatalogue::stars_in_cone(const Vec3& center_N, double radius_rad, double max_v_mag,
                                         std::span<Star> out) const {
  return search(center_N, radius_rad, max_v_mag, [&](std::size_t n, std::uint32_t, const Record& record) {
    if (n < out.size()) out[n] = decode(record);
  });
}

Vec3 star_direction(const Star& star, Epoch epoch, const Vec3& p_observer_O_N) {
  return StarPlaces(epoch, p_observer_O_N).direction(star);
}

}  // namespace astronav
