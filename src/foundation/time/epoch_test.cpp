// SPDX-License-Identifier: Apache-2.0
#include "foundation/time/epoch.h"

#include <cmath>
#include <fstream>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "support/shared_data.h"

namespace astronav {
namespace {

Epoch at(std::string_view text) {
  const auto epoch = Epoch::parse(text);
  EXPECT_TRUE(epoch) << text << ": " << (epoch ? "" : describe(epoch.error()));
  return epoch.value_or(Epoch());
}

std::string message(std::string_view text) {
  const auto epoch = Epoch::parse(text);
  return epoch ? "was read" : describe(epoch.error());
}

double seconds_between(Epoch later, Epoch earlier) {
  return (later - earlier).seconds();
}

// In seconds of TAI, which TDB's run fast and slow against by 3e-10.
double tai_between(Epoch later, Epoch earlier) {
  const auto a = earlier.julian_date(TimeScale::tai), b = later.julian_date(TimeScale::tai);
  return ((b.jd1 - a.jd1) + (b.jd2 - a.jd2)) * 86400.0;
}

// SOFA, "Time Scale and Calendar Tools", the worked example of 2006-01-15T21:24:37.5 UTC. Its TDB is for a site off the
// Earth's axis, where the topocentric term is up to 2 microseconds.
TEST(Epoch, AgreesWithTheSofaCookbook) {
  const Epoch epoch = at("2006-01-15T21:24:37.500000 UTC");
  EXPECT_EQ(epoch.iso(TimeScale::tai, 6), "2006-01-15T21:25:10.500000 TAI");
  EXPECT_EQ(epoch.iso(TimeScale::tt, 6), "2006-01-15T21:25:42.684000 TT");
  EXPECT_NEAR(seconds_between(epoch, at("2006-01-15T21:25:42.684373 TDB")), 0.0, 3e-6);
}

// The same document: UTC 2010-07-24T11:18:07.318.
TEST(Epoch, AgreesWithTheSofaCookbookAcrossScales) {
  const Epoch epoch = at("2010-07-24T11:18:07.318Z");
  EXPECT_EQ(epoch, at("2010-07-24T11:18:41.318 TAI"));
  EXPECT_EQ(epoch, at("2010-07-24T11:19:13.502 TT"));
}

// USNO Circular 179, eq. 2.6: good to 10 microseconds from 1600 to 2200.
TEST(Epoch, TdbMinusTtFollowsTheShortSeries) {
  for (int year = 1750; year < 2200; year += 7) {
    for (const char* day : {"-01-09", "-04-30", "-10-01"}) {
      const std::string date = std::to_string(year) + day;
      const double t = at(date + " TDB").tdb_seconds() / (86400.0 * 36525.0);
      const double expected = 0.001657 * std::sin(628.3076 * t + 6.2401) + 0.000022 * std::sin(575.3385 * t + 4.2970) +
                              0.000014 * std::sin(1256.6152 * t + 6.1969) + 0.000005 * std::sin(606.9777 * t + 4.0212) +
                              0.000005 * std::sin(52.9691 * t + 0.4444) + 0.000002 * std::sin(21.3299 * t + 5.5431) +
                              0.000010 * t * std::sin(628.3076 * t + 4.2490);
      EXPECT_NEAR(seconds_between(at(date + " TT"), at(date + " TDB")), expected, 1e-5) << date;
    }
  }
}

TEST(Epoch, J2000IsTheOrigin) {
  EXPECT_EQ(at("2000-01-01T12:00:00 TDB").tdb_nanoseconds(), 0);
  EXPECT_EQ(at("2000-01-01T12:00:00.000000001 TDB").tdb_nanoseconds(), 1);
  EXPECT_EQ(at("JD 2451545.0 TDB"), Epoch());
  EXPECT_DOUBLE_EQ(at("2001-01-01T18:00:00 TDB").julian_years_since_j2000(), 366.25 / 365.25);
}

TEST(Epoch, ReadsTheForms) {
  const Epoch noon = at("2028-03-01T12:00:00 UTC");
  EXPECT_EQ(at("2028-03-01T12:00:00"), noon);
  EXPECT_EQ(at("2028-03-01T12:00:00Z"), noon);
  EXPECT_EQ(at("2028-03-01 12:00:00 UTC"), noon);
  EXPECT_EQ(at(" 2028-03-01T12:00  UTC "), noon);
  EXPECT_EQ(at("2028-03-01"), at("2028-03-01T00:00:00 UTC"));
  EXPECT_EQ(at("2028-03-01T12:00:00.0000000004"), noon);
  EXPECT_EQ(at("2028-03-01T12:00:00.0000000006"), noon + Duration::nanoseconds(1));
  EXPECT_EQ(at("JD 2461832.0 UTC"), noon);
  EXPECT_EQ(Epoch::parse("2028-03-01T12:00:00", TimeScale::tdb).value(), at("2028-03-01T12:00:00 TDB"));
  // Years far ahead of the table of leap seconds: the last value holds.
  EXPECT_NEAR(tai_between(at("2050-01-01 UTC"), at("2050-01-01 TAI")), 37.0, 2e-9);
}

TEST(Epoch, LeapSecond) {
  const Epoch before = at("2016-12-31T23:59:59 UTC");
  const Epoch leap = at("2016-12-31T23:59:60 UTC");
  const Epoch after = at("2017-01-01T00:00:00 UTC");
  EXPECT_NEAR(seconds_between(leap, before), 1.0, 2e-9);
  EXPECT_NEAR(seconds_between(after, leap), 1.0, 2e-9);
  EXPECT_EQ(leap.iso(TimeScale::utc), "2016-12-31T23:59:60.000 UTC");
  EXPECT_EQ((leap + Duration::seconds(0.5)).iso(TimeScale::utc), "2016-12-31T23:59:60.500 UTC");
  EXPECT_EQ((leap + Duration::seconds(0.9996)).iso(TimeScale::utc), "2017-01-01T00:00:00.000 UTC");
  EXPECT_EQ(after.iso(TimeScale::utc), "2017-01-01T00:00:00.000 UTC");
  EXPECT_EQ(leap.iso(TimeScale::tai), "2017-01-01T00:00:36.000 TAI");
  EXPECT_NE(message("2015-12-31T23:59:60 UTC").find("no leap second"), std::string::npos);
  EXPECT_NE(message("2016-12-31T22:59:60 UTC").find("no leap second"), std::string::npos);
  EXPECT_NE(message("2016-12-31T23:59:60 TAI").find("no leap second"), std::string::npos);
}

TEST(Epoch, SaysWhatIsWrong) {
  const std::vector<std::pair<std::string, std::string>> cases = {
      {"", "missing"},
      {"yesterday", "column 1"},
      {"2028", "column 5"},
      {"2028-3-1", "column 6"},
      {"2028-13-01", "no month 13"},
      {"2027-02-29", "no day 29"},
      {"1600-01-01 TDB", "1708 to 2291"},
      {"2300-01-01 TDB", "1708 to 2291"},
      {"1950-01-01 UTC", "no UTC before 1960"},
      {"2028-03-01T24:00:00", "no hour 24"},
      {"2028-03-01T12:60:00", "no minute 60"},
      {"2028-03-01T12:00:61", "no second 61"},
      {"2028-03-01T12", "column 14"},
      {"2028-03-01T12:00:00.", "column 21"},
      {"2028-03-01T12:00:00+02:00", "offsets"},
      {"2028-03-01T12:00:00 GPS", "none of UTC, TAI, TT, TDB"},
      {"2028-03-01T12:00:00 TDB x", "none of UTC, TAI, TT, TDB"},
      {"2028-03-01T12:00:00Zulu", "nothing may follow"},
      {"2028-03-01x", "column 11"},
      {"JD", "number of days"},
      {"JD 1e6 TDB", "column 5"},
      {"JD 99 TDB", "Julian Date 99"},
  };
  for (const auto& [text, expected] : cases)
    EXPECT_NE(message(text).find(expected), std::string::npos) << text << " -> " << message(text);
}

// Every scale, over three centuries, and around every kind of jump.
TEST(Epoch, RoundTripsToANanosecond) {
  for (std::int64_t i = -290; i <= 290; ++i) {
    const Epoch epoch = Epoch::tdb_nanoseconds(i * 31'556'952'123'456'789LL);
    for (const TimeScale scale : {TimeScale::tdb, TimeScale::tt, TimeScale::tai, TimeScale::utc}) {
      if (scale == TimeScale::utc && epoch < Epoch() - Duration::days(40 * 365.25)) continue;
      const auto by_text = Epoch::parse(epoch.iso(scale, 9));
      ASSERT_TRUE(by_text) << epoch.iso(scale, 9) << " " << describe(by_text.error());
      EXPECT_LE(std::abs((*by_text - epoch).nanoseconds()), 1) << epoch.iso(scale, 9);
      const auto jd = epoch.julian_date(scale);
      const auto by_jd = Epoch::from_julian_date(jd.jd1, jd.jd2, scale);
      ASSERT_TRUE(by_jd) << describe(by_jd.error());
      EXPECT_LE(std::abs((*by_jd - epoch).nanoseconds()), 1) << epoch.iso(scale, 9);
    }
  }
  for (int ms = -3000; ms < 3000; ms += 37) {
    const Epoch epoch = at("2017-01-01T00:00:00 UTC") + Duration::nanoseconds(1'000'000LL * ms + 123);
    const auto jd = epoch.julian_date(TimeScale::utc);
    EXPECT_LE(std::abs((at(epoch.iso(TimeScale::utc, 9)) - epoch).nanoseconds()), 1);
    EXPECT_LE(std::abs((Epoch::from_julian_date(jd.jd1, jd.jd2, TimeScale::utc).value() - epoch).nanoseconds()), 1);
  }
}

TEST(Epoch, JulianDateTakesAnySplit) {
  const Epoch epoch = at("2006-01-15T21:24:37.500000 TT");
  const auto jd = epoch.julian_date(TimeScale::tt);
  EXPECT_EQ(jd.jd1, 2453750.5);
  for (const double shift : {0.0, 1.0, 0.5, -2453750.0, 1e5}) {
    const auto same = Epoch::from_julian_date(jd.jd1 + shift, jd.jd2 - shift, TimeScale::tt);
    ASSERT_TRUE(same);
    EXPECT_NEAR(seconds_between(*same, epoch), 0.0, std::abs(shift) > 10.0 ? 5e-5 : 1e-9);
  }
  EXPECT_FALSE(Epoch::from_julian_date(NAN, 0.0, TimeScale::tt));
  EXPECT_FALSE(Epoch::from_julian_date(1e300, -1e300, TimeScale::tt));
  EXPECT_FALSE(Epoch::from_julian_date(2400000.5, 0.0, TimeScale::utc));
}

TEST(Epoch, WritesWhatWasAskedFor) {
  const Epoch epoch = at("2028-03-01T23:59:59.9996 TDB");
  EXPECT_EQ(epoch.iso(), "2028-03-02T00:00:00.000 TDB");
  EXPECT_EQ(epoch.iso(TimeScale::tdb, 4, false), "2028-03-01T23:59:59.9996");
  EXPECT_EQ(epoch.iso(TimeScale::tdb, 0), "2028-03-02T00:00:00 TDB");
  EXPECT_EQ(at("1708-01-01 TDB").iso(), "1708-01-01T00:00:00.000 TDB");
  EXPECT_EQ(at("2291-12-31T23:59:59 TDB").iso(), "2291-12-31T23:59:59.000 TDB");
}

TEST(Duration, Parses) {
  EXPECT_EQ(parse_duration("10d").value(), Duration::days(10.0));
  EXPECT_EQ(parse_duration("1h").value(), Duration::seconds(3600.0));
  EXPECT_EQ(parse_duration("30min").value(), Duration::seconds(1800.0));
  EXPECT_EQ(parse_duration(" 0.5 s ").value(), Duration::nanoseconds(500'000'000));
  EXPECT_EQ(parse_duration("250ms").value(), Duration::nanoseconds(250'000'000));
  for (const char* bad : {"", "d", "10", "10 weeks", "1e9d", "nan s", "inf s", "10d 5h"})
    EXPECT_FALSE(parse_duration(bad)) << bad;
}

// NAIF's leap seconds: pairs "seconds, @date" after DELTET/DELTA_AT.
TEST(EpochAgainstNaif, LeapSeconds) {
  const auto path = ASTRONAV_SHARED_DATA("ephemeris/naif0012.tls");
  std::ifstream file(path);
  std::string text((std::istreambuf_iterator<char>(file)), {});
  const std::vector<std::string> months = {"JAN", "FEB", "MAR", "APR", "MAY", "JUN",
                                           "JUL", "AUG", "SEP", "OCT", "NOV", "DEC"};
  int found = 0;
  double last = 0.0;
  // Lines like "( 10,   @1972-JAN-1".
  for (std::size_t i = text.rfind("DELTA_AT"); (i = text.find('@', i)) != std::string::npos; ++i) {
    const std::size_t comma = text.rfind(',', i);
    const double tai_minus_utc = std::stod(text.substr(comma - 2, 2));
    const std::string date = text.substr(i + 1, text.find_first_of(" )\r\n", i) - i - 1);
    std::size_t month = 0;
    while (months.at(month) != date.substr(5, 3)) ++month;
    char day[48];
    std::snprintf(day, sizeof day, "%s-%02zu-%02d", date.substr(0, 4).c_str(), month + 1, std::stoi(date.substr(9)));
    const Epoch utc = at(std::string(day) + " UTC"), tai = at(std::string(day) + " TAI");
    EXPECT_NEAR(tai_between(utc, tai), tai_minus_utc, 2e-9) << day;
    if (found > 0) {
      EXPECT_NEAR(tai_between(utc, tai), last + 1.0, 2e-9) << day;
      // The second before is a leap second, and TAI counts it.
      EXPECT_NEAR(tai_between(utc, (utc - Duration::seconds(1.0))), 1.0, 2e-9);
      EXPECT_NE((utc - Duration::seconds(0.5)).iso(TimeScale::utc).find("23:59:60.500"), std::string::npos) << day;
    }
    last = tai_minus_utc;
    ++found;
  }
  EXPECT_EQ(found, 28);
  EXPECT_NEAR(tai_between(at("2026-11-22 UTC"), at("2026-11-22 TAI")), last, 2e-9);
}

}  // namespace
}  // namespace astronav
