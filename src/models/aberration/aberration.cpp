// SPDX-License-Identifier: Apache-2.0
#include "models/aberration/aberration.h"

#include <cmath>

namespace astronav {
namespace {

constexpr double kLightSpeed = 299792458.0;  // m/s

}  // namespace

Vec3 aberrate(const Vec3& direction, const Vec3& velocity_m_s, Mat3* by_direction, Mat3* by_velocity) {
  const Vec3 beta = velocity_m_s / kLightSpeed;
  const double b = std::sqrt(1.0 - beta.squaredNorm());  // 1 / gamma
  const double g = 1.0 / (1.0 + b);
  const double along = direction.dot(beta);
  const double doppler = 1.0 + along;
  const Vec3 apparent = (b * direction + (1.0 + g * along) * beta) / doppler;
  if (by_direction != nullptr) {
    *by_direction = (b * Mat3::Identity() + (g * beta - apparent) * beta.transpose()) / doppler;
  }
  if (by_velocity != nullptr) {
    const Vec3 g_slope = g * g / b * beta;  // dg/dbeta; db/dbeta = -beta/b
    *by_velocity = (Mat3((1.0 + g * along) * Mat3::Identity()) - direction * beta.transpose() / b +
                    beta * (g * direction + along * g_slope).transpose() - apparent * direction.transpose()) /
                   (doppler * kLightSpeed);
  }
  return apparent.normalized();
}

Vec3 unaberrate(const Vec3& apparent, const Vec3& velocity_m_s) {
  return aberrate(apparent, -velocity_m_s);
}

Vec3 aberrate_first_order(const Vec3& direction, const Vec3& velocity_m_s, Mat3* by_direction, Mat3* by_velocity) {
  const Vec3 beta = velocity_m_s / kLightSpeed;
  const double along = direction.dot(beta);
  if (by_direction != nullptr) *by_direction = (1.0 - along) * Mat3::Identity() - direction * beta.transpose();
  if (by_velocity != nullptr) *by_velocity = (Mat3::Identity() - direction * direction.transpose()) / kLightSpeed;
  return (direction + beta - along * direction).normalized();
}

ApparentMotion aberrate_motion(const Vec3& p_m, const Vec3& v_m_s, const Vec3& observer_velocity_m_s,
                               const Vec3& observer_acceleration_m_s2) {
  const double distance = p_m.norm();
  if (distance == 0.0) return {p_m, v_m_s};
  const Vec3 direction = p_m / distance;
  const double range_rate = direction.dot(v_m_s);
  const Vec3 direction_rate = (v_m_s - range_rate * direction) / distance;
  Mat3 by_direction, by_velocity;
  const Vec3 apparent = aberrate(direction, observer_velocity_m_s, &by_direction, &by_velocity);
  return {distance * apparent, range_rate * apparent + distance * (by_direction * direction_rate +
                                                                   by_velocity * observer_acceleration_m_s2)};
}

}  // namespace astronav
