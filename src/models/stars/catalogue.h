// SPDX-License-Identifier: Apache-2.0
// StarCatalogue: the stars, read in place from the bytes of an astronav catalogue file (docs/formats.md).
#pragma once

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

 private:
  std::span<const std::byte> bytes_;
  std::size_t cell_count_ = 0;
  std::size_t size_ = 0;
};

// Unit vector (N) towards a star at an epoch from a place (barycentric, metres): uniform motion in space, so along a
// great circle, parallax, and the travel time of light across the solar system; no aberration. The same as SOFA's Pmpx.
// Radial velocity is not known to the catalogue and taken as zero, a negative parallax as none.
Vec3 star_direction(const Star& star, Epoch epoch, const Vec3& p_observer_O_N);

}  // namespace astronav
