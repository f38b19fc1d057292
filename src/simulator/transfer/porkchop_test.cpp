// SPDX-License-Identifier: Apache-2.0
#include "simulator/transfer/porkchop.h"

#include <algorithm>
#include <cmath>
#include <string>

#include <gtest/gtest.h>

#include "support/shipped_ephemeris.h"

namespace astronav::transfer {
namespace {

Epoch date(const char* text) {
  return Epoch::parse(text, TimeScale::tdb).value();
}
Result<Porkchop> earth_mars(const char* begin, const char* end, double shortest, double longest, double step_days) {
  return porkchop(testing::shipped_ephemeris(), body::earth, body::mars,
                  {.departure_begin = date(begin),
                   .departure_end = date(end),
                   .departure_step = Duration::days(step_days),
                   .shortest = Duration::days(shortest),
                   .longest = Duration::days(longest),
                   .flight_step = Duration::days(step_days)});
}
long count(const std::string& text, const std::string& part) {
  long n = 0;
  for (std::size_t at = text.find(part); at != std::string::npos; at = text.find(part, at + 1)) ++n;
  return n;
}

// Least departure energies to Mars, from table 1 of NASA's handbook (Burke, Falck & McGuire, NASA/TM-2010-216764): by
// more than half a turn in 2026 and 2033, by less in 2035. Another ephemeris and other conventions: 1.5 %.
TEST(Porkchop, LeastEnergies) {
  struct Case {
    const char *begin, *end;
    double shortest, longest;
    double c3_km2_s2;
  };
  for (const Case& c :
       {Case{"2026-10-01", "2026-12-01", 270.0, 330.0, 9.144}, Case{"2033-04-01", "2033-06-01", 240.0, 310.0, 7.781},
        Case{"2035-06-01", "2035-08-15", 150.0, 225.0, 10.19}}) {
    const auto p = earth_mars(c.begin, c.end, c.shortest, c.longest, 2.0);
    ASSERT_TRUE(p) << describe(p.error());
    EXPECT_NEAR(p->least_c3().c3_m2_s2() * 1e-6, c.c3_km2_s2, 0.015 * c.c3_km2_s2) << c.begin;
    EXPECT_NE(p->least_c3().departure, p->departures.front()) << c.begin;
    EXPECT_NE(p->least_c3().departure, p->departures.back()) << c.begin;
  }
}

TEST(Porkchop, Tables) {
  const auto p = earth_mars("2026-10-01", "2026-12-01", 250.0, 350.0, 10.0);
  ASSERT_TRUE(p) << describe(p.error());
  EXPECT_EQ(p->departures.size(), 7u);
  EXPECT_EQ(p->flights.size(), 11u);
  const std::string csv = to_csv(*p);
  EXPECT_EQ(std::count(csv.begin(), csv.end(), '\n'), 1 + 77);
  EXPECT_EQ(csv.substr(0, csv.find('\n')),
            "departure_tdb,arrival_tdb,days,c3_km2_s2,v_infinity_departure_km_s,v_infinity_arrival_km_s");
  // The row of 2026-10-31 and 290 days is the leg itself.
  const auto leg =
      lambert_leg(testing::shipped_ephemeris(), body::earth, body::mars, date("2026-10-31"), Duration::days(290.0));
  const std::size_t at = csv.find("2026-10-31T00:00:00,2027-08-17T00:00:00,290,");
  ASSERT_NE(at, std::string::npos);
  EXPECT_NEAR(std::stod(csv.substr(at + 44)), leg->c3_m2_s2() * 1e-6, 1e-6);
  EXPECT_EQ(p->at(3, 4)->arrival, leg->arrival);
}

TEST(Porkchop, Picture) {
  const auto p = earth_mars("2026-08-01", "2027-02-01", 150.0, 400.0, 5.0);
  ASSERT_TRUE(p);
  const std::string svg = to_svg(*p, "Earth < Mars & back");
  EXPECT_EQ(svg.rfind("<svg ", 0), 0u);
  EXPECT_EQ(svg.substr(svg.size() - 7), "</svg>\n");
  EXPECT_NE(svg.find("Earth &lt; Mars &amp; back"), std::string::npos);
  EXPECT_EQ(count(svg, "<text"), count(svg, "</text>"));
  EXPECT_EQ(count(svg, "nan"), 0) << "what is not there is not drawn";
  EXPECT_GT(count(svg, "<rect"), 500) << "cells";
  EXPECT_GT(count(svg, "M"), 100) << "contours";
  EXPECT_EQ(svg, to_svg(*p, "Earth < Mars & back"));
}

TEST(Porkchop, RefusesNonsense) {
  EXPECT_EQ(earth_mars("2027-01-01", "2026-01-01", 100.0, 200.0, 1.0).error().code, ErrorCode::invalid_argument);
  EXPECT_EQ(earth_mars("2026-01-01", "2027-01-01", 200.0, 100.0, 1.0).error().code, ErrorCode::invalid_argument);
  EXPECT_EQ(earth_mars("2026-01-01", "2027-01-01", 100.0, 200.0, 0.0).error().code, ErrorCode::invalid_argument);
  EXPECT_EQ(earth_mars("2026-01-01", "2027-01-01", 0.0, 200.0, 1.0).error().code, ErrorCode::invalid_argument);
  EXPECT_EQ(earth_mars("2026-01-01", "2027-01-01", 100.0, 200.0, 0.01).error().code, ErrorCode::limit_exceeded);
  EXPECT_EQ(earth_mars("2126-01-01", "2127-01-01", 100.0, 200.0, 1.0).error().code, ErrorCode::out_of_range);
}

}  // namespace
}  // namespace astronav::transfer
