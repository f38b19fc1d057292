// SPDX-License-Identifier: Apache-2.0
#include "simulator/motion/gyro.h"

#include <cmath>

namespace astronav::motion {

Gyro::Gyro(const GyroErrors& errors, const StreamId& stream) : errors_(errors), random_(stream) {
  bias_ = errors_.bias_sigma_rad_s * normal3();
}

Vec3 Gyro::normal3() {
  const double x = random_.normal(), y = random_.normal(), z = random_.normal();
  return {x, y, z};
}

Vec3 Gyro::measure(const Vec3& mean_rate_rad_s, double seconds) {
  const double v = errors_.angle_random_walk_rad_sqrt_s, u = errors_.bias_random_walk_rad_s_sqrt_s;
  const Vec3 before = bias_;
  bias_ += u * std::sqrt(seconds) * normal3();
  return mean_rate_rad_s + 0.5 * (before + bias_) + std::sqrt(v * v / seconds + u * u * seconds / 12.0) * normal3();
}

void Gyro::jump(double size_rad_s) {
  bias_ += size_rad_s * normal3().normalized();
}

}  // namespace astronav::motion
