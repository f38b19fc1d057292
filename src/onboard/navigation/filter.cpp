// SPDX-License-Identifier: Apache-2.0
#include "onboard/navigation/filter.h"

#include <algorithm>
#include <cmath>

#include <Eigen/Cholesky>

#include "onboard/navigation/two_by_two.h"

namespace astronav::navigation {
namespace {

double squared(double x) {
  return x * x;
}

// Centroid and attitude: e + H_theta theta with E[e theta'] = C.
Mat2 noise_covariance(const BeaconMeasurement& measurement, const PixelPrediction& prediction) {
  const Mat23& h = prediction.by_attitude;
  const Mat2 cross = measurement.pixel_attitude_covariance * h.transpose();
  const Mat3 attitude = measurement.attitude_covariance_rad2 - measurement.attitude_repeating_rad2;
  return measurement.pixel_covariance_px2 + h * attitude * h.transpose() + cross + cross.transpose();
}

AgeingLaws ageing_laws(const FilterSettings& settings) {
  AgeingLaws laws;
  const auto law = [&laws](int state) -> GaussMarkov& {
    return laws[static_cast<std::size_t>(state - kDynamicStates)];
  };
  law(index::focal) = settings.focal;
  law(index::clock) = settings.clock;
  law(index::k1) = settings.k1;
  law(index::bias) = law(index::bias + 1) = settings.bias;
  for (int i = 0; i < kBeaconBodies; ++i) {
    const BeaconErrors& errors = settings.beacon_errors[static_cast<std::size_t>(i)];
    law(index::photocentre + i) = {errors.photocentre_fraction, settings.photocentre_tau_s};
    law(index::ephemeris + 2 * i) =
        law(index::ephemeris + 2 * i + 1) = {errors.lasting_ephemeris_m, settings.ephemeris_tau_s};
  }
  return laws;
}

// How often a coast is flown anew at most: each time what is left is less by the square.
constexpr int kMostFlights = 3;

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
  return Process(settings.process, ephemeris, ageing_laws(settings));
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
  variance(index::solar_pressure, settings_.process.solar_pressure.sigma);
  const AgeingLaws laws = ageing_laws(settings_);
  for (int i = 0; i < kAgeingStates; ++i) variance(kDynamicStates + i, laws[static_cast<std::size_t>(i)].sigma);

  const StateVector inverse = scales.cwiseInverse();
  const StateMatrix scaled = inverse.asDiagonal() * P * inverse.asDiagonal();
  const Result<FactorisedCovariance> factors = factorise(scaled);
  if (!factors) return forward(factors);

  epoch_ = initial.epoch;
  x_ = x.cwiseProduct(inverse);
  along_ = false;
  beside_.setZero();
  way_.setIdentity();
  covariance_ = *factors;
  last_body_ = BodyId{};
  last_image_.reset();
  last_accepted_.reset();
  coast_.reset();
  accepted_in_window_ = 0;
  rejections_ = {};
  noise_scales_ = {};
  seen_ = {};
  return {};
}

Result<void> Filter::propagate_to(Epoch epoch) {
  if (epoch < epoch_)
    return fail(ErrorCode::invalid_argument, "the filter does not go back by {0} s", {(epoch_ - epoch).seconds()});
  if (epoch == epoch_) return {};
  if (!coast_) coast_ = Coast{epoch_, x_, covariance_, Dynamic::Identity()};
  return fly_to(epoch, coast_->phi);
}

// phi becomes that of the way so far.
Result<void> Filter::fly_to(Epoch epoch, Dynamic& phi) {
  const Epoch before = epoch_;
  Result<void> result;
  Transition transition;
  while (result && epoch_ < epoch) {
    const Result<Duration> h = process_.step_towards(epoch_, epoch, x_);
    if (!h) {
      result = forward(h);
      break;
    }
    StateVector x = x_;
    result = process_.step(epoch_, *h, thrust_, x, transition);
    if (!result) break;
    x_ = x;
    time_update(covariance_, transition);
    phi = (transition.phi * phi).eval();
    way_ = (transition.phi * way_).eval();
    beside_.head<kDynamicStates>() = (transition.phi * beside_.head<kDynamicStates>()).eval();
    epoch_ = epoch_ + *h;
  }
  age(epoch_ - before);
  return result;
}

StateVector Filter::ageing_factors(Duration span) const {
  StateVector factors = StateVector::Ones();
  factors.tail<kAgeingStates>() = process_.ageing(span).factor;
  return factors;
}

void Filter::age(Duration span) {
  // A state of which less is left than this starts anew.
  constexpr double kNothing = 1e-9;
  const Process::Ageing ageing = process_.ageing(span);
  StateVector factor = StateVector::Ones();
  for (int i = 0; i < kAgeingStates; ++i) {
    const int state = kDynamicStates + i;
    if (ageing.factor[i] > kNothing) {
      factor[state] = ageing.factor[i];
    } else {
      forget(covariance_, state);
      x_[state] = beside_[state] = 0.0;
    }
  }
  scale(covariance_, factor);
  x_ = x_.cwiseProduct(factor).eval();
  beside_ = beside_.cwiseProduct(factor).eval();
  for (int i = 0; i < kAgeingStates; ++i)
    if (ageing.variance[i] > 0.0)
      add_outer_product(covariance_, StateVector::Unit(kDynamicStates + i), ageing.variance[i]);
}

BeaconErrors FilterSettings::errors_of(BodyId body) const {
  const auto known = std::find_if(beacon_errors.begin(), beacon_errors.end(),
                                  [&](const BeaconErrors& errors) { return errors.body == body; });
  return known == beacon_errors.end() ? BeaconErrors{} : *known;
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

Filter::Seen* Filter::seen_of(BodyId body) {
  for (Seen& seen : seen_)
    if (seen.body == body) return &seen;
  return nullptr;
}

// The beacon tracked last, seen again while its bias lasts: the same stars, the same bias.
Duration Filter::longest_pause() const {
  return settings_.window_memory.seconds() > 0.0 ? Duration::seconds(settings_.bias.tau_s) : Duration::seconds(0.0);
}

// Eq. 3a.
double Filter::excess_of_window(BodyId body, Epoch epoch) {
  const Seen* seen = seen_of(body);
  if (seen == nullptr || !(settings_.window_memory.seconds() > 0.0)) return 1.0;
  const double alike = std::exp(-std::max((epoch - seen->last).seconds(), settings_.window_gap.seconds()) /
                                settings_.window_memory.seconds());
  return (1.0 + alike) / (1.0 - alike);
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
  window_repeating_px2_ = squared(measurement.repeating_sigma_px);
  const double repeating2 = squared(settings_.bias.sigma) + window_repeating_px2_;
  const Mat2 covariance = window_excess_ * (repeating2 * Mat2::Identity() + by_body * by_body.transpose() +
                                            prediction.by_attitude * measurement.attitude_repeating_rad2 *
                                                prediction.by_attitude.transpose());

  forget(covariance_, index::bias);
  forget(covariance_, index::bias + 1);
  // covariance = L L', also where it is singular.
  const double l00 = std::sqrt(covariance(0, 0));
  const double l10 = l00 > 0.0 ? covariance(1, 0) / l00 : 0.0;
  StateVector first = StateVector::Zero();
  first.segment<2>(index::bias) = Vec2(l00, l10);
  add_outer_product(covariance_, first, 1.0);
  add_outer_product(covariance_, StateVector::Unit(index::bias + 1), std::max(covariance(1, 1) - l10 * l10, 0.0));
  x_.segment<2>(index::bias).setZero();
  beside_.segment<2>(index::bias).setZero();
}

void Filter::set_thrust(const Thrust& thrust) {
  const bool same = thrust.force_n == thrust_.force_n &&
                    (thrust.force_n == 0.0 || (thrust.specific_impulse_s == thrust_.specific_impulse_s &&
                                               thrust.direction_N == thrust_.direction_N));
  if (!same) coast_.reset();  // it is flown anew under one thrust
  thrust_ = thrust;
}

void Filter::fly_beside(const State& begin) {
  Vec6 to;
  to << begin.p_m / unit::length_m, begin.v_m_s / unit::velocity_m_s;
  beside_.head<6>() += x_.head<6>() - to;
  x_.head<6>() = to;
  along_ = true;
  way_.setIdentity();
  coast_.reset();
}

void Filter::join() {
  x_ += beside_;
  beside_.setZero();
  along_ = false;
  coast_.reset();
}

Mat6 Filter::sensitivity() const {
  const Vec6 scales = state_scales().head<6>();
  return scales.asDiagonal() * way_.topLeftCorner<6, 6>() * scales.cwiseInverse().asDiagonal();
}

Result<void> Filter::kick(const Vec3& delta_v_N_m_s, double sigma_m_s) {
  if (!delta_v_N_m_s.allFinite() || !(sigma_m_s >= 0.0) || !std::isfinite(sigma_m_s))
    return fail(ErrorCode::invalid_argument, "a push of {0} m/s with sigma {1} m/s", {delta_v_N_m_s.norm(), sigma_m_s});
  coast_.reset();
  x_.segment<3>(index::velocity) += delta_v_N_m_s / unit::velocity_m_s;
  for (int axis = 0; axis < 3; ++axis)
    add_outer_product(covariance_, StateVector::Unit(index::velocity + axis),
                      std::pow(sigma_m_s / unit::velocity_m_s, 2));
  return {};
}

// Iterated update of x_ (Jazwinski 1970, section 8.3), whose mean before was `prior`: linearised where x_ is, then
// where the last result put it, until the pixel predicted there is what the linear model said to a fiftieth of the
// noise. The covariance, which is left to the caller, gets the derivatives of the last place: those of the place before
// are turned by as much as the sight has turned since, and the next image, seen the right way, would be held for news
// of the distance.
Result<Filter::Correction> Filter::correct(const StateVector& prior, const Prediction& at_x, const Beacon& beacon,
                                           const BeaconMeasurement& measurement, const Mat2& R) {
  const double tolerance = 0.02 * std::sqrt(smaller_eigenvalue(R));
  Correction out{at_x, StateVector::Zero()};
  for (;;) {
    const MeasurementMatrix h = out.prediction.by_state;
    const Vec2 predicted = out.prediction.pixel.pixel;
    const Vec2 innovation = measurement.pixel.vec() - predicted - h * (prior - x_);
    const MeasurementMatrix f = h * covariance_.u;
    const Mat2 S = f * covariance_.d.asDiagonal() * f.transpose() + R;
    const Vec2 weighted = S.inverse() * innovation;
    const StateVector next = prior + covariance_.u * covariance_.d.cwiseProduct(f.transpose() * weighted);
    const Vec2 linear = predicted + h * (next - x_);
    x_ = next;
    Result<Prediction> there = predict(x_, beacon, measurement);
    if (!there) return forward(there);
    out.prediction = *there;
    out.pull = h.transpose() * weighted;
    ++out.iterations;
    if (out.iterations >= settings_.max_iterations || (there->pixel.pixel - linear).norm() <= tolerance) return out;
  }
}

// Linear where the way is, once.
Filter::Correction Filter::correct_beside(const Prediction& at_x, const UpdateResult& foretold) {
  const MeasurementMatrix f = at_x.by_state * covariance_.u;
  const Vec2 weighted = foretold.innovation_covariance_px2.inverse() * foretold.innovation_px;
  beside_ += covariance_.u * covariance_.d.cwiseProduct(f.transpose() * weighted);
  Correction out{at_x, at_x.by_state.transpose() * weighted, 1};
  out.prediction.pixel.pixel += at_x.by_state * beside_;
  return out;
}

// A coast of length T that begins with a velocity wrong by v ends wrong by d = T v, and by GM d^2 T^2 / (4 r^4) beside
// what a linear model says: the Sun's pull (its second derivative by place, twice integrated).
bool Filter::bends(const StateVector& change) const {
  constexpr double kTolerance_m = 100.0;
  if (!coast_) return false;
  const double T = (epoch_ - coast_->begin).seconds() / unit::time_s;
  const double d2 = change.segment<3>(index::position).squaredNorm(), r2 = x_.segment<3>(index::position).squaredNorm();
  return 0.25 * d2 * T * T / (r2 * r2) * unit::length_m > kTolerance_m;
}

// Flies the last coast once more, from where the pull of the sight at its end shows that it began: smoothed back to
// its beginning, x_s = x_0 + P_0 Phi' pull. The state is then where that flight ends, the covariance the one along it;
// returned is the mean that x_0 has there, f(x_s) + Phi (x_0 - x_s).
Result<StateVector> Filter::fly_anew(const StateVector& pull) {
  Coast& coast = *coast_;
  const Epoch end = epoch_;
  const StateVector ageing = ageing_factors(end - coast.begin);
  const auto along = [&](const Dynamic& phi, const StateVector& x) {
    StateVector out = ageing.cwiseProduct(x);
    out.head<kDynamicStates>() = phi * x.head<kDynamicStates>();
    return out;
  };
  StateVector at_begin = along(coast.phi.transpose(), pull);
  at_begin.segment<2>(index::bias).setZero();  // of another window
  const StateVector change =
      coast.covariance.u * coast.covariance.d.cwiseProduct(coast.covariance.u.transpose() * at_begin);
  epoch_ = coast.begin;
  x_ = coast.x + change;
  covariance_ = coast.covariance;
  coast.phi.setIdentity();
  if (const Result<void> flown = fly_to(end, coast.phi); !flown) return forward(flown);
  return StateVector(x_ - along(coast.phi, change));
}

UpdateResult Filter::update(const BeaconMeasurement& measurement) {
  UpdateResult result;
  const auto rejected = [&result](UpdateReason reason) {
    result.accepted = false;
    result.reason = reason;
    return result;
  };
  if (!measurement.pixel.vec().allFinite() || !is_covariance(measurement.pixel_covariance_px2) ||
      !measurement.attitude_covariance_rad2.allFinite() || !measurement.attitude_repeating_rad2.allFinite() ||
      !measurement.pixel_attitude_covariance.allFinite() || !measurement.R_CN.allFinite())
    return rejected(UpdateReason::bad_measurement);
  if (measurement.mid_exposure < epoch_) return rejected(UpdateReason::before_filter);
  const Result<Beacon> beacon = find(measurement.body, measurement.mid_exposure);
  if (!beacon || !propagate_to(measurement.mid_exposure)) return rejected(UpdateReason::no_ephemeris);

  const bool same_body = last_image_ && last_body_ == measurement.body;
  const bool paused = same_body && epoch_ - *last_image_ > settings_.window_gap;
  const bool same_window = same_body && (!paused || epoch_ - *last_image_ <= longest_pause());
  if (last_body_ != measurement.body) rejections_ = {};
  if (!same_window) {
    x_.segment<2>(index::bias).setZero();
    beside_.segment<2>(index::bias).setZero();
  }
  Result<Prediction> prediction = predict(x_, *beacon, measurement);
  if (!prediction) return rejected(UpdateReason::out_of_view);
  if (!same_window) {
    window_excess_ = excess_of_window(measurement.body, epoch_);
    start_window(measurement, prediction->pixel);
    result.window_started = true;
  }
  if (!same_window || paused) accepted_in_window_ = 0;
  last_body_ = measurement.body;
  last_image_ = epoch_;
  Seen* seen = seen_of(measurement.body);
  if (seen == nullptr) seen = seen_of(BodyId{});
  if (seen != nullptr) *seen = {measurement.body, epoch_};

  const double beyond_window2 = std::max(0.0, squared(measurement.repeating_sigma_px) - window_repeating_px2_);
  const Mat2 unscaled_noise = noise_covariance(measurement, prediction->pixel) + beyond_window2 * Mat2::Identity();
  const Mat2 R = noise_scale(measurement.body) * unscaled_noise;
  if (!is_covariance(R)) return rejected(UpdateReason::bad_measurement);
  const Vec2 z = measurement.pixel.vec();
  const auto prior_covariance = [this](const MeasurementMatrix& by_x) -> Mat2 {
    const MeasurementMatrix f = by_x * covariance_.u;
    return f * covariance_.d.asDiagonal() * f.transpose();
  };

  const Vec2 predicted = prediction->pixel.pixel;
  result.predicted = {predicted.x(), predicted.y()};
  result.noise_covariance_px2 = R;
  MeasurementMatrix h = prediction->by_state;
  result.innovation_px = z - predicted - h * beside_;
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
    coast_.reset();
    rejections_ = {};
    prior = prior_covariance(h);
    result.innovation_covariance_px2 = prior + R;
    result.nis = quadratic(result.innovation_px, result.innovation_covariance_px2);
    if (!(result.nis <= gate_)) return rejected(UpdateReason::gated);
  }
  rejections_ = {};

  StateVector before = x_, flown = x_;
  Result<Correction> correction =
      along_ ? correct_beside(*prediction, result) : correct(before, *prediction, *beacon, measurement, R);
  for (int flights = 0; !along_ && correction && flights < kMostFlights && bends(x_ - flown); ++flights) {
    const Result<StateVector> predicted_anew = fly_anew(correction->pull);
    if (!predicted_anew) return rejected(UpdateReason::no_ephemeris);
    before = *predicted_anew;
    flown = x_;
    prediction = predict(x_, *beacon, measurement);
    if (!prediction) return rejected(UpdateReason::out_of_view);
    start_window(measurement, prediction->pixel);
    before.segment<2>(index::bias).setZero();
    correction = correct(before, *prediction, *beacon, measurement, R);
  }
  if (!correction) {
    x_ = before;
    return rejected(UpdateReason::out_of_view);
  }
  result.iterations = correction->iterations;
  h = correction->prediction.by_state;

  // Two uncorrelated scalars of variance one.
  const Mat2 whitening = Mat2(R.llt().matrixL()).inverse();
  const MeasurementMatrix whitened = whitening * h;
  measurement_update(covariance_, whitened.row(0).transpose(), 1.0);
  measurement_update(covariance_, whitened.row(1).transpose(), 1.0);

  if (settings_.adaptive_noise) {
    // What the noise's normalised square is expected to be now that the measurement is in (Shumway & Stoffer 1982).
    if (NoiseScale* scale = scale_of(measurement.body)) {
      const Vec2 residual = z - correction->prediction.pixel.pixel;
      const Mat2 expected = residual * residual.transpose() + prior_covariance(h);
      const double memory = 1.0 - 1.0 / settings_.adaptive_memory_count;
      scale->sum = memory * scale->sum + (unscaled_noise.inverse() * expected).trace();
      scale->count = memory * scale->count + 2.0;
    }
  }
  ++accepted_in_window_;
  last_accepted_ = epoch_;
  coast_.reset();
  result.accepted = true;
  result.reason = UpdateReason::accepted;
  return result;
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
  const Vec6 scales = state_scales().head<6>();
  return scales.asDiagonal() * (rows * covariance_.d.asDiagonal() * rows.transpose()) * scales.asDiagonal();
}

}  // namespace astronav::navigation
