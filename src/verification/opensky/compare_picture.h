// SPDX-License-Identifier: Apache-2.0
// A picture, its rendering and their difference, side by side.
#pragma once

#include <cstdint>

#include "foundation/image/image.h"
#include "verification/opensky/compare.h"

namespace astronav::opensky {

// Left the picture, in the middle the rendering with the same stretch (asinh, from 3 sigma below the sky to what the
// unsaturated stars reach), right the difference, grey where there is none, black and white at -8 and +8 sigma.
Image<std::uint8_t> side_by_side(const ImageF& picture_dn, const Comparison& comparison);

}  // namespace astronav::opensky
