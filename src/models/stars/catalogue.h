// SPDX-License-Identifier: Apache-2.0
// StarCatalogue: the stars, read in place from the bytes of an astronav catalogue file (docs/formats.md).
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <string_view>

#include "foundation/base/error.h"
#include "foundation/math/linear.h"
#include "foundation/time/epoch.h"

namespace astronav {

struct Star {
  std::uint32_t id = 0;              // Hipparcos number, or 1e9 + a running number for stars of other catalogues
  Vec3 direction_N = Vec3::UnitZ();  // unit vector at J2000.0 (ICRS), as seen from the solar-system barycentre
  double pm_ra_cosdec_rad_yr = 0;    // proper motion
  double pm_dec_rad_yr = 0;
  double parallax_rad = 0;  // as measured: may be negative
  float v_mag = 0;
  float b_v = 0;  // B-V; NaN where unknown
};

class StarCatalogue {
 public:
  // Refuses a broken or truncated file with the byte offset. The bytes must outlive the object. Reads every byte once.
  static Result<StarCatalogue> open(std::span<const std::byte> file);

  std::size_t size() const { return size_; }
  std::string_view source() const;     // what the file says of its origin
  Star star(std::size_t index) const;  // index < size(); in file order (cells of the sky, bright first within each)
  // Index of the star with this number, if there is one. A linear search.
  std::optional<std::size_t> find(std::uint32_t id) const;

  // Indices of all stars within `radius_rad` of the unit vector `center_N` (J2000 places) not fainter than `max_v_mag`,
  // into `out`; returns how many there are, which can be more than fit. Does not allocate. Stars that proper motion
  // carries over the edge are the caller's business (enlarge the radius).
  std::size_t cone(const Vec3& center_N, double radius_rad, double max_v_mag, std::span<std::uint32_t> out) const;
  // The same with the stars themselves.
  std::size_t stars_in_cone(const Vec3& center_N, double radius_rad, double max_v_mag, std::span<Star> out) const;

 private:
  template <typename Take>
  std::size_t search(const Vec3& center_N, double radius_rad, double max_v_mag, Take&& take) const;

  std::span<const std::byte> bytes_;
  std::size_t cell_count_ = 0;
  std::size_t size_ = 0;
};

// Unit vector (N) towards a star at an epoch from a place (barycentric, metres): uniform motion in space, so along a
// great circle, parallax, and the travel time of light across the solar system; no aberration. The same as SOFA's Pmpx.
// Radial velocity is not known to the catalogue and taken as zero, a negative parallax as none.
Vec3 star_direction(const Star& star, Epoch epoch, const Vec3& p_observer_O_N);

// The same for many stars: what they share is computed once.
class StarPlaces {
 public:
  StarPlaces(Epoch epoch, const Vec3& p_observer_O_N)
      : years_(epoch.julian_years_since_j2000()),
        p_au_(p_observer_O_N / kMetresPerAu),
        p_light_years_(p_observer_O_N / kMetresPerLightYear) {}
  Vec3 direction(const Star& star) const {
    const Vec3& d = star.direction_N;
    const auto [x, y, z] =
        displaced(d.x(), d.y(), d.z(), star.pm_ra_cosdec_rad_yr, star.pm_dec_rad_yr, std::max(star.parallax_rad, 0.0));
    return Vec3(x, y, z).normalized();
  }
  // Along the direction, of a length near 1, of one star (Real = double) or of several side by side (an Eigen::Array):
  // from the unit vector at J2000, the motion to the east and to the north (rad/yr) and the parallax (rad, not below
  // 0).
  template <typename Real>
  std::array<Real, 3> displaced(const Real& x, const Real& y, const Real& z, const Real& pm_east, const Real& pm_north,
                                const Real& parallax) const {
    using std::sqrt;
    // Unit vectors to the east, (-y, x, 0)/rho, and to the north, (-xz, -yz, rho^2)/rho; at a pole, where east has no
    // meaning, proper motion is not defined either.
    const Real rho2 = x * x + y * y + 1e-24;
    // Light passes the observer earlier than the barycentre by d.p/c; the catalogue's motion counts at the barycentre.
    const Real time = (years_ + x * p_light_years_.x() + y * p_light_years_.y() + z * p_light_years_.z()) / sqrt(rho2);
    const Real east = pm_east * time;
    const Real north = pm_north * time;
    return {x - east * y - north * x * z - parallax * p_au_.x(), y + east * x - north * y * z - parallax * p_au_.y(),
            z + north * rho2 - parallax * p_au_.z()};
  }

 private:
  static constexpr double kMetresPerAu = 149597870700.0;                         // IAU 2012 B2
  static constexpr double kMetresPerLightYear = 299792458.0 * 365.25 * 86400.0;  // Julian year
  double years_;
  Vec3 p_au_;
  Vec3 p_light_years_;
};

}  // namespace astronav
