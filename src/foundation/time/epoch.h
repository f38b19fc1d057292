// SPDX-License-Identifier: Apache-2.0
// Epoch and Duration: integer nanoseconds in TDB since J2000 (2000-01-01T12:00:00 TDB); good for 1708 to 2292.
//
// UTC, TAI and TT come and go through ERFA (SOFA: Dat, Dtdb, Dtf2d, Utctai, Taitt). TDB-TT is ERFA's series at the
// geocentre (eraDtdb); the topocentric part (2 microseconds) is left out.
#pragma once

#include <compare>
#include <cstdint>
#include <string>
#include <string_view>

#include "foundation/base/error.h"

namespace astronav {

class Duration {
 public:
  constexpr Duration() = default;
  static constexpr Duration nanoseconds(std::int64_t n) { return Duration(n); }
  // Rounded to the nearest nanosecond.
  static constexpr Duration seconds(double s) {
    return Duration(static_cast<std::int64_t>(s * 1e9 + (s >= 0.0 ? 0.5 : -0.5)));
  }
  static constexpr Duration days(double d) { return seconds(d * 86400.0); }
  constexpr std::int64_t nanoseconds() const { return ns_; }
  constexpr double seconds() const { return static_cast<double>(ns_) * 1e-9; }
  constexpr double days() const { return seconds() / 86400.0; }
  constexpr auto operator<=>(const Duration&) const = default;
  constexpr Duration operator-() const { return Duration(-ns_); }
  constexpr Duration operator+(Duration o) const { return Duration(ns_ + o.ns_); }
  constexpr Duration operator-(Duration o) const { return Duration(ns_ - o.ns_); }
  constexpr Duration operator*(std::int64_t k) const { return Duration(ns_ * k); }

 private:
  explicit constexpr Duration(std::int64_t n) : ns_(n) {}
  std::int64_t ns_ = 0;
};

enum class TimeScale : unsigned char { utc, tai, tt, tdb };
std::string_view name(TimeScale scale);

class Epoch {
 public:
  constexpr Epoch() = default;  // J2000 TDB
  static constexpr Epoch tdb_nanoseconds(std::int64_t since_j2000) { return Epoch(since_j2000); }
  // Seconds past J2000 TDB: what SPICE calls ephemeris time.
  static constexpr Epoch tdb_seconds(double since_j2000) { return Epoch(Duration::seconds(since_j2000).nanoseconds()); }
  // ISO 8601 ("2028-03-01", "2028-03-01T12:00:00.5", a blank for the T) with the scale as suffix (" TDB", " TT",
  // " TAI", " UTC" or "Z"); `fallback` where none is given. Leap seconds are read (23:59:60). Also "JD 2461000.5 TDB".
  static Result<Epoch> parse(std::string_view text, TimeScale fallback = TimeScale::utc);
  // Two-part Julian Date in a scale (quasi-JD for UTC, as in SOFA).
  static Result<Epoch> from_julian_date(double jd1, double jd2, TimeScale scale);

  constexpr std::int64_t tdb_nanoseconds() const { return ns_; }
  constexpr double tdb_seconds() const { return static_cast<double>(ns_) * 1e-9; }
  // Julian years of 365.25 days from J2000.0 TDB, and from J1991.25 (the epoch of Hipparcos), for proper motion.
  constexpr double julian_years_since_j2000() const { return tdb_seconds() / (365.25 * 86400.0); }
  constexpr double julian_years_since_j1991_25() const { return julian_years_since_j2000() + 8.75; }
  struct JulianDate {
    double jd1 = 0.0;
    double jd2 = 0.0;
  };
  JulianDate julian_date(TimeScale scale) const;
  // "2028-03-01T12:00:00.000 TDB" with `decimals` in 0..9; without the suffix if `suffix` is false.
  std::string iso(TimeScale scale = TimeScale::tdb, int decimals = 3, bool suffix = true) const;

  constexpr auto operator<=>(const Epoch&) const = default;
  constexpr Epoch operator+(Duration d) const { return Epoch(ns_ + d.nanoseconds()); }
  constexpr Epoch operator-(Duration d) const { return Epoch(ns_ - d.nanoseconds()); }
  constexpr Duration operator-(Epoch o) const { return Duration::nanoseconds(ns_ - o.ns_); }

 private:
  explicit constexpr Epoch(std::int64_t ns) : ns_(ns) {}
  std::int64_t ns_ = 0;
};

// "START/STOP/STEP" with a step like 10d, 1h, 60s is the business of the command line; this reads the step.
Result<Duration> parse_duration(std::string_view text);

}  // namespace astronav
