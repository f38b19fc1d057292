// SPDX-License-Identifier: Apache-2.0
// Rotations: matrices R_CN (v_C = R_CN * v_N), quaternions with named fields, and pointings.
//
// A quaternion is Hamilton's and means the same as the matrix: to_matrix(q_NC) == R_NC and v_N = R_NC * v_C.
#pragma once

#include "foundation/math/linear.h"

namespace astronav {

struct Quaternion {
  double w = 1.0;
  double x = 0.0;
  double y = 0.0;
  double z = 0.0;
};

Mat3 to_matrix(const Quaternion& q);
// w >= 0; exact for any rotation matrix (Shepperd 1978: the largest of the four is taken first).
Quaternion to_quaternion(const Mat3& R);

// [v]x, so that cross_matrix(a) * b == a x b.
Mat3 cross_matrix(const Vec3& v);
// exp([phi]x): the rotation by |phi| rad about phi.
Mat3 rotation_exp(const Vec3& phi);
// The rotation vector phi with |phi| <= pi and rotation_exp(phi) == R.
Vec3 rotation_log(const Mat3& R);

// Unit vector of right ascension and declination (rad), and back (ra in [0, 2 pi)).
Vec3 direction_from_radec(double ra_rad, double dec_rad);
struct RaDec {
  double ra_rad = 0.0;
  double dec_rad = 0.0;
};
RaDec radec_from_direction(const Vec3& direction);
// Unit vectors towards increasing right ascension (east) and declination (north) at a direction.
struct EastNorth {
  Vec3 east;
  Vec3 north;
};
EastNorth east_north(const Vec3& direction);

// Angle between two directions in rad, exact for small and for nearly opposite ones.
double angle_between(const Vec3& a, const Vec3& b);

// Where a camera looks. Roll is the position angle of the image's up direction (-y_C, towards row 0) from north through
// east. Camera axes: +x right (columns), +y down (rows), +z along the boresight.
struct Pointing {
  double ra_rad = 0.0;
  double dec_rad = 0.0;
  double roll_rad = 0.0;
};
Mat3 R_CN_from_pointing(const Pointing& pointing);
Pointing pointing_from_R_CN(const Mat3& R_CN);

}  // namespace astronav
