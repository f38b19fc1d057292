// SPDX-License-Identifier: Apache-2.0
// What each star's spot has been off by so far, on the sky: companions that no catalogue knows, places that are wrong.
// No image tells a companion's pull of some hundredths of a pixel from noise; those of a window do. What is remembered
// says how far a star is to be believed, not where it is: if all stars of a field are off by the same, nobody can tell.
// docs/theory/vision.md, eq. 11c.
#pragma once

#include <cstdint>
#include <vector>

#include "onboard/vision/attitude.h"

namespace astronav::vision {

class StarMemory {
 public:
  // Of so many stars, by their index in the field. Allocates, once.
  explicit StarMemory(std::size_t stars) : seen_(stars) {}

  // What the star itself is expected to be off by: px^2, an axis. Of one never seen: that of AttitudeOptions.
  double expected_px2(std::uint32_t star) const;
  // What will be left of that after some more images in which its spot weighs so much (1/px^2, an axis).
  double lasting_px2(std::uint32_t star, double weight) const;
  // The first (eq. 11c) of one that was off by the square of so much in the mean of images which together weigh so much
  // (1/px^2, an axis).
  static double expected_px2(double weight, double off2_px2);
  static constexpr double kDoubleShare = 0.2;  // so many stars have a companion
  // After a fit in which it took part.
  void learn(std::uint32_t star, const StarSight& sight, const Mat3& R_CN, const Intrinsics& camera);

 private:
  struct Seen {
    float east_px = 0.0F, north_px = 0.0F;  // the mean of what it was off by
    float weight = 0.0F;                    // 1/px^2, an axis
  };
  std::vector<Seen> seen_;
  double sights_ = 0.0;  // that it learned from
};

}  // namespace astronav::vision
