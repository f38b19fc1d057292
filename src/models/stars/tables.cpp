// SPDX-License-Identifier: Apache-2.0
#include "models/stars/tables.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstring>
#include <limits>
#include <optional>
#include <string>
#include <unordered_set>
#include <utility>

#include "foundation/math/rotation.h"
#include "models/stars/astrometry_index.h"
#include "models/stars/format.h"
#include "models/stars/gzip.h"

namespace astronav {
namespace {

constexpr double kHipparcosEpoch = 1991.25;
constexpr std::uint32_t kFirstRunningNumber = 1'000'000'000;

std::string_view trim(std::string_view s) {
  const std::size_t first = s.find_first_not_of(" \r");
  if (first == std::string_view::npos) return {};
  return s.substr(first, s.find_last_not_of(" \r") - first + 1);
}

std::vector<std::string_view> split(std::string_view line) {
  std::vector<std::string_view> fields;
  for (std::size_t begin = 0;;) {
    const std::size_t end = line.find('|', begin);
    fields.push_back(line.substr(begin, end - begin));
    if (end == std::string_view::npos) return fields;
    begin = end + 1;
  }
}

// What a line says of one star. Reading a field that is not a number within its bounds makes the line bad.
class Line {
 public:
  explicit Line(std::string_view text) : fields_(split(text)) {}

  std::size_t size() const { return fields_.size(); }
  std::string_view field(std::size_t i) const { return trim(fields_[i]); }
  // The field numbered `field`, empty if it is blank.
  std::optional<double> number(std::size_t field, double min, double max) {
    return parse(fields_[field], field, min, max);
  }
  std::optional<double> parse(std::string_view text, std::size_t field, double min, double max) {
    text = trim(text);
    if (text.empty()) return std::nullopt;
    if (text.front() == '+') text.remove_prefix(1);
    double value = 0.0;
    const auto [end, code] = std::from_chars(text.data(), text.data() + text.size(), value);
    if (code != std::errc{} || end != text.data() + text.size() || !(value >= min && value <= max)) {
      if (!bad_field_) bad_field_ = field;
      return std::nullopt;
    }
    return value;
  }
  std::optional<std::size_t> bad_field() const { return bad_field_; }

 private:
  std::vector<std::string_view> fields_;
  std::optional<std::size_t> bad_field_;
};

// "HH MM SS.SS" or "+DD MM SS.S" in hours or degrees.
std::optional<double> sexagesimal(Line& line, std::size_t field, double max) {
  std::string_view text = line.field(field);
  if (text.empty()) return std::nullopt;
  const bool negative = text.front() == '-';
  if (negative || text.front() == '+') text.remove_prefix(1);
  const std::size_t first = std::min(text.find(' '), text.size());
  const std::size_t second = std::min(text.find(' ', first + 1), text.size());
  const auto whole = line.parse(text.substr(0, first), field, 0, max);
  const auto minutes = line.parse(text.substr(first, second - first), field, 0, 60);
  const auto seconds = line.parse(text.substr(second), field, 0, 60);
  if (!whole || !minutes || !seconds) return std::nullopt;
  return (negative ? -1.0 : 1.0) * (*whole + *minutes / 60.0 + *seconds / 3600.0);
}

// Moves a star uniformly in space; its proper motion turns with it.
void advance(Star& star, double years) {
  const auto [east, north] = east_north(star.direction_N);
  const Vec3 motion = star.pm_ra_cosdec_rad_yr * east + star.pm_dec_rad_yr * north;
  const Vec3 moved = star.direction_N + motion * years;
  const double distance = moved.norm();
  star.direction_N = moved / distance;
  const auto [new_east, new_north] = east_north(star.direction_N);
  star.pm_ra_cosdec_rad_yr = motion.dot(new_east) / distance;
  star.pm_dec_rad_yr = motion.dot(new_north) / distance;
}

// Fields H1, H3.. of the Hipparcos catalogue's documentation are numbered as here.
constexpr std::size_t kHipparcosFields = 78;
std::optional<Star> hipparcos_star(Line& line) {
  const auto hip = line.number(1, 1, 999'999);
  const auto v = line.number(5, -5, 30);
  auto ra_deg = line.number(8, 0, 360);
  auto dec_deg = line.number(9, -90, 90);
  const auto parallax_mas = line.number(11, -1e4, 1e4);
  const auto pm_ra = line.number(12, -1e5, 1e5);
  const auto pm_dec = line.number(13, -1e5, 1e5);
  const auto b_v = line.number(37, -5, 20);
  if (!ra_deg || !dec_deg) {
    const auto hours = sexagesimal(line, 3, 24);
    dec_deg = sexagesimal(line, 4, 90);
    if (hours) ra_deg = *hours * 15.0;
  }
  if (!hip || !v || !ra_deg || !dec_deg) return std::nullopt;
  Star star;
  star.id = static_cast<std::uint32_t>(*hip);
  star.direction_N = direction_from_radec(*ra_deg * kDegree, *dec_deg * kDegree);
  star.pm_ra_cosdec_rad_yr = pm_ra.value_or(0.0) * kMilliarcsecond;
  star.pm_dec_rad_yr = pm_dec.value_or(0.0) * kMilliarcsecond;
  star.parallax_rad = parallax_mas.value_or(0.0) * kMilliarcsecond;
  star.v_mag = static_cast<float>(*v);
  star.b_v = b_v ? static_cast<float>(*b_v) : std::numeric_limits<float>::quiet_NaN();
  advance(star, 2000.0 - kHipparcosEpoch);
  return star;
}

// Fields in the order of the "Byte-by-byte description" of tyc2.dat, from 0.
constexpr std::size_t kTycho2Fields = 32;
std::optional<Star> tycho2_star(Line& line) {
  auto ra_deg = line.number(2, 0, 360);
  auto dec_deg = line.number(3, -90, 90);
  const auto pm_ra = line.number(4, -1e5, 1e5);
  const auto pm_dec = line.number(5, -1e5, 1e5);
  const auto bt = line.number(17, -5, 30);
  const auto vt = line.number(19, -5, 30);
  const auto hip = line.parse(line.field(23).substr(0, line.field(23).find_first_not_of("0123456789")), 23, 1, 999'999);
  if (!ra_deg || !dec_deg) {
    ra_deg = line.number(24, 0, 360);
    dec_deg = line.number(25, -90, 90);
  }
  if (!ra_deg || !dec_deg || !vt) return std::nullopt;
  Star star;
  star.id = static_cast<std::uint32_t>(hip.value_or(0.0));
  star.direction_N = direction_from_radec(*ra_deg * kDegree, *dec_deg * kDegree);
  star.pm_ra_cosdec_rad_yr = pm_ra.value_or(0.0) * kMilliarcsecond;
  star.pm_dec_rad_yr = pm_dec.value_or(0.0) * kMilliarcsecond;
  star.v_mag = static_cast<float>(bt ? *vt - 0.090 * (*bt - *vt) : *vt);
  star.b_v = bt ? static_cast<float>(0.850 * (*bt - *vt)) : std::numeric_limits<float>::quiet_NaN();
  return star;
}

// Where stars stand, for asking whether one of them is the star at another place.
constexpr float kCompleteToV = 7.0f;  // Hipparcos is complete to 7.3 or fainter
constexpr double kSamePlace = 10.0 * kArcsecond;
constexpr double kYearsAstray = 10.0;

class Neighbourhood {
 public:
  explicit Neighbourhood(std::span<const Star> stars) : stars_(stars) {
    for (std::uint32_t i = 0; i < stars.size(); ++i) {
      // In every cell that the star's surroundings touch.
      const double reach = reach_of(stars[i]);
      const Vec3& d = stars[i].direction_N;
      const auto low = [&](int k) { return cell(d[k] - reach); };
      const auto high = [&](int k) { return cell(d[k] + reach); };
      for (std::uint64_t x = low(0); x <= high(0); ++x)
        for (std::uint64_t y = low(1); y <= high(1); ++y)
          for (std::uint64_t z = low(2); z <= high(2); ++z) entries_.push_back({key(x, y, z), i});
    }
    std::sort(entries_.begin(), entries_.end());
  }
  bool holds(const Vec3& d) const {
    const std::uint64_t wanted = key(cell(d.x()), cell(d.y()), cell(d.z()));
    for (auto at = std::lower_bound(entries_.begin(), entries_.end(), std::pair{wanted, std::uint32_t{0}});
         at != entries_.end() && at->first == wanted; ++at) {
      const Star& star = stars_[at->second];
      if ((star.direction_N - d).norm() < reach_of(star)) return true;
    }
    return false;
  }

 private:
  static constexpr double kCellsPerUnit = 1000.0;  // 206 arcsec
  static std::uint64_t cell(double x) { return static_cast<std::uint64_t>((x + 1.5) * kCellsPerUnit); }
  static std::uint64_t key(std::uint64_t x, std::uint64_t y, std::uint64_t z) { return x << 40 | y << 20 | z; }
  static double reach_of(const Star& star) {
    return kSamePlace + kYearsAstray * std::hypot(star.pm_ra_cosdec_rad_yr, star.pm_dec_rad_yr);
  }
  std::span<const Star> stars_;
  std::vector<std::pair<std::uint64_t, std::uint32_t>> entries_;
};

std::optional<StarTableKind> kind_of(std::string_view first_line) {
  const Line line(first_line);
  if (line.size() == kHipparcosFields && line.field(0) == "H") return StarTableKind::hipparcos;
  if (line.size() == kTycho2Fields) return StarTableKind::tycho2;
  return std::nullopt;
}

Result<StarTable> read_lines(std::string_view text) {
  const auto kind = kind_of(text.substr(0, text.find('\n')));
  if (!kind) {
    return fail(ErrorCode::unsupported,
                "neither a Hipparcos main table ({0} fields separated by '|', the first of them 'H') nor Tycho-2 ({1} "
                "fields), a "
                "FITS index of astrometry.net or a catalogue file",
                {kHipparcosFields, kTycho2Fields}, "line 1");
  }
  StarTable table;
  table.kind = *kind;
  const std::size_t fields = *kind == StarTableKind::hipparcos ? kHipparcosFields : kTycho2Fields;
  std::size_t number = 0;
  while (!text.empty()) {
    const std::size_t end = std::min(text.find('\n'), text.size());
    const std::string_view row = text.substr(0, end);
    text.remove_prefix(std::min(end + 1, text.size()));
    ++number;
    if (trim(row).empty()) continue;
    Line line(row);
    const std::string where = "line " + std::to_string(number);
    if (line.size() != fields) {
      return fail(ErrorCode::corrupt_data, "{0} fields where this table has {1}",
                  {static_cast<double>(line.size()), static_cast<double>(fields)}, where);
    }
    const auto star = *kind == StarTableKind::hipparcos ? hipparcos_star(line) : tycho2_star(line);
    if (line.bad_field()) {
      return fail(ErrorCode::corrupt_data, "field {0} is \"{s}\", which is no number in its range",
                  {static_cast<double>(*line.bad_field())}, where, line.field(*line.bad_field()));
    }
    if (star) {
      table.stars.push_back(*star);
    } else {
      ++table.skipped;
    }
  }
  return table;
}

}  // namespace

std::string_view name(StarTableKind kind) {
  switch (kind) {
    case StarTableKind::hipparcos:
      return "Hipparcos";
    case StarTableKind::catalogue:
      return "catalogue";
    case StarTableKind::tycho2:
    case StarTableKind::tycho2_index:
      break;
  }
  return "Tycho-2";
}

Result<StarTable> read_star_table(std::span<const std::byte> table) {
  if (is_fits(table)) {
    auto stars = read_astrometry_index(table);
    if (!stars) return forward(stars);
    return StarTable{StarTableKind::tycho2_index, std::move(*stars), 0};
  }
  if (table.size() >= sizeof star_file::kMagic &&
      std::memcmp(table.data(), star_file::kMagic, sizeof star_file::kMagic) == 0) {
    const auto catalogue = StarCatalogue::open(table);
    if (!catalogue) return forward(catalogue);
    StarTable out{StarTableKind::catalogue, {}, 0};
    for (std::size_t i = 0; i < catalogue->size(); ++i) out.stars.push_back(catalogue->star(i));
    return out;
  }
  if (!is_gzip(table)) return read_lines({reinterpret_cast<const char*>(table.data()), table.size()});
  const Result<std::string> text = gunzip(table);
  if (!text) return forward(text);
  return read_lines(*text);
}

std::vector<Star> merge_star_tables(std::span<const StarTable> tables) {
  std::vector<Star> stars;
  std::unordered_set<std::uint32_t> taken;
  const auto leads = [](const StarTable& t) {
    return t.kind == StarTableKind::hipparcos || t.kind == StarTableKind::catalogue;
  };
  for (const StarTable& table : tables) {
    if (!leads(table)) continue;
    for (const Star& star : table.stars) {
      if (taken.insert(star.id).second) stars.push_back(star);
    }
  }
  const std::unordered_set<std::uint32_t> in_hipparcos = taken;
  std::uint32_t running = kFirstRunningNumber;
  const auto add = [&](Star star) {
    while (star.id == 0 || !taken.insert(star.id).second) star.id = running++;
    stars.push_back(star);
  };
  for (const StarTable& table : tables) {
    if (table.kind != StarTableKind::tycho2) continue;
    for (const Star& star : table.stars) {
      if (!in_hipparcos.contains(star.id)) add(star);
    }
  }
  for (const StarTable& table : tables) {
    if (table.kind != StarTableKind::tycho2_index) continue;
    const std::vector<Star> before = stars;  // `stars` grows
    const Neighbourhood others(before);
    for (const Star& star : table.stars) {
      if (star.v_mag >= kCompleteToV && !others.holds(star.direction_N)) add(star);
    }
  }
  return stars;
}

}  // namespace astronav
