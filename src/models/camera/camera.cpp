// SPDX-License-Identifier: Apache-2.0
#include "models/camera/camera.h"

#include <algorithm>
#include <cmath>

namespace astronav {
namespace {

// Distorted point and its (symmetric) derivative by the undistorted one.
struct Distorted {
  double x, y;
  double dx_dx, dx_dy, dy_dy;
  double determinant() const { return dx_dx * dy_dy - dx_dy * dx_dy; }
};

Distorted distort(const Distortion& d, double x, double y) {
  const double r2 = x * x + y * y;
  const double radial = 1.0 + r2 * (d.k1 + r2 * (d.k2 + r2 * d.k3));
  const double radial_by_r2 = d.k1 + r2 * (2.0 * d.k2 + r2 * 3.0 * d.k3);
  Distorted out;
  out.x = x * radial + 2.0 * d.p1 * x * y + d.p2 * (r2 + 2.0 * x * x);
  out.y = y * radial + d.p1 * (r2 + 2.0 * y * y) + 2.0 * d.p2 * x * y;
  out.dx_dx = radial + 2.0 * x * x * radial_by_r2 + 2.0 * d.p1 * y + 6.0 * d.p2 * x;
  out.dx_dy = 2.0 * x * y * radial_by_r2 + 2.0 * d.p1 * x + 2.0 * d.p2 * y;
  out.dy_dy = radial + 2.0 * y * y * radial_by_r2 + 6.0 * d.p1 * y + 2.0 * d.p2 * x;
  return out;
}

// Whether the distorted radius r (1 + k1 r2 + k2 r4 + k3 r6) still grows everywhere between the axis and r2: its
// derivative q(s) = 1 + 3 k1 s + 5 k2 s2 + 7 k3 s3 with s = r2 must be positive at the end and wherever q has a
// minimum.
bool radius_grows_up_to(const Distortion& d, double r2) {
  if (d.k1 >= 0.0 && d.k2 >= 0.0 && d.k3 >= 0.0) return true;
  const auto q = [&](double s) { return 1.0 + s * (3.0 * d.k1 + s * (5.0 * d.k2 + s * 7.0 * d.k3)); };
  if (!(q(r2) > 0.0)) return false;
  const double a = 21.0 * d.k3;
  const double b = 10.0 * d.k2;
  const double c = 3.0 * d.k1;
  const double discriminant = b * b - 4.0 * a * c;
  if (!(discriminant > 0.0)) return true;
  // Both roots of q' without cancellation.
  const double t = -0.5 * (b + std::copysign(std::sqrt(discriminant), b));
  for (const double s : {a != 0.0 ? t / a : -1.0, t != 0.0 ? c / t : -1.0}) {
    if (s > 0.0 && s < r2 && !(q(s) > 0.0)) return false;
  }
  return true;
}

bool one_to_one(const Distortion& d, double x, double y, const Distorted& there) {
  return there.dx_dx > 0.0 && there.determinant() > 0.0 && radius_grows_up_to(d, x * x + y * y);
}

tl::unexpected<Error> folded(double off_axis_rad) {
  return fail(ErrorCode::out_of_range,
              "the direction is {0} rad off the axis, where the camera's distortion folds over", {off_axis_rad});
}

Pixel pixel_of(const Intrinsics& camera, const Distorted& there) {
  return {camera.fx_px * there.x + camera.cx_px, camera.fy_px * there.y + camera.cy_px};
}

void differentiate_by_intrinsics(const Intrinsics& camera, double x, double y, const Distorted& there,
                                 IntrinsicsJacobian& J) {
  const double fx = camera.fx_px;
  const double fy = camera.fy_px;
  const double r2 = x * x + y * y;
  const double r4 = r2 * r2;
  const double r6 = r4 * r2;
  J << there.x, 0.0, 1.0, 0.0, fx * x * r2, fx * x * r4, fx * x * r6, fx * 2.0 * x * y, fx * (r2 + 2.0 * x * x),  //
      0.0, there.y, 0.0, 1.0, fy * y * r2, fy * y * r4, fy * y * r6, fy * (r2 + 2.0 * y * y), fy * 2.0 * x * y;
}

// docs/theory/camera.md eq. 2 and 6.
Result<Pixel> project_fisheye(const Intrinsics& camera, const Vec3& direction_C, Mat23* by_direction,
                              IntrinsicsJacobian* by_intrinsics) {
  const double X = direction_C.x();
  const double Y = direction_C.y();
  const double Z = direction_C.z();
  const double across2 = X * X + Y * Y;
  const double across = std::sqrt(across2);
  const double length2 = across2 + Z * Z;
  if (!(across > 0.0 || Z > 0.0)) {
    return fail(ErrorCode::out_of_range, "the direction lies right behind the camera (z = {0})", {Z});
  }
  // s = a / across, and g = (ds/d across) / across; near the axis by their series, where both would cancel.
  double s, g;
  if (Z > 0.0 && across < 1e-2 * Z) {
    const double t2 = across2 / (Z * Z);
    s = (1.0 - t2 * (1.0 / 3.0 - t2 * (1.0 / 5.0 - t2 * (1.0 / 7.0 - t2 / 9.0)))) / Z;
    g = -(2.0 / 3.0 - t2 * (4.0 / 5.0 - t2 * (6.0 / 7.0 - t2 * 8.0 / 9.0))) / (Z * Z * Z);
  } else {
    s = std::atan2(across, Z) / across;
    g = (Z / length2 - s) / across2;
  }
  const double x = X * s;
  const double y = Y * s;
  const Distorted there = distort(camera.distortion, x, y);
  if (!one_to_one(camera.distortion, x, y, there)) return folded(std::hypot(x, y));
  if (by_direction != nullptr) {
    Mat23 plane;
    plane << s + X * X * g, X * Y * g, -X / length2,  //
        X * Y * g, s + Y * Y * g, -Y / length2;
    Mat2 pixel_by_plane;
    pixel_by_plane << camera.fx_px * there.dx_dx, camera.fx_px * there.dx_dy, camera.fy_px * there.dx_dy,
        camera.fy_px * there.dy_dy;
    *by_direction = pixel_by_plane * plane;
  }
  if (by_intrinsics != nullptr) differentiate_by_intrinsics(camera, x, y, there, *by_intrinsics);
  return pixel_of(camera, there);
}

// The direction that falls on a point of the plane before distortion, and its derivative (docs/theory/camera.md eq. 7).
Vec3 direction_from_plane(ProjectionModel model, double x, double y, Eigen::Matrix<double, 3, 2>& by_plane) {
  if (model == ProjectionModel::fisheye) {
    const double a2 = x * x + y * y;
    const double a = std::sqrt(a2);
    const double s = a > 1e-2 ? std::sin(a) / a : 1.0 - a2 / 6.0 * (1.0 - a2 / 20.0 * (1.0 - a2 / 42.0));
    const double h = a > 1e-2 ? (std::cos(a) - s) / a2 : -1.0 / 3.0 + a2 / 30.0 * (1.0 - a2 / 28.0);
    by_plane << s + x * x * h, x * y * h,  //
        x * y * h, s + y * y * h,          //
        -s * x, -s * y;
    return {s * x, s * y, std::cos(a)};
  }
  const double norm = std::sqrt(1.0 + x * x + y * y);
  const Vec3 direction_C(x / norm, y / norm, 1.0 / norm);
  by_plane = -direction_C * direction_C.head<2>().transpose();
  by_plane(0, 0) += 1.0;
  by_plane(1, 1) += 1.0;
  by_plane /= norm;
  return direction_C;
}

// The angle at which a distance from the axis on the plane lies, without distortion.
double angle_on_plane(ProjectionModel model, double r) {
  return model == ProjectionModel::fisheye ? std::clamp(r, -kPi, kPi) : std::atan(r);
}

}  // namespace

Vec2 fits_from_pixel(Pixel p, int height) {
  return {p.u + 1.0, height - p.v};
}
Pixel pixel_from_fits(const Vec2& xy, int height) {
  return {xy.x() - 1.0, height - xy.y()};
}
Vec2 corner_from_pixel(Pixel p) {
  return {p.u + 0.5, p.v + 0.5};
}
Pixel pixel_from_corner(const Vec2& xy) {
  return {xy.x() - 0.5, xy.y() - 0.5};
}

Intrinsics Intrinsics::from_field_of_view(int width_px, int height_px, double fov_horizontal_rad,
                                          ProjectionModel model) {
  Intrinsics camera;
  camera.width_px = width_px;
  camera.height_px = height_px;
  const double half = 0.5 * fov_horizontal_rad;
  camera.fx_px = camera.fy_px = 0.5 * width_px / (model == ProjectionModel::fisheye ? half : std::tan(half));
  camera.cx_px = 0.5 * (width_px - 1);
  camera.cy_px = 0.5 * (height_px - 1);
  camera.model = model;
  return camera;
}

double Intrinsics::field_of_view_horizontal_rad() const {
  return angle_on_plane(model, (width_px - 0.5 - cx_px) / fx_px) + angle_on_plane(model, (cx_px + 0.5) / fx_px);
}

double Intrinsics::field_of_view_vertical_rad() const {
  return angle_on_plane(model, (height_px - 0.5 - cy_px) / fy_px) + angle_on_plane(model, (cy_px + 0.5) / fy_px);
}

double Intrinsics::half_diagonal_px() const {
  return 0.5 * std::hypot(width_px, height_px);
}

double Intrinsics::half_diagonal_rad() const {
  double largest = 0.0;
  for (const double u : {-0.5, width_px - 0.5}) {
    for (const double v : {-0.5, height_px - 0.5}) {
      const Result<Vec3> corner = unproject(*this, {u, v});
      const double off_axis = corner ? std::atan2(std::hypot(corner->x(), corner->y()), corner->z())
                                     : angle_on_plane(model, std::hypot((u - cx_px) / fx_px, (v - cy_px) / fy_px));
      largest = std::max(largest, off_axis);
    }
  }
  return largest;
}

Result<Pixel> project(const Intrinsics& camera, const Vec3& direction_C, Mat23* by_direction,
                      IntrinsicsJacobian* by_intrinsics) {
  if (camera.model == ProjectionModel::fisheye)
    return project_fisheye(camera, direction_C, by_direction, by_intrinsics);
  const double z = direction_C.z();
  if (!(z > 0.0)) return fail(ErrorCode::out_of_range, "the direction lies behind the camera (z = {0})", {z});
  const double x = direction_C.x() / z;
  const double y = direction_C.y() / z;
  const Distorted there = distort(camera.distortion, x, y);
  if (!one_to_one(camera.distortion, x, y, there)) return folded(std::atan(std::hypot(x, y)));
  if (by_direction != nullptr) {
    const double fx = camera.fx_px;
    const double fy = camera.fy_px;
    Mat23& J = *by_direction;
    J(0, 0) = fx * there.dx_dx / z;
    J(0, 1) = fx * there.dx_dy / z;
    J(1, 0) = fy * there.dx_dy / z;
    J(1, 1) = fy * there.dy_dy / z;
    J(0, 2) = -(J(0, 0) * x + J(0, 1) * y);
    J(1, 2) = -(J(1, 0) * x + J(1, 1) * y);
  }
  if (by_intrinsics != nullptr) differentiate_by_intrinsics(camera, x, y, there, *by_intrinsics);
  return pixel_of(camera, there);
}

Result<Vec3> unproject(const Intrinsics& camera, Pixel pixel, Eigen::Matrix<double, 3, 2>* by_pixel) {
  const Distortion& d = camera.distortion;
  const double x_goal = (pixel.u - camera.cx_px) / camera.fx_px;
  const double y_goal = (pixel.v - camera.cy_px) / camera.fy_px;
  // Newton from the distorted point. For barrel and for pincushion distortion it comes monotonically from one side; the
  // step is halved where it does not lessen the miss.
  double x = x_goal;
  double y = y_goal;
  Distorted there = distort(d, x, y);
  double miss = std::hypot(there.x - x_goal, there.y - y_goal);
  const double tolerance = 1e-14 * std::max(1.0, std::hypot(x_goal, y_goal));
  for (int iteration = 0; iteration < 30 && miss > tolerance; ++iteration) {
    const double det = there.determinant();
    if (!(std::abs(det) > 1e-12)) break;
    const double ex = x_goal - there.x;
    const double ey = y_goal - there.y;
    const double step_x = (there.dy_dy * ex - there.dx_dy * ey) / det;
    const double step_y = (there.dx_dx * ey - there.dx_dy * ex) / det;
    bool better = false;
    for (double share = 1.0; share > 1e-3 && !better; share *= 0.5) {
      const Distorted next = distort(d, x + share * step_x, y + share * step_y);
      const double next_miss = std::hypot(next.x - x_goal, next.y - y_goal);
      if (next_miss < miss) {
        x += share * step_x;
        y += share * step_y;
        there = next;
        miss = next_miss;
        better = true;
      }
    }
    if (!better) break;
  }
  const bool beyond = camera.model == ProjectionModel::fisheye && !(std::hypot(x, y) < kPi);
  if (!(miss <= 1e-12 * std::max(1.0, std::hypot(x_goal, y_goal))) || !one_to_one(d, x, y, there) || beyond) {
    return fail(ErrorCode::not_converged,
                beyond ? "no direction falls on pixel ({0}, {1}): it would lie more than 180 degrees off the axis"
                       : "the camera's distortion has no inverse at pixel ({0}, {1})",
                {pixel.u, pixel.v});
  }
  Eigen::Matrix<double, 3, 2> direction_by_plane;
  const Vec3 direction_C = direction_from_plane(camera.model, x, y, direction_by_plane);
  if (by_pixel != nullptr) {
    const double det = there.determinant();
    Mat2 plane_by_pixel;
    plane_by_pixel << there.dy_dy / (det * camera.fx_px), -there.dx_dy / (det * camera.fy_px),
        -there.dx_dy / (det * camera.fx_px), there.dx_dx / (det * camera.fy_px);
    *by_pixel = direction_by_plane * plane_by_pixel;
  }
  return direction_C;
}

double dark_factor(const Detector& d) {
  return d.dark_doubling_k > 0.0 ? std::exp2((d.temperature_c - d.dark_reference_c) / d.dark_doubling_k) : 1.0;
}

}  // namespace astronav
