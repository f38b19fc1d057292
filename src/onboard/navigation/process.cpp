// SPDX-License-Identifier: Apache-2.0
#include "onboard/navigation/process.h"

#include <algorithm>
#include <cmath>

namespace astronav::navigation {
namespace {

constexpr double kSolarPressure = 4.56e-6;    // N/m2 at 1 AU
constexpr double kStandardGravity = 9.80665;  // m/s2

// Position and velocity, and their derivatives by the dynamic states at the beginning of the step.
using Sensitivity = Eigen::Matrix<double, 6, kDynamicStates>;
using Sensitivity3 = Eigen::Matrix<double, 3, kDynamicStates>;

struct Flow {
  Vec6 x;
  Sensitivity s;
};

// e1, e2: any two directions across u, the same for the same u.
void thrust_axes(const Vec3& u, Vec3& e1, Vec3& e2) {
  const Vec3 a = std::abs(u.z()) < 0.9 ? Vec3::UnitZ() : Vec3::UnitX();
  e1 = a.cross(u).normalized();
  e2 = u.cross(e1);
}

Result<void> check_law(const GaussMarkov& law) {
  if (law.tau_s > 0.0 && law.sigma >= 0.0) return {};
  return fail(ErrorCode::invalid_argument, "a Gauss-Markov law has sigma {0} and time constant {1} s",
              {law.sigma, law.tau_s});
}

}  // namespace

Process::Process(const ProcessSettings& settings, const Ephemeris& ephemeris, const AgeingLaws& ageing)
    : settings_(settings), ephemeris_(&ephemeris), ageing_(ageing) {
  for (const BodyId body : settings_.attractors) {
    if (body == BodyId{}) break;
    const Result<BodyConstants> constants = body_constants(body);
    constants_known_ = constants_known_ && constants.has_value();
    if (body == body::sun) sun_ = attractors_;
    gm_[attractors_++] = constants ? constants->gm_m3_s2 / unit::gm_m3_s2 : 0.0;
  }
}

Result<void> Process::check(Epoch epoch) const {
  if (sun_ < 0) return fail(ErrorCode::invalid_argument, "the list of attractors lacks the Sun");
  if (!constants_known_) return fail(ErrorCode::not_found, "an attractor's gravitational parameter is not known");
  for (const GaussMarkov& law :
       {settings_.acceleration, settings_.thrust_magnitude, settings_.thrust_pointing, settings_.solar_pressure})
    if (const Result<void> sound = check_law(law); !sound) return sound;
  for (const GaussMarkov& law : ageing_)
    if (const Result<void> sound = check_law(law); !sound) return sound;
  if (!(settings_.step_share > 0.0) || settings_.max_step <= Duration())
    return fail(ErrorCode::invalid_argument, "step share {0} and longest step {1} s must be positive",
                {settings_.step_share, settings_.max_step.seconds()});
  Places ignored;
  return places(epoch, ignored);
}

Result<void> Process::places(Epoch epoch, Places& out) const {
  if (out.valid && out.epoch == epoch) return {};
  out.valid = false;
  for (int i = 0; i < attractors_; ++i) {
    const Result<State> state = ephemeris_->state(settings_.attractors[i], body::solar_system_barycenter, epoch);
    if (!state) return forward(state);
    out.p[i] = state->p_m / unit::length_m;
  }
  out.epoch = epoch;
  out.valid = true;
  return {};
}

Result<Duration> Process::step_length(Epoch epoch, const StateVector& x) {
  if (end_.valid && end_.epoch == epoch) std::swap(start_, end_);
  if (const Result<void> found = places(epoch, start_); !found) return forward(found);
  const Vec3 p = x.segment<3>(index::position);
  double shortest2 = 1e30;
  for (int i = 0; i < attractors_; ++i) {
    const double d2 = (p - start_.p[i]).squaredNorm();
    // A planet is passed faster than it would be orbited: there 0.4 of the share is short enough.
    const double passing = i == sun_ ? 1.0 : 0.4 * 0.4;
    shortest2 = std::min(shortest2, passing * d2 * std::sqrt(d2) / gm_[i]);
  }
  // The quadrature of the process noise wants steps short against the correlation times, too.
  double h_s = settings_.step_share * std::sqrt(shortest2) * unit::time_s;
  h_s = std::min({h_s, settings_.max_step.seconds(), 0.5 * settings_.acceleration.tau_s});
  return Duration::seconds(std::max(h_s, 1e-3));
}

Result<Duration> Process::step_towards(Epoch epoch, Epoch to, const StateVector& x) {
  const Result<Duration> longest = step_length(epoch, x);
  if (!longest) return longest;
  const std::int64_t left = (to - epoch).nanoseconds();
  const std::int64_t steps = (left + longest->nanoseconds() - 1) / longest->nanoseconds();
  return Duration::nanoseconds((left + steps - 1) / steps);
}

Result<void> Process::step(Epoch epoch, Duration h, const Thrust& thrust, StateVector& x, Transition& out) {
  if (end_.valid && end_.epoch == epoch) std::swap(start_, end_);
  if (const Result<void> found = places(epoch, start_); !found) return found;
  if (const Result<void> found = places(epoch + Duration::nanoseconds(h.nanoseconds() / 2), middle_); !found)
    return found;
  if (const Result<void> found = places(epoch + h, end_); !found) return found;

  const double step = h.seconds() / unit::time_s;
  const double mass = x[index::mass];
  const Vec3 xi_a = x.segment<3>(index::acceleration);
  const Vec3 xi_t = x.segment<3>(index::thrust);
  const double xi_s = x[index::solar_pressure];
  const double rate_a = unit::time_s / settings_.acceleration.tau_s;
  const double rate_s = unit::time_s / settings_.solar_pressure.tau_s;
  const double rate_t[2] = {unit::time_s / settings_.thrust_magnitude.tau_s,
                            unit::time_s / settings_.thrust_pointing.tau_s};

  Mat3 thrust_frame;  // columns u, e1, e2: what xi_T multiplies
  thrust_frame.col(0) = thrust.direction_N;
  Vec3 e1, e2;
  thrust_axes(thrust.direction_N, e1, e2);
  thrust_frame.col(1) = e1;
  thrust_frame.col(2) = e2;
  const double mass_flow = thrust.force_n > 0.0
                               ? thrust.force_n / (thrust.specific_impulse_s * kStandardGravity) * unit::time_s
                               : 0.0;  // kg per unit of time

  // Derivative of position, velocity and their sensitivities, `s` into the step.
  const auto derivative = [&](double s, const Places& at, const Flow& flow) {
    const double m = mass - mass_flow * s;
    const double decay_a = std::exp(-rate_a * s);
    const Vec3 decay_t(std::exp(-rate_t[0] * s), std::exp(-rate_t[1] * s), std::exp(-rate_t[1] * s));
    const double decay_s = std::exp(-rate_s * s);
    const double believed = kSolarPressure * settings_.reflectivity_area_m2 / (m * unit::acceleration_m_s2);
    const double pressure = believed * (1.0 + decay_s * xi_s);
    const double thrust_acceleration = thrust.force_n / (m * unit::acceleration_m_s2);

    const Vec3 p = flow.x.head<3>();
    Vec3 a = Vec3::Zero();
    Mat3 gradient = Mat3::Zero();
    Vec3 pressure_acceleration = Vec3::Zero(), by_xi_s = Vec3::Zero();
    for (int i = 0; i < attractors_; ++i) {
      const Vec3 d = p - at.p[i];
      const double r2 = d.squaredNorm();
      const double inverse3 = 1.0 / (r2 * std::sqrt(r2));
      // Sunlight pushes with the same law as the Sun pulls.
      double gm = gm_[i];
      if (i == sun_) {
        pressure_acceleration = pressure * inverse3 * d;
        by_xi_s = decay_s * believed * inverse3 * d;
        gm -= pressure;
      }
      a -= gm * inverse3 * d;
      gradient += gm * inverse3 * (3.0 / r2 * d * d.transpose() - Mat3::Identity());
    }
    const Vec3 thrust_share = decay_t.cwiseProduct(xi_t) + Vec3::UnitX();  // along u, e1, e2
    const Vec3 thrust_vector = thrust_acceleration * (thrust_frame * thrust_share);
    a += decay_a * xi_a + thrust_vector;

    Flow rate;
    rate.x << flow.x.tail<3>(), a;
    rate.s.topRows<3>() = flow.s.bottomRows<3>();
    Sensitivity3 s_a = gradient * flow.s.topRows<3>();
    s_a.col(index::mass) -= (pressure_acceleration + thrust_vector) / m;
    s_a.middleCols<3>(index::acceleration).diagonal().array() += decay_a;
    s_a.middleCols<3>(index::thrust) += thrust_acceleration * thrust_frame * decay_t.asDiagonal();
    s_a.col(index::solar_pressure) += by_xi_s;
    rate.s.bottomRows<3>() = s_a;
    return rate;
  };
  const auto advanced = [](const Flow& from, const Flow& rate, double by) {
    return Flow{from.x + by * rate.x, from.s + by * rate.s};
  };

  Flow flow;
  flow.x = x.head<6>();
  flow.s.setZero();
  flow.s.leftCols<6>().setIdentity();
  const Flow k1 = derivative(0.0, start_, flow);
  const Flow k2 = derivative(0.5 * step, middle_, advanced(flow, k1, 0.5 * step));
  const Flow k3 = derivative(0.5 * step, middle_, advanced(flow, k2, 0.5 * step));
  const Flow k4 = derivative(step, end_, advanced(flow, k3, step));
  flow.x += step / 6.0 * (k1.x + 2.0 * k2.x + 2.0 * k3.x + k4.x);
  flow.s += step / 6.0 * (k1.s + 2.0 * k2.s + 2.0 * k3.s + k4.s);

  const double phi_a = std::exp(-rate_a * step);
  const Vec3 phi_t(std::exp(-rate_t[0] * step), std::exp(-rate_t[1] * step), std::exp(-rate_t[1] * step));
  const double phi_s = std::exp(-rate_s * step);
  x.head<6>() = flow.x;
  x[index::mass] = mass - mass_flow * step;
  x.segment<3>(index::acceleration) *= phi_a;
  x.segment<3>(index::thrust).array() *= phi_t.array();
  x[index::solar_pressure] *= phi_s;
  out.phi.setIdentity();
  out.phi.topRows<6>() = flow.s;
  out.phi.diagonal().segment<3>(index::acceleration).setConstant(phi_a);
  out.phi.diagonal().segment<3>(index::thrust) = phi_t;
  out.phi(index::solar_pressure, index::solar_pressure) = phi_s;

  // Process noise: white noise that drives xi at s before the end of the step has grown by then into xi, velocity and
  // position (gravity's gradient within one step is left out). Gauss-Legendre over the step gives columns of Q
  // directly.
  constexpr double kNode = 0.38729833462074169;  // sqrt(3/20)
  constexpr double nodes[3] = {0.5 - kNode, 0.5, 0.5 + kNode};
  constexpr double shares[3] = {5.0 / 18.0, 8.0 / 18.0, 5.0 / 18.0};
  out.n.setZero();
  out.q.setZero();
  int column = 0;
  const auto drive = [&](int state, const Vec3& influence, double sigma, double rate) {
    for (int i = 0; i < 3; ++i, ++column) {
      const double s = nodes[i] * step;
      const double decay_less_one = std::expm1(-rate * s);
      out.n(state, column) = 1.0 + decay_less_one;
      out.n.col(column).segment<3>(index::velocity) = influence * (-decay_less_one / rate);
      out.n.col(column).segment<3>(index::position) = influence * ((rate * s + decay_less_one) / (rate * rate));
      out.q[column] = 2.0 * sigma * sigma * rate * step * shares[i];
    }
  };
  const double sigma_a = settings_.acceleration.sigma / unit::acceleration_m_s2;
  for (int axis = 0; axis < 3; ++axis) drive(index::acceleration + axis, Vec3::Unit(axis), sigma_a, rate_a);
  const double thrust_acceleration = thrust.force_n / (mass * unit::acceleration_m_s2);
  for (int axis = 0; axis < 3; ++axis)
    drive(index::thrust + axis, thrust_acceleration * thrust_frame.col(axis),
          axis == 0 ? settings_.thrust_magnitude.sigma : settings_.thrust_pointing.sigma, rate_t[axis == 0 ? 0 : 1]);
  // What noise of xi_s has grown into within one step is nothing beside what xi_s itself does.
  out.n(index::solar_pressure, column) = 1.0;
  out.q[column] = -settings_.solar_pressure.sigma * settings_.solar_pressure.sigma * std::expm1(-2.0 * rate_s * step);
  return {};
}

Process::Ageing Process::ageing(Duration span) const {
  const StateVector scales = state_scales();
  Ageing out;
  for (int i = 0; i < kAgeingStates; ++i) {
    const GaussMarkov& law = ageing_[static_cast<std::size_t>(i)];
    const double exponent = law.sigma > 0.0 ? -span.seconds() / law.tau_s : 0.0;
    const double sigma = law.sigma / scales[kDynamicStates + i];
    out.factor[i] = std::exp(exponent);
    out.variance[i] = -sigma * sigma * std::expm1(2.0 * exponent);
  }
  return out;
}

}  // namespace astronav::navigation
