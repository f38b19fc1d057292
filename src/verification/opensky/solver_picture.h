// SPDX-License-Identifier: Apache-2.0
// A solved picture with what was found in it: stars in green circles, planets between orange brackets, spots that are
// neither in small red crosses. Dark and light by an inverse hyperbolic sine, so that faint and bright are seen.
#pragma once

#include "foundation/image/image.h"
#include "verification/opensky/solver.h"

namespace astronav::opensky {

// Red, green, blue in three columns a pixel, as encode_png_rgb() takes it.
Image<std::uint8_t> annotated(const Picture& picture, const Solution& solution);

}  // namespace astronav::opensky
