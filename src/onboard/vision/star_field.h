// SPDX-License-Identifier: Apache-2.0
// StarField: the catalogue's stars to a limiting magnitude, ready for fast questions about any part of the sky.
//
// The unit cube around the sphere is cut into small cubes; stars are kept in the order of those. Directions are
// barycentric, at the field's epoch, N. Building allocates; asking does not.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "foundation/base/error.h"
#include "foundation/math/linear.h"
#include "foundation/time/epoch.h"
#include "models/aberration/aberration.h"
#include "models/stars/catalogue.h"

namespace astronav::vision {

// How the observer moves and where (barycentric, N); zero where it is not known.
struct Observer {
  Epoch epoch;
  Vec3 p_O_N = Vec3::Zero();  // m
  Vec3 v_O_N = Vec3::Zero();  // m/s
};

struct FieldStar {
  Vec3 direction_N;
  Eigen::Vector3f motion_rad_yr;  // tangential
  float parallax_rad = 0.0f;
  float v_mag = 0.0f;
  std::uint32_t catalogue_index = 0;
  std::uint32_t id = 0;
};

class StarField {
 public:
  static StarField build(const StarCatalogue& catalogue, double max_v_mag, Epoch epoch);
  // Some of these stars alone.
  StarField subset(std::span<const std::uint32_t> stars) const;

  std::span<const FieldStar> stars() const { return stars_; }
  Epoch epoch() const { return epoch_; }
  // Stars within `radius_rad` of `center_N`, in no order, as indices into stars(). Returns how many were written.
  std::size_t cone(const Vec3& center_N, double radius_rad, std::span<std::uint32_t> out) const;
  // The star nearest to a direction within `radius_rad` and not fainter than `max_v_mag`, or -1.
  std::int32_t nearest(const Vec3& direction_N, double radius_rad, double max_v_mag = 99.0) const;
  // Apparent unit vector (N): motion since the field's epoch, parallax and aberration.
  Vec3 apparent(const FieldStar& star, const Observer& observer) const;

 private:
  void arrange();
  template <typename Use>
  void visit(const Vec3& center, double radius, Use&& use) const;

  std::vector<FieldStar> stars_;
  std::vector<std::uint32_t> first_;  // of each cell, and the end
  int cells_ = 1;                     // along an edge
  Epoch epoch_;
};

// apparent() of many stars: what they share is computed once.
class ApparentPlaces {
 public:
  ApparentPlaces(const StarField& field, const Observer& observer)
      : years_((observer.epoch - field.epoch()).seconds() / kJulianYearS),
        p_au_(observer.p_O_N / kMetresPerAu),
        aberration_(observer.v_O_N) {}
  Vec3 of(const FieldStar& star) const {
    const Vec3 at =
        star.direction_N + star.motion_rad_yr.cast<double>() * years_ - p_au_ * static_cast<double>(star.parallax_rad);
    const auto [x, y, z] = aberration_.apparent(at.x(), at.y(), at.z());
    return {x, y, z};
  }

 private:
  static constexpr double kJulianYearS = 365.25 * 86400.0;
  static constexpr double kMetresPerAu = 149597870700.0;  // IAU 2012 B2
  double years_;
  Vec3 p_au_;
  Aberration aberration_;
};

}  // namespace astronav::vision
