// SPDX-License-Identifier: Apache-2.0
#include "foundation/time/epoch.h"

#include <array>
#include <charconv>
#include <chrono>
#include <cmath>
#include <limits>

#include <erfa.h>
#include <fmt/format.h>

namespace astronav {
namespace {

// Times inside this file are counted in nanoseconds since 2000-01-01T12:00:00 of their own scale, so that the
// conversions are sums of integers; floating point is left to the small differences between scales.
using Nanoseconds = std::int64_t;

constexpr Nanoseconds kSecond = 1'000'000'000;
constexpr Nanoseconds kDay = 86'400 * kSecond;
constexpr Nanoseconds kTtMinusTai = 32'184'000'000;  // IAU 1991, recommendation IV
constexpr double kJdOfDayZero = 2451544.5;           // 2000-01-01T00:00:00
constexpr int kFirstYear = 1708;
constexpr int kLastYear = 2291;

// A day (0 is 2000-01-01) and the time since its midnight. On a day with a leap second the latter passes 24 hours.
struct DayTime {
  std::int64_t day = 0;
  Nanoseconds time = 0;
};

std::chrono::year_month_day civil(std::int64_t day) {
  using namespace std::chrono;
  return year_month_day(sys_days(year(2000) / January / 1) + days(day));
}

std::int64_t day_number(const std::chrono::year_month_day& date) {
  using namespace std::chrono;
  return (sys_days(date) - sys_days(year(2000) / January / 1)).count();
}

DayTime split(Nanoseconds since_j2000) {
  // Halves of a day are taken first: the sum with 12 hours could overflow.
  std::int64_t day = since_j2000 / kDay;
  Nanoseconds time = since_j2000 % kDay + kDay / 2;
  if (time < 0) {
    time += kDay;
    --day;
  } else if (time >= kDay) {
    time -= kDay;
    ++day;
  }
  return {day, time};
}

Nanoseconds join(DayTime t) {
  return t.day * kDay + (t.time - kDay / 2);
}

// TAI-UTC on a day at a fraction of it. ERFA warns of years far behind its table: the last value known then holds.
// Before 1960 there is no UTC; ERFA gives 0.
Nanoseconds tai_minus_utc(std::int64_t day, double fraction) {
  const auto date = civil(day);
  double seconds = 0.0;
  eraDat(static_cast<int>(date.year()), static_cast<int>(static_cast<unsigned>(date.month())),
         static_cast<int>(static_cast<unsigned>(date.day())), fraction, &seconds);
  return std::llround(seconds * 1e9);
}

Nanoseconds utc_midnight_in_tai(std::int64_t day) {
  return day * kDay - kDay / 2 + tai_minus_utc(day, 0.0);
}

// How much TAI gains on UTC within a day, apart from a leap at its end: not zero from 1961 to 1971 only.
Nanoseconds drift(std::int64_t day) {
  return 2 * (tai_minus_utc(day, 0.5) - tai_minus_utc(day, 0.0));
}

// Length of a UTC day in its own seconds, counted in nanoseconds.
Nanoseconds utc_day_length(std::int64_t day) {
  return kDay + tai_minus_utc(day + 1, 0.0) - tai_minus_utc(day, 0.0) - drift(day);
}

Nanoseconds tai_from_utc(DayTime utc) {
  const double fraction = static_cast<double>(utc.time) / static_cast<double>(kDay);
  return utc_midnight_in_tai(utc.day) + utc.time + std::llround(static_cast<double>(drift(utc.day)) * fraction);
}

DayTime utc_from_tai(Nanoseconds tai) {
  std::int64_t day = split(tai).day;
  while (utc_midnight_in_tai(day) > tai) --day;
  while (utc_midnight_in_tai(day + 1) <= tai) ++day;
  const Nanoseconds elapsed = tai - utc_midnight_in_tai(day);
  const double gained = static_cast<double>(drift(day));
  return {day, elapsed - std::llround(gained * static_cast<double>(elapsed) / (static_cast<double>(kDay) + gained))};
}

Nanoseconds tdb_minus_tt(Nanoseconds tdb) {
  const DayTime t = split(tdb);
  return std::llround(1e9 * eraDtdb(kJdOfDayZero + static_cast<double>(t.day),
                                    static_cast<double>(t.time) / static_cast<double>(kDay), 0.0, 0.0, 0.0, 0.0));
}

// The series wants TDB; it changes so slowly (2e-10) that the second pass is exact.
Nanoseconds tdb_from_tt(Nanoseconds tt) {
  return tt + tdb_minus_tt(tt + tdb_minus_tt(tt));
}

DayTime day_time(Nanoseconds tdb, TimeScale scale) {
  if (scale == TimeScale::tdb) return split(tdb);
  const Nanoseconds tt = tdb - tdb_minus_tt(tdb);
  if (scale == TimeScale::tt) return split(tt);
  const Nanoseconds tai = tt - kTtMinusTai;
  return scale == TimeScale::tai ? split(tai) : utc_from_tai(tai);
}

// `t` within the years that an Epoch can hold.
Nanoseconds tdb_from(DayTime t, TimeScale scale) {
  switch (scale) {
    case TimeScale::tdb:
      return join(t);
    case TimeScale::tt:
      return tdb_from_tt(join(t));
    case TimeScale::tai:
      return tdb_from_tt(join(t) + kTtMinusTai);
    case TimeScale::utc:
      break;
  }
  return tdb_from_tt(tai_from_utc(t) + kTtMinusTai);
}

constexpr const char* kUtcTooEarly = "there is no UTC before 1960; give TAI, TT or TDB";

// Reads a text from left to right; the first thing that does not fit becomes the error.
class Reader {
 public:
  explicit Reader(std::string_view text) : text_(text), rest_(text) {}

  bool at_end() const { return rest_.empty(); }
  char peek() const { return rest_.empty() ? '\0' : rest_.front(); }
  bool take(char c) {
    if (peek() != c) return false;
    rest_.remove_prefix(1);
    return true;
  }
  bool take(std::string_view word) {
    if (!rest_.starts_with(word)) return false;
    rest_.remove_prefix(word.size());
    return true;
  }
  // Exactly `count` digits.
  bool digits(std::size_t count, int& value) {
    if (rest_.size() < count) return false;
    value = 0;
    for (const char c : rest_.substr(0, count)) {
      if (c < '0' || c > '9') return false;
      value = 10 * value + (c - '0');
    }
    rest_.remove_prefix(count);
    return true;
  }
  // As many digits as there are, as a text.
  std::string_view digits() {
    std::size_t n = 0;
    while (n < rest_.size() && rest_[n] >= '0' && rest_[n] <= '9') ++n;
    const std::string_view run = rest_.substr(0, n);
    rest_.remove_prefix(n);
    return run;
  }
  std::string_view rest() const { return rest_; }

  // {0} in the text is the column, {1} a number.
  tl::unexpected<Error> wrong(const char* what, double number = 0.0) const {
    return fail(ErrorCode::invalid_argument, what,
                {static_cast<double>(text_.size() - rest_.size() + 1), number, 0.0, 0.0}, {}, text_);
  }

 private:
  std::string_view text_;
  std::string_view rest_;
};

std::string_view trimmed(std::string_view s) {
  while (!s.empty() && (s.front() == ' ' || s.front() == '\t')) s.remove_prefix(1);
  while (!s.empty() && (s.back() == ' ' || s.back() == '\t')) s.remove_suffix(1);
  return s;
}

// Nanoseconds of a decimal fraction, rounded.
Nanoseconds fraction_nanoseconds(std::string_view digits) {
  Nanoseconds ns = 0;
  for (std::size_t i = 0; i < 9; ++i) ns = 10 * ns + (i < digits.size() ? digits[i] - '0' : 0);
  return digits.size() > 9 && digits[9] >= '5' ? ns + 1 : ns;
}

Result<TimeScale> read_scale(Reader& in, TimeScale fallback) {
  if (in.at_end()) return fallback;
  if (in.take('Z')) {
    if (in.at_end()) return TimeScale::utc;
    return in.wrong("'{s}' is not an epoch: nothing may follow the Z (column {0})");
  }
  if (in.peek() == '+' || in.peek() == '-')
    return in.wrong("'{s}' is not an epoch: offsets from UTC (column {0}) are not read; give UTC");
  if (!in.take(' ')) return in.wrong("'{s}' is not an epoch: unexpected character at column {0}");
  while (in.take(' ')) {
  }
  for (const TimeScale scale : {TimeScale::utc, TimeScale::tai, TimeScale::tt, TimeScale::tdb}) {
    if (in.rest() == name(scale)) return scale;
  }
  return in.wrong("'{s}' is not an epoch: the scale at column {0} is none of UTC, TAI, TT, TDB");
}

Result<Epoch> parse_julian_date(Reader in, std::string_view text, TimeScale fallback) {
  while (in.take(' ')) {
  }
  const std::string_view whole = in.digits();
  std::string_view fraction;
  if (in.take('.')) fraction = in.digits();
  if (whole.empty() || whole.size() > 9)
    return in.wrong("'{s}' is not an epoch: 'JD' wants a number of days at column {0}, as in 'JD 2461000.5 TDB'");
  const auto scale = read_scale(in, fallback);
  if (!scale) return forward(scale);
  double jd1 = 0.0;
  for (const char c : whole) jd1 = 10.0 * jd1 + (c - '0');
  double jd2 = 0.0;
  for (std::size_t i = fraction.size(); i-- > 0;) jd2 = (jd2 + (fraction[i] - '0')) / 10.0;
  const auto epoch = Epoch::from_julian_date(jd1, jd2, *scale);
  if (!epoch) return forward(epoch, text);
  return epoch;
}

}  // namespace

std::string_view name(TimeScale scale) {
  switch (scale) {
    case TimeScale::utc:
      return "UTC";
    case TimeScale::tai:
      return "TAI";
    case TimeScale::tt:
      return "TT";
    case TimeScale::tdb:
      return "TDB";
  }
  return "?";
}

Result<Epoch> Epoch::parse(std::string_view text, TimeScale fallback) {
  Reader in(trimmed(text));
  if (in.at_end()) return in.wrong("an epoch is missing: give one like '2028-03-01T12:00:00 TDB'");
  if (in.take(std::string_view("JD"))) return parse_julian_date(in, text, fallback);

  int year = 0, month = 0, day = 0, hour = 0, minute = 0, second = 0;
  if (!in.digits(4, year) || !in.take('-') || !in.digits(2, month) || !in.take('-') || !in.digits(2, day))
    return in.wrong("'{s}' is not an epoch: expected a date like 2028-03-01 (column {0})");
  if (year < kFirstYear || year > kLastYear)
    return fail(ErrorCode::out_of_range, "'{s}': the year must lie in {0} to {1}", {kFirstYear, kLastYear, 0, 0}, {},
                text);
  const std::chrono::year_month_day date{std::chrono::year(year), std::chrono::month(static_cast<unsigned>(month)),
                                         std::chrono::day(static_cast<unsigned>(day))};
  if (!date.month().ok()) return in.wrong("'{s}' is not an epoch: there is no month {1}", month);
  if (!date.ok()) return in.wrong("'{s}' is not an epoch: that month has no day {1}", day);

  Nanoseconds fraction = 0;
  const bool has_time =
      in.peek() == 'T' || (in.peek() == ' ' && in.rest().size() > 1 && in.rest()[1] >= '0' && in.rest()[1] <= '9');
  if (has_time) {
    if (!in.take('T')) in.take(' ');
    if (!in.digits(2, hour) || !in.take(':') || !in.digits(2, minute))
      return in.wrong("'{s}' is not an epoch: expected a time like 12:00:00 (column {0})");
    if (in.take(':')) {
      if (!in.digits(2, second)) return in.wrong("'{s}' is not an epoch: expected seconds at column {0}");
      if (in.take('.')) {
        const std::string_view digits = in.digits();
        if (digits.empty()) return in.wrong("'{s}' is not an epoch: expected decimals at column {0}");
        fraction = fraction_nanoseconds(digits);
      }
    }
    if (hour > 23) return in.wrong("'{s}' is not an epoch: there is no hour {1}", hour);
    if (minute > 59) return in.wrong("'{s}' is not an epoch: there is no minute {1}", minute);
    if (second > 60) return in.wrong("'{s}' is not an epoch: there is no second {1}", second);
  }
  const auto scale = read_scale(in, fallback);
  if (!scale) return forward(scale);

  const DayTime t{day_number(date), (hour * 3600 + minute * 60 + second) * kSecond + fraction};
  if (*scale == TimeScale::utc && year < 1960) return fail(ErrorCode::out_of_range, kUtcTooEarly, {}, text);
  if (second == 60) {
    const bool leap =
        *scale == TimeScale::utc && hour == 23 && minute == 59 && year >= 1972 && utc_day_length(t.day) > kDay;
    if (!leap) return in.wrong("'{s}' is not an epoch: no leap second was inserted there");
  }
  return Epoch(tdb_from(t, *scale));
}

Result<Epoch> Epoch::from_julian_date(double jd1, double jd2, TimeScale scale) {
  constexpr double kFirst = 2344928.5;  // 1708-01-01
  constexpr double kEnd = 2558218.5;    // 2292-01-01
  const double sum = jd1 + jd2;
  if (!(sum >= kFirst && sum < kEnd) || !(std::abs(jd1) < 1e7 && std::abs(jd2) < 1e7))
    return fail(ErrorCode::out_of_range, "the Julian Date {0} is not in {1} to {2}", {sum, kFirst, kEnd, 0});
  if (scale == TimeScale::utc && sum < 2436934.5) return fail(ErrorCode::out_of_range, kUtcTooEarly);
  // Whole and broken days apart, from the midnight of 2000-01-01, each step exact.
  const double whole1 = std::floor(jd1), whole2 = std::floor(jd2);
  double fraction = (jd1 - whole1) + (jd2 - whole2) - 0.5;
  double day = whole1 + whole2 - (kJdOfDayZero - 0.5);
  const double carry = std::floor(fraction);
  fraction -= carry;
  day += carry;
  const auto day_index = static_cast<std::int64_t>(day);
  // SOFA's quasi-JD spreads a leap second over its day.
  const Nanoseconds length = scale == TimeScale::utc ? utc_day_length(day_index) : kDay;
  return Epoch(tdb_from({day_index, std::llround(fraction * static_cast<double>(length))}, scale));
}

Epoch::JulianDate Epoch::julian_date(TimeScale scale) const {
  const DayTime t = day_time(ns_, scale);
  const Nanoseconds length = scale == TimeScale::utc ? utc_day_length(t.day) : kDay;
  return {kJdOfDayZero + static_cast<double>(t.day), static_cast<double>(t.time) / static_cast<double>(length)};
}

std::string Epoch::iso(TimeScale scale, int decimals, bool suffix) const {
  constexpr std::array<Nanoseconds, 10> kSteps{kSecond, kSecond / 10, kSecond / 100, 1'000'000, 100'000,
                                               10'000,  1'000,        100,           10,        1};
  decimals = decimals < 0 ? 0 : decimals > 9 ? 9 : decimals;
  const Nanoseconds step = kSteps[static_cast<std::size_t>(decimals)];
  DayTime t = day_time(ns_, scale);
  t.time = (t.time + step / 2) / step * step;
  const Nanoseconds length = scale == TimeScale::utc ? utc_day_length(t.day) : kDay;
  if (t.time >= length) t = {t.day + 1, 0};
  const auto date = civil(t.day);
  const Nanoseconds whole = t.time / kSecond;
  // A leap second is the 61st of the last minute.
  const Nanoseconds hour = std::min<Nanoseconds>(whole / 3600, 23);
  const Nanoseconds minute = std::min<Nanoseconds>(whole / 60 - 60 * hour, 59);
  std::string out = fmt::format("{:04}-{:02}-{:02}T{:02}:{:02}:{:02}", static_cast<int>(date.year()),
                                static_cast<unsigned>(date.month()), static_cast<unsigned>(date.day()), hour, minute,
                                whole - 3600 * hour - 60 * minute);
  if (decimals > 0) out += fmt::format(".{:0{}}", t.time % kSecond / step, decimals);
  if (suffix) out.append(" ").append(name(scale));
  return out;
}

Result<Duration> parse_duration(std::string_view text) {
  struct Unit {
    std::string_view name;
    double seconds;
  };
  constexpr std::array<Unit, 5> kUnits{{{"d", 86400.0}, {"h", 3600.0}, {"min", 60.0}, {"s", 1.0}, {"ms", 1e-3}}};
  const std::string_view all = trimmed(text);
  double value = 0.0;
  const auto [end, error] = std::from_chars(all.data(), all.data() + all.size(), value);
  if (error != std::errc() || !std::isfinite(value))
    return fail(ErrorCode::invalid_argument,
                "'{s}' is not a duration: expected a number and a unit, as in 10d, 1h, 30min, 60s", {}, {}, text);
  const std::string_view unit = trimmed(all.substr(static_cast<std::size_t>(end - all.data())));
  for (const Unit& known : kUnits) {
    if (unit != known.name) continue;
    const double seconds = value * known.seconds;
    if (std::abs(seconds) > 9e9)
      return fail(ErrorCode::out_of_range, "'{s}' is longer than the 285 years that a duration can hold", {}, {}, text);
    return Duration::seconds(seconds);
  }
  return fail(ErrorCode::invalid_argument, "'{s}' is not a duration: the unit must be one of d, h, min, s, ms", {}, {},
              text);
}

}  // namespace astronav
