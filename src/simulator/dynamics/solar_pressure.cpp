// SPDX-License-Identifier: Apache-2.0
#include "simulator/dynamics/solar_pressure.h"

#include <algorithm>
#include <cmath>

#include "foundation/base/check.h"

namespace astronav::dynamics {
namespace {

bool is_unit(const Vec3& v) {
  return std::abs(v.squaredNorm() - 1.0) < 1e-9;
}

// Right-handed axes: the first along `a`, the second in the plane of a and b, on the side of b.
Mat3 axes_of(const Vec3& a, const Vec3& b) {
  Mat3 axes;
  axes.col(0) = a.normalized();
  axes.col(2) = a.cross(b).normalized();
  axes.col(1) = axes.col(2).cross(axes.col(0));
  return axes;
}

}  // namespace

std::vector<Plate> box_wing(const Vec3& edges_m, double box_specular, double box_diffuse, double wing_area_m2,
                            const Vec3& hinge_B, double wing_specular, double wing_diffuse) {
  std::vector<Plate> plates;
  for (int axis = 0; axis < 3; ++axis) {
    const double area = edges_m[(axis + 1) % 3] * edges_m[(axis + 2) % 3];
    for (const double side : {1.0, -1.0}) {
      plates.push_back(
          {.area_m2 = area, .normal_B = side * Vec3::Unit(axis), .specular = box_specular, .diffuse = box_diffuse});
    }
  }
  plates.push_back({.area_m2 = wing_area_m2, .specular = wing_specular, .diffuse = wing_diffuse, .hinge_B = hinge_B});
  return plates;
}

Result<void> check_plates(std::span<const Plate> plates) {
  for (std::size_t i = 0; i < plates.size(); ++i) {
    const Plate& p = plates[i];
    if (!std::isfinite(p.area_m2) || p.area_m2 < 0.0 || !(p.specular >= 0.0) || !(p.diffuse >= 0.0) ||
        !(p.specular + p.diffuse <= 1.0)) {
      return fail(ErrorCode::invalid_argument,
                  "plate {0}: the area ({1} m^2) must be zero or more, the shares mirrored ({2}) and scattered ({3}) "
                  "zero or more and together at most one",
                  {static_cast<double>(i), p.area_m2, p.specular, p.diffuse});
    }
    if (!is_unit(p.hinge_B.value_or(p.normal_B))) {
      return fail(ErrorCode::invalid_argument, "plate {0}: its normal or hinge is no unit vector",
                  {static_cast<double>(i)});
    }
  }
  return {};
}

Vec3 pressure_area(std::span<const Plate> plates, const Vec3& to_sun_B) {
  Vec3 sum = Vec3::Zero();
  for (const Plate& p : plates) {
    Vec3 normal = p.normal_B;
    if (p.hinge_B) {
      normal = to_sun_B - to_sun_B.dot(*p.hinge_B) * *p.hinge_B;
      const double length = normal.norm();
      if (length < 1e-12) continue;  // the Sun stands on the hinge: the array is seen from its edge
      normal /= length;
    }
    const double cosine = normal.dot(to_sun_B);
    if (cosine <= 0.0) continue;
    sum -=
        p.area_m2 * cosine * ((1.0 - p.specular) * to_sun_B + 2.0 * (p.specular * cosine + p.diffuse / 3.0) * normal);
  }
  return sum;
}

Attitude fixed_attitude(const Mat3& R_BN) {
  return [R_BN](Epoch, const Vec3&) { return R_BN; };
}

Attitude sun_pointing(const Vec3& axis_B, const Vec3& second_B) {
  ASTRONAV_CHECK(axis_B.cross(second_B).norm() > 1e-6);
  const Mat3 body = axes_of(axis_B, second_B);
  return [body](Epoch, const Vec3& to_sun_N) -> Mat3 {
    // With the Sun at the pole any roll will do; this one is continuous in every other direction.
    const bool at_pole = to_sun_N.cross(Vec3::UnitZ()).norm() < 1e-9;
    return body * axes_of(to_sun_N, at_pole ? Vec3::UnitX() : Vec3::UnitZ()).transpose();
  };
}

}  // namespace astronav::dynamics
