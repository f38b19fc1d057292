// SPDX-License-Identifier: Apache-2.0
// Reads the published tables of the Hipparcos main catalogue (ESA 1997, CDS I/239, hip_main.dat) and of Tycho-2 (Hog et
// al. 2000, CDS I/259, tyc2.dat), one line a star, fields separated by '|', plain or gzip; indexes of astrometry.net
// made from Tycho-2 (astrometry_index.h); and catalogue files of our own.
#pragma once

#include <cstddef>
#include <span>
#include <string_view>
#include <vector>

#include "foundation/base/error.h"
#include "models/stars/catalogue.h"

namespace astronav {

enum class StarTableKind : unsigned char { hipparcos, tycho2, tycho2_index, catalogue };
std::string_view name(StarTableKind kind);

struct StarTable {
  StarTableKind kind = StarTableKind::hipparcos;
  std::vector<Star> stars;  // at J2000.0; `id` is the Hipparcos number, 0 where a Tycho-2 star has none
  std::size_t skipped = 0;  // lines without a place or without a magnitude
};

// Hipparcos: places move from J1991.25 to J2000.0; the 263 stars without an astrometric solution keep their place to
// 0.1 arcsec and get no motion. Tycho-2: V = VT - 0.090 (BT - VT), B-V = 0.850 (BT - VT) (Hog et al. 2000, valid for
// -0.2 < BT-VT < 1.8); stars without a mean place take the observed one; no parallax. Errors name the line.
Result<StarTable> read_star_table(std::span<const std::byte> table);

// One list with unique numbers. Hipparcos and catalogue files come first; a Tycho-2 star that carries a number of them
// is dropped, and one without a number gets 1e9 + a running number. The first line that bears a number keeps it. A star
// of an index has no number. It is left out where one of the others stands: within 10 arcsec (two observers' components
// of one double star, which count as one) and what that one moves in ten years, since some places are as of the
// observation, 1991; and if it is brighter than V 7, where Hipparcos is complete and places of the index go astray.
std::vector<Star> merge_star_tables(std::span<const StarTable> tables);

}  // namespace astronav
