// SPDX-License-Identifier: Apache-2.0
// Refraction: how the atmosphere lifts what an observer on the ground sees.
#pragma once

#include "foundation/math/linear.h"
#include "foundation/time/epoch.h"
#include "models/ephemeris/ground.h"

namespace astronav {

struct Atmosphere {
  double pressure_hpa = 1010.0;  // at the observer; 0: none
  double temperature_c = 10.0;
  double relative_humidity = 0.5;  // 0 to 1
  double wavelength_um = 0.55;
};

// dZ = A tan Z + B tan^3 Z with Z the observed zenith distance (SOFA's Refco; docs/theory/light-time-and-aberration.md
// eq. 6). Right to 0.1 arcsec to 70 degrees and 1 arcsec to 80; from 86 degrees on, and below the horizon, the bend of
// 86 degrees is kept, as nothing is known there without a sounding of the air.
class Refraction {
 public:
  Refraction() = default;  // none
  // The zenith is the unit vector (N) normal to the ellipsoid, upwards.
  Refraction(const Atmosphere& atmosphere, const Vec3& zenith_N);

  // From the direction that arrives above the air, aberration included, to the one that is seen; unit vectors (N).
  Vec3 refract(const Vec3& direction_N) const;
  // The inverse.
  Vec3 unrefract(const Vec3& seen_N) const;
  const Vec3& zenith_N() const { return zenith_N_; }

 private:
  double bend(double seen_zenith_distance_rad) const;
  Vec3 zenith_N_ = Vec3::UnitZ();
  double a_ = 0.0;
  double b_ = 0.0;
};

// The zenith (N) of a place at an epoch: normal of the ellipsoid WGS84, turned as in ground_state().
Vec3 ground_zenith(const GroundSite& site, Epoch epoch);

}  // namespace astronav
