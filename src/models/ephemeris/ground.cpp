// SPDX-License-Identifier: Apache-2.0
#include "models/ephemeris/ground.h"

#include <erfa.h>

namespace astronav {

State ground_state(const GroundSite& site, Epoch epoch) {
  const Epoch::JulianDate tt = epoch.julian_date(TimeScale::tt);
  const Epoch::JulianDate utc = epoch.julian_date(TimeScale::utc);
  double celestial_to_intermediate[3][3];
  eraC2i06a(tt.jd1, tt.jd2, celestial_to_intermediate);
  double pv[2][3];
  eraPvtob(site.longitude_rad, site.latitude_rad, site.height_m, 0.0, 0.0, eraSp00(tt.jd1, tt.jd2),
           eraEra00(utc.jd1, utc.jd2), pv);
  eraTrxpv(celestial_to_intermediate, pv, pv);
  return {Vec3(pv[0][0], pv[0][1], pv[0][2]), Vec3(pv[1][0], pv[1][1], pv[1][2])};
}

}  // namespace astronav
