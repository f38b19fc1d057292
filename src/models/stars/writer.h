// SPDX-License-Identifier: Apache-2.0
// Writes the bytes of a star catalogue file (docs/formats.md).
#pragma once

#include <span>
#include <string>
#include <string_view>

#include "foundation/base/error.h"
#include "models/stars/catalogue.h"

namespace astronav {

// Stars at J2000.0, in any order; the same stars give the same bytes. `source` is cut to 32 bytes. out_of_range (names
// the star) for a value that the format cannot hold.
Result<std::string> write_star_catalogue(std::span<const Star> stars, std::string_view source);

}  // namespace astronav
