// SPDX-License-Identifier: Apache-2.0
// Ground: where a place on the Earth's surface is, relative to the Earth's centre.
#pragma once

#include "foundation/time/epoch.h"
#include "models/ephemeris/ephemeris.h"

namespace astronav {

// Geodetic, on the ellipsoid WGS84; east positive.
struct GroundSite {
  double latitude_rad = 0.0;
  double longitude_rad = 0.0;
  double height_m = 0.0;
};

// Relative to the Earth's centre (N, m and m/s). Precession and nutation of IAU 2006/2000A, rotation by the Earth
// rotation angle (SOFA: Pvtob, C2i06a, Era00). UT1 is taken as UTC, which is up to 0.9 s or 420 m at the equator; polar
// motion (10 m) is left out.
State ground_state(const GroundSite& site, Epoch epoch);

}  // namespace astronav
