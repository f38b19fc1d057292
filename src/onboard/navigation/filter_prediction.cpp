// SPDX-License-Identifier: Apache-2.0
// What the filter expects to see.
#include <cmath>

#include "onboard/navigation/filter.h"

namespace astronav::navigation {
namespace {

double mean_radius_m(BodyId body) {
  const Result<BodyConstants> constants = body_constants(body);
  return constants ? constants->mean_radius_m : 0.0;
}

}  // namespace

Result<Filter::Beacon> Filter::find(BodyId body, Epoch epoch) const {
  const Result<State> state = ephemeris_->state(body, body::solar_system_barycenter, epoch);
  if (!state) return forward(state);
  const Result<State> sun = ephemeris_->state(body::sun, body::solar_system_barycenter, epoch);
  if (!sun) return forward(sun);
  Beacon beacon;
  beacon.state = *state;
  beacon.sun = *sun;
  beacon.radius_m = mean_radius_m(body);
  if (body == body::moon) {
    const Result<State> earth = ephemeris_->state(body::earth, body::solar_system_barycenter, epoch);
    const Result<BodyConstants> constants = body_constants(body::earth);
    if (!earth || !constants) return fail(ErrorCode::not_found, "the Moon without the Earth");
    const Vec3 to_earth = earth->p_m - state->p_m;
    beacon.pull_m_s2 = constants->gm_m3_s2 / std::pow(to_earth.norm(), 3) * to_earth;
  }
  const Vec3 from_sun = state->p_m - sun->p_m;
  const Vec3 pole = from_sun.cross(state->v_m_s - sun->v_m_s).normalized();
  beacon.along_and_across << pole.cross(from_sun).normalized(), pole;
  const int of_light = beacon_of(body), of_place = beacon_of(body == body::moon ? body::earth : body);
  if (of_light >= 0) beacon.light = index::photocentre + of_light;
  if (of_place >= 0) beacon.place = index::ephemeris + 2 * of_place;
  return beacon;
}

Filter::SightPrediction Filter::predict(const StateVector& x, const Beacon& beacon) const {
  const State observer{x.segment<3>(index::position) * unit::length_m,
                       x.segment<3>(index::velocity) * unit::velocity_m_s};
  State body = beacon.state;
  if (beacon.place >= 0) body.p_m += beacon.along_and_across * x.segment<2>(beacon.place) * unit::length_m;
  body.p_m -= x[index::clock] * beacon.state.v_m_s;
  const double light = beacon.light < 0 ? 1.0 : 1.0 + x[beacon.light];
  SightSettings settings = settings_.sight;
  settings.centre_of_light_scale *= light;
  SightPrediction out{apparent_sight(observer, body, beacon.sun.p_m, beacon.radius_m, settings, beacon.pull_m_s2), {}};
  const Sight& sight = out.sight;
  out.by_state.setZero();
  out.by_state.middleCols<3>(index::position) = sight.by_position * unit::length_m;
  out.by_state.middleCols<3>(index::velocity) = sight.by_velocity * unit::velocity_m_s;
  if (beacon.light >= 0 && light != 0.0) out.by_state.col(beacon.light) = sight.shift_N / light;
  // It is only their difference that counts.
  out.by_state.col(index::clock) = sight.by_position * beacon.state.v_m_s;
  if (beacon.place >= 0)
    out.by_state.middleCols<2>(beacon.place) = -sight.by_position * beacon.along_and_across * unit::length_m;
  return out;
}

Result<Filter::Prediction> Filter::predict(const StateVector& x, const Beacon& beacon,
                                           const BeaconMeasurement& measurement) const {
  SightPrediction seen = predict(x, beacon);
  if (measurement.v_stars_m_s) {
    // Stars that were aberrated by another velocity took the attitude with them, by the turn b x (v - v_stars) / c.
    const Vec3 s = seen.sight.direction_N, b = measurement.R_CN.row(2).transpose();
    const Vec3 v_m_s = x.segment<3>(index::velocity) * unit::velocity_m_s;
    const Vec3 delta = (v_m_s - *measurement.v_stars_m_s) / kSpeedOfLight;
    seen.sight.direction_N = (s - (delta * b.dot(s) - b * delta.dot(s))).normalized();
    seen.by_state.middleCols<3>(index::velocity) -=
        (b.dot(s) * Mat3::Identity() - b * s.transpose()) * (unit::velocity_m_s / kSpeedOfLight);
  }
  const auto pixel = predict_pixel(seen.sight, measurement.R_CN, settings_.camera, x.segment<4>(index::camera));
  if (!pixel) return forward(pixel);
  Prediction out{*pixel, pixel->by_direction * seen.by_state};
  out.by_state.middleCols<4>(index::camera) = pixel->by_camera;
  return out;
}

Result<DirectionPrediction> Filter::predict_direction(BodyId body) const {
  const Result<Beacon> beacon = find(body, epoch_);
  if (!beacon) return forward(beacon);
  const SightPrediction seen = predict(x_, *beacon);
  const Mat3 by_body = errors_of(beacon_of(body)).ephemeris_m * seen.sight.by_position;
  const Eigen::Matrix<double, 3, kStates> f = seen.by_state * covariance_.u;
  return DirectionPrediction{seen.sight.direction_N,
                             f * covariance_.d.asDiagonal() * f.transpose() + by_body * by_body.transpose(),
                             seen.sight.distance_m, seen.sight.light_time_s};
}

}  // namespace astronav::navigation
