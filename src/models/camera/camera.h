// SPDX-License-Identifier: Apache-2.0
// Camera: pinhole or fisheye with Brown-Conrady distortion, and the parameters of optics, point-spread function and
// detector.
//
// Camera axes C: +x right (columns), +y down (rows), +z along the boresight. Pixel (u, v) = (column, row); the centre
// of the top-left pixel is (0, 0). A mirrored camera does not exist here: parity is a property of an image on disk.
#pragma once

#include <array>
#include <string>
#include <vector>

#include "foundation/base/error.h"
#include "foundation/math/linear.h"

namespace astronav {

struct Pixel {
  double u = 0.0;  // column
  double v = 0.0;  // row
  Vec2 vec() const { return {u, v}; }
};
// FITS and many catalogues count from 1, with row 1 at the bottom: x = u + 1, y = height - v.
Vec2 fits_from_pixel(Pixel p, int height);
Pixel pixel_from_fits(const Vec2& xy, int height);
// The origin at the top-left corner of the image: the centre of the first pixel is (0.5, 0.5).
Vec2 corner_from_pixel(Pixel p);
Pixel pixel_from_corner(const Vec2& xy);

// Where a direction at the angle a off the boresight falls on the normalised plane, before distortion:
//   pinhole   r = tan a, so (x, y) = (X/Z, Y/Z);   fisheye   r = a (equidistant), for a below 180 degrees.
enum class ProjectionModel : unsigned char { pinhole, fisheye };

// Brown-Conrady on the normalised plane (x, y), r2 = x2 + y2:
//   x' = x (1 + k1 r2 + k2 r4 + k3 r6) + 2 p1 x y + p2 (r2 + 2 x2)
//   y' = y (1 + k1 r2 + k2 r4 + k3 r6) + p1 (r2 + 2 y2) + 2 p2 x y           (Brown 1966; OpenCV's order of p1, p2)
struct Distortion {
  double k1 = 0.0, k2 = 0.0, k3 = 0.0, p1 = 0.0, p2 = 0.0;
};

struct Intrinsics {
  int width_px = 0;
  int height_px = 0;
  double fx_px = 0.0;  // focal length over pixel pitch
  double fy_px = 0.0;
  double cx_px = 0.0;  // where the boresight falls
  double cy_px = 0.0;
  ProjectionModel model = ProjectionModel::pinhole;
  Distortion distortion;

  static Intrinsics from_field_of_view(int width_px, int height_px, double fov_horizontal_rad,
                                       ProjectionModel model = ProjectionModel::pinhole);
  double field_of_view_horizontal_rad() const;  // without distortion, edge to edge
  double field_of_view_vertical_rad() const;
  double half_diagonal_rad() const;  // boresight to the farthest corner, with distortion
  double half_diagonal_px() const;   // of the image
  double plate_scale_rad_px() const { return 1.0 / fx_px; }
  // Whether a place lies on one of the pixels, each of which reaches half a pixel from its centre.
  bool contains(Pixel p) const { return p.u >= -0.5 && p.v >= -0.5 && p.u < width_px - 0.5 && p.v < height_px - 0.5; }
};

// Derivatives of the pixel by the parameters, in the order fx, fy, cx, cy, k1, k2, k3, p1, p2.
using IntrinsicsJacobian = Eigen::Matrix<double, 2, 9>;

// Projects a direction in C (any length; z > 0 for a pinhole, any but straight back for a fisheye). out_of_range for a
// direction behind the camera or so far off the axis that the distortion folds over. Optional derivatives by the
// direction's components and by the parameters. docs/theory/camera.md eq. 1 to 7.
Result<Pixel> project(const Intrinsics& camera, const Vec3& direction_C, Mat23* by_direction = nullptr,
                      IntrinsicsJacobian* by_intrinsics = nullptr);
// The unit vector in C whose projection is the pixel (Newton, to 1e-12). not_converged where the distortion has no
// inverse there. Optional derivative (3x2) by the pixel.
Result<Vec3> unproject(const Intrinsics& camera, Pixel pixel, Eigen::Matrix<double, 3, 2>* by_pixel = nullptr);

struct BandPoint {
  double wavelength_m = 0.0;
  double value = 0.0;  // 0..1
};

struct Optics {
  double focal_length_m = 0.0;
  double pupil_diameter_m = 0.0;
  std::vector<BandPoint> transmission;  // piecewise linear in wavelength, zero outside
  // Vignetting: at the angle a off the boresight and d pixels from it, cos(a)^power (1 - loss (d/D)^2) of the light
  // arrives, with D half the image's diagonal.
  double vignetting_cos_power = 0.0;  // 4: an ideal lens
  double vignetting_corner_loss = 0.0;
  // Stray sunlight on every pixel: this much at 30 degrees from the Sun, at 1 au; it falls with a power of the angle
  // and with the square of the distance.
  double stray_light_e_s_px = 0.0;
  double stray_light_power = 3.0;
};

// A measured point-spread function: light in samples of 1/samples_per_px pixels, its sum 1. The source is at the middle
// of the array.
struct PsfKernel {
  std::string file;  // where it was read from
  int width = 0;
  int height = 0;
  double samples_per_px = 1.0;
  std::vector<float> values;  // row-major
  bool empty() const { return values.empty(); }
};

// The truth's point-spread function: a Gaussian core whose width grows with the square of the distance from the
// boresight's pixel, and a halo that may be displaced: three fifths of it a Gaussian of halo_sigma_px, two fifths one
// of twice that (real wings fall more slowly than one Gaussian). Fractions of the energy. With halo_fraction = 0 it is
// a plain Gaussian. A measured kernel takes the place of core and coma.
struct PointSpread {
  double sigma_px = 0.8;
  double sigma_growth_px = 0.0;  // added to sigma at half the image's diagonal
  double halo_fraction = 0.0;
  double halo_sigma_px = 3.0;
  double halo_offset_u_px = 0.0;
  double halo_offset_v_px = 0.0;
  // Third-order coma: length of its pattern at half the image's diagonal, outwards where positive, in proportion to the
  // distance from the boresight. The centre of light stays where the projection puts it.
  double coma_px = 0.0;
  PsfKernel kernel;
};

enum class Shutter : unsigned char { global, rolling };

struct Detector {
  double pixel_pitch_m = 0.0;
  std::vector<BandPoint> quantum_efficiency;
  double read_noise_e = 0.0;         // 1 sigma
  double dark_current_e_s = 0.0;     // mean, at dark_reference_c
  double dark_nonuniformity = 0.0;   // DSNU, 1 sigma, share of the dark current
  double photo_nonuniformity = 0.0;  // PRNU, 1 sigma, share of the signal
  double full_well_e = 0.0;
  double gain_e_dn = 1.0;  // electrons per DN
  double bias_dn = 0.0;
  int bits = 12;
  double background_e_s_px = 0.0;  // diffuse light
  // Dark current doubles every so many kelvin; 0: it is the same at every temperature.
  double temperature_c = 20.0;
  double dark_reference_c = 20.0;
  double dark_doubling_k = 0.0;
  // Pixels that leak: their share, and the mean of what they leak beyond the dark current (exponential law).
  double hot_pixel_share = 0.0;
  double hot_pixel_e_s = 0.0;  // at dark_reference_c
  // Protons: hits on the detector, what they leave on their way through the silicon, and how thick that is.
  double cosmic_rays_cm2_s = 0.0;
  double cosmic_ray_e_um = 80.0;
  double depth_um = 15.0;
  bool blooming = false;               // what a full well cannot hold runs along the column; otherwise it is lost
  double frame_transfer_row_us = 0.0;  // time in which the image moves by a row, under light, at the exposure's end
  Shutter shutter = Shutter::global;
  double rolling_row_us = 0.0;  // from the exposure of a row to that of the next
  // The time tag of a frame is late by this much, and scatters (1 sigma).
  double time_tag_latency_ms = 0.0;
  double time_tag_jitter_ms = 0.0;
};
// Of a pixel's dark current (and what hot pixels leak) at the detector's temperature, over that at the reference.
double dark_factor(const Detector& detector);

struct Camera {
  std::string name;
  Intrinsics intrinsics;
  Optics optics;
  PointSpread psf;
  Detector detector;
  double exposure_s = 0.4;  // default exposure
};

}  // namespace astronav
