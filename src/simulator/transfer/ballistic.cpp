// SPDX-License-Identifier: Apache-2.0
#include "simulator/transfer/ballistic.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include <Eigen/Dense>

#include "simulator/transfer/encounter.h"

namespace astronav::transfer {
namespace {

// At the pericentre (radius rp) of the hyperbola that leaves with v_infinity, relative to the body. Of all the planes
// that hold v_infinity, the one least inclined to the ICRF equator, prograde (docs/theory/dynamics.md eq. 8).
State pericentre_state(const Vec3& v_infinity, double rp, double gm) {
  const Vec3 s = v_infinity.normalized();
  const Vec3 h = across(Vec3::UnitZ(), s, Vec3::UnitX());
  const double e = 1.0 + rp * v_infinity.squaredNorm() / gm;
  const double cos_nu = -1.0 / e;
  const double sin_nu = std::sqrt(1.0 - cos_nu * cos_nu);
  const Vec3 p = cos_nu * s - sin_nu * h.cross(s);
  return {rp * p, std::sqrt(v_infinity.squaredNorm() + 2.0 * gm / rp) * h.cross(p)};
}

class Shooter {
 public:
  Shooter(const dynamics::ForceModel& forces, const dynamics::PropagationSettings& propagation,
          const State& departure_body_O, double pericentre_m, double departure_gm, Epoch departure, Epoch arrival)
      : forces_(forces),
        propagation_(propagation),
        departure_body_O_(departure_body_O),
        pericentre_m_(pericentre_m),
        departure_gm_(departure_gm),
        departure_(departure),
        arrival_(arrival) {}

  Result<dynamics::Arc> fly(const Vec3& v_infinity) const {
    const State relative = pericentre_state(v_infinity, pericentre_m_, departure_gm_);
    return dynamics::propagate(forces_,
                               {departure_body_O_.p_m + relative.p_m, departure_body_O_.v_m_s + relative.v_m_s},
                               departure_, arrival_, propagation_);
  }
  // Barycentric place at the arrival epoch.
  Result<Vec3> arrive(const Vec3& v_infinity) const {
    auto arc = fly(v_infinity);
    if (!arc) return forward(arc);
    return arc->nodes().back().state.p_m;
  }

 private:
  const dynamics::ForceModel& forces_;
  dynamics::PropagationSettings propagation_;
  State departure_body_O_;
  double pericentre_m_, departure_gm_;
  Epoch departure_, arrival_;
};

struct Solution {
  Vec3 v_infinity = Vec3::Zero();
  double miss_m = 0.0;
  int iterations = 0;
};

// Newton's method with a numerical Jacobian; a step that makes things worse is halved.
Result<Solution> correct(const Shooter& shooter, const Vec3& first_guess, const Vec3& aim, double tolerance_m) {
  constexpr int kMostIterations = 30;
  constexpr int kMostHalvings = 10;
  constexpr double kProbe_m_s = 0.1;
  constexpr double kLongestStep_m_s = 500.0;
  Solution now{first_guess, 0.0, 0};
  auto place = shooter.arrive(now.v_infinity);
  if (!place) return forward(place);
  Vec3 miss = aim - *place;
  while (miss.norm() > tolerance_m) {
    if (now.iterations == kMostIterations) break;
    ++now.iterations;
    Mat3 jacobian;
    for (int i = 0; i < 3; ++i) {
      auto probed = shooter.arrive(now.v_infinity + kProbe_m_s * Vec3::Unit(i));
      if (!probed) return forward(probed);
      jacobian.col(i) = (*probed - *place) / kProbe_m_s;
    }
    Vec3 step = jacobian.fullPivLu().solve(miss);
    if (!step.allFinite()) break;
    if (step.norm() > kLongestStep_m_s) step *= kLongestStep_m_s / step.norm();
    bool better = false;
    for (int halving = 0; halving < kMostHalvings && !better; ++halving, step *= 0.5) {
      auto tried = shooter.arrive(now.v_infinity + step);
      if (!tried) continue;  // a fall into a planet: a shorter step may miss it
      if ((aim - *tried).norm() < miss.norm()) {
        now.v_infinity += step;
        place = tried;
        miss = aim - *tried;
        better = true;
      }
    }
    if (!better) break;
  }
  now.miss_m = miss.norm();
  if (now.miss_m > tolerance_m) {
    return fail(ErrorCode::not_converged,
                "no ballistic transfer found: after {0} corrections the arrival misses by {1} km",
                {static_cast<double>(now.iterations), now.miss_m * 1e-3});
  }
  return now;
}

}  // namespace

Result<BallisticDesign> design_ballistic(const Ephemeris& ephemeris, BodyId from, BodyId to, Epoch departure,
                                         Duration duration, const BallisticSettings& settings) {
  const Epoch arrival = departure + duration;
  const Epoch begin = departure + settings.coast_in;
  const Epoch end = arrival - settings.coast_out;
  if (settings.coast_in < Duration{} || settings.coast_out < Duration{} || end <= begin) {
    return fail(ErrorCode::invalid_argument,
                "a transfer of {0} d has no cruise left after {1} d at its beginning and {2} d at its end",
                {duration.days(), settings.coast_in.days(), settings.coast_out.days()});
  }
  if (from == to || from == body::sun || to == body::sun)
    return fail(ErrorCode::invalid_argument, "a transfer leads from one planet to another, not from {0} to {1}",
                {static_cast<double>(from.value), static_cast<double>(to.value)});
  const auto from_constants = body_constants(from);
  if (!from_constants) return forward(from_constants);
  const auto sun_constants = body_constants(body::sun);
  if (!sun_constants) return forward(sun_constants);
  const auto to_constants = body_constants(to);
  if (!to_constants) return forward(to_constants);
  if (!(settings.departure_altitude_m > 0.0) || !std::isfinite(settings.departure_altitude_m) ||
      !std::isfinite(settings.miss_distance_m) ||
      (settings.miss_distance_m != 0.0 && settings.miss_distance_m <= to_constants->equatorial_radius_m)) {
    return fail(ErrorCode::invalid_argument,
                "the departure altitude ({0} km) must be above zero, the miss distance ({1} km) beyond the body's "
                "radius ({2} km)",
                {settings.departure_altitude_m * 1e-3, settings.miss_distance_m * 1e-3,
                 to_constants->equatorial_radius_m * 1e-3});
  }

  const auto leg = lambert_leg(ephemeris, from, to, departure, duration);
  if (!leg) return forward(leg);
  const auto forces = dynamics::ForceModel::create(ephemeris, settings.forces);
  if (!forces) return forward(forces);
  const auto from_O = ephemeris.state(from, body::solar_system_barycenter, departure);
  if (!from_O) return forward(from_O);
  const auto to_O = ephemeris.state(to, body::solar_system_barycenter, arrival);
  if (!to_O) return forward(to_O);
  const auto to_S = ephemeris.state(to, body::sun, arrival);
  if (!to_S) return forward(to_S);

  const Vec3 outwards = across(to_S->p_m, leg->v_infinity_arrival_m_s, Vec3::UnitZ());
  const double miss_distance =
      settings.miss_distance_m != 0.0
          ? settings.miss_distance_m
          : 0.2 * sphere_of_influence(to_S->p_m.norm(), to_constants->gm_m3_s2, sun_constants->gm_m3_s2);
  const Vec3 aim = to_O->p_m + miss_distance * outwards;
  const double pericentre = from_constants->equatorial_radius_m + settings.departure_altitude_m;
  const Shooter shooter(*forces, settings.propagation, *from_O, pericentre, from_constants->gm_m3_s2, departure,
                        arrival);
  auto solution = correct(shooter, leg->v_infinity_departure_m_s, aim, settings.position_tolerance_m);
  if (!solution && solution.error().code == ErrorCode::not_converged) {
    dynamics::ForceSettings without = settings.forces;
    std::erase_if(without.bodies, [&](BodyId id) { return id == to || id == barycenter_of(to); });
    const auto weak = dynamics::ForceModel::create(ephemeris, without);
    if (!weak) return forward(weak);
    const Shooter first(*weak, settings.propagation, *from_O, pericentre, from_constants->gm_m3_s2, departure, arrival);
    const auto guess = correct(first, leg->v_infinity_departure_m_s, aim, settings.position_tolerance_m);
    if (!guess) return forward(guess);
    solution = correct(shooter, guess->v_infinity, aim, settings.position_tolerance_m);
  }
  if (!solution) return forward(solution);

  const auto whole = shooter.fly(solution->v_infinity);
  if (!whole) return forward(whole);
  const auto initial = whole->at(begin);
  if (!initial) return forward(initial);
  auto cruise = dynamics::propagate(*forces, *initial, begin, arrival, settings.propagation);
  if (!cruise) return forward(cruise);
  const State last = cruise->nodes().back().state;
  const Hyperbola encounter = osculating({last.p_m - to_O->p_m, last.v_m_s - to_O->v_m_s}, to_constants->gm_m3_s2);
  return BallisticDesign{.departure = departure,
                         .arrival = arrival,
                         .begin = begin,
                         .end = end,
                         .initial = *initial,
                         .arc = std::move(*cruise),
                         .lambert = *leg,
                         .miss_distance_m = miss_distance,
                         .v_infinity_departure_m_s = solution->v_infinity,
                         .v_infinity_arrival_m_s = encounter.v_infinity_in_m_s,
                         .c3_m2_s2 = solution->v_infinity.squaredNorm(),
                         .closest_approach_m = encounter.pericentre_m,
                         .aim_error_m = (last.p_m - aim).norm(),
                         .iterations = solution->iterations};
}

}  // namespace astronav::transfer
