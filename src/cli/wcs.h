// SPDX-License-Identifier: Apache-2.0
// The world coordinates of a picture as FITS cards, and back.
#pragma once

#include <map>
#include <string>
#include <vector>

#include "foundation/base/error.h"
#include "foundation/math/linear.h"
#include "foundation/raster/raster.h"
#include "models/camera/camera.h"

namespace astronav::cli {

// TAN of a pinhole, ARC of a fisheye, with SIP polynomials (Shupe et al. 2005) where the camera distorts. `mirrored`:
// the picture's columns run the other way, u_picture = width - 1 - u.
std::vector<FitsCard> wcs_cards(const Intrinsics& camera, const Mat3& R_CN, bool mirrored = false);

// The camera that sees the sky as a FITS header says (TAN or TAN-SIP, CD matrix): fitted to the header's map over the
// whole picture, its principal point in the middle. not_found where the header says nothing; unsupported for other
// projections, and where the camera is more than a tenth of a pixel off.
struct HeaderPlate {
  Intrinsics camera;
  Mat3 R_CN = Mat3::Identity();
  bool mirrored = false;
  double largest_error_px = 0.0;
};
Result<HeaderPlate> plate_from_header(const std::map<std::string, std::string>& header, int width, int height);

}  // namespace astronav::cli
