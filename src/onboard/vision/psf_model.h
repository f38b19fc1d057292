// SPDX-License-Identifier: Apache-2.0
// What the onboard software believes of its detector and of its optics, and how it learns the latter in flight.
//
// The point-spread function at one place is a Gaussian core and a halo beside it: two Gaussians, the outer one twice as
// wide as the inner, which together fall about as slowly as real wings do (docs/theory/vision.md eq. 6).
#pragma once

#include <algorithm>
#include <cmath>

#include "foundation/math/linear.h"
#include "models/camera/camera.h"

namespace astronav::vision {

// DN where not said otherwise. What is said of the optics is the belief before the first frame.
struct SensorModel {
  double gain_e_dn = 1.0;
  double read_noise_e = 0.0;
  double photo_nonuniformity = 0.0;  // PRNU, 1 sigma
  double saturation_dn = 65535.0;    // a pixel at or above this tells nothing but "bright"
  bool blooming = false;             // what a full pixel cannot hold runs along its column
  double psf_sigma_px = 0.8;
  // What is believed of the halo, and what the belief may be wrong by, 1 sigma.
  double halo_fraction = 0.01;  // its light, over the core's; as much again is its uncertainty
  double halo_sigma_px = 3.0;
  double psf_sigma_relative = 0.08;    // of the core's width, at the middle and at the corners
  double psf_shape_relative = 0.0012;  // of the light in a pixel: no core is a Gaussian
  double halo_shape_relative = 0.003;  // of the halo's light in a pixel, nor is a halo
  double halo_offset_px = 0.2;         // of the halo's centre from the core's, each axis

  // Saturation: 95 % of the lower of full well and converter range, where clipping does not bite yet.
  static SensorModel from(const Camera& camera);
  // Variance of a pixel that holds `signal_dn` above a background with the noise `background_sigma_dn`.
  double pixel_variance_dn2(double signal_dn, double background_sigma_dn) const {
    const double signal = signal_dn > 0.0 ? signal_dn : 0.0;
    const double fixed_pattern = photo_nonuniformity * signal;
    return background_sigma_dn * background_sigma_dn + signal / gain_e_dn + fixed_pattern * fixed_pattern;
  }
};

// The point-spread function at one place, with the covariance of what is not known about it.
struct LocalPsf {
  enum Parameter : int { width, halo_share, halo_width, outer_share, halo_u, halo_v, count };
  static constexpr double kOuterWidth = 2.0;  // of the halo's outer Gaussian, in its inner one's
  using Vector = Eigen::Matrix<double, count, 1>;
  using Matrix = Eigen::Matrix<double, count, count>;

  Vector value = Vector::Zero();
  Matrix covariance = Matrix::Identity();

  double sigma_px() const { return value[width]; }
  // Half the side of the window that holds a star's core: three widths.
  int reach_px() const { return static_cast<int>(std::ceil(3.0 * sigma_px())); }
  // As believed before any frame.
  static LocalPsf from(const SensorModel& sensor);
  // The same, known as well as flight ever tells.
  static LocalPsf learnt(const SensorModel& sensor);
  // Of a body that may be a small disc: its light is wider by 10 % (1 sigma), a radius of 0.9 times the width.
  LocalPsf of_body() const;
  // Of a disc whose form is foretold: wider or narrower by 2 %, for its law of light and colour.
  LocalPsf of_disc() const;

 private:
  LocalPsf wider_by(double relative) const;
};

// What a disc of a radius adds to the error that repeats, when its saturated spot is fitted as a point's; and as a disc
// whose law of scattering is wrong by so much, relative.
double skew_of_disc_px(double radius_px, double psf_sigma_px);
double skew_of_known_disc_px(double radius_px, double psf_sigma_px, double law_of_light);

// What the light of one star says of the point-spread function there, its place and flux taken out: the likelihood is
// exp(-x' information x / 2 + vector' x).
struct PsfEvidence {
  LocalPsf::Matrix information = LocalPsf::Matrix::Zero();
  LocalPsf::Vector vector = LocalPsf::Vector::Zero();

  // Of light that no such function fits: chi-square per degree of freedom above one.
  void weaken(double misfit) {
    information /= std::max(1.0, misfit);
    vector /= std::max(1.0, misfit);
  }
};

// The point-spread function of the whole field: width = middle + growth r^2, r from the image's middle in half its
// diagonal; the halo is the same everywhere. A Gaussian belief, made better by every star that is bright enough.
class PsfBelief {
 public:
  PsfBelief(const SensorModel& sensor, int width_px, int height_px);

  LocalPsf at(Pixel pixel) const;
  // `resolved`: the light may be a disc's, whose width says little of the optics.
  void learn(Pixel pixel, const PsfEvidence& evidence, bool resolved);
  // The core's width is known to 2 % or better.
  bool settled() const;
  // Back to what was believed before the first frame.
  void forget();

 private:
  static constexpr int kGrowth = LocalPsf::count;
  static constexpr int kStates = LocalPsf::count + 1;
  using Vector = Eigen::Matrix<double, kStates, 1>;
  using Matrix = Eigen::Matrix<double, kStates, kStates>;
  using Map = Eigen::Matrix<double, LocalPsf::count, kStates>;
  double growth_at(Pixel pixel) const;
  Map map_at(Pixel pixel) const;

  SensorModel sensor_;
  Vec2 middle_px_;
  double half_diagonal_px_;
  Vector value_;
  Matrix covariance_;
  Vector least_sigma_;
};

}  // namespace astronav::vision
