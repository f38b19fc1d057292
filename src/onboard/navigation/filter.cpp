// SPDX-License-Identifier: Apache-2.0
#include "onboard/navigation/filter.h"

#include <algorithm>
#include <cmath>

#include <Eigen/Cholesky>

namespace astronav::navigation {
namespace {

// Centroid and attitude: e + H_theta theta with E[e theta'] = C.
Mat2 noise_covariance(const BeaconMeasurement& measurement, const PixelPrediction& prediction) {
  const Mat23& h = prediction.by_attitude;
  const Mat2 cross = measurement.pixel_attitude_covariance * h.transpose();
  return measurement.pixel_covariance_px2 + h * measurement.attitude_covariance_rad2 * h.transpose() + cross +
         cross.transpose();
}

double mean_radius_m(BodyId body) {
  const Result<BodyConstants> constants = body_constants(body);
  return constants ? constants->mean_radius_m : 0.0;
}

bool is_covariance(const Mat2& m) {
  return m.allFinite() && m(0, 0) > 0.0 && m.determinant() > 0.0;
}

double smaller_eigenvalue(const Mat2& m) {
  const double half_trace = 0.5 * m.trace();
  return half_trace - std::sqrt(std::max(half_trace * half_trace - m.determinant(), 0.0));
}

double quadratic(const Vec2& v, const Mat2& m) {
  return v.dot(m.inverse() * v);
}

}  // namespace

const char* name(UpdateReason reason) {
  switch (reason) {
    case UpdateReason::accepted:
      return "accepted";
    case UpdateReason::gated:
      return "innovation beyond the gate";
    case UpdateReason::out_of_view:
      return "prediction out of the camera's view";
    case UpdateReason::no_ephemeris:
      return "no ephemeris";
    case UpdateReason::before_filter:
      return "earlier than the filter's epoch";
    case UpdateReason::bad_measurement:
      return "not a measurement";
  }
  return "";
}

Process process_of(const FilterSettings& settings, const Ephemeris& ephemeris) {
  Process::Photocentres photocentres;
  for (std::size_t i = 0; i < photocentres.size(); ++i)
    photocentres[i] = {settings.beacon_errors[i].photocentre_fraction, settings.photocentre_tau_s};
  return Process(settings.process, ephemeris, settings.focal, settings.k1, settings.bias, photocentres);
}

Filter::Filter(const FilterSettings& settings, const Ephemeris& ephemeris)
    : settings_(settings),
      ephemeris_(&ephemeris),
      process_(process_of(settings, ephemeris)),
      // Quantile of chi-square with two degrees of freedom, in closed form.
      gate_(-2.0 * std::log1p(-std::min(settings.gate_probability, 1.0))) {}

Result<void> Filter::initialise(const InitialState& initial) {
  if (const Result<void> checked = process_.check(initial.epoch); !checked) return checked;
  if (!initial.state.p_m.allFinite() || !initial.state.v_m_s.allFinite() || !initial.covariance.allFinite())
    return fail(ErrorCode::invalid_argument, "the initial state or its covariance is not finite");
  if (!(initial.mass_kg > 0.0) || !(initial.mass_sigma_kg >= 0.0))
    return fail(ErrorCode::invalid_argument, "mass {0} kg with sigma {1} kg", {initial.mass_kg, initial.mass_sigma_kg});

  const StateVector scales = state_scales();
  StateVector x = StateVector::Zero();
  x << initial.state.p_m, initial.state.v_m_s, initial.mass_kg,
      Eigen::Matrix<double, kStates - index::acceleration, 1>::Zero();
  StateMatrix P = StateMatrix::Zero();
  P.topLeftCorner<6, 6>() = initial.covariance;
  const auto variance = [&P](int state, double sigma) { P(state, state) = sigma * sigma; };
  variance(index::mass, initial.mass_sigma_kg);
  for (int i = 0; i < 3; ++i) {
    variance(index::acceleration + i, settings_.process.acceleration.sigma);
    variance(index::thrust + i,
             i == 0 ? settings_.process.thrust_magnitude.sigma : settings_.process.thrust_pointing.sigma);
  }
  variance(index::focal, settings_.focal.sigma);
  variance(index::k1, settings_.k1.sigma);
  variance(index::bias, settings_.bias.sigma);
  variance(index::bias + 1, settings_.bias.sigma);
  variance(index::solar_pressure, settings_.process.solar_pressure.sigma);
  for (int i = 0; i < kBeaconBodies; ++i) variance(index::photocentre + i, errors_of(i).photocentre_fraction);

  const StateVector inverse = scales.cwiseInverse();
  const StateMatrix scaled = inverse.asDiagonal() * P * inverse.asDiagonal();
  const Result<FactorisedCovariance> factors = factorise(scaled);
  if (!factors) return forward(factors);

  epoch_ = initial.epoch;
  x_ = x.cwiseProduct(inverse);
  covariance_ = *factors;
  last_body_ = BodyId{};
  last_image_.reset();
  last_accepted_.reset();
  accepted_in_window_ = 0;
  rejections_ = {};
  noise_scales_ = {};
  return {};
}

Result<void> Filter::propagate_to(Epoch epoch) {
  if (epoch < epoch_)
    return fail(ErrorCode::invalid_argument, "the filter does not go back by {0} s", {(epoch_ - epoch).seconds()});
  Process::Step step;
  while (epoch_ < epoch) {
    const Result<Duration> h = process_.step_towards(epoch_, epoch, x_);
    if (!h) return forward(h);
    StateVector x = x_;
    if (const Result<void> done = process_.step(epoch_, *h, thrust_, x, step); !done) return done;
    x_ = x;
    time_update(covariance_, step.phi, step.noise);
    epoch_ = epoch_ + *h;
  }
  return {};
}

Result<Filter::Prediction> Filter::predict(const StateVector& x, const BeaconMeasurement& measurement,
                                           const State& body, const Vec3& p_sun) const {
  const State observer{x.segment<3>(index::position) * unit::length_m,
                       x.segment<3>(index::velocity) * unit::velocity_m_s};
  const int beacon = beacon_of(measurement.body);
  const double light = beacon < 0 ? 1.0 : 1.0 + x[index::photocentre + beacon];
  SightSettings settings = settings_.sight;
  settings.centre_of_light_scale *= light;
  const Sight sight = apparent_sight(observer, body, p_sun, mean_radius_m(measurement.body), settings);
  const auto pixel = predict_pixel(sight, measurement.R_CN, settings_.camera, x.segment<4>(index::camera));
  if (!pixel) return forward(pixel);
  Prediction out{*pixel, MeasurementMatrix::Zero()};
  out.by_state.middleCols<3>(index::position) = pixel->by_position * unit::length_m;
  out.by_state.middleCols<3>(index::velocity) = pixel->by_velocity * unit::velocity_m_s;
  out.by_state.middleCols<4>(index::camera) = pixel->by_camera;
  if (beacon >= 0 && light != 0.0)
    out.by_state.col(index::photocentre + beacon) = pixel->by_direction * sight.shift_N / light;
  return out;
}

BeaconErrors Filter::errors_of(int beacon) const {
  return beacon < 0 ? BeaconErrors{} : settings_.beacon_errors[static_cast<std::size_t>(beacon)];
}

int Filter::beacon_of(BodyId body) const {
  if (body == BodyId{}) return -1;
  for (int i = 0; i < kBeaconBodies; ++i)
    if (errors_of(i).body == body) return i;
  return -1;
}

Filter::NoiseScale* Filter::scale_of(BodyId body) {
  for (NoiseScale& scale : noise_scales_) {
    if (scale.body == BodyId{}) scale.body = body;
    if (scale.body == body) return &scale;
  }
  return nullptr;
}

double Filter::noise_scale(BodyId body) const {
  if (!settings_.adaptive_noise) return 1.0;
  for (const NoiseScale& scale : noise_scales_)
    if (scale.body == body)
      return (2.0 * settings_.adaptive_prior_count + scale.sum) / (2.0 * settings_.adaptive_prior_count + scale.count);
  return 1.0;
}

// The bias forgets the last window: its rows leave the covariance, and come back with everything that will be the same
// in all images of this one.
void Filter::start_window(const BeaconMeasurement& measurement, const PixelPrediction& prediction) {
  const Mat23 by_body = errors_of(beacon_of(measurement.body)).ephemeris_m * prediction.by_position;
  const double repeating2 =
      settings_.bias.sigma * settings_.bias.sigma + measurement.repeating_sigma_px * measurement.repeating_sigma_px;
  const Mat2 covariance = repeating2 * Mat2::Identity() + by_body * by_body.transpose();

  StateMatrix phi = StateMatrix::Identity();
  phi.block<2, 2>(index::bias, index::bias).setZero();
  ProcessNoise noise;
  noise.n.setZero();
  noise.q.setZero();
  // covariance = L L', also where it is singular.
  const double l00 = std::sqrt(covariance(0, 0));
  const double l10 = l00 > 0.0 ? covariance(1, 0) / l00 : 0.0;
  noise.n(index::bias, 0) = l00;
  noise.n(index::bias + 1, 0) = l10;
  noise.n(index::bias + 1, 1) = std::sqrt(std::max(covariance(1, 1) - l10 * l10, 0.0));
  noise.q.head<2>().setOnes();
  time_update(covariance_, phi, noise);
  x_.segment<2>(index::bias).setZero();
}

// The rejected innovations agree with each other to within their noise, so it is the state that is wrong. Which of its
// errors would explain their mean?
bool Filter::recover(const MeasurementMatrix& by_state) {
  const double n = rejections_.count;
  const Vec2 mean = rejections_.sum / n;
  const double scatter2 = rejections_.sum2 / n - mean.squaredNorm();
  if (scatter2 > 4.0 * rejections_.noise / n) return false;
  if (accepted_in_window_ > 0) return undo(by_state, mean);
  return allow_push(by_state, mean) || allow_displacement(by_state, mean);
}

// This window said something else before, and that was wrong: an outlier while the gate was wide. Of all changes that
// explain the mean, b = P H' (H P H')^-1 mean is the least in the covariance's own measure; P + b b' holds it possible,
// and leaves what it has nothing to do with as it was.
bool Filter::undo(const MeasurementMatrix& by_state, const Vec2& mean) {
  const MeasurementMatrix f = by_state * covariance_.u;
  const Mat2 prior = f * covariance_.d.asDiagonal() * f.transpose();
  if (!is_covariance(prior)) return false;
  StateVector change = covariance_.u * covariance_.d.cwiseProduct(f.transpose() * (prior.inverse() * mean));
  const double moved_m = change.segment<3>(index::position).norm() * unit::length_m;
  change *= std::min(1.0, settings_.recovery_max_position_m / moved_m);
  ProcessNoise noise;
  noise.n.setZero();
  noise.q.setZero();
  noise.n.col(0) = change;
  noise.q[0] = 1.0;
  time_update(covariance_, StateMatrix::Identity(), noise);
  return true;
}

// The state came wrong into the window: somebody pushed the spacecraft, at any time since the last sight that was
// accepted. A push of variance s^2 an axis then has the covariance s^2 [T^2/3, T/2; T/2, 1] of position and velocity
// now (gravity's gradient left out); s is such that the mean is an ordinary innovation, with room to spare.
bool Filter::allow_push(const MeasurementMatrix& by_state, const Vec2& mean) {
  constexpr double kRoom = 2.0;
  constexpr double kLeastPause_s = 3600.0;
  constexpr double kLargestPush_m_s = 1000.0;
  if (!last_accepted_) return false;
  const double pause_s = (epoch_ - *last_accepted_).seconds();
  if (pause_s < kLeastPause_s) return false;
  const double T = pause_s / unit::time_s;
  const Mat23 by_position = by_state.middleCols<3>(index::position);
  const Mat2 of_unit_push = T * T / 3.0 * by_position * by_position.transpose();
  if (!is_covariance(of_unit_push)) return false;
  const double push = kRoom * std::sqrt(0.5 * quadratic(mean, of_unit_push));
  if (push * unit::velocity_m_s > kLargestPush_m_s) return false;
  ProcessNoise noise;
  noise.n.setZero();
  noise.q.setZero();
  noise.n.block<3, 3>(index::position, 0).diagonal().setConstant(push * T / std::sqrt(3.0));
  noise.n.block<3, 3>(index::velocity, 0).diagonal().setConstant(push * 0.5 * std::sqrt(3.0));
  noise.n.block<3, 3>(index::velocity, 3).diagonal().setConstant(push * 0.5);
  noise.q.head<6>().setOnes();
  time_update(covariance_, StateMatrix::Identity(), noise);
  return true;
}

// Or it was wrong from the start, in no direction more than in another: position and velocity covariance grow until the
// mean is an ordinary innovation.
bool Filter::allow_displacement(const MeasurementMatrix& by_state, const Vec2& mean) {
  const MeasurementMatrix f = by_state * covariance_.u;
  const Mat2 prior = f * covariance_.d.asDiagonal() * f.transpose();
  if (!is_covariance(prior)) return false;
  const double sigma_m = std::sqrt(covariance_pv().topLeftCorner<3, 3>().trace());
  const double growth = std::min(std::sqrt(0.5 * quadratic(mean, prior)), settings_.recovery_max_position_m / sigma_m);
  if (!(growth > 1.0)) return false;
  StateMatrix phi = StateMatrix::Identity();
  phi.diagonal().head<6>().setConstant(growth);
  ProcessNoise none;
  none.n.setZero();
  none.q.setZero();
  time_update(covariance_, phi, none);
  return true;
}

Result<void> Filter::kick(const Vec3& delta_v_N_m_s, double sigma_m_s) {
  if (!delta_v_N_m_s.allFinite() || !(sigma_m_s >= 0.0) || !std::isfinite(sigma_m_s))
    return fail(ErrorCode::invalid_argument, "a push of {0} m/s with sigma {1} m/s", {delta_v_N_m_s.norm(), sigma_m_s});
  x_.segment<3>(index::velocity) += delta_v_N_m_s / unit::velocity_m_s;
  ProcessNoise noise;
  noise.n.setZero();
  noise.q.setZero();
  noise.n.block<3, 3>(index::velocity, 0).setIdentity();
  noise.q.head<3>().setConstant(std::pow(sigma_m_s / unit::velocity_m_s, 2));
  time_update(covariance_, StateMatrix::Identity(), noise);
  return {};
}

UpdateResult Filter::update(const BeaconMeasurement& measurement) {
  UpdateResult result;
  const auto rejected = [&result](UpdateReason reason) {
    result.accepted = false;
    result.reason = reason;
    return result;
  };
  if (!measurement.pixel.vec().allFinite() || !is_covariance(measurement.pixel_covariance_px2) ||
      !measurement.attitude_covariance_rad2.allFinite() || !measurement.pixel_attitude_covariance.allFinite() ||
      !measurement.R_CN.allFinite())
    return rejected(UpdateReason::bad_measurement);
  if (measurement.mid_exposure < epoch_) return rejected(UpdateReason::before_filter);
  const Result<State> body =
      ephemeris_->state(measurement.body, body::solar_system_barycenter, measurement.mid_exposure);
  const Result<State> sun = ephemeris_->state(body::sun, body::solar_system_barycenter, measurement.mid_exposure);
  if (!body || !sun || !propagate_to(measurement.mid_exposure)) return rejected(UpdateReason::no_ephemeris);

  const bool same_window =
      last_image_ && last_body_ == measurement.body && epoch_ - *last_image_ <= settings_.window_gap;
  if (last_body_ != measurement.body) rejections_ = {};
  if (!same_window) x_.segment<2>(index::bias).setZero();
  Result<Prediction> prediction = predict(x_, measurement, *body, sun->p_m);
  if (!prediction) return rejected(UpdateReason::out_of_view);
  if (!same_window) {
    start_window(measurement, prediction->pixel);
    result.window_started = true;
    accepted_in_window_ = 0;
  }
  last_body_ = measurement.body;
  last_image_ = epoch_;

  const Mat2 unscaled_noise = noise_covariance(measurement, prediction->pixel);
  const Mat2 R = noise_scale(measurement.body) * unscaled_noise;
  if (!is_covariance(R)) return rejected(UpdateReason::bad_measurement);
  MeasurementMatrix h = prediction->by_state;
  const Vec2 z = measurement.pixel.vec();
  const auto prior_covariance = [this](const MeasurementMatrix& by_x) -> Mat2 {
    const MeasurementMatrix f = by_x * covariance_.u;
    return f * covariance_.d.asDiagonal() * f.transpose();
  };

  const Vec2 predicted = prediction->pixel.pixel;
  result.predicted = {predicted.x(), predicted.y()};
  result.innovation_px = z - predicted;
  result.noise_covariance_px2 = R;
  Mat2 prior = prior_covariance(h);
  result.innovation_covariance_px2 = prior + R;
  result.nis = quadratic(result.innovation_px, result.innovation_covariance_px2);

  if (!(result.nis <= gate_)) {
    rejections_.count += 1;
    rejections_.sum += result.innovation_px;
    rejections_.sum2 += result.innovation_px.squaredNorm();
    rejections_.noise += R.trace();
    if (settings_.recovery_rejections <= 0 || rejections_.count < settings_.recovery_rejections)
      return rejected(UpdateReason::gated);
    result.recovered = recover(h);
    rejections_ = {};
    prior = prior_covariance(h);
    result.innovation_covariance_px2 = prior + R;
    result.nis = quadratic(result.innovation_px, result.innovation_covariance_px2);
    if (!(result.nis <= gate_)) return rejected(UpdateReason::gated);
  }
  rejections_ = {};

  // Iterated update (Jazwinski 1970, section 8.3): linearise anew where the last result put the state, until the pixel
  // predicted there is what the linear model said to a fiftieth of the noise.
  const StateVector before = x_;
  const double tolerance = 0.02 * std::sqrt(smaller_eigenvalue(R));
  MeasurementMatrix used = h;
  for (result.iterations = 1;; ++result.iterations) {
    used = h;
    const Vec2 innovation = z - prediction->pixel.pixel - h * (before - x_);
    const MeasurementMatrix f = h * covariance_.u;
    const Mat2 S = f * covariance_.d.asDiagonal() * f.transpose() + R;
    const StateVector weighted = covariance_.d.cwiseProduct(f.transpose() * (S.inverse() * innovation));
    const StateVector next = before + covariance_.u * weighted;
    const Vec2 linear = prediction->pixel.pixel + h * (next - x_);
    x_ = next;
    if (result.iterations >= settings_.max_iterations) break;
    prediction = predict(x_, measurement, *body, sun->p_m);
    if (!prediction) {
      x_ = before;
      return rejected(UpdateReason::out_of_view);
    }
    if ((prediction->pixel.pixel - linear).norm() <= tolerance) break;
    h = prediction->by_state;
  }

  // Two uncorrelated scalars of variance one.
  const Mat2 whitening = Mat2(R.llt().matrixL()).inverse();
  const MeasurementMatrix whitened = whitening * used;
  measurement_update(covariance_, whitened.row(0).transpose(), 1.0);
  measurement_update(covariance_, whitened.row(1).transpose(), 1.0);

  if (settings_.adaptive_noise) {
    // What the noise's normalised square is expected to be now that the measurement is in (Shumway & Stoffer 1982).
    if (NoiseScale* scale = scale_of(measurement.body)) {
      const Vec2 residual = result.innovation_px - used * (x_ - before);
      const Mat2 expected = residual * residual.transpose() + prior_covariance(used);
      const double memory = 1.0 - 1.0 / settings_.adaptive_memory_count;
      scale->sum = memory * scale->sum + (unscaled_noise.inverse() * expected).trace();
      scale->count = memory * scale->count + 2.0;
    }
  }
  ++accepted_in_window_;
  last_accepted_ = epoch_;
  result.accepted = true;
  result.reason = UpdateReason::accepted;
  return result;
}

Result<DirectionPrediction> Filter::predict_direction(BodyId body) const {
  const Result<State> place = ephemeris_->state(body, body::solar_system_barycenter, epoch_);
  if (!place) return forward(place);
  const Result<State> sun = ephemeris_->state(body::sun, body::solar_system_barycenter, epoch_);
  if (!sun) return forward(sun);
  const int beacon = beacon_of(body);
  SightSettings settings = settings_.sight;
  if (beacon >= 0) settings.centre_of_light_scale *= 1.0 + x_[index::photocentre + beacon];
  const Sight sight = apparent_sight(state(), *place, sun->p_m, mean_radius_m(body), settings);
  Eigen::Matrix<double, 3, kStates> by_state = Eigen::Matrix<double, 3, kStates>::Zero();
  by_state.middleCols<3>(index::position) = sight.by_position * unit::length_m;
  by_state.middleCols<3>(index::velocity) = sight.by_velocity * unit::velocity_m_s;
  if (beacon >= 0 && settings.centre_of_light_scale != 0.0)
    by_state.col(index::photocentre + beacon) =
        settings_.sight.centre_of_light_scale / settings.centre_of_light_scale * sight.shift_N;
  const Mat3 by_body = errors_of(beacon).ephemeris_m * sight.by_position;
  const Eigen::Matrix<double, 3, kStates> f = by_state * covariance_.u;
  return DirectionPrediction{sight.direction_N,
                             f * covariance_.d.asDiagonal() * f.transpose() + by_body * by_body.transpose(),
                             sight.distance_m, sight.light_time_s};
}

State Filter::state() const {
  return {x_.segment<3>(index::position) * unit::length_m, x_.segment<3>(index::velocity) * unit::velocity_m_s};
}

double Filter::mass_kg() const {
  return x_[index::mass];
}

StateVector Filter::state_vector() const {
  return x_.cwiseProduct(state_scales());
}

StateMatrix Filter::covariance() const {
  const StateVector scales = state_scales();
  return scales.asDiagonal() * covariance_.dense() * scales.asDiagonal();
}

Mat6 Filter::covariance_pv() const {
  const Eigen::Matrix<double, 6, kStates> rows = covariance_.u.topRows<6>();
  const Eigen::Matrix<double, 6, 1> scales = state_scales().head<6>();
  return scales.asDiagonal() * (rows * covariance_.d.asDiagonal() * rows.transpose()) * scales.asDiagonal();
}

}  // namespace astronav::navigation
