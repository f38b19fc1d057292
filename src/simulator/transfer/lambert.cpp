// SPDX-License-Identifier: Apache-2.0
#include "simulator/transfer/lambert.h"

#include <algorithm>
#include <cmath>
#include <cstdint>

#include <Eigen/Geometry>
#include <boost/math/tools/toms748_solve.hpp>

namespace astronav::transfer {
namespace {

// Izzo's geometry: lambda in (-1, 1), and 1 - lambda^2 kept apart because it cancels for short arcs.
struct Geometry {
  double lambda = 0.0;
  double one_minus_lambda2 = 0.0;

  double y(double x) const { return std::sqrt(one_minus_lambda2 + lambda * lambda * x * x); }
  // y - lambda x without cancellation.
  double eta(double x) const {
    const double lx = lambda * x;
    return lx > 0.0 ? one_minus_lambda2 / (y(x) + lx) : y(x) - lx;
  }

  // Non-dimensional time of flight, falling with x in (-1, inf); x = 1 is the parabola.
  double time(double x) const {
    const double e = eta(x);
    const double s1 = 0.5 * (1.0 - lambda - x * e);
    if (std::abs(s1) < 0.3) {  // Battin's form (Izzo eq. 20): smooth through the parabola
      double term = 4.0 / 3.0, q = term;
      for (int n = 0; n < 200 && std::abs(term) > 1e-17 * q; ++n) {
        term *= (3.0 + n) / (2.5 + n) * s1;
        q += term;
      }
      return 0.5 * (e * e * e * q + 4.0 * lambda * e);
    }
    // Lancaster and Blanchard's form (Izzo eq. 18).
    const double a = (1.0 - x) * (1.0 + x);
    const double root = std::sqrt(std::abs(a));
    const double psi = x < 1.0 ? std::atan2(e * root, x * y(x) + lambda * a) : std::asinh(e * root);
    return (psi / root - x + lambda * y(x)) / a;
  }
};

}  // namespace

Result<LambertVelocities> lambert(const Vec3& p1_m, const Vec3& p2_m, double time_s, double gm_m3_s2,
                                  const Vec3& pole) {
  const double r1 = p1_m.norm();
  const double r2 = p2_m.norm();
  if (!(time_s > 0.0) || !std::isfinite(time_s) || !(gm_m3_s2 > 0.0)) {
    return fail(ErrorCode::invalid_argument, "the time of flight ({0} s) and GM ({1} m^3/s^2) must be above zero",
                {time_s, gm_m3_s2});
  }
  if (!(r1 > 0.0) || !(r2 > 0.0) || !std::isfinite(r1) || !std::isfinite(r2)) {
    return fail(ErrorCode::invalid_argument, "both places must lie off the centre");
  }
  const Vec3 u1 = p1_m / r1;
  const Vec3 u2 = p2_m / r2;
  Vec3 normal = u1.cross(u2);
  if (normal.norm() < 1e-10) {
    return fail(ErrorCode::invalid_argument, "departure and arrival lie in line with the centre: no plane is defined");
  }
  normal.normalize();
  const double along_pole = normal.dot(pole.normalized());
  if (std::abs(along_pole) < 1e-12) {
    return fail(ErrorCode::invalid_argument,
                "the plane of the transfer contains the pole: neither way round is prograde");
  }
  const double way = along_pole > 0.0 ? 1.0 : -1.0;  // -1: more than half a turn
  normal *= way;

  const double chord = (p2_m - p1_m).norm();
  const double s = 0.5 * (r1 + r2 + chord);
  Geometry g;
  g.one_minus_lambda2 = chord / s;
  // lambda^2 = sqrt(r1 r2)/s cos(theta/2), squared; |u1 + u2| = 2 cos(theta/2).
  g.lambda = way * 0.5 * std::sqrt(r1 * r2) * (u1 + u2).norm() / s;
  const double goal = time_s * std::sqrt(2.0 * gm_m3_s2 / s) / s;

  // log T is nearly linear in xi = log(1 + x).
  const auto miss = [&](double xi) { return std::log(g.time(std::expm1(xi)) / goal); };
  double low = 0.0, high = 0.0;
  constexpr double kReach = 60.0;  // x up to 1e26
  while (miss(low) < 0.0 && low > -kReach) low -= 1.0;
  while (miss(high) > 0.0 && high < kReach) high += 1.0;
  const double miss_low = miss(low);
  const double miss_high = miss(high);
  if (!(miss_low >= 0.0) || !(miss_high <= 0.0)) {
    return fail(ErrorCode::not_converged, "no conic joins the two places in {0} s", {time_s});
  }
  double xi = low;
  if (low < high) {
    std::uintmax_t iterations = 200;
    const auto bracket = boost::math::tools::toms748_solve(miss, low, high, miss_low, miss_high,
                                                           boost::math::tools::eps_tolerance<double>(52), iterations);
    xi = 0.5 * (bracket.first + bracket.second);
  }

  const double x = std::expm1(xi);
  const double y = g.y(x);
  const double gamma = std::sqrt(0.5 * gm_m3_s2 * s);
  const double rho = (r1 - r2) / chord;
  const double sigma = std::sqrt(r1 * r2) * (u1 - u2).norm() / chord;
  const double radial_difference = g.lambda * y - x;
  const double radial_sum = rho * (g.lambda * y + x);
  const double transverse = gamma * sigma * (y + g.lambda * x);
  return LambertVelocities{gamma * (radial_difference - radial_sum) / r1 * u1 + transverse / r1 * normal.cross(u1),
                           -gamma * (radial_difference + radial_sum) / r2 * u2 + transverse / r2 * normal.cross(u2)};
}

Result<LambertLeg> lambert_leg(const Ephemeris& ephemeris, BodyId from, BodyId to, Epoch departure, Duration duration) {
  const Epoch arrival = departure + duration;
  const auto sun = body_constants(body::sun);
  if (!sun) return forward(sun);
  const auto start = ephemeris.state(from, body::sun, departure);
  if (!start) return forward(start);
  const auto goal = ephemeris.state(to, body::sun, arrival);
  if (!goal) return forward(goal);
  // IAU 2006 obliquity at J2000, 84381.406 arcsec.
  const double obliquity = 84381.406 * kArcsecond;
  const Vec3 ecliptic_pole(0.0, -std::sin(obliquity), std::cos(obliquity));
  const auto v = lambert(start->p_m, goal->p_m, duration.seconds(), sun->gm_m3_s2, ecliptic_pole);
  if (!v) return forward(v);
  return LambertLeg{departure, arrival, v->v1_m_s - start->v_m_s, v->v2_m_s - goal->v_m_s};
}

}  // namespace astronav::transfer
