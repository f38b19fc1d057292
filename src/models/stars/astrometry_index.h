// SPDX-License-Identifier: Apache-2.0
// Reads the stars of an index file of astrometry.net that was made from Tycho-2: Debian's packages
// astrometry-data-tycho2-* put them at /usr/share/astrometry/index-tycho2-*.fits. FITS binary tables; the places are
// the data of a kd-tree (32-bit integers over the cube from -1 to 1), the magnitudes are the column MAG_VT.
#pragma once

#include <cstddef>
#include <span>
#include <vector>

#include "foundation/base/error.h"
#include "models/stars/catalogue.h"

namespace astronav {

bool is_fits(std::span<const std::byte> bytes);

// At J2000.0 without proper motion, parallax and colour; `id` is 1e9 + the row. V = VT - 0.07, as for a star of B-V
// 0.66 (kVtMinusV); 68 % of stars are within 0.09 mag of that. corrupt_data and unsupported with the byte.
Result<std::vector<Star>> read_astrometry_index(std::span<const std::byte> file);

inline constexpr double kVtMinusV = 0.07;

}  // namespace astronav
