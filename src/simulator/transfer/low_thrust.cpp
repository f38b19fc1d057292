// SPDX-License-Identifier: Apache-2.0
#include "simulator/transfer/low_thrust.h"

#include <algorithm>
#include <cmath>
#include <optional>
#include <utility>
#include <vector>

#include <Eigen/LU>

#include "simulator/transfer/encounter.h"
#include "simulator/transfer/steering.h"

namespace astronav::transfer {
namespace {

using Mat69 = Eigen::Matrix<double, 6, 9>;  // derivatives by the state at a segment's begin, and by its thrust

constexpr double kLeastLevel = 0.02;  // of thrust; below it an arc is not flown

struct Interval {
  Epoch begin, end;
};

// The arcs that may thrust: what the coasts leave of the cruise, each stretch cut into equal parts.
std::vector<Interval> intervals_of(Epoch begin, Epoch end, const LowThrustSettings& s) {
  std::vector<Interval> out;
  const auto add = [&](Epoch a, Epoch b, int parts) {
    b = std::min(b, end);
    if (b - a < Duration::seconds(3600.0)) return;
    const Duration part = Duration::nanoseconds((b - a).nanoseconds() / parts);
    for (int i = 0; i < parts; ++i) out.push_back({a + part * i, i + 1 == parts ? b : a + part * (i + 1)});
  };
  add(begin, begin + s.first_coast, 1);
  for (Epoch coast = begin + s.first_coast; coast + s.coast < end; coast = coast + s.cycle) {
    add(coast + s.coast, coast + s.cycle, s.arcs_per_cycle);
  }
  return out;
}

// What is being sought: the thrust of each interval, in units of the largest, and the launcher's v-infinity.
struct Guess {
  std::vector<Vec3> thrust;
  Vec3 v_infinity = Vec3::Zero();
};

struct Flight {
  ThrustPlan plan;
  dynamics::Arc arc;
};

class Designer {
 public:
  Designer(const Ephemeris& ephemeris, const LowThrustSettings& settings, BodyId from, BodyId to, Epoch begin,
           Epoch arrival)
      : ephemeris_(ephemeris), settings_(settings), from_(from), to_(to), begin_(begin), arrival_(arrival) {}

  Result<LowThrustDesign> run();

 private:
  Result<void> look_up();
  State start_of(const Vec3& v_infinity) const;
  Result<Flight> fly(const Guess& guess);
  Result<Mat3> gravity_gradient(Epoch epoch, const Vec3& p) const;
  Result<Mat69> across_segment(const Flight& flight, Epoch begin, Epoch end) const;
  // B of every control (thrust intervals, departure, arrival) at the arrival, non-dimensional.
  Result<std::vector<Control>> linearise(const Flight& flight, const Guess& guess) const;
  double miss_m(const Flight& flight) const;
  // One linearisation and steering from `guess`, flown.
  Result<void> improve(Guess& guess, Flight& flight, double departure_limit, double arrival_limit, double smoothing);
  Result<void> approach_limits(Guess& guess, Flight& flight);
  Result<void> sharpen(Guess& guess, Flight& flight);

  const Ephemeris& ephemeris_;
  LowThrustSettings settings_;
  BodyId from_, to_;
  Epoch begin_, arrival_, end_;
  LambertLeg leg_;
  State from_O_, to_O_;
  double from_gm_ = 0.0, to_gm_ = 0.0, miss_distance_ = 0.0;
  Vec3 aim_ = Vec3::Zero();
  double speed_ = 1.0;  // unit: the Earth's
  std::vector<std::pair<BodyId, double>> attractors_;
  std::vector<Interval> intervals_;
  std::vector<bool> idle_;  // intervals that stay without thrust
  Vec6 costate_ = Vec6::Zero();
  int flights_ = 0;
};

Result<void> Designer::look_up() {
  const auto leg = lambert_leg(ephemeris_, from_, to_, begin_, arrival_ - begin_);
  if (!leg) return forward(leg);
  leg_ = *leg;
  const auto from_O = ephemeris_.state(from_, body::solar_system_barycenter, begin_);
  if (!from_O) return forward(from_O);
  from_O_ = *from_O;
  const auto to_O = ephemeris_.state(to_, body::solar_system_barycenter, arrival_);
  if (!to_O) return forward(to_O);
  to_O_ = *to_O;
  const auto to_S = ephemeris_.state(to_, body::sun, arrival_);
  if (!to_S) return forward(to_S);
  const auto from_constants = body_constants(from_);
  if (!from_constants) return forward(from_constants);
  from_gm_ = from_constants->gm_m3_s2;
  const auto to_constants = body_constants(to_);
  if (!to_constants) return forward(to_constants);
  to_gm_ = to_constants->gm_m3_s2;
  const auto sun = body_constants(body::sun);
  if (!sun) return forward(sun);
  speed_ = std::sqrt(sun->gm_m3_s2 / kAstronomicalUnit);
  for (const BodyId id : settings_.forces.bodies) {
    const auto constants = body_constants(id);
    if (!constants) return forward(constants);
    const auto resolved = ephemeris_.resolve(id);
    if (!resolved) return forward(resolved);
    attractors_.emplace_back(*resolved, constants->gm_m3_s2);
  }
  miss_distance_ = settings_.miss_distance_m != 0.0
                       ? settings_.miss_distance_m
                       : 0.2 * sphere_of_influence(to_S->p_m.norm(), to_gm_, sun->gm_m3_s2);
  aim_ = to_O_.p_m + miss_distance_ * across(to_S->p_m, leg_.v_infinity_arrival_m_s, Vec3::UnitZ());
  return {};
}

// On the way straight out from the planet, as fast as the hyperbola is at this distance.
State Designer::start_of(const Vec3& v_infinity) const {
  const double d = settings_.departure_distance_m;
  const Vec3 out = v_infinity.normalized();
  return {from_O_.p_m + d * out, from_O_.v_m_s + std::sqrt(v_infinity.squaredNorm() + 2.0 * from_gm_ / d) * out};
}

Result<Flight> Designer::fly(const Guess& guess) {
  ++flights_;
  ThrustPlan plan{.mass_kg = settings_.mass_kg, .arcs = {}};
  for (std::size_t i = 0; i < intervals_.size(); ++i) {
    const double level = std::min(guess.thrust[i].norm(), 1.0);
    if (level < 1e-6) continue;
    plan.arcs.push_back({intervals_[i].begin, intervals_[i].end, level * settings_.force_n,
                         settings_.specific_impulse_s, guess.thrust[i].normalized()});
  }
  auto thrust = dynamics::ThrustHistory::as_planned(plan);
  if (!thrust) return forward(thrust);
  const auto forces = dynamics::ForceModel::create(
      ephemeris_, settings_.forces, dynamics::Events{.unmodelled = {}, .thrust = std::move(*thrust), .kicks = {}});
  if (!forces) return forward(forces);
  auto arc = dynamics::propagate(*forces, start_of(guess.v_infinity), begin_, arrival_, settings_.propagation);
  if (!arc) return forward(arc);
  return Flight{std::move(plan), std::move(*arc)};
}

Result<Mat3> Designer::gravity_gradient(Epoch epoch, const Vec3& p) const {
  Mat3 sum = Mat3::Zero();
  for (const auto& [id, gm] : attractors_) {
    const auto body_O = ephemeris_.state(id, body::solar_system_barycenter, epoch);
    if (!body_O) return forward(body_O);
    const Vec3 d = p - body_O->p_m;
    const double r2 = d.squaredNorm();
    sum += gm / (r2 * std::sqrt(r2)) * (3.0 / r2 * d * d.transpose() - Mat3::Identity());
  }
  return sum;
}

// Runge and Kutta's method of order 4 along the flight. The gradient of gravity alone: solar pressure and relativity
// change the derivatives by 1e-5.
Result<Mat69> Designer::across_segment(const Flight& flight, Epoch begin, Epoch end) const {
  Mat69 y = Mat69::Zero();
  y.leftCols<6>().setIdentity();
  const int steps = std::max(1, static_cast<int>(std::ceil((end - begin).days() / 0.25)));
  const double h = (end - begin).seconds() / steps;
  const auto rate = [&](Epoch e, const Mat69& x, const Mat3& gradient) {
    Mat69 out;
    out.topRows<3>() = x.bottomRows<3>();
    out.bottomRows<3>() = gradient * x.topRows<3>();
    out.bottomRightCorner<3, 3>() += settings_.force_n / flight.plan.mass_at_kg(e) * Mat3::Identity();
    return out;
  };
  for (int i = 0; i < steps; ++i) {
    const Epoch t[3] = {begin + Duration::seconds(h * i), begin + Duration::seconds(h * (i + 0.5)),
                        i + 1 == steps ? end : begin + Duration::seconds(h * (i + 1))};
    Mat3 gradient[3];
    for (int k = 0; k < 3; ++k) {
      const auto at = flight.arc.at(t[k]);
      if (!at) return forward(at);
      const auto g = gravity_gradient(t[k], at->p_m);
      if (!g) return forward(g);
      gradient[k] = *g;
    }
    const Mat69 k1 = rate(t[0], y, gradient[0]);
    const Mat69 k2 = rate(t[1], y + 0.5 * h * k1, gradient[1]);
    const Mat69 k3 = rate(t[1], y + 0.5 * h * k2, gradient[1]);
    const Mat69 k4 = rate(t[2], y + h * k3, gradient[2]);
    y += h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4);
  }
  return y;
}

Result<std::vector<Control>> Designer::linearise(const Flight& flight, const Guess& guess) const {
  Vec6 unit;
  unit << Vec3::Constant(kAstronomicalUnit), Vec3::Constant(speed_);
  const double total_s = (end_ - begin_).seconds();
  std::vector<Control> controls(intervals_.size() + 2);
  // From the arrival backwards, so that what follows a segment is known.
  Mat6 onwards = Mat6::Identity();
  Epoch later = arrival_;
  for (std::size_t i = intervals_.size(); i-- > 0;) {
    const auto coast = across_segment(flight, intervals_[i].end, later);
    if (!coast) return forward(coast);
    onwards = onwards * coast->leftCols<6>();
    const auto arc = across_segment(flight, intervals_[i].begin, intervals_[i].end);
    if (!arc) return forward(arc);
    controls[i].effect = unit.cwiseInverse().asDiagonal() * (onwards * arc->rightCols<3>());
    controls[i].limit = idle_[i] ? 0.0 : 1.0;
    controls[i].weight = (intervals_[i].end - intervals_[i].begin).seconds() / total_s;
    onwards = onwards * arc->leftCols<6>();
    later = intervals_[i].begin;
  }
  const auto first = across_segment(flight, begin_, later);
  if (!first) return forward(first);
  onwards = onwards * first->leftCols<6>();

  // How the state at the beginning depends on the launcher's v-infinity (start_of).
  const double v = guess.v_infinity.norm();
  const double d = settings_.departure_distance_m;
  const double speed = std::sqrt(v * v + 2.0 * from_gm_ / d);
  const Mat3 along = guess.v_infinity * guess.v_infinity.transpose() / (v * v);
  Mat63 start;
  start.topRows<3>() = d / v * (Mat3::Identity() - along);
  start.bottomRows<3>() = speed / v * (Mat3::Identity() - along) + v / speed * along;
  Control& departure = controls[intervals_.size()];
  departure.effect = unit.cwiseInverse().asDiagonal() * (onwards * start) * speed_;
  departure.weight = 0.0;
  // The velocity relative to the planet that is left at the arrival counts as reached.
  Control& arrival = controls[intervals_.size() + 1];
  arrival.effect.bottomRows<3>() = -Mat3::Identity();
  arrival.weight = 0.0;
  return controls;
}

double Designer::miss_m(const Flight& flight) const {
  return (flight.arc.nodes().back().state.p_m - aim_).norm();
}

Result<void> Designer::improve(Guess& guess, Flight& flight, double departure_limit, double arrival_limit,
                               double smoothing) {
  auto controls = linearise(flight, guess);
  if (!controls) return forward(controls);
  const std::size_t n = intervals_.size();
  (*controls)[n].limit = departure_limit / speed_;
  // At the aim point the planet has added to v-infinity.
  (*controls)[n + 1].limit = std::sqrt(arrival_limit * arrival_limit + 2.0 * to_gm_ / miss_distance_) / speed_;
  const State last = flight.arc.nodes().back().state;
  Vec6 goal;
  goal << (aim_ - last.p_m) / kAstronomicalUnit, (to_O_.v_m_s - last.v_m_s) / speed_;
  for (std::size_t i = 0; i < n; ++i) goal += (*controls)[i].effect * guess.thrust[i];
  goal += (*controls)[n].effect * guess.v_infinity / speed_;

  auto steered = steer(*controls, goal, smoothing, costate_);
  if (!steered) return forward(steered);
  Guess next;
  next.thrust.assign(steered->controls.begin(), steered->controls.begin() + static_cast<std::ptrdiff_t>(n));
  next.v_infinity = steered->controls[n] * speed_;
  if (next.v_infinity.norm() < 1.0) {
    return fail(ErrorCode::not_converged, "the transfer needs no departure, which this design cannot do");
  }
  auto flown = fly(next);
  if (!flown) return forward(flown);
  costate_ = steered->costate;
  guess = std::move(next);
  flight = std::move(*flown);
  return {};
}

// Least energy, with the v-infinities brought from Lambert's to their limits.
Result<void> Designer::approach_limits(Guess& guess, Flight& flight) {
  constexpr double kClose_m = 2e9;  // where the linearisation is trusted to go on from
  constexpr double kLongest = 0.25, kShortest = 0.01;
  const auto limit = [](double lambert, double asked, double share) {
    return asked >= lambert ? asked : lambert + share * (asked - lambert);
  };
  double done = 0.0, stride = kLongest;
  Error last_error;
  while (done < 1.0 || miss_m(flight) > 1e-3 * kClose_m) {
    const double share = std::min(done + stride, 1.0);
    const double departure = limit(leg_.v_infinity_departure_m_s.norm(), settings_.v_infinity_departure_m_s, share);
    const double arrival = limit(leg_.v_infinity_arrival_m_s.norm(), settings_.v_infinity_arrival_m_s, share);
    Guess next = guess;
    Flight flown = flight;
    const Vec6 costate = costate_;
    bool good = true;
    for (int i = 0; i < 3 && good; ++i) {
      const auto improved = improve(next, flown, departure, arrival, 1.0);
      good = improved.has_value();
      if (!good) last_error = improved.error();
    }
    good = good && miss_m(flown) < kClose_m;
    if (good) {
      const bool stuck = done == 1.0 && miss_m(flown) > 0.5 * miss_m(flight);
      guess = std::move(next);
      flight = std::move(flown);
      done = share;
      stride = std::min(2.0 * stride, kLongest);
      if (!stuck) continue;
    }
    costate_ = good ? costate_ : costate;
    stride *= 0.5;
    if (stride < kShortest) {
      if (last_error.code == ErrorCode::not_converged) return tl::unexpected<Error>(last_error);
      return fail(ErrorCode::not_converged,
                  "no low-thrust transfer found: at {0} % of the way to the asked v-infinities "
                  "the arrival misses by {1} km",
                  {100.0 * done, miss_m(flight) * 1e-3});
    }
  }
  return {};
}

// From least energy to the smoothing asked for; then arcs that hardly thrust are dropped, and the rest made to arrive.
Result<void> Designer::sharpen(Guess& guess, Flight& flight) {
  const double departure = settings_.v_infinity_departure_m_s, arrival = settings_.v_infinity_arrival_m_s;
  for (double smoothing = 1.0; smoothing > settings_.smoothing;) {
    smoothing = std::max(0.5 * smoothing, settings_.smoothing);
    for (int i = 0; i < 2; ++i) {
      if (const auto ok = improve(guess, flight, departure, arrival, smoothing); !ok) return ok;
    }
  }
  for (std::size_t i = 0; i < intervals_.size(); ++i) idle_[i] = guess.thrust[i].norm() < kLeastLevel;
  for (int i = 0; i < 15; ++i) {
    if (const auto ok = improve(guess, flight, departure, arrival, settings_.smoothing); !ok) return ok;
    if (miss_m(flight) <= settings_.position_tolerance_m) return {};
  }
  return fail(ErrorCode::not_converged, "the low-thrust transfer still misses its aim by {0} km",
              {miss_m(flight) * 1e-3});
}

Result<LowThrustDesign> Designer::run() {
  if (const auto ok = look_up(); !ok) return forward(ok);
  end_ = arrival_ - settings_.coast_out;
  intervals_ = intervals_of(begin_, end_, settings_);
  idle_.assign(intervals_.size(), false);
  Guess guess{std::vector<Vec3>(intervals_.size(), Vec3::Zero()), leg_.v_infinity_departure_m_s};
  auto flight = fly(guess);
  if (!flight) return forward(flight);
  if (const auto ok = approach_limits(guess, *flight); !ok) return forward(ok);
  if (const auto ok = sharpen(guess, *flight); !ok) return forward(ok);

  const State last = flight->arc.nodes().back().state;
  const Hyperbola encounter = osculating({last.p_m - to_O_.p_m, last.v_m_s - to_O_.v_m_s}, to_gm_);
  double thrust_s = 0.0;
  for (const ThrustArc& arc : flight->plan.arcs) thrust_s += (arc.end - arc.begin).seconds();
  const double miss = miss_m(*flight);
  return LowThrustDesign{.begin = begin_,
                         .end = end_,
                         .arrival = arrival_,
                         .initial = start_of(guess.v_infinity),
                         .plan = flight->plan,
                         .arc = std::move(flight->arc),
                         .lambert = leg_,
                         .miss_distance_m = miss_distance_,
                         .v_infinity_departure_m_s = guess.v_infinity,
                         .v_infinity_arrival_m_s = encounter.v_infinity_in_m_s,
                         .closest_approach_m = encounter.pericentre_m,
                         .aim_error_m = miss,
                         .propellant_kg = settings_.mass_kg - flight->plan.mass_at_kg(arrival_),
                         .thrust_share = thrust_s / (end_ - begin_).seconds(),
                         .flights = flights_};
}

}  // namespace

Result<LowThrustDesign> design_low_thrust(const Ephemeris& ephemeris, BodyId from, BodyId to, Epoch departure,
                                          Duration duration, const LowThrustSettings& s) {
  if (from == to || from == body::sun || to == body::sun) {
    return fail(ErrorCode::invalid_argument, "a transfer leads from one planet to another, not from {0} to {1}",
                {static_cast<double>(from.value), static_cast<double>(to.value)});
  }
  const auto positive = [](double x) { return x > 0.0 && std::isfinite(x); };
  if (!positive(s.mass_kg) || !positive(s.force_n) || !positive(s.specific_impulse_s)) {
    return fail(ErrorCode::invalid_argument, "mass ({0} kg), thrust ({1} N) and impulse ({2} s) must be above zero",
                {s.mass_kg, s.force_n, s.specific_impulse_s});
  }
  constexpr double kLeastDeparture_m_s = 100.0;
  if (!(s.v_infinity_departure_m_s >= kLeastDeparture_m_s) || !(s.v_infinity_arrival_m_s >= 0.0)) {
    return fail(ErrorCode::invalid_argument,
                "the v-infinity at departure ({0} m/s) must be at least {1}, that at arrival "
                "({2}) zero or more",
                {s.v_infinity_departure_m_s, kLeastDeparture_m_s, s.v_infinity_arrival_m_s});
  }
  if (!(s.smoothing > 0.0 && s.smoothing <= 1.0) || s.arcs_per_cycle < 1 || s.arcs_per_cycle > 100) {
    return fail(ErrorCode::invalid_argument,
                "smoothing ({0}) must be above 0 and at most 1, arcs to a cycle ({1}) 1 to "
                "100",
                {s.smoothing, static_cast<double>(s.arcs_per_cycle)});
  }
  if (s.first_coast < Duration{} || s.coast < Duration{} || s.cycle <= s.coast || s.coast_out < Duration{} ||
      duration - s.coast_out <= s.first_coast + s.coast) {
    return fail(ErrorCode::invalid_argument, "no time for thrust: {0} d with coasts of {1} d every {2} d",
                {duration.days(), s.coast.days(), s.cycle.days()});
  }
  if (!positive(s.departure_distance_m) || !(s.miss_distance_m >= 0.0) || !positive(s.position_tolerance_m)) {
    return fail(ErrorCode::invalid_argument, "distances at departure ({0} km) and arrival ({1} km) must be above zero",
                {s.departure_distance_m * 1e-3, s.miss_distance_m * 1e-3});
  }
  return Designer(ephemeris, s, from, to, departure, departure + duration).run();
}

}  // namespace astronav::transfer
