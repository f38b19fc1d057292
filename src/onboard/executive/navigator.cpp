// SPDX-License-Identifier: Apache-2.0
#include "onboard/executive/navigator.h"

#include <algorithm>
#include <span>

#include "foundation/base/check.h"
#include "foundation/math/statistics.h"

namespace astronav::executive {

Navigator::Navigator(const NavigatorSettings& settings, const Ephemeris& ephemeris, vision::Vision* eyes)
    : settings_(settings),
      ephemeris_(&ephemeris),
      eyes_(eyes),
      filter_(settings.filter, ephemeris),
      flight_{.begin = filter_},
      stance_(settings.stance) {}

Result<void> Navigator::start(const navigation::InitialState& initial) {
  thrust_ = 0;
  kick_ = first_kick_after(settings_.maneuvers, initial.epoch);
  filter_.set_thrust({});
  const auto initialised = filter_.initialise(initial);
  begin_flight();
  return initialised;
}

Result<void> Navigator::advance(Epoch epoch) {
  return fly_with(settings_.maneuvers, filter_, thrust_, kick_, epoch);
}

void Navigator::begin_flight() {
  flight_.begin = filter_;
  flight_.thrust = thrust_;
  flight_.kick = kick_;
  flight_.badly_known = false;
  flight_.accepted = flight_.sights = 0;
}

navigation::UpdateResult Navigator::update(const navigation::BeaconMeasurement& measurement) {
  constexpr double kBadlyKnown_m = 3e7;
  if (flight_.sights == 0)
    flight_.badly_known = filter_.covariance_pv().topLeftCorner<3, 3>().trace() > kBadlyKnown_m * kBadlyKnown_m;
  if (flight_.sights < flight_.kept.size()) flight_.kept[flight_.sights] = measurement;
  ++flight_.sights;
  if (settings_.listener != nullptr) settings_.listener->saw(measurement);
  const navigation::UpdateResult result = filter_.update(measurement);
  flight_.accepted += result.accepted;
  return result;
}

// Gauss and Newton's iteration on a whole flight, the filter's own: linear along the way to where the last one ended.
Result<bool> Navigator::end_flight() {
  constexpr int kRounds = 5;
  constexpr double kSettled = 0.05;       // sigma, of the end
  if (flight_.sights == 0) return false;  // it goes on
  const bool kept = flight_.sights <= flight_.kept.size();
  bool better = false;
  for (int round = 0; flight_.badly_known && kept && round < kRounds; ++round) {
    const auto anew = fly_anew();
    if (!anew) return forward(anew);
    if (anew->accepted < flight_.accepted) break;
    Vec6 moved;
    moved << anew->filter.state().p_m - filter_.state().p_m, anew->filter.state().v_m_s - filter_.state().v_m_s;
    filter_ = anew->filter;
    flight_.accepted = anew->accepted;
    better = true;
    if (normalised_square(moved, filter_.covariance_pv()) < kSettled * kSettled) break;
  }
  begin_flight();
  return better;
}

// Shoots for where the flight ended, by its own sensitivities; then the mean is carried along that way, and all that
// was seen is used once more.
Result<Navigator::Flown> Navigator::fly_anew() const {
  constexpr int kShots = 4;
  const State end = filter_.state();
  State from = flight_.begin.state();
  for (int shot = 0; shot < kShots; ++shot) {
    navigation::Filter way = flight_.begin;
    std::size_t thrust = flight_.thrust, kick = flight_.kick;
    way.fly_beside(from);
    if (const auto flown = fly_with(settings_.maneuvers, way, thrust, kick, filter_.epoch()); !flown)
      return forward(flown);
    const State there = way.state();
    Vec6 miss;
    miss << end.p_m - there.p_m, end.v_m_s - there.v_m_s;
    const Vec6 by = way.sensitivity().partialPivLu().solve(miss);
    from.p_m += by.head<3>();
    from.v_m_s += by.tail<3>();
  }
  Flown out{.filter = flight_.begin};
  std::size_t thrust = flight_.thrust, kick = flight_.kick;
  out.filter.fly_beside(from);
  for (std::size_t i = 0; i < flight_.sights; ++i) {
    const navigation::BeaconMeasurement& sight = flight_.kept[i];
    if (sight.mid_exposure > out.filter.epoch()) {
      if (const auto flown = fly_with(settings_.maneuvers, out.filter, thrust, kick, sight.mid_exposure); !flown)
        return forward(flown);
    }
    out.accepted += out.filter.update(sight).accepted;
  }
  if (const auto flown = fly_with(settings_.maneuvers, out.filter, thrust, kick, filter_.epoch()); !flown)
    return forward(flown);
  out.filter.join();
  return out;
}

navigation::UpdateResult Navigator::use(const navigation::BeaconMeasurement& measurement) {
  // What stands in the way is told by the update.
  if (measurement.mid_exposure > filter_.epoch()) (void)advance(measurement.mid_exposure);
  return update(measurement);
}

Result<void> Navigator::coast_to(Epoch epoch) {
  return advance(epoch);
}

Result<navigation::BeaconSelection> Navigator::select() const {
  const Mat6 covariance = filter_.covariance_pv();
  return navigation::select_beacons(*ephemeris_, filter_.state(), filter_.epoch(), settings_.beacons, &covariance);
}

Result<Vec3> Navigator::aim(BodyId body, Epoch epoch) {
  if (const auto ok = advance(epoch); !ok) return forward(ok);
  const auto predicted = filter_.predict_direction(body);
  if (!predicted) return forward(predicted);
  return predicted->direction_N;
}

Result<vision::PlanetPrediction> Navigator::predict(BodyId beacon, Epoch epoch) const {
  const auto predicted = filter_.predict_direction(beacon);
  if (!predicted) return forward(predicted);
  vision::PlanetPrediction prediction;
  prediction.body = beacon;
  prediction.direction_N = predicted->direction_N;
  prediction.direction_covariance = predicted->covariance;
  // Where the place is that of the figure, the light is a point's.
  const auto constants = body_constants(beacon);
  if (constants && settings_.filter.sight.centre_of_light) {
    prediction.angular_radius_rad = constants->mean_radius_m / (predicted->light_time_s * kSpeedOfLight);
  }
  if (!settings_.brightness) return prediction;

  const auto known = ephemeris_->resolve(beacon);
  if (!known) return forward(known);
  const Epoch emitted = epoch - Duration::seconds(predicted->light_time_s);
  const auto from_sun = ephemeris_->state(*known, body::sun, emitted);
  if (!from_sun) return forward(from_sun);
  const auto from_center = ephemeris_->state(*known, body::solar_system_barycenter, emitted);
  if (!from_center) return forward(from_center);
  prediction.sunward_N = -from_sun->p_m.normalized();
  prediction.law_of_light = settings_.filter.errors_of(beacon).photocentre_fraction;
  const auto v_mag = planet_v_magnitude(beacon, {.p_body_from_sun_N = from_sun->p_m,
                                                 .p_body_from_observer_N = from_center->p_m - filter_.state().p_m,
                                                 .epoch = emitted});
  if (!v_mag) return prediction;  // no law for this body: place alone
  prediction.v_mag = *v_mag;
  prediction.expected_flux_dn = flux_dn(*v_mag, beacon);
  if (beacon == body::earth) add_moon(prediction, emitted);
  return prediction;
}

Result<void> Navigator::prepare_window(BodyId beacon, Epoch epoch) {
  if (settings_.exposure == nullptr || eyes_ == nullptr || !settings_.brightness) return {};
  if (const auto ok = advance(epoch); !ok) return ok;
  const auto planet = predict(beacon, epoch);
  if (!planet) return forward(planet);
  if (!(planet->expected_flux_dn > 0.0)) return {};
  const vision::ExpectedPlanet expected{
      .direction_N = planet->direction_N,
      .dn_s = (planet->expected_flux_dn + planet->companion_flux_dn) / settings_.brightness->exposure_s,
      .radius_px = planet->angular_radius_rad / settings_.filter.camera.plate_scale_rad_px()};
  settings_.brightness->exposure_s = settings_.exposure->choose(expected, eyes_->psf_in_the_middle()).exposure_s;
  return {};
}

// The Earth's spot holds the Moon's light wherever both are a few pixels apart.
void Navigator::add_moon(vision::PlanetPrediction& prediction, Epoch emitted) const {
  const auto from_sun = ephemeris_->state(body::moon, body::sun, emitted);
  const auto sight = filter_.predict_direction(body::moon);
  const auto from_center = ephemeris_->state(body::moon, body::solar_system_barycenter, emitted);
  if (!from_sun || !sight || !from_center) return;
  const auto v_mag = planet_v_magnitude(body::moon, {.p_body_from_sun_N = from_sun->p_m,
                                                     .p_body_from_observer_N = from_center->p_m - filter_.state().p_m,
                                                     .epoch = emitted});
  if (!v_mag) return;
  prediction.companion_direction_N = sight->direction_N;
  prediction.companion_flux_dn = flux_dn(*v_mag, body::moon);
}

double Navigator::flux_dn(double v_mag, BodyId body) const {
  const BrightnessSettings& bright = *settings_.brightness;
  return bright.band.flux(v_mag, planet_b_v(body)).electrons_per_s * bright.exposure_s / bright.gain_e_dn;
}

Result<Look> Navigator::watch(ImageView<const std::uint16_t> frame, Epoch mid_exposure, BodyId beacon,
                              const std::optional<Mat3>& commanded_R_CN) {
  ASTRONAV_CHECK(eyes_ != nullptr);
  if (const auto ok = advance(mid_exposure); !ok) return forward(ok);
  const auto prediction = predict(beacon, mid_exposure);
  if (!prediction) return forward(prediction);

  Look look;
  look.prediction = *prediction;
  const State here = filter_.state();
  const vision::Observer observer{.epoch = mid_exposure, .p_O_N = here.p_m, .v_O_N = here.v_m_s};
  const auto expected_R_CN = stance_.expected_R_CN(mid_exposure, eyes_->camera(), commanded_R_CN);
  const vision::FrameResult& seen = eyes_->process(frame, observer, expected_R_CN, std::span(&look.prediction, 1));
  if (seen.source != vision::AttitudeSource::none) stance_.take(mid_exposure, seen.attitude, commanded_R_CN);
  look.stance = stance_.report();
  look.frame = &seen;
  look.measured = seen.source != vision::AttitudeSource::none && seen.planets[0].found;
  if (!look.measured) return look;

  const vision::Centroid& spot = seen.centroids[seen.planets[0].centroid];
  look.measurement.body = beacon;
  look.measurement.mid_exposure = mid_exposure;
  // The filter knows the camera as it was told; stars and planet were seen through the camera as it is believed now.
  const auto pixel = vision::as_told(seen.attitude, settings_.filter.camera, spot.pixel);
  if (!pixel) return forward(pixel);
  const auto share = vision::camera_share(seen.attitude, seen.attitude.R_CN * prediction->direction_N);
  look.measurement.pixel = *pixel;
  look.measurement.pixel_covariance_px2 = spot.covariance_px2 + share.covariance_px2;
  look.measurement.pixel_attitude_covariance = share.with_attitude;
  look.measurement.repeating_sigma_px = spot.repeating_sigma_px;
  look.measurement.R_CN = seen.attitude.R_CN;
  look.measurement.v_stars_m_s = here.v_m_s;
  look.measurement.attitude_covariance_rad2 = seen.attitude.covariance_rad2;
  look.measurement.attitude_repeating_rad2 = seen.attitude.repeating_rad2;
  return look;
}

Result<Look> Navigator::look(ImageView<const std::uint16_t> frame, Epoch mid_exposure, BodyId beacon,
                             const std::optional<Mat3>& commanded_R_CN) {
  auto look = watch(frame, mid_exposure, beacon, commanded_R_CN);
  if (look && look->measured) look->update = update(look->measurement);
  return look;
}

}  // namespace astronav::executive
