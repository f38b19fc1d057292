// SPDX-License-Identifier: Apache-2.0
#include "simulator/motion/turn.h"

#include <algorithm>

#include "foundation/base/check.h"
#include "foundation/math/rotation.h"

namespace astronav::motion {

Turn::Turn(Epoch begin, const Mat3& R_BN_begin, Epoch end, const Mat3& R_BN_end)
    : begin_(begin), end_(end), R_begin_(R_BN_begin), angle_rad_(-rotation_log(R_BN_end * R_BN_begin.transpose())) {
  ASTRONAV_CHECK(begin < end);
}

double Turn::share(Epoch epoch) const {
  const double s = std::clamp((epoch - begin_).seconds() / (end_ - begin_).seconds(), 0.0, 1.0);
  return s * s * s * (10.0 + s * (6.0 * s - 15.0));
}

Mat3 Turn::R_BN(Epoch epoch) const {
  return rotation_exp(-angle_rad_ * share(epoch)) * R_begin_;
}

Vec3 Turn::mean_rate_rad_s(Epoch from, Epoch to) const {
  return angle_rad_ * ((share(to) - share(from)) / (to - from).seconds());
}

}  // namespace astronav::motion
