// SPDX-License-Identifier: Apache-2.0
// Bodies by their NAIF numbers, with names, gravitational parameters and radii.
#pragma once

#include <compare>
#include <cstdint>
#include <optional>
#include <string_view>

#include "foundation/base/error.h"

namespace astronav {

// A NAIF number: 0 is the solar-system barycentre, 10 the Sun, 399 the Earth, 3 the Earth-Moon barycentre.
struct BodyId {
  std::int32_t value = 0;
  constexpr auto operator<=>(const BodyId&) const = default;
};

namespace body {
inline constexpr BodyId solar_system_barycenter{0};
inline constexpr BodyId mercury_barycenter{1}, venus_barycenter{2}, earth_moon_barycenter{3}, mars_barycenter{4},
    jupiter_barycenter{5}, saturn_barycenter{6}, uranus_barycenter{7}, neptune_barycenter{8}, pluto_barycenter{9};
inline constexpr BodyId sun{10};
inline constexpr BodyId mercury{199}, venus{299}, earth{399}, moon{301}, mars{499}, jupiter{599}, saturn{699},
    uranus{799}, neptune{899}, pluto{999};
}  // namespace body

// Lower-case English name ("jupiter", "earth-moon barycenter"), or empty where the number is not in the table.
std::string_view body_name(BodyId id);
// A name (case, blanks, '-' and '_' alike) or a NAIF number as text; the error names the nearest known name.
Result<BodyId> parse_body(std::string_view text);
// The barycentre that stands in for a planet's centre where a kernel lacks it (599 -> 5; 399 -> none).
std::optional<BodyId> barycenter_of(BodyId id);

// The number in the catalogue of minor planets, for NAIF's numbers 2000000 + n (below a million) and 20000000 + n.
std::optional<std::int32_t> asteroid_number(BodyId id);
// 2000001 for 20000001 and back: kernels use either for the same body. None for other bodies.
std::optional<BodyId> other_number(BodyId id);

struct BodyConstants {
  double gm_m3_s2 = 0.0;             // DE440 (gm_de440.tpc)
  double equatorial_radius_m = 0.0;  // IAU 2015 (pck00011.tpc)
  double mean_radius_m = 0.0;
};
// For Sun, planets (centre or barycentre number), Moon and Pluto; not_found otherwise.
Result<BodyConstants> body_constants(BodyId id);

inline constexpr double kAstronomicalUnit = 149597870700.0;  // m, IAU 2012 B2
inline constexpr double kSpeedOfLight = 299792458.0;         // m/s

}  // namespace astronav
