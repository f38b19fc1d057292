// SPDX-License-Identifier: Apache-2.0
// PairIndex: pairs of stars by the angle between them (k-vector, Mortari 1997), in one flat block of bytes that a
// flight computer can map. docs/formats.md; built on the ground by build_pair_index().
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "foundation/base/error.h"
#include "foundation/math/linear.h"
#include "onboard/vision/star_field.h"

namespace astronav::vision {

// Which stars make asterisms. Going from the brightest down, a star is taken if fewer than `neighbours` are taken
// already within `radius_rad` of it: the list is then even over the sky, however narrow the field.
struct AsterismSettings {
  double max_angle_rad = 0.0;  // longest pair
  double radius_rad = 0.0;
  int neighbours = 4;
  double max_v_mag = 9.0;
  // For a camera: a quarter of its shorter field as radius, its diagonal (at most 20 degrees) as longest pair.
  static AsterismSettings for_field(double fov_h_rad, double fov_v_rad);
};

// On the ground: these allocate.
std::vector<std::uint32_t> choose_asterism_stars(const StarField& field, const AsterismSettings& settings);
std::vector<std::byte> build_pair_index(const StarField& field, const AsterismSettings& settings);

class PairIndex {
 public:
  struct Pair {
    std::uint16_t a = 0, b = 0;
  };
  struct IndexStar {
    float direction_N[3];
    float v_mag;
    std::uint32_t catalogue_index;
  };

  // Checks every count against the size of the block. The bytes (aligned to 8) must outlive the object.
  static Result<PairIndex> open(std::span<const std::byte> bytes);

  // Pairs whose cosine may lie within [cos_min, cos_max]; a few beyond it are among them.
  std::span<const Pair> pairs(double cos_min, double cos_max) const;
  std::size_t star_count() const { return stars_.size(); }
  std::size_t pair_count() const { return pairs_.size(); }
  Vec3 direction(std::uint32_t star) const {
    const float* d = stars_[star].direction_N;
    return {d[0], d[1], d[2]};
  }
  const IndexStar& star(std::uint32_t index) const { return stars_[index]; }
  double max_angle_rad() const { return max_angle_rad_; }
  double radius_rad() const { return radius_rad_; }
  int neighbours() const { return neighbours_; }

 private:
  std::span<const IndexStar> stars_;
  std::span<const std::uint32_t> first_;  // pair of each slot of the cosine, and the end
  std::span<const Pair> pairs_;
  double max_angle_rad_ = 0.0, radius_rad_ = 0.0;
  int neighbours_ = 0;
  double cos_first_ = 0.0, slots_per_cos_ = 0.0;
};

}  // namespace astronav::vision
