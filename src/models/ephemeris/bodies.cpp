// SPDX-License-Identifier: Apache-2.0
#include "models/ephemeris/bodies.h"

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <cstdio>

#include "foundation/base/nearest_word.h"

namespace astronav {
namespace {

struct Name {
  std::int32_t id;
  std::string_view name;
};

// The first name of a number is the one that is written; the others are read. After NAIF's "NAIF Integer ID codes".
constexpr std::array kNames = std::to_array<Name>({
    {0, "solar system barycenter"},
    {0, "ssb"},
    {1, "mercury barycenter"},
    {2, "venus barycenter"},
    {3, "earth-moon barycenter"},
    {3, "emb"},
    {3, "earth barycenter"},
    {4, "mars barycenter"},
    {5, "jupiter barycenter"},
    {6, "saturn barycenter"},
    {7, "uranus barycenter"},
    {8, "neptune barycenter"},
    {9, "pluto barycenter"},
    {10, "sun"},
    {199, "mercury"},
    {299, "venus"},
    {399, "earth"},
    {301, "moon"},
    {499, "mars"},
    {401, "phobos"},
    {402, "deimos"},
    {599, "jupiter"},
    {501, "io"},
    {502, "europa"},
    {503, "ganymede"},
    {504, "callisto"},
    {699, "saturn"},
    {601, "mimas"},
    {602, "enceladus"},
    {603, "tethys"},
    {604, "dione"},
    {605, "rhea"},
    {606, "titan"},
    {608, "iapetus"},
    {799, "uranus"},
    {701, "ariel"},
    {702, "umbriel"},
    {703, "titania"},
    {704, "oberon"},
    {705, "miranda"},
    {899, "neptune"},
    {801, "triton"},
    {999, "pluto"},
    {901, "charon"},
    {2000001, "ceres"},
    {2000002, "pallas"},
    {2000003, "juno"},
    {2000004, "vesta"},
    {2000006, "hebe"},
    {2000007, "iris"},
    {2000008, "flora"},
    {2000009, "metis"},
    {2000010, "hygiea"},
    {2000015, "eunomia"},
    {2000016, "psyche"},
    {2000021, "lutetia"},
    {2000029, "amphitrite"},
    {2000243, "ida"},
    {2000253, "mathilde"},
    {2000433, "eros"},
    {2000511, "davida"},
    {2000704, "interamnia"},
    {2000951, "gaspra"},
    {2002867, "steins"},
    {2025143, "itokawa"},
    {2065803, "didymos"},
    {2099942, "apophis"},
    {2101955, "bennu"},
    {2162173, "ryugu"},
    {2050000, "quaoar"},
    {2090377, "sedna"},
    {2090482, "orcus"},
    {2136108, "haumea"},
    {2136199, "eris"},
    {2136472, "makemake"},
    {-31, "voyager 1"},
    {-32, "voyager 2"},
    {-96, "parker solar probe"},
    {-98, "new horizons"},
    {-203, "dawn"},
    {-226, "rosetta"},
});

struct Constants {
  std::int32_t id;
  double gm_km3_s2;
  double a_km, b_km, c_km;  // radii of the ellipsoid
};

// GM: DE440 as in NAIF's gm_de440.tpc (Park et al. 2021, and the satellite ephemerides for planets apart from their
// moons). Radii: IAU WGCCRE 2015 as in NAIF's pck00011.tpc. A barycentre has its planet's radii and its system's GM.
constexpr std::array kConstants = std::to_array<Constants>({
    {10, 1.3271244004127942e+11, 695700.0, 695700.0, 695700.0},
    {1, 2.2031868551400003e+04, 2440.53, 2440.53, 2438.26},
    {199, 2.2031868551400003e+04, 2440.53, 2440.53, 2438.26},
    {2, 3.2485859200000000e+05, 6051.8, 6051.8, 6051.8},
    {299, 3.2485859200000000e+05, 6051.8, 6051.8, 6051.8},
    {3, 4.0350323562548019e+05, 6378.1366, 6378.1366, 6356.7519},
    {399, 3.9860043550702266e+05, 6378.1366, 6378.1366, 6356.7519},
    {301, 4.9028001184575496e+03, 1737.4, 1737.4, 1737.4},
    {4, 4.2828375815756102e+04, 3396.19, 3396.19, 3376.20},
    {499, 4.282837362069909e+04, 3396.19, 3396.19, 3376.20},
    {5, 1.2671276409999998e+08, 71492.0, 71492.0, 66854.0},
    {599, 1.266865319003704e+08, 71492.0, 71492.0, 66854.0},
    {6, 3.7940584841799997e+07, 60268.0, 60268.0, 54364.0},
    {699, 3.793120623436167e+07, 60268.0, 60268.0, 54364.0},
    {7, 5.7945563999999985e+06, 25559.0, 25559.0, 24973.0},
    {799, 5.793951256527211e+06, 25559.0, 25559.0, 24973.0},
    {8, 6.8365271005803989e+06, 24764.0, 24764.0, 24341.0},
    {899, 6.835103145462294e+06, 24764.0, 24764.0, 24341.0},
    {9, 9.7550000000000000e+02, 1188.3, 1188.3, 1188.3},
    {999, 8.696138177608748e+02, 1188.3, 1188.3, 1188.3},
});

constexpr std::size_t kLongestName = 32;
struct Plain {
  std::array<char, kLongestName> text{};
  std::size_t size = 0;
  std::string_view view() const { return {text.data(), size}; }
};

// Lower case, one blank for '-', '_' and runs of blanks, "centre" as "center". What is too long is no name.
Plain plain(std::string_view s) {
  Plain out;
  bool gap = false;
  for (const char c : s) {
    if (c == ' ' || c == '-' || c == '_' || c == '\t') {
      gap = out.size > 0;
      continue;
    }
    if (out.size + 2 > kLongestName) return {};
    if (gap) out.text[out.size++] = ' ';
    gap = false;
    out.text[out.size++] = c >= 'A' && c <= 'Z' ? static_cast<char>(c - 'A' + 'a') : c;
  }
  constexpr std::string_view kBritish = "barycentre";
  if (out.view().ends_with(kBritish)) {
    out.text[out.size - 2] = 'e';
    out.text[out.size - 1] = 'r';
  }
  return out;
}

}  // namespace

std::optional<std::int32_t> asteroid_number(BodyId id) {
  if (id.value > 2'000'000 && id.value < 3'000'000) return id.value - 2'000'000;
  if (id.value > 20'000'000 && id.value < 50'000'000) return id.value - 20'000'000;
  return std::nullopt;
}

std::optional<BodyId> other_number(BodyId id) {
  const auto number = asteroid_number(id);
  if (!number || *number >= 1'000'000) return std::nullopt;
  return BodyId{id.value < 3'000'000 ? 20'000'000 + *number : 2'000'000 + *number};
}

std::string_view body_name(BodyId id) {
  if (id.value > 20'000'000) id = other_number(id).value_or(id);
  for (const Name& known : kNames) {
    if (known.id == id.value) return known.name;
  }
  return {};
}

Result<BodyId> parse_body(std::string_view text) {
  while (!text.empty() && text.front() == ' ') text.remove_prefix(1);
  while (!text.empty() && text.back() == ' ') text.remove_suffix(1);
  if (text.empty()) return fail(ErrorCode::invalid_argument, "a body is missing: give a name or a NAIF number");
  std::int32_t number = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), number);
  if (error == std::errc() && end == text.data() + text.size()) return BodyId{number};

  const Plain wanted = plain(text);
  for (const Name& known : kNames) {
    if (plain(known.name).view() == wanted.view()) return BodyId{known.id};
  }
  const std::string_view nearest =
      nearest_word(wanted.view(), kNames, [](const Name& known) { return known.name; })->name;
  // The error has one field for text: what was asked for and what is near share it.
  std::array<char, 160> said{};
  std::snprintf(said.data(), said.size(), "'%.*s' (the nearest name is '%.*s'; NAIF numbers are read too)",
                static_cast<int>(std::min<std::size_t>(text.size(), 60)), text.data(), static_cast<int>(nearest.size()),
                nearest.data());
  return fail(ErrorCode::not_found, "there is no body {s}", {}, {}, said.data());
}

std::optional<BodyId> barycenter_of(BodyId id) {
  if (id.value % 100 != 99 || id.value < 199 || id.value > 999 || id == body::earth) return std::nullopt;
  return BodyId{id.value / 100};
}

Result<BodyConstants> body_constants(BodyId id) {
  for (const Constants& known : kConstants) {
    if (known.id != id.value) continue;
    return BodyConstants{.gm_m3_s2 = known.gm_km3_s2 * 1e9,
                         .equatorial_radius_m = known.a_km * 1e3,
                         .mean_radius_m = std::cbrt(known.a_km * known.b_km * known.c_km) * 1e3};
  }
  return fail(ErrorCode::not_found, "the constants of body {0} are not known",
              {static_cast<double>(id.value), 0, 0, 0});
}

}  // namespace astronav
