// SPDX-License-Identifier: Apache-2.0
#include "verification/loop/forecast.h"

#include <cmath>
#include <utility>

#include "verification/loop/belief.h"

namespace astronav::loop {

scenario::Scenario undisturbed(scenario::Scenario s) {
  s.truth.dynamics.srp_scale_error = 0.0;
  s.truth.dynamics.unmodelled_acceleration_m_s2 = 0.0;
  s.truth.thrust = {};
  s.truth.unloading.on = false;
  s.truth.clock = {};
  s.truth.ephemeris = {};
  s.truth.upsets.clock_step_ms = 0.0;
  s.truth.upsets.maneuver_errs = false;
  s.truth.pointing.jitter_arcsec = 0.0;
  s.truth.photocentre = {.on = s.truth.photocentre.on};
  s.truth.camera.file = s.onboard.camera.file;
  s.truth.camera.focal_error_relative = 0.0;
  s.truth.camera.center_offset_u_px = s.truth.camera.center_offset_v_px = 0.0;
  s.truth.camera.k1_error = 0.0;
  s.conops.dither_px = 0.0;
  s.onboard.filter.adaptive_r = false;  // there are no residuals to learn from
  return s;
}

Result<std::unique_ptr<Forecast>> Forecast::create(const scenario::Scenario& s, const World& world,
                                                   const Camera& believed, Epoch epoch) {
  std::unique_ptr<Forecast> out(new Forecast(world, believed));
  const auto exposure = exposure_settings(s, believed);
  if (!exposure) return forward(exposure);
  out->field_ = vision::StarField::build(world.catalogue(), s.onboard.vision.star_max_v_mag, epoch);
  const auto sensor = vision::SensorModel::from(believed);
  out->control_.emplace(*exposure, sensor, believed.intrinsics, out->field_);
  out->choose_exposure_ = s.onboard.vision.exposure == "chosen";
  out->optics_ = vision::LocalPsf::learnt(sensor);
  out->law_of_light_ = s.onboard.filter.photocentre_sigma;
  return out;
}

Result<void> Forecast::prepare_window(BodyId beacon, Epoch epoch, const State& truth_O) {
  const auto planet = world_.planet(beacon, epoch, truth_O);
  if (!planet) return forward(planet);
  const double radius_px = planet->angular_radius_rad * believed_.intrinsics.fx_px;
  const vision::ExpectedPlanet expected{
      .direction_N = planet->direction_N,
      .dn_s = band_.flux(planet->v_mag, planet->b_v).electrons_per_s / believed_.detector.gain_e_dn,
      .radius_px = radius_px};
  window_ = choose_exposure_ ? control_->choose(expected, optics_)
                             : control_->forecast(expected, optics_, believed_.exposure_s);
  if (window_.planet.saturated) {
    window_.planet.repeating_px = std::hypot(
        window_.planet.repeating_px, vision::skew_of_known_disc_px(radius_px, believed_.psf.sigma_px, law_of_light_));
  }
  return {};
}

Result<navigation::BeaconMeasurement> Forecast::measure(BodyId beacon, Epoch epoch, const State& truth_O,
                                                        const Mat3& R_CN) const {
  const auto planet = world_.planet(beacon, epoch, truth_O);
  if (!planet) return forward(planet);
  const auto pixel = project(believed_.intrinsics, R_CN * planet->direction_N);
  if (!pixel) return forward(pixel);
  navigation::BeaconMeasurement m;
  m.body = beacon;
  m.mid_exposure = epoch;
  m.pixel = *pixel;
  m.pixel_covariance_px2 = window_.planet.sigma_px * window_.planet.sigma_px * Mat2::Identity();
  m.repeating_sigma_px = window_.planet.repeating_px;
  m.R_CN = R_CN;
  // The planet stands in the middle of the picture, where the roll does not move it.
  const double across_rad = window_.attitude_px / believed_.intrinsics.fx_px;
  const double repeating_rad = window_.attitude_repeating_px / believed_.intrinsics.fx_px;
  m.attitude_covariance_rad2.diagonal() << across_rad * across_rad, across_rad * across_rad, 0.0;
  m.attitude_repeating_rad2.diagonal() << repeating_rad * repeating_rad, repeating_rad * repeating_rad, 0.0;
  return m;
}

}  // namespace astronav::loop
