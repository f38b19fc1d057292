// SPDX-License-Identifier: Apache-2.0
// The tables of states that NAIF's WebGeocalc wrote for 2022 (vectors/webgeocalc of the shared data), all 31 by name.
#pragma once

#include <array>
#include <filesystem>
#include <string>
#include <vector>

#include "models/ephemeris/ephemeris.h"

namespace astronav::testing {

enum class WebgeocalcCorrection { none, lt, lt_s };

struct WebgeocalcTable {
  const char* file;
  BodyId target;
  BodyId observer;
  WebgeocalcCorrection correction;
  bool needs_missing_kernel = false;  // Mars relative to its barycentre: no kernel at hand holds Mars' centre
};

struct WebgeocalcRow {
  Epoch epoch;
  State state;
  double light_time_s = 0.0;
};

inline constexpr auto kNone = WebgeocalcCorrection::none;
inline constexpr auto kLt = WebgeocalcCorrection::lt;
inline constexpr auto kLtS = WebgeocalcCorrection::lt_s;

inline constexpr std::array<WebgeocalcTable, 31> kWebgeocalcTables{{
    {"WGC_StateVector_20220727190826.csv", body::mercury, body::earth, kNone},
    {"WGC_StateVector_20220802230546.csv", body::venus, body::earth, kNone},
    {"WGC_StateVector_20220802225259.csv", body::mars, body::earth, kNone},
    {"WGC_StateVector_20220802221423.csv", body::jupiter, body::earth, kNone},
    {"WGC_StateVector_20220802225311.csv", body::saturn, body::earth, kNone},
    {"WGC_StateVector_20220802230606.csv", body::uranus, body::earth, kNone},
    {"WGC_StateVector_20220802230619.csv", body::neptune, body::earth, kNone},
    {"WGC_StateVector_20220802230632.csv", body::pluto, body::earth, kNone},
    {"WGC_StateVector_20220803165555.csv", body::mars, body::mars_barycenter, kNone, true},
    {"WGC_StateVector_20220803170949.csv", body::mars_barycenter, body::solar_system_barycenter, kNone},
    {"WGC_StateVector_20220812182335.csv", body::mercury, body::earth, kLt},
    {"WGC_StateVector_20220812183524.csv", body::venus, body::earth, kLt},
    {"WGC_StateVector_20220812183540.csv", body::mars, body::earth, kLt},
    {"WGC_StateVector_20220812183553.csv", body::jupiter, body::earth, kLt},
    {"WGC_StateVector_20220812183606.csv", body::saturn, body::earth, kLt},
    {"WGC_StateVector_20220812183634.csv", body::uranus, body::earth, kLt},
    {"WGC_StateVector_20220812183620.csv", body::neptune, body::earth, kLt},
    {"WGC_StateVector_20220812183650.csv", body::pluto, body::earth, kLt},
    {"WGC_StateVector_20220812183758.csv", body::mars, body::mars_barycenter, kLt, true},
    {"WGC_StateVector_20220816193347.csv", body::mars_barycenter, body::solar_system_barycenter, kLt},
    {"WGC_StateVector_20220816210748.csv", body::mercury, body::earth, kLtS},
    {"WGC_StateVector_20220816210929.csv", body::venus, body::earth, kLtS},
    {"WGC_StateVector_20220816210945.csv", body::moon, body::earth, kLtS},
    {"WGC_StateVector_20220816211000.csv", body::mars, body::earth, kLtS},
    {"WGC_StateVector_20220816211014.csv", body::jupiter, body::earth, kLtS},
    {"WGC_StateVector_20220816211027.csv", body::saturn, body::earth, kLtS},
    {"WGC_StateVector_20220816211041.csv", body::uranus, body::earth, kLtS},
    {"WGC_StateVector_20220816211053.csv", body::neptune, body::earth, kLtS},
    {"WGC_StateVector_20220816211107.csv", body::pluto, body::earth, kLtS},
    {"WGC_StateVector_20220816211205.csv", body::mars_barycenter, body::solar_system_barycenter, kLtS},
    {"WGC_StateVector_20220816211222.csv", body::solar_system_barycenter, body::mars_barycenter, kLtS},
}};

// Checks that the inputs which the file states are those of the table.
std::vector<WebgeocalcRow> read_webgeocalc(const std::filesystem::path& path, const WebgeocalcTable& table);

}  // namespace astronav::testing
