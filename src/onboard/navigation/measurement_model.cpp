// SPDX-License-Identifier: Apache-2.0
#include "onboard/navigation/measurement_model.h"

#include <algorithm>
#include <cmath>

#include "foundation/math/rotation.h"
#include "models/aberration/aberration.h"

namespace astronav::navigation {
namespace {

constexpr double c = kSpeedOfLight;

// lambert_shift over the sine of the phase angle: smooth at full phase, where the shift itself vanishes.
double lambert_shift_over_sine(double alpha) {
  const double a = std::min(alpha, kPi - 1e-3);  // a new planet is a 0/0, and not seen
  return 3.0 * kPi / 16.0 * (1.0 + std::cos(a)) / (std::sin(a) + (kPi - a) * std::cos(a));
}

}  // namespace

double lambert_shift(double phase_angle_rad) {
  return lambert_shift_over_sine(phase_angle_rad) * std::sin(std::min(phase_angle_rad, kPi - 1e-3));
}

Sight apparent_sight(const State& observer, const State& body, const Vec3& p_sun_O_N, double radius_m,
                     const SightSettings& settings, const Vec3& other_acceleration_m_s2) {
  Sight sight;

  // Light time: |d + V tau| = c tau with d from body to observer is a quadratic equation (eq. 4); the body's
  // acceleration is put in afterwards (eq. 5), since it changes tau itself by less than 0.1 ms: metres of the planet's
  // way.
  const Vec3 d = observer.p_m - body.p_m;
  Vec3 v_emission = body.v_m_s;
  Vec3 l = -d;
  if (settings.light_time) {
    const double dv = d.dot(body.v_m_s);
    const double c2_v2 = c * c - body.v_m_s.squaredNorm();
    sight.light_time_s = (dv + std::sqrt(dv * dv + c2_v2 * d.squaredNorm())) / c2_v2;
    const Vec3 from_sun = body.p_m - p_sun_O_N;
    const double r = from_sun.norm();
    const Vec3 acceleration = other_acceleration_m_s2 - body_constants(body::sun)->gm_m3_s2 / (r * r * r) * from_sun;
    const double tau = sight.light_time_s;
    l += -body.v_m_s * tau + 0.5 * tau * tau * acceleration;
    v_emission -= acceleration * tau;
  }
  sight.p_body_from_observer_N = l;
  sight.distance_m = l.norm();

  if (settings.centre_of_light) {
    const Vec3 s = l / sight.distance_m;
    const Vec3 to_sun = (p_sun_O_N - observer.p_m - l).normalized();
    const double alpha = std::acos(std::clamp(-s.dot(to_sun), -1.0, 1.0));
    const Vec3 shift_m =
        settings.centre_of_light_scale * radius_m * lambert_shift_over_sine(alpha) * (to_sun - s * s.dot(to_sun));
    sight.shift_N = shift_m / sight.distance_m;
    l += shift_m;
  }
  const Vec3 s = l.normalized();

  // ds/dr (eq. 6). The shift is carried along unchanged: it turns with r only by its own size over the distance.
  Mat3 dl_dr = -Mat3::Identity();
  if (settings.light_time) dl_dr += v_emission * s.transpose() / (c + s.dot(v_emission));
  const Mat3 across = Mat3::Identity() - s * s.transpose();
  sight.by_position = across * dl_dr / l.norm();
  sight.by_velocity.setZero();
  sight.direction_N = s;

  if (settings.aberration) {
    Mat3 by_s, by_v;
    // Exact: the term of second order is 0.6 milliarcseconds at 30 km/s and 26 at 200.
    sight.direction_N = aberrate(s, observer.v_m_s, &by_s, &by_v);
    sight.by_position = (by_s * sight.by_position).eval();
    sight.by_velocity = by_v;
  }
  return sight;
}

Result<PixelPrediction> predict_pixel(const Sight& sight, const Mat3& R_CN, const Intrinsics& camera,
                                      const Eigen::Vector4d& xi_c) {
  Intrinsics corrected = camera;
  corrected.fx_px *= 1.0 + xi_c[0];
  corrected.fy_px *= 1.0 + xi_c[0];
  corrected.distortion.k1 += xi_c[1];

  const Vec3 direction_C = R_CN * sight.direction_N;
  Mat23 by_direction_C;
  IntrinsicsJacobian by_intrinsics;
  const Result<Pixel> pixel = project(corrected, direction_C, &by_direction_C, &by_intrinsics);
  if (!pixel) return forward(pixel);

  PixelPrediction prediction;
  prediction.sight = sight;
  prediction.pixel = pixel->vec() + xi_c.tail<2>();
  prediction.by_direction = by_direction_C * R_CN;
  prediction.by_position = prediction.by_direction * sight.by_position;
  prediction.by_velocity = prediction.by_direction * sight.by_velocity;
  prediction.by_attitude = by_direction_C * cross_matrix(direction_C);
  prediction.by_camera.col(0) = camera.fx_px * by_intrinsics.col(0) + camera.fy_px * by_intrinsics.col(1);
  prediction.by_camera.col(1) = by_intrinsics.col(4);
  prediction.by_camera.rightCols<2>().setIdentity();
  return prediction;
}

}  // namespace astronav::navigation
