// SPDX-License-Identifier: Apache-2.0
#include "onboard/vision/psf_model.h"

#include <algorithm>
#include <cmath>

#include <Eigen/LU>

namespace astronav::vision {
namespace {

// Of the halo's light in its outer Gaussian: unknown, so between none and all of it.
constexpr double kOuterShare = 0.3, kOuterShareSigma = 0.3;
constexpr double kHaloWidthRelative = 0.3;
// One object differs from the next by this much in width, relative: colour, and a disc if it is a body's.
constexpr double kWidthOfStars = 0.005, kWidthOfBodies = 0.1, kWidthOfDiscs = 0.02;
// A lesson moves a belief by its own sigma, or less. Who would have the halo somewhere else altogether (5 sigma) is two
// stars: one double of V 2 in the second picture of a flight had moved all others' halos by 3 px.
constexpr double kTwoStarsChi2 = 25.0;
// Optics drift with temperature, and no model of them is exact: no belief becomes firmer than this.
constexpr double kLeastRelative = 0.0015, kLeastHaloRelative = 0.003, kLeastOffsetPx = 0.0005;

LocalPsf::Vector least_sigma(const SensorModel& sensor) {
  LocalPsf::Vector sigma;
  sigma << kLeastRelative * sensor.psf_sigma_px, kLeastHaloRelative * sensor.halo_fraction,
      kLeastHaloRelative * sensor.halo_sigma_px, kLeastHaloRelative, kLeastOffsetPx, kLeastOffsetPx;
  return sigma;
}

}  // namespace

SensorModel SensorModel::from(const Camera& camera) {
  SensorModel model;
  const Detector& d = camera.detector;
  model.gain_e_dn = d.gain_e_dn;
  model.read_noise_e = d.read_noise_e;
  model.photo_nonuniformity = d.photo_nonuniformity;
  const double converter = std::ldexp(1.0, d.bits) - 1.0;
  const double full_well = d.full_well_e > 0.0 ? d.full_well_e / d.gain_e_dn : converter;
  model.saturation_dn = d.bias_dn + 0.95 * std::min(full_well, converter - d.bias_dn);
  model.blooming = d.blooming;
  model.psf_sigma_px = camera.psf.sigma_px;
  return model;
}

LocalPsf LocalPsf::from(const SensorModel& sensor) {
  LocalPsf psf;
  psf.value << sensor.psf_sigma_px, sensor.halo_fraction, sensor.halo_sigma_px, kOuterShare, 0.0, 0.0;
  Vector sigma;
  sigma << sensor.psf_sigma_relative * sensor.psf_sigma_px, 2.0 * sensor.halo_fraction,
      kHaloWidthRelative * sensor.halo_sigma_px, kOuterShareSigma, sensor.halo_offset_px, sensor.halo_offset_px;
  psf.covariance = sigma.cwiseAbs2().asDiagonal();
  return psf;
}

LocalPsf LocalPsf::learnt(const SensorModel& sensor) {
  LocalPsf psf = from(sensor);
  psf.covariance = least_sigma(sensor).cwiseAbs2().asDiagonal();
  return psf;
}

LocalPsf LocalPsf::wider_by(double relative) const {
  LocalPsf psf = *this;
  psf.covariance(width, width) += relative * relative * sigma_px() * sigma_px();
  return psf;
}
LocalPsf LocalPsf::of_body() const {
  return wider_by(kWidthOfBodies);
}
LocalPsf LocalPsf::of_disc() const {
  return wider_by(kWidthOfDiscs);
}

// A disc lit from one side is skew: its third cumulant along the Sun's direction is up to 0.013 R^3 (Lambert). At x
// from the centre a Gaussian's wing then seems shifted by 0.013 R^3 x^2 / (6 sigma^4); the wings of a saturated spot
// are seen at 3 to 4 sigma.
double skew_of_disc_px(double radius_px, double psf_sigma_px) {
  constexpr double kShift = 0.013 * 3.5 * 3.5 / 6.0;
  return kShift * radius_px * radius_px * radius_px / (psf_sigma_px * psf_sigma_px);
}

// Shares of that which windows show (docs/adr/0002): fits of discs whose law is known, and of Minnaert's discs whose
// skewness is off by as much as the law (0.08 for an exponent of 0.85 instead of Lambert's 1).
double skew_of_known_disc_px(double radius_px, double psf_sigma_px, double law_of_light) {
  constexpr double kLeast = 0.005, kOfLaw = 0.10;
  return std::hypot(kLeast, kOfLaw * law_of_light) * skew_of_disc_px(radius_px, psf_sigma_px);
}

PsfBelief::PsfBelief(const SensorModel& sensor, int width_px, int height_px)
    : sensor_(sensor),
      middle_px_(0.5 * (width_px - 1), 0.5 * (height_px - 1)),
      half_diagonal_px_(0.5 * std::hypot(width_px, height_px)) {
  least_sigma_ << least_sigma(sensor), kLeastRelative * sensor.psf_sigma_px;
  forget();
}

void PsfBelief::forget() {
  const LocalPsf before = LocalPsf::from(sensor_);
  value_ << before.value, 0.0;
  covariance_.setZero();
  covariance_.topLeftCorner<LocalPsf::count, LocalPsf::count>() = before.covariance;
  covariance_(kGrowth, kGrowth) = before.covariance(LocalPsf::width, LocalPsf::width);
}

bool PsfBelief::settled() const {
  return std::sqrt(covariance_(LocalPsf::width, LocalPsf::width)) < 0.02 * value_[LocalPsf::width];
}

double PsfBelief::growth_at(Pixel pixel) const {
  return (pixel.vec() - middle_px_).squaredNorm() / (half_diagonal_px_ * half_diagonal_px_);
}

// map_at() applied: only the width knows of its growth.
LocalPsf PsfBelief::at(Pixel pixel) const {
  const double r2 = growth_at(pixel);
  LocalPsf psf{value_.head<LocalPsf::count>(), covariance_.topLeftCorner<LocalPsf::count, LocalPsf::count>()};
  psf.value[LocalPsf::width] += r2 * value_[kGrowth];
  const LocalPsf::Vector with_growth = r2 * covariance_.col(kGrowth).head<LocalPsf::count>();
  psf.covariance.row(LocalPsf::width) += with_growth.transpose();
  psf.covariance.col(LocalPsf::width) += with_growth;
  psf.covariance(LocalPsf::width, LocalPsf::width) += r2 * r2 * covariance_(kGrowth, kGrowth);
  return psf;
}

PsfBelief::Map PsfBelief::map_at(Pixel pixel) const {
  Map map = Map::Identity();
  map(LocalPsf::width, kGrowth) = growth_at(pixel);
  return map;
}

void PsfBelief::learn(Pixel pixel, const PsfEvidence& evidence, bool resolved) {
  const Map map = map_at(pixel);
  // The object's own width lies between what its light says and what is believed of all.
  LocalPsf::Matrix own = LocalPsf::Matrix::Zero();
  const double width = (resolved ? kWidthOfBodies : kWidthOfStars) * sensor_.psf_sigma_px;
  own(LocalPsf::width, LocalPsf::width) = width * width;
  const LocalPsf::Matrix spread = LocalPsf::Matrix::Identity() + evidence.information * own;
  const Eigen::PartialPivLU<LocalPsf::Matrix> lu(spread);
  const LocalPsf::Matrix information = lu.solve(evidence.information);
  const LocalPsf::Vector vector = lu.solve(evidence.vector);
  const Matrix whole = map.transpose() * information * map;
  const Eigen::PartialPivLU<Matrix> update(Matrix::Identity() + covariance_ * whole);
  const Matrix covariance = update.solve(covariance_);
  const Vector value = value_ + covariance * (map.transpose() * (vector - information * (map * value_)));
  if (!value.allFinite() || !covariance.allFinite()) return;
  const Vec2 aside = (value - value_).segment<2>(LocalPsf::halo_u);
  if (aside.dot(covariance_.block<2, 2>(LocalPsf::halo_u, LocalPsf::halo_u).inverse() * aside) > kTwoStarsChi2) return;
  value_ = value;
  covariance_ = 0.5 * (covariance + covariance.transpose());
  for (int k = 0; k < kStates; ++k) {
    const double lacking = least_sigma_[k] * least_sigma_[k] - covariance_(k, k);
    if (lacking > 0.0) covariance_(k, k) += lacking;
  }
  value_[LocalPsf::width] = std::clamp(value_[LocalPsf::width], 0.5 * sensor_.psf_sigma_px, 2.0 * sensor_.psf_sigma_px);
  value_[LocalPsf::halo_share] = std::max(value_[LocalPsf::halo_share], 0.0);
  value_[LocalPsf::halo_width] =
      std::clamp(value_[LocalPsf::halo_width], 0.4 * sensor_.halo_sigma_px, 2.5 * sensor_.halo_sigma_px);
  value_[LocalPsf::outer_share] = std::clamp(value_[LocalPsf::outer_share], 0.0, 1.0);
}

}  // namespace astronav::vision
