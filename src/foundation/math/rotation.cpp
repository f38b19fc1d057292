// SPDX-License-Identifier: Apache-2.0
#include "foundation/math/rotation.h"

#include <cmath>

namespace astronav {

Mat3 to_matrix(const Quaternion& q) {
  return Eigen::Quaterniond(q.w, q.x, q.y, q.z).normalized().toRotationMatrix();
}

Quaternion to_quaternion(const Mat3& R) {
  Eigen::Quaterniond q(R);
  q.normalize();
  if (q.w() < 0.0) q.coeffs() *= -1.0;
  return {q.w(), q.x(), q.y(), q.z()};
}

Mat3 cross_matrix(const Vec3& v) {
  Mat3 m;
  m << 0.0, -v.z(), v.y(), v.z(), 0.0, -v.x(), -v.y(), v.x(), 0.0;
  return m;
}

Mat3 rotation_exp(const Vec3& phi) {
  const double angle2 = phi.squaredNorm();
  const double angle = std::sqrt(angle2);
  // sin(a)/a and (1-cos a)/a^2, by series where the quotients lose digits.
  const double s = angle < 1e-4 ? 1.0 - angle2 / 6.0 : std::sin(angle) / angle;
  const double c = angle < 1e-4 ? 0.5 - angle2 / 24.0 : (1.0 - std::cos(angle)) / angle2;
  const Mat3 k = cross_matrix(phi);
  return Mat3::Identity() + s * k + c * k * k;
}

Vec3 rotation_log(const Mat3& R) {
  const Quaternion q = to_quaternion(R);
  const Vec3 v(q.x, q.y, q.z);
  const double n = v.norm();
  if (n < 1e-12) return 2.0 * v;
  return 2.0 * std::atan2(n, q.w) / n * v;
}

Vec3 direction_from_radec(double ra_rad, double dec_rad) {
  return {std::cos(dec_rad) * std::cos(ra_rad), std::cos(dec_rad) * std::sin(ra_rad), std::sin(dec_rad)};
}

RaDec radec_from_direction(const Vec3& d) {
  double ra = std::atan2(d.y(), d.x());
  if (ra < 0.0) ra += 2.0 * kPi;
  return {ra, std::atan2(d.z(), std::hypot(d.x(), d.y()))};
}

EastNorth east_north(const Vec3& direction) {
  const double rho = std::hypot(direction.x(), direction.y());
  // At a pole every direction is south (or north): the one of right ascension zero is taken.
  const double c = rho > 0.0 ? direction.x() / rho : 1.0;
  const double s = rho > 0.0 ? direction.y() / rho : 0.0;
  const Vec3 east(-s, c, 0.0);
  return {east, direction.normalized().cross(east)};
}

double angle_between(const Vec3& a, const Vec3& b) {
  return std::atan2(a.cross(b).norm(), a.dot(b));
}

Mat3 R_CN_from_pointing(const Pointing& p) {
  const Vec3 z = direction_from_radec(p.ra_rad, p.dec_rad);
  const Vec3 east(-std::sin(p.ra_rad), std::cos(p.ra_rad), 0.0);
  const Vec3 north = z.cross(east);
  const Vec3 up = std::cos(p.roll_rad) * north + std::sin(p.roll_rad) * east;
  Mat3 R;
  R.row(0) = z.cross(up).transpose();  // right: seen from inside the sphere, east is to the left of north
  R.row(1) = -up.transpose();
  R.row(2) = z.transpose();
  return R;
}

Pointing pointing_from_R_CN(const Mat3& R_CN) {
  const Vec3 z = R_CN.row(2).transpose();
  const Vec3 up = -R_CN.row(1).transpose();
  const RaDec at = radec_from_direction(z);
  const Vec3 east(-std::sin(at.ra_rad), std::cos(at.ra_rad), 0.0);
  const Vec3 north = z.cross(east);
  double roll = std::atan2(up.dot(east), up.dot(north));
  if (roll < 0.0) roll += 2.0 * kPi;
  return {at.ra_rad, at.dec_rad, roll};
}

}  // namespace astronav
