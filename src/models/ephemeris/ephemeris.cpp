// SPDX-License-Identifier: Apache-2.0
#include "models/ephemeris/ephemeris.h"

#include <algorithm>
#include <bit>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <limits>
#include <numeric>

namespace astronav {
namespace {

// ---- DAF: records of 1024 bytes, words of 8 bytes counted from 1 ----

constexpr std::size_t kRecordBytes = 1024;
constexpr std::size_t kWordBytes = 8;
constexpr int kSummaryBytes = 40;  // SPK: ND = 2 doubles, NI = 6 integers
constexpr int kMaxSummaries = 25;  // (1024 - 24) / 40
constexpr int kFrameJ2000 = 1;
constexpr double kEpochLimit = 9.2e9;  // s; an Epoch holds a little more
// Where a transfer in text mode has changed line ends or dropped bits, these bytes show it.
constexpr std::string_view kTransferCheck("FTPSTR:\r:\n:\r\n:\r\0:\x81:\x10\xce:ENDFTP", 28);
constexpr std::size_t kTransferCheckAt = 699;

template <bool Swap>
double load_double(const std::byte* at) {
  std::uint64_t bits;
  std::memcpy(&bits, at, sizeof bits);
  if constexpr (Swap) bits = __builtin_bswap64(bits);
  return std::bit_cast<double>(bits);
}

double load_double(const std::byte* at, bool swap) {
  return swap ? load_double<true>(at) : load_double<false>(at);
}

std::int32_t load_int(const std::byte* at, bool swap) {
  std::uint32_t bits;
  std::memcpy(&bits, at, sizeof bits);
  return static_cast<std::int32_t>(swap ? __builtin_bswap32(bits) : bits);
}

std::string_view text_at(std::span<const std::byte> bytes, std::size_t at, std::size_t count) {
  return {reinterpret_cast<const char*>(bytes.data()) + at, count};
}

tl::unexpected<Error> corrupt(const char* text, std::size_t byte, double number = 0.0, double number2 = 0.0) {
  return fail(ErrorCode::corrupt_data, text, {static_cast<double>(byte), number, number2, 0.0});
}

// A whole number held in a double, as DAF and SPK hold counts.
bool is_count(double value, double min, double max) {
  return value >= min && value <= max && value == std::floor(value);
}

Result<bool> byte_order(std::span<const std::byte> file) {
  constexpr bool kLittle = std::endian::native == std::endian::little;
  if (file.size() < kRecordBytes)
    return fail(ErrorCode::corrupt_data, "is not an SPK kernel: it has {0} bytes, but its first record alone has 1024",
                {static_cast<double>(file.size()), 0, 0, 0});
  const std::string_view id = text_at(file, 0, 8);
  if (id != "DAF/SPK " && id != "NAIF/DAF") {
    if (id.starts_with("DAF/"))
      return fail(ErrorCode::unsupported, "is a DAF file, but not an SPK kernel ('{s}')", {}, {}, id);
    return fail(ErrorCode::corrupt_data, "is not an SPK kernel: byte 0 does not begin with 'DAF/SPK '");
  }
  const std::string_view format = text_at(file, 88, 8);
  bool swap = false;
  if (format == "LTL-IEEE") {
    swap = !kLittle;
  } else if (format == "BIG-IEEE") {
    swap = kLittle;
  } else if (id == "NAIF/DAF") {  // files of before 1994 do not name their byte order
    swap = load_int(file.data() + 8, false) != 2;
  } else {
    return fail(ErrorCode::unsupported, "byte 88: the number format is neither LTL-IEEE nor BIG-IEEE");
  }
  if (load_int(file.data() + 8, swap) != 2 || load_int(file.data() + 12, swap) != 6)
    return corrupt("byte {0}: an SPK kernel has ND = 2 and NI = 6, not {1} and {2}", 8, load_int(file.data() + 8, swap),
                   load_int(file.data() + 12, swap));
  const std::string_view check = text_at(file, kTransferCheckAt, kTransferCheck.size());
  if (check.starts_with("FTPSTR") && check != kTransferCheck)
    return corrupt("byte {0}: the file was damaged by a transfer in text mode", kTransferCheckAt);
  return swap;
}

// Types 2 and 3: MID, RADIUS and the coefficients of each record; INIT, INTLEN, RSIZE and N at the end.
Result<void> read_directory(std::span<const std::byte> file, Ephemeris::Segment& segment) {
  const std::size_t words = (segment.last_byte + 1 - segment.first_byte) / kWordBytes;
  const std::size_t at = segment.last_byte + 1 - 4 * kWordBytes;
  if (words < 4)
    return corrupt("byte {0}: a segment of {1} words has no room for its directory", segment.first_byte,
                   static_cast<double>(words));
  const std::byte* const directory = file.data() + at;
  segment.init_s = load_double(directory, segment.swap_bytes);
  segment.interval_s = load_double(directory + 8, segment.swap_bytes);
  const double record = load_double(directory + 16, segment.swap_bytes);
  const double count = load_double(directory + 24, segment.swap_bytes);
  const double most = static_cast<double>(words);
  const int series = segment.type == 2 ? 3 : 6;
  if (!std::isfinite(segment.init_s)) return corrupt("byte {0}: the first epoch of the records is not a number", at);
  if (!(segment.interval_s > 0.0) || !std::isfinite(segment.interval_s))
    return corrupt("byte {0}: the interval of a record is {1} s", at + 8, segment.interval_s);
  if (!is_count(record, 2 + series, most) || static_cast<std::int64_t>(record - 2) % series != 0)
    return corrupt("byte {0}: a record cannot have {1} words", at + 16, record);
  if (!is_count(count, 1, most) || record * count + 4 != most)
    return corrupt("byte {0}: {1} records do not fill a segment of {2} words", at + 24, count, most);
  segment.record_doubles = static_cast<int>(record);
  segment.record_count = static_cast<int>(count);
  const double slack = 1e-3 * segment.interval_s;
  const double end = segment.init_s + segment.interval_s * count;
  if (segment.begin_tdb_s < segment.init_s - slack || segment.end_tdb_s > end + slack)
    return corrupt("byte {0}: the records end before the time that the segment promises", at);
  return {};
}

Result<void> read_segments(std::span<const std::byte> file, int kernel, std::vector<Ephemeris::Segment>& segments) {
  const auto swapped = byte_order(file);
  if (!swapped) return forward(swapped);
  const bool swap = *swapped;
  const auto whole_records = static_cast<double>(file.size() / kRecordBytes);
  const std::size_t words = file.size() / kWordBytes;

  double record = load_int(file.data() + 76, swap);
  std::size_t named_at = 76;
  for (double visited = 0; record != 0.0; ++visited) {
    if (!is_count(record, 2, whole_records))
      return corrupt("byte {0}: points to a summary record {1}, but the file has {2} whole records", named_at, record,
                     whole_records);
    if (visited >= whole_records) return corrupt("byte {0}: the summary records form a circle", named_at);
    const std::size_t start = (static_cast<std::size_t>(record) - 1) * kRecordBytes;
    const double count = load_double(file.data() + start + 16, swap);
    if (!is_count(count, 0, kMaxSummaries))
      return corrupt("byte {0}: a record cannot hold {1} summaries", start + 16, count);

    for (int i = 0; i < static_cast<int>(count); ++i) {
      const std::size_t at = start + 24 + static_cast<std::size_t>(i * kSummaryBytes);
      const std::byte* const summary = file.data() + at;
      Ephemeris::Segment segment;
      segment.begin_tdb_s = load_double(summary, swap);
      segment.end_tdb_s = load_double(summary + 8, swap);
      segment.target.value = load_int(summary + 16, swap);
      segment.center.value = load_int(summary + 20, swap);
      segment.frame = load_int(summary + 24, swap);
      segment.type = load_int(summary + 28, swap);
      const std::int64_t first_word = load_int(summary + 32, swap);
      const std::int64_t last_word = load_int(summary + 36, swap);
      segment.kernel = kernel;
      segment.swap_bytes = swap;
      if (!std::isfinite(segment.begin_tdb_s) || !std::isfinite(segment.end_tdb_s) ||
          segment.begin_tdb_s > segment.end_tdb_s)
        return corrupt("byte {0}: a segment cannot last from {1} s to {2} s", at, segment.begin_tdb_s,
                       segment.end_tdb_s);
      if (segment.target == segment.center)
        return corrupt("byte {0}: body {1} cannot be its own centre", at + 16, segment.target.value);
      if (first_word <= static_cast<std::int64_t>(kRecordBytes / kWordBytes) || last_word < first_word ||
          static_cast<std::uint64_t>(last_word) > words)
        return corrupt("byte {0}: the segment's words {1} to {2} are not inside the file", at + 32,
                       static_cast<double>(first_word), static_cast<double>(last_word));
      segment.first_byte = static_cast<std::size_t>(first_word - 1) * kWordBytes;
      segment.last_byte = static_cast<std::size_t>(last_word) * kWordBytes - 1;
      if (segment.type == 2 || segment.type == 3) {
        const auto directory = read_directory(file, segment);
        if (!directory) return forward(directory);
      }
      segments.push_back(segment);
    }
    named_at = start;
    record = load_double(file.data() + start, swap);
  }
  return {};
}

// ---- Chebyshev records ----

// Three series and their derivatives by their argument at s in [-1, 1] (Clenshaw's recurrence), added to the sums.
template <bool Swap>
void chebyshev(const std::byte* coefficients, int count, double s, double value[3], double slope[3]) {
  const std::size_t stride = static_cast<std::size_t>(count) * kWordBytes;
  double b1[3] = {}, b2[3] = {}, d1[3] = {}, d2[3] = {};
  const double s2 = 2.0 * s;
  for (int k = count - 1; k > 0; --k) {
    const std::byte* const at = coefficients + static_cast<std::size_t>(k) * kWordBytes;
    for (std::size_t axis = 0; axis < 3; ++axis) {
      const double d0 = 2.0 * b1[axis] + s2 * d1[axis] - d2[axis];
      const double b0 = load_double<Swap>(at + axis * stride) + s2 * b1[axis] - b2[axis];
      d2[axis] = d1[axis];
      d1[axis] = d0;
      b2[axis] = b1[axis];
      b1[axis] = b0;
    }
  }
  for (std::size_t axis = 0; axis < 3; ++axis) {
    value[axis] = load_double<Swap>(coefficients + axis * stride) + s * b1[axis] - b2[axis];
    slope[axis] = b1[axis] + s * d1[axis] - d2[axis];
  }
}

// Text on the stack, cut where it is full: errors must not allocate either.
class Sentence {
 public:
  template <typename... Args>
  void add(const char* format, Args... args) {
    const int n = std::snprintf(text_ + used_, sizeof text_ - used_, format, args...);
    if (n > 0) used_ = std::min(used_ + static_cast<std::size_t>(n), sizeof text_ - 1);
  }
  void add_body(BodyId id) {
    const std::string_view known = body_name(id);
    if (known.empty())
      add("body %d", static_cast<int>(id.value));
    else
      add("%.*s (%d)", static_cast<int>(known.size()), known.data(), static_cast<int>(id.value));
  }
  void add_time(double tdb_s) {
    using namespace std::chrono;
    if (!(std::abs(tdb_s) < kEpochLimit)) return add("%.4g s past J2000", tdb_s);
    const auto since_midnight = static_cast<std::int64_t>(std::floor(tdb_s)) + 43200;
    const auto day = floor<days>(seconds(since_midnight));
    const year_month_day date(sys_days(year(2000) / January / 1) + day);
    const hh_mm_ss time(seconds(since_midnight) - day);
    add("%04d-%02u-%02uT%02d:%02d:%02d", static_cast<int>(date.year()), static_cast<unsigned>(date.month()),
        static_cast<unsigned>(date.day()), static_cast<int>(time.hours().count()),
        static_cast<int>(time.minutes().count()), static_cast<int>(time.seconds().count()));
  }
  std::string_view view() const { return {text_, used_}; }

 private:
  char text_[200] = {};
  std::size_t used_ = 0;
};

}  // namespace

Result<Ephemeris> Ephemeris::open(std::span<const std::byte> kernel) {
  return open(std::span(&kernel, 1));
}

Result<Ephemeris> Ephemeris::open(std::span<const std::span<const std::byte>> kernels) {
  Ephemeris out;
  out.kernels_.assign(kernels.begin(), kernels.end());
  for (std::size_t i = 0; i < kernels.size(); ++i) {
    const auto read = read_segments(kernels[i], static_cast<int>(i), out.segments_);
    if (read) continue;
    Sentence place;
    place.add("kernel %zu", i);
    return kernels.size() > 1 ? forward(read, place.view()) : forward(read);
  }
  out.by_target_.resize(out.segments_.size());
  std::iota(out.by_target_.begin(), out.by_target_.end(), 0U);
  std::sort(out.by_target_.begin(), out.by_target_.end(), [&](std::uint32_t a, std::uint32_t b) {
    const auto ta = out.segments_[a].target, tb = out.segments_[b].target;
    return ta != tb ? ta < tb : a > b;
  });
  for (std::uint32_t i = 0; i < out.by_target_.size(); ++i) {
    const Segment& segment = out.segments_[out.by_target_[i]];
    if (out.bodies_.empty() || out.bodies_.back().target != segment.target.value)
      out.bodies_.push_back({segment.target.value, i, 0});
    ++out.bodies_.back().count;
    out.centers_.push_back(segment.center.value);
  }
  std::sort(out.centers_.begin(), out.centers_.end());
  out.centers_.erase(std::unique(out.centers_.begin(), out.centers_.end()), out.centers_.end());
  return out;
}

const Ephemeris::Bodies* Ephemeris::find(std::int32_t target) const {
  const auto at = std::lower_bound(bodies_.begin(), bodies_.end(), target,
                                   [](const Bodies& bodies, std::int32_t id) { return bodies.target < id; });
  return at != bodies_.end() && at->target == target ? &*at : nullptr;
}

Result<BodyId> Ephemeris::resolve(BodyId id) const {
  const auto held = [&](BodyId b) {
    return find(b.value) != nullptr || std::binary_search(centers_.begin(), centers_.end(), b.value);
  };
  if (held(id)) return id;
  const auto stand_in = barycenter_of(id);
  if (stand_in && held(*stand_in)) return *stand_in;
  const auto other = other_number(id);
  if (other && held(*other)) return *other;
  Sentence who;
  who.add_body(id);
  return fail(ErrorCode::not_found, "no kernel holds {s}", {}, {}, who.view());
}

Result<Ephemeris::Span> Ephemeris::span(BodyId id) const {
  const auto used = resolve(id);
  if (!used) return forward(used);
  double begin = kEpochLimit, end = -kEpochLimit;
  if (const Bodies* const bodies = find(used->value)) {
    for (std::uint32_t i = 0; i < bodies->count; ++i) {
      const Segment& segment = segments_[by_target_[bodies->first + i]];
      begin = std::min(begin, segment.begin_tdb_s);
      end = std::max(end, segment.end_tdb_s);
    }
  } else {
    std::swap(begin, end);  // a root is always there
  }
  return Span{Epoch::tdb_seconds(std::clamp(begin, -kEpochLimit, kEpochLimit)),
              Epoch::tdb_seconds(std::clamp(end, -kEpochLimit, kEpochLimit))};
}

Result<const Ephemeris::Segment*> Ephemeris::choose(const Bodies& bodies, Epoch epoch) const {
  const double t = epoch.tdb_seconds();
  double begin = std::numeric_limits<double>::infinity(), end = -begin;
  for (std::uint32_t i = 0; i < bodies.count; ++i) {
    const Segment& segment = segments_[by_target_[bodies.first + i]];
    if (t >= segment.begin_tdb_s && t <= segment.end_tdb_s) return &segment;
    begin = std::min(begin, segment.begin_tdb_s);
    end = std::max(end, segment.end_tdb_s);
  }
  const bool gap = t >= begin && t <= end;
  Sentence what;
  what.add_body(BodyId{bodies.target});
  what.add("%s", gap ? " has a gap between " : " is known from ");
  what.add_time(begin);
  what.add("%s", gap ? " and " : " to ");
  what.add_time(end);
  what.add(" TDB, not at ");
  what.add_time(t);
  return fail(ErrorCode::out_of_range, "the kernels do not reach: {s}", {}, {}, what.view());
}

Result<Ephemeris::Chain> Ephemeris::chain(BodyId from, Epoch epoch) const {
  Chain out;
  std::int32_t body = from.value;
  while (out.size < kMaxDepth) {
    const Bodies* const bodies = find(body);
    Link& link = out.links[static_cast<std::size_t>(out.size++)];
    link.body = body;
    if (bodies == nullptr) return out;
    const auto segment = choose(*bodies, epoch);
    if (!segment) return out;  // perhaps nobody asks for what lies beyond
    link.segment = *segment;
    body = (*segment)->center.value;
  }
  return fail(ErrorCode::corrupt_data, "the centres of body {0} form a circle, or a chain of more than 16",
              {static_cast<double>(from.value), 0, 0, 0});
}

Result<void> Ephemeris::add(const Segment& segment, const Epoch& epoch, double sign, State& sum) const {
  if (segment.frame != kFrameJ2000)
    return fail(ErrorCode::unsupported, "SPK frame {0} (body {1}, segment at byte {2}): only 1, J2000, is read",
                {static_cast<double>(segment.frame), static_cast<double>(segment.target.value),
                 static_cast<double>(segment.first_byte), 0});
  if (segment.type != 2 && segment.type != 3)
    return fail(ErrorCode::unsupported, "SPK type {0} (body {1}, segment at byte {2}): types 2 and 3 are read",
                {static_cast<double>(segment.type), static_cast<double>(segment.target.value),
                 static_cast<double>(segment.first_byte), 0});

  // Whole seconds and the rest apart: a double of seconds since J2000 resolves a tenth of a microsecond only.
  const std::int64_t whole = epoch.tdb_nanoseconds() / 1'000'000'000;
  const double rest = static_cast<double>(epoch.tdb_nanoseconds() % 1'000'000'000) * 1e-9;
  const double position = (static_cast<double>(whole) - segment.init_s + rest) / segment.interval_s;
  const int index = static_cast<int>(std::clamp(position, 0.0, static_cast<double>(segment.record_count - 1)));
  const std::size_t at = segment.first_byte + static_cast<std::size_t>(index) *
                                                  static_cast<std::size_t>(segment.record_doubles) * kWordBytes;
  const std::byte* const record = kernels_[static_cast<std::size_t>(segment.kernel)].data() + at;
  const double middle = load_double(record, segment.swap_bytes);
  const double radius = load_double(record + 8, segment.swap_bytes);
  const double s = (static_cast<double>(whole) - middle + rest) / radius;
  // A directory's interval may be rounded; more than a thousandth outside is another record's time.
  if (!(radius > 0.0) || !(std::abs(s) <= 1.001))
    return fail(ErrorCode::corrupt_data,
                "byte {0}: the record's times do not hold the epoch that the directory puts there",
                {static_cast<double>(at), 0, 0, 0});

  const int series = segment.type == 2 ? 3 : 6;
  const int count = (segment.record_doubles - 2) / series;
  const std::byte* const coefficients = record + 2 * kWordBytes;
  double p_km[3], v_km_s[3];
  if (segment.swap_bytes)
    chebyshev<true>(coefficients, count, s, p_km, v_km_s);
  else
    chebyshev<false>(coefficients, count, s, p_km, v_km_s);
  if (segment.type == 2) {
    for (double& v : v_km_s) v /= radius;
  } else {
    const std::byte* const velocity = coefficients + 3 * static_cast<std::size_t>(count) * kWordBytes;
    double unused[3];
    if (segment.swap_bytes)
      chebyshev<true>(velocity, count, s, v_km_s, unused);
    else
      chebyshev<false>(velocity, count, s, v_km_s, unused);
  }
  const double scale = sign * 1e3;
  sum.p_m += scale * Vec3(p_km[0], p_km[1], p_km[2]);
  sum.v_m_s += scale * Vec3(v_km_s[0], v_km_s[1], v_km_s[2]);
  // One comparison for six numbers: a NaN or an infinity survives sums.
  const double all = sum.p_m.squaredNorm() + sum.v_m_s.squaredNorm();
  if (!(all < std::numeric_limits<double>::infinity()))
    return fail(ErrorCode::corrupt_data, "byte {0}: the record gives no finite place",
                {static_cast<double>(at), 0, 0, 0});
  return {};
}

Result<State> Ephemeris::state(BodyId target, BodyId center, Epoch epoch) const {
  const auto from = resolve(target);
  if (!from) return forward(from);
  const auto to = resolve(center);
  if (!to) return forward(to);
  State sum;
  if (*from == *to) return sum;
  const auto down = chain(*to, epoch);
  if (!down) return forward(down);
  const auto up = chain(*from, epoch);
  if (!up) return forward(up);

  // The first body that both chains pass: what lies beyond it would cancel.
  for (int i = 0; i < up->size; ++i) {
    for (int j = 0; j < down->size; ++j) {
      if (up->links[static_cast<std::size_t>(i)].body != down->links[static_cast<std::size_t>(j)].body) continue;
      for (int k = 0; k < i; ++k) {
        const auto added = add(*up->links[static_cast<std::size_t>(k)].segment, epoch, 1.0, sum);
        if (!added) return forward(added);
      }
      for (int k = 0; k < j; ++k) {
        const auto added = add(*down->links[static_cast<std::size_t>(k)].segment, epoch, -1.0, sum);
        if (!added) return forward(added);
      }
      return sum;
    }
  }
  // Not connected at all, or a chain stopped early since no segment covers the time: that error says which body.
  for (const Chain* const c : {&*up, &*down}) {
    const Bodies* const last = find(c->links[static_cast<std::size_t>(c->size - 1)].body);
    if (last == nullptr) continue;
    const auto segment = choose(*last, epoch);
    if (!segment) return forward(segment);
  }
  Sentence who;
  who.add_body(*from);
  who.add(" and ");
  who.add_body(*to);
  return fail(ErrorCode::not_found, "no kernel connects {s}", {}, {}, who.view());
}

Result<LightTime> light_time(const Ephemeris& ephemeris, BodyId target, const State& observer_O, Epoch epoch,
                             int iterations) {
  // Each step gains the factor v/c: four reach 1e-12 s from anywhere in the solar system.
  constexpr int kMaxIterations = 10;
  constexpr double kConverged = 1e-12;  // s
  constexpr double kFarthest = 1e8;     // s; three light years, so that epochs cannot overflow
  constexpr BodyId kBarycenter = body::solar_system_barycenter;
  auto there = ephemeris.state(target, kBarycenter, epoch);
  if (!there) return forward(there);
  double tau = (there->p_m - observer_O.p_m).norm() / kSpeedOfLight;
  const int limit = iterations < 0 ? kMaxIterations : std::min(iterations, kMaxIterations);
  Duration applied;
  for (int i = 0; i < limit; ++i) {
    if (!(tau < kFarthest))
      return fail(ErrorCode::out_of_range, "body {0} is {1} light-seconds away",
                  {static_cast<double>(target.value), tau, 0, 0});
    const Duration delay = Duration::seconds(tau);
    if (iterations < 0 && i > 0 && delay == applied) break;  // finer than an Epoch can tell
    applied = delay;
    there = ephemeris.state(target, kBarycenter, epoch - delay);
    if (!there) return forward(there);
    // What the nanosecond leaves over is made good with the velocity.
    there->p_m -= (tau - delay.seconds()) * there->v_m_s;
    const double next = (there->p_m - observer_O.p_m).norm() / kSpeedOfLight;
    const double step = std::abs(next - tau);
    tau = next;
    if (iterations < 0 && step < kConverged) break;
  }
  LightTime out;
  out.light_time_s = tau;
  out.relative.p_m = there->p_m - observer_O.p_m;
  out.relative.v_m_s = there->v_m_s - observer_O.v_m_s;
  if (iterations == 0 || tau == 0.0) return out;
  // d tau/dt from the derivative of c tau = |p_target(t - tau) - p_observer(t)|.
  const Vec3 toward = out.relative.p_m.normalized() / kSpeedOfLight;
  const double rate = toward.dot(out.relative.v_m_s) / (1.0 + toward.dot(there->v_m_s));
  out.relative.v_m_s -= rate * there->v_m_s;
  return out;
}

}  // namespace astronav
