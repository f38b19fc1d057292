// SPDX-License-Identifier: Apache-2.0
#include "models/stars/writer.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <limits>
#include <tuple>
#include <vector>

#include "models/stars/format.h"

namespace astronav {
namespace {

using star_file::Cell;
using star_file::Header;
using star_file::Record;

// The sky as the six faces of a cube, each split into n x n cells by equal angles.
class CubeGrid {
 public:
  explicit CubeGrid(std::size_t stars)
      : n_(std::clamp(static_cast<int>(std::lround(std::sqrt(static_cast<double>(stars) / kStarsPerN2))), 1, 64)) {}

  std::uint32_t cell(const Vec3& d) const {
    int axis = 0;
    d.cwiseAbs().maxCoeff(&axis);
    const int face = 2 * axis + (d[axis] < 0.0 ? 1 : 0);
    const int i = step(d[(axis + 1) % 3] / std::abs(d[axis]));
    const int j = step(d[(axis + 2) % 3] / std::abs(d[axis]));
    return static_cast<std::uint32_t>((face * n_ + i) * n_ + j);
  }

  Vec3 center(std::uint32_t cell) const {
    const int index = static_cast<int>(cell);
    const int face = index / (n_ * n_);
    Vec3 center;
    center[face / 2] = face % 2 == 0 ? 1.0 : -1.0;
    center[(face / 2 + 1) % 3] = middle(index / n_ % n_);
    center[(face / 2 + 2) % 3] = middle(index % n_);
    return center.normalized();
  }

 private:
  static constexpr double kStarsPerN2 = 1800.0;  // 300 stars a cell on the average

  int step(double t) const {
    return std::clamp(static_cast<int>((std::atan(t) * 4.0 / kPi + 1.0) / 2.0 * n_), 0, n_ - 1);
  }
  double middle(int i) const { return std::tan(((i + 0.5) / n_ * 2.0 - 1.0) * kPi / 4.0); }

  int n_;
};

struct Placed {
  std::uint32_t cell;
  Record record;
};

// Rounds value / unit into an integer field; false where it does not fit (or is no number).
template <typename Integer>
bool quantise(double value, double unit, Integer& field) {
  const double rounded = std::nearbyint(value / unit);
  // The smallest value stands for "unknown" and is never written as a number.
  if (!(std::abs(rounded) <= static_cast<double>(std::numeric_limits<Integer>::max()))) return false;
  field = static_cast<Integer>(rounded);
  return true;
}

Result<Record> encode(const Star& star) {
  Record record{};
  record.id = star.id;
  const Vec3 direction = star.direction_N.normalized();
  bool fits = true;
  for (int k = 0; k < 3; ++k) fits &= quantise(direction[k], 1.0 / star_file::kDirectionScale, record.direction[k]);
  const double motion_unit = star_file::kMotionUnitMas * kMilliarcsecond;
  fits &= quantise(star.pm_ra_cosdec_rad_yr, motion_unit, record.pm_ra_cosdec);
  fits &= quantise(star.pm_dec_rad_yr, motion_unit, record.pm_dec);
  fits &= quantise(star.parallax_rad, star_file::kParallaxUnitMas * kMilliarcsecond, record.parallax);
  fits &= quantise(static_cast<double>(star.v_mag), star_file::kMagnitudeUnit, record.v);
  if (std::isnan(star.b_v)) {
    record.b_v = star_file::kUnknownColour;
  } else {
    fits &= quantise(static_cast<double>(star.b_v), star_file::kMagnitudeUnit, record.b_v);
  }
  if (!fits) {
    return fail(ErrorCode::out_of_range,
                "star {0} has a place, motion, parallax or magnitude that the format cannot hold",
                {static_cast<double>(star.id)});
  }
  return record;
}

Vec3 direction_of(const Record& r) {
  return Vec3(r.direction[0], r.direction[1], r.direction[2]).normalized();
}

template <typename T>
void append(std::string& bytes, const T& value) {
  bytes.append(reinterpret_cast<const char*>(&value), sizeof(T));
}

}  // namespace

Result<std::string> write_star_catalogue(std::span<const Star> stars, std::string_view source) {
  if (stars.size() > std::numeric_limits<std::uint32_t>::max()) {
    return fail(ErrorCode::limit_exceeded, "{0} stars are more than the format can count",
                {static_cast<double>(stars.size())});
  }
  const CubeGrid grid(stars.size());
  std::vector<Placed> placed;
  placed.reserve(stars.size());
  for (const Star& star : stars) {
    const Result<Record> record = encode(star);
    if (!record) return forward(record);
    placed.push_back({grid.cell(star.direction_N), *record});
  }
  std::sort(placed.begin(), placed.end(), [](const Placed& a, const Placed& b) {
    return std::tie(a.cell, a.record.v, a.record.id) < std::tie(b.cell, b.record.v, b.record.id);
  });

  std::string cells;
  std::uint32_t cell_count = 0;
  for (std::size_t first = 0, last = 0; first < placed.size(); first = last) {
    const Vec3 center = grid.center(placed[first].cell);
    double cos_radius = 1.0;
    for (last = first; last < placed.size() && placed[last].cell == placed[first].cell; ++last) {
      cos_radius = std::min(cos_radius, center.dot(direction_of(placed[last].record)));
    }
    cos_radius = std::max(cos_radius - 1e-9, -1.0);  // 1e-9: the rounding of the directions
    append(cells, Cell{.center = {center.x(), center.y(), center.z()},
                       .cos_radius = cos_radius,
                       .sin_radius = std::sqrt(1.0 - cos_radius * cos_radius),
                       .first = static_cast<std::uint32_t>(first),
                       .count = static_cast<std::uint32_t>(last - first)});
    ++cell_count;
  }

  Header header{};
  std::memcpy(header.magic, star_file::kMagic, sizeof(header.magic));
  header.version = star_file::kVersion;
  header.star_count = static_cast<std::uint32_t>(stars.size());
  header.cell_count = cell_count;
  header.epoch_year = star_file::kEpochYear;
  std::memcpy(header.source, source.data(), std::min(source.size(), sizeof(header.source)));
  std::string bytes;
  bytes.reserve(sizeof(Header) + cells.size() + placed.size() * sizeof(Record));
  append(bytes, header);
  bytes += cells;
  for (const Placed& star : placed) append(bytes, star.record);
  const std::uint32_t crc = star_file::crc32(std::as_bytes(std::span(bytes)).subspan(star_file::kChecksummedFrom));
  std::memcpy(bytes.data() + offsetof(Header, crc32), &crc, sizeof(crc));
  return bytes;
}

}  // namespace astronav
