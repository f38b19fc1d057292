// SPDX-License-Identifier: Apache-2.0
// Magnitudes from vectors: geometry of planets as JPL Horizons gives it for the published cases of Mallama & Hilton
// 2018, and Horizons' own magnitudes of Mars and Venus, 2010 to 2030. Vectors come from the shipped ephemeris (DE405).
#include <cmath>
#include <fstream>
#include <sstream>
#include <string>
#include <vector>

#include <gtest/gtest.h>

#include "foundation/files/mapped_file.h"
#include "foundation/math/statistics.h"
#include "models/ephemeris/ephemeris.h"
#include "models/photometry/photometry.h"
#include "support/shared_data.h"

namespace astronav {
namespace {

class FromTheEarth {
 public:
  FromTheEarth()
      : file_(MappedFile::open(home_directory() / "data/de405_2000_2050.bsp").value()),
        ephemeris_(Ephemeris::open(file_.bytes()).value()) {}

  Illumination see(BodyId body, const std::string& utc) const {
    const Epoch epoch = Epoch::parse(utc).value();
    const State earth = ephemeris_.state(body::earth, body::solar_system_barycenter, epoch).value();
    const LightTime light = light_time(ephemeris_, body, earth, epoch).value();
    const Epoch departure = epoch - Duration::seconds(light.light_time_s);
    return {.p_body_from_sun_N = ephemeris_.state(body, body::sun, departure).value().p_m,
            .p_body_from_observer_N = light.relative.p_m,
            .epoch = departure};
  }

 private:
  MappedFile file_;
  Ephemeris ephemeris_;
};

double around(double degrees) {
  return degrees - 360.0 * std::round(degrees / 360.0);
}

// Planetographic latitudes and west longitudes; the longitudes of Uranus play no part.
TEST(MagnitudesAgainstHorizons, SubPointsOfThePublishedCases) {
  struct Case {
    BodyId planet;
    const char* utc;
    double observer_longitude, observer_latitude, sun_longitude, sun_latitude, ratio;
  };
  constexpr double kMars = 3396.19 / 3376.20;
  const FromTheEarth earth;
  for (const Case& c :
       {Case{body::mars, "2003-08-28T00:00:00", 329.27, -19.00, 330.76, -23.74, kMars},
        Case{body::mars, "2004-07-19T00:00:00", 76.84, 20.10, 64.66, 22.38, kMars},
        Case{body::saturn, "2032-12-25T00:00:00", 285.41, -31.19, 285.39, -31.31, kSaturnEquatorialOverPolarRadius},
        Case{body::saturn, "2026-09-18T00:00:00", 169.17, -9.82, 170.95, -9.14, kSaturnEquatorialOverPolarRadius},
        Case{body::uranus, "2008-03-08T00:00:00", 26.79, 0.97, 26.76, 1.02, kUranusEquatorialOverPolarRadius}}) {
    const SubPoints points = sub_points(c.planet, earth.see(c.planet, c.utc)).value();
    EXPECT_NEAR(planetographic_latitude_deg(points.observer_latitude_deg, c.ratio), c.observer_latitude, 0.02) << c.utc;
    EXPECT_NEAR(planetographic_latitude_deg(points.sun_latitude_deg, c.ratio), c.sun_latitude, 0.02) << c.utc;
    if (c.planet == body::uranus) continue;
    EXPECT_NEAR(around(points.observer_longitude_deg - c.observer_longitude), 0.0, 0.2) << c.utc;
    EXPECT_NEAR(around(points.sun_longitude_deg - c.sun_longitude), 0.0, 0.2) << c.utc;
  }
}

TEST(MagnitudesAgainstHorizons, PublishedCasesFromVectors) {
  struct Case {
    BodyId planet;
    const char* utc;
    double v;
  };
  const FromTheEarth earth;
  for (const Case& c :
       {Case{body::mercury, "2006-06-15T00:00:00", 0.181}, Case{body::venus, "2005-12-14T00:00:00", -4.916},
        Case{body::mars, "2003-08-28T00:00:00", -2.862}, Case{body::mars, "2004-07-19T00:00:00", 1.788},
        Case{body::jupiter, "2004-09-21T00:00:00", -1.667}, Case{body::jupiter, "2010-09-21T00:00:00", -2.934},
        Case{body::saturn, "2032-12-25T00:00:00", -0.552}, Case{body::uranus, "2008-03-08T00:00:00", 6.025},
        Case{body::neptune, "2009-08-17T00:00:00", 7.701}}) {
    EXPECT_NEAR(*planet_v_magnitude(c.planet, earth.see(c.planet, c.utc)), c.v, 0.002) << c.utc;
  }
}

struct Row {
  std::string utc;
  double v, r_au, delta_au, phase_deg;
};

std::vector<Row> read_rows(const std::filesystem::path& path) {
  std::ifstream file(path);
  std::vector<Row> rows;
  for (std::string line; std::getline(file, line);) {
    std::istringstream in(line);
    std::string date, time;
    double v = 0, brightness = 0, r = 0, rdot = 0, delta = 0, deldot = 0, phase = 0;
    if (!(in >> date >> time >> v >> brightness >> r >> rdot >> delta >> deldot >> phase)) continue;
    if (date.size() != 11 || date[4] != '-') continue;
    const std::string months = "JanFebMarAprMayJunJulAugSepOctNovDec";
    const std::string month = std::to_string(months.find(date.substr(5, 3)) / 3 + 101).substr(1);
    rows.push_back({date.substr(0, 5) + month + date.substr(8) + "T" + time + ":00", v, r, delta, phase});
  }
  return rows;
}

// Horizons of 2019 had laws of its own: rms 0.03 mag for Venus, 0.05 for Mars (no terms for its rotation and season).
void compare(const std::filesystem::path& path, BodyId planet, double max_rms, double max_difference) {
  const FromTheEarth earth;
  std::vector<double> differences;
  const auto rows = read_rows(path);
  for (const Row& row : rows) {
    const Illumination geometry = earth.see(planet, row.utc);
    const PhaseGeometry g = phase_geometry(geometry);
    EXPECT_NEAR(g.r_au, row.r_au, 1e-6) << row.utc;
    EXPECT_NEAR(g.delta_au, row.delta_au, 1e-6) << row.utc;
    EXPECT_NEAR(g.phase_deg, row.phase_deg, 0.015) << row.utc;  // Horizons' is apparent: with aberration
    differences.push_back(*planet_v_magnitude(planet, geometry) - row.v);
    EXPECT_LE(std::abs(differences.back()), max_difference) << row.utc;
  }
  EXPECT_GE(rows.size(), 80u);
  EXPECT_LE(rms(differences), max_rms);
  ::testing::Test::RecordProperty("rms_mag", std::to_string(rms(differences)));
  ::testing::Test::RecordProperty("mean_mag", std::to_string(mean(differences)));
}

TEST(MagnitudesAgainstHorizons, Venus) {
  const auto path = ASTRONAV_SHARED_DATA("vectors/horizons/magnitude_Venus.txt");
  compare(path, body::venus, 0.04, 0.1);
}

TEST(MagnitudesAgainstHorizons, Mars) {
  const auto path = ASTRONAV_SHARED_DATA("vectors/horizons/magnitude_Mars.txt");
  compare(path, body::mars, 0.07, 0.15);
}

}  // namespace
}  // namespace astronav
