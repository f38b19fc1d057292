// SPDX-License-Identifier: Apache-2.0
// The fixed-size vectors and matrices that every folder uses. Components are named at the use: p_OS_N, R_CN.
#pragma once

#include <Eigen/Geometry>  // with Core and LU: cross(), inverse() and determinant() are everywhere

namespace astronav {

using Vec2 = Eigen::Vector2d;
using Vec3 = Eigen::Vector3d;
using Mat2 = Eigen::Matrix2d;
using Mat3 = Eigen::Matrix3d;
using Mat23 = Eigen::Matrix<double, 2, 3>;
using Vec6 = Eigen::Matrix<double, 6, 1>;  // position and velocity, mostly
using Mat6 = Eigen::Matrix<double, 6, 6>;

inline constexpr double kPi = 3.14159265358979323846;
inline constexpr double kDegree = kPi / 180.0;               // rad
inline constexpr double kArcsecond = kDegree / 3600.0;       // rad
inline constexpr double kMilliarcsecond = kArcsecond / 1e3;  // rad

}  // namespace astronav
