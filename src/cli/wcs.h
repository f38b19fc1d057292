// SPDX-License-Identifier: Apache-2.0
// The world coordinates of a picture as FITS cards.
#pragma once

#include <vector>

#include "foundation/math/linear.h"
#include "foundation/raster/raster.h"
#include "models/camera/camera.h"

namespace astronav::cli {

// TAN, with SIP polynomials (Shupe et al. 2005) where the camera distorts. `mirrored`: the picture's columns run the
// other way, u_picture = width - 1 - u.
std::vector<FitsCard> wcs_cards(const Intrinsics& camera, const Mat3& R_CN, bool mirrored = false);

}  // namespace astronav::cli
