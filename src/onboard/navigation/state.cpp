// SPDX-License-Identifier: Apache-2.0
#include "onboard/navigation/state.h"

namespace astronav::navigation {

StateVector state_scales() {
  StateVector scales = StateVector::Ones();  // kg, relative errors, rad, px, seconds of the clock stay as they are
  scales.segment<3>(index::position).setConstant(unit::length_m);
  scales.segment<3>(index::velocity).setConstant(unit::velocity_m_s);
  scales.segment<3>(index::acceleration).setConstant(unit::acceleration_m_s2);
  scales.segment<2 * kBeaconBodies>(index::ephemeris).setConstant(unit::length_m);
  return scales;
}

}  // namespace astronav::navigation
