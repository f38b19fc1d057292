// SPDX-License-Identifier: Apache-2.0
// Turn: from one attitude to another, from rest to rest about one axis: the angle goes as 10 s^3 - 15 s^4 + 6 s^5 of
// the time s, so that rate and acceleration are zero at both ends and a picture taken there is not smeared. The rate
// is 1.875 times the mean at most.
#pragma once

#include "foundation/math/linear.h"
#include "foundation/time/epoch.h"

namespace astronav::motion {

class Turn {
 public:
  // On the shorter way. At rest before and after.
  Turn(Epoch begin, const Mat3& R_BN_begin, Epoch end, const Mat3& R_BN_end);

  Epoch begin() const { return begin_; }
  Epoch end() const { return end_; }
  Mat3 R_BN(Epoch epoch) const;
  // Of B with respect to N, in B (rad/s), as a mean over an interval: exact, as the axis stands still.
  Vec3 mean_rate_rad_s(Epoch from, Epoch to) const;

 private:
  double share(Epoch epoch) const;  // of the angle

  Epoch begin_, end_;
  Mat3 R_begin_;
  Vec3 angle_rad_;
};

}  // namespace astronav::motion
