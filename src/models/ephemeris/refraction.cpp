// SPDX-License-Identifier: Apache-2.0
#include "models/ephemeris/refraction.h"

#include <algorithm>
#include <cmath>

#include <erfa.h>

#include "foundation/math/rotation.h"

namespace astronav {
namespace {

constexpr double kLowest = 86.0 * kDegree;  // zenith distance

// Turns a direction towards the zenith by an angle.
Vec3 lifted(const Vec3& direction, const Vec3& zenith, double angle) {
  const Vec3 across = zenith - direction * direction.dot(zenith);
  const double length = across.norm();
  if (!(length > 0.0)) return direction;
  return (std::cos(angle) * direction + std::sin(angle) / length * across).normalized();
}

}  // namespace

Refraction::Refraction(const Atmosphere& atmosphere, const Vec3& zenith_N) : zenith_N_(zenith_N.normalized()) {
  eraRefco(atmosphere.pressure_hpa, atmosphere.temperature_c, std::clamp(atmosphere.relative_humidity, 0.0, 1.0),
           atmosphere.wavelength_um, &a_, &b_);
}

double Refraction::bend(double seen_zenith_distance_rad) const {
  const double t = std::tan(std::clamp(seen_zenith_distance_rad, 0.0, kLowest));
  return (a_ + b_ * t * t) * t;
}

Vec3 Refraction::refract(const Vec3& direction_N) const {
  if (a_ == 0.0 && b_ == 0.0) return direction_N;
  const double arriving = angle_between(direction_N, zenith_N_);
  // The law knows the seen zenith distance. Each step gains a factor of 50 even at the lowest.
  double angle = 0.0;
  for (int i = 0; i < 8; ++i) angle = bend(arriving - angle);
  return lifted(direction_N, zenith_N_, angle);
}

Vec3 Refraction::unrefract(const Vec3& seen_N) const {
  if (a_ == 0.0 && b_ == 0.0) return seen_N;
  return lifted(seen_N, zenith_N_, -bend(angle_between(seen_N, zenith_N_)));
}

Vec3 ground_zenith(const GroundSite& site, Epoch epoch) {
  const Epoch::JulianDate tt = epoch.julian_date(TimeScale::tt);
  const Epoch::JulianDate utc = epoch.julian_date(TimeScale::utc);
  double celestial_to_intermediate[3][3];
  eraC2i06a(tt.jd1, tt.jd2, celestial_to_intermediate);
  const double angle = eraEra00(utc.jd1, utc.jd2) + eraSp00(tt.jd1, tt.jd2) + site.longitude_rad;
  double zenith[3] = {std::cos(site.latitude_rad) * std::cos(angle), std::cos(site.latitude_rad) * std::sin(angle),
                      std::sin(site.latitude_rad)};
  eraTrxp(celestial_to_intermediate, zenith, zenith);
  return {zenith[0], zenith[1], zenith[2]};
}

}  // namespace astronav
