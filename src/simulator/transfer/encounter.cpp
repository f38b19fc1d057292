// SPDX-License-Identifier: Apache-2.0
#include "simulator/transfer/encounter.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include <Eigen/Eigenvalues>

namespace astronav::transfer {

Vec3 across(const Vec3& v, const Vec3& axis, const Vec3& fallback) {
  const Vec3 unit = axis.normalized();
  const Vec3 part = v - v.dot(unit) * unit;
  if (part.norm() > 1e-6 * v.norm()) return part.normalized();
  return (fallback - fallback.dot(unit) * unit).normalized();
}

double sphere_of_influence(double distance_m, double gm_m3_s2, double sun_gm_m3_s2) {
  return distance_m * std::pow(gm_m3_s2 / sun_gm_m3_s2, 0.4);
}

Hyperbola osculating(const State& s, double gm) {
  const double r = s.p_m.norm();
  const Vec3 h = s.p_m.cross(s.v_m_s);
  const Vec3 e = s.v_m_s.cross(h) / gm - s.p_m / r;
  Hyperbola out;
  out.pericentre_m = h.squaredNorm() / gm / (1.0 + e.norm());
  const double energy2 = s.v_m_s.squaredNorm() - 2.0 * gm / r;
  if (energy2 <= 0.0) return out;
  const double cos_nu = -1.0 / e.norm();
  const Vec3 p = e.normalized();
  const Vec3 q = h.normalized().cross(p);
  // It comes from true anomaly -nu: the place is cos(nu) p - sin(nu) q, the way inwards its opposite.
  out.v_infinity_in_m_s = std::sqrt(energy2) * (-cos_nu * p + std::sqrt(1.0 - cos_nu * cos_nu) * q);
  return out;
}

Result<BPlane> b_plane(const State& s, double gm, const Vec3& pole) {
  const double r = s.p_m.norm();
  const Vec3 h = s.p_m.cross(s.v_m_s);
  const double energy2 = s.v_m_s.squaredNorm() - 2.0 * gm / r;
  if (!(gm > 0.0) || !(r > 0.0) || !(energy2 > 0.0) || !(h.norm() > 0.0)) {
    return fail(ErrorCode::invalid_argument, "no hyperbola passes here: distance {0} km, speed {1} km/s",
                {r * 1e-3, s.v_m_s.norm() * 1e-3});
  }
  BPlane out;
  const Vec3 v_infinity = osculating(s, gm).v_infinity_in_m_s;
  out.v_infinity_m_s = v_infinity.norm();
  const Vec3 along = v_infinity.normalized();
  const Vec3 t = along.cross(pole);
  if (t.norm() < 1e-9 * pole.norm()) return fail(ErrorCode::invalid_argument, "the asymptote lies along the pole");
  out.R_BN.row(0) = along;
  out.R_BN.row(1) = t.normalized();
  out.R_BN.row(2) = along.cross(t.normalized());
  // The asymptote's distance is h / v-infinity, on the side from which h turns it.
  const Vec3 b = along.cross(h) / out.v_infinity_m_s;
  out.b_t_m = b.dot(out.R_BN.row(1));
  out.b_r_m = b.dot(out.R_BN.row(2));
  // Kepler's equation of the hyperbola, e sinh F = r.v / sqrt(gm a) with a > 0.
  const double a = gm / energy2;
  const double e = std::sqrt(1.0 + h.squaredNorm() / (gm * a));
  const double e_sinh = s.p_m.dot(s.v_m_s) / std::sqrt(gm * a);
  out.time_to_pericentre_s = -(e_sinh - std::asinh(e_sinh / e)) * std::sqrt(a * a * a / gm);
  return out;
}

Result<BPlaneError> b_plane_error(const State& relative, const Mat6& covariance, double gm_m3_s2, const Vec3& pole) {
  const auto nominal = b_plane(relative, gm_m3_s2, pole);
  if (!nominal) return forward(nominal);
  // Derivatives of B on the nominal axes, by central differences: B has a closed form, and is smooth at this scale.
  Eigen::Matrix<double, 3, 6> slope;
  for (int i = 0; i < 6; ++i) {
    const double step = i < 3 ? 1e-5 * relative.p_m.norm() : 1e-5 * relative.v_m_s.norm();
    Vec3 side[2];
    for (int k = 0; k < 2; ++k) {
      State moved = relative;
      (i < 3 ? moved.p_m[i] : moved.v_m_s[i - 3]) += k == 0 ? -step : step;
      const auto at = b_plane(moved, gm_m3_s2, pole);
      if (!at) return forward(at);
      side[k] = {at->b_t_m, at->b_r_m, at->time_to_pericentre_s};
    }
    slope.col(i) = (side[1] - side[0]) / (2.0 * step);
  }
  BPlaneError out;
  out.at = *nominal;
  out.covariance = slope * covariance * slope.transpose();
  const Eigen::SelfAdjointEigenSolver<Mat2> axes(out.covariance.topLeftCorner<2, 2>());
  out.semi_minor_m = std::sqrt(std::max(axes.eigenvalues()[0], 0.0));
  out.semi_major_m = std::sqrt(std::max(axes.eigenvalues()[1], 0.0));
  Vec2 major = axes.eigenvectors().col(1);
  if (major.x() < 0.0 || (major.x() == 0.0 && major.y() < 0.0)) major = -major;
  out.angle_rad = std::atan2(major.y(), major.x());
  return out;
}

Result<Epoch> closest_approach(const dynamics::ForceModel& forces, const Ephemeris& ephemeris, BodyId planet,
                               Epoch from, const State& state, Epoch until) {
  const auto arc = dynamics::propagate(forces, state, from, until);
  if (!arc) return forward(arc);
  Epoch best = from;
  double least = 0.0;
  // By the hour, then by the minute around the best hour.
  for (const double step_s : {3600.0, 60.0}) {
    const Duration reach = Duration::seconds(3600.0);
    const Epoch begin = step_s == 3600.0 ? from : std::max(from, best - reach);
    const Epoch end = step_s == 3600.0 ? until : std::min(until, best + reach);
    least = std::numeric_limits<double>::infinity();
    for (Epoch e = begin; e <= end; e = e + Duration::seconds(step_s)) {
      const auto planet_O = ephemeris.state(planet, body::solar_system_barycenter, e);
      if (!planet_O) return forward(planet_O);
      const double distance = (arc->at(e).value().p_m - planet_O->p_m).norm();
      if (distance < least) {
        least = distance;
        best = e;
      }
    }
  }
  const Duration edge = Duration::seconds(120.0);
  if (best - from < edge || until - best < edge) {
    return fail(ErrorCode::not_found, "the spacecraft does not pass the planet: it is nearest, {0} km, at {s}",
                {least * 1e-3}, {}, best.iso());
  }
  return best;
}

Result<BPlaneError> arrival_error(const dynamics::ForceModel& forces, const Ephemeris& ephemeris, BodyId planet,
                                  Epoch from, const State& state, const Mat6& covariance, Epoch to, const Vec3& pole) {
  const auto constants = body_constants(planet);
  if (!constants) return forward(constants);
  const auto planet_O = ephemeris.state(planet, body::solar_system_barycenter, to);
  if (!planet_O) return forward(planet_O);
  const auto arrive = [&](const State& s) -> Result<State> {
    const auto arc = dynamics::propagate(forces, s, from, to);
    if (!arc) return forward(arc);
    const State last = arc->at(to).value();
    return State{last.p_m - planet_O->p_m, last.v_m_s - planet_O->v_m_s};
  };
  const auto nominal = arrive(state);
  if (!nominal) return forward(nominal);
  // Steps at which a flight of a year bends by millionths, and its integration errs by less.
  constexpr double kStep_m = 1e4, kStep_m_s = 1e-2;
  Mat6 phi;
  for (int i = 0; i < 6; ++i) {
    const double step = i < 3 ? kStep_m : kStep_m_s;
    State side[2] = {state, state};
    for (int k = 0; k < 2; ++k) {
      (i < 3 ? side[k].p_m[i] : side[k].v_m_s[i - 3]) += k == 0 ? -step : step;
      const auto at = arrive(side[k]);
      if (!at) return forward(at);
      side[k] = *at;
    }
    phi.col(i) << (side[1].p_m - side[0].p_m) / (2.0 * step), (side[1].v_m_s - side[0].v_m_s) / (2.0 * step);
  }
  return b_plane_error(*nominal, phi * covariance * phi.transpose(), constants->gm_m3_s2, pole);
}

}  // namespace astronav::transfer
