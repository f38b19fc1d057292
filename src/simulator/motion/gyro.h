// SPDX-License-Identifier: Apache-2.0
// Gyro: three axes that measure how fast the spacecraft turns, with white noise of the rate (the angle walks at random)
// and a bias that walks at random too: R. L. Farrenkopf 1978, J. Guid. Control 1(4), exact for samples of any length
// (J. L. Crassidis & J. L. Junkins, Optimal Estimation of Dynamic Systems, eq. 7.145).
#pragma once

#include "foundation/math/linear.h"
#include "foundation/math/random.h"

namespace astronav::motion {

struct GyroErrors {
  double angle_random_walk_rad_sqrt_s = 0.0;
  double bias_random_walk_rad_s_sqrt_s = 0.0;  // rad/s per sqrt(s)
  double bias_sigma_rad_s = 0.0;               // drawn when it is switched on, an axis
};

class Gyro {
 public:
  // Switched on.
  Gyro(const GyroErrors& errors, const StreamId& stream);

  // What a sample says of the true mean rate over its length.
  Vec3 measure(const Vec3& mean_rate_rad_s, double seconds);
  // As it is after the last sample.
  const Vec3& bias_rad_s() const { return bias_; }
  // A fault: the bias jumps by so much, in any direction.
  void jump(double size_rad_s);

 private:
  Vec3 normal3();

  GyroErrors errors_;
  RandomStream random_;
  Vec3 bias_;
};

}  // namespace astronav::motion
