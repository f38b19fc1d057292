// SPDX-License-Identifier: Apache-2.0
// For the tests: the kernel that ships, and an arc like Earth-Mars flown by an integrator that is none of the filter's
// (Boost's Fehlberg 7(8), written against the ephemeris alone).
#pragma once

#include <array>
#include <cstdlib>
#include <functional>
#include <map>
#include <string>
#include <vector>

#include <boost/numeric/odeint.hpp>
#include <gtest/gtest.h>

#include "foundation/math/random.h"
#include "foundation/math/rotation.h"
#include "models/aberration/aberration.h"
#include "models/ephemeris/ephemeris.h"
#include "onboard/navigation/filter.h"
#include "support/shipped_ephemeris.h"

namespace astronav::navigation::testing {

inline const Ephemeris& kernel() {
  return astronav::testing::shipped_ephemeris();
}

inline State barycentric(BodyId body, Epoch epoch) {
  return kernel().state(body, body::solar_system_barycenter, epoch).value();
}

using Accelerations = std::function<Vec3(double s)>;  // extra acceleration (m/s2), s seconds after the start

// Point masses of Sun, planets and Moon, solar pressure k = P0 CR A / m in m/s2 at 1 AU, and what else there is.
inline State fly(const State& from, Epoch epoch, Duration span, double pressure_m_s2 = 0.0,
                 const Accelerations& extra = {}, bool sun_only = false) {
  using Vector = std::vector<double>;
  struct Body {
    BodyId id;
    double gm;
  };
  static const std::array<Body, 10> bodies = [] {
    std::array<Body, 10> out{};
    int n = 0;
    for (const int id : {10, 1, 2, 399, 301, 4, 5, 6, 7, 8})
      out[n++] = {BodyId{id}, body_constants(BodyId{id}).value().gm_m3_s2};
    return out;
  }();
  const auto rate = [&](const Vector& y, Vector& dy, double s) {
    const Epoch now = epoch + Duration::seconds(s);
    const Vec3 p(y[0], y[1], y[2]);
    Vec3 a = Vec3::Zero();
    for (const Body& body : bodies) {
      const Vec3 d = barycentric(body.id, now).p_m - p;
      a += body.gm / std::pow(d.norm(), 3) * d;
      if (body.id == body::sun) a -= pressure_m_s2 * std::pow(kAstronomicalUnit / d.norm(), 2) * d.normalized();
      if (sun_only) break;
    }
    if (extra) a += extra(s);
    dy = {y[3], y[4], y[5], a.x(), a.y(), a.z()};
  };
  Vector y{from.p_m.x(), from.p_m.y(), from.p_m.z(), from.v_m_s.x(), from.v_m_s.y(), from.v_m_s.z()};
  namespace ode = boost::numeric::odeint;
  const double length = span.seconds();
  ode::integrate_adaptive(ode::make_controlled(1e-4, 1e-13, ode::runge_kutta_fehlberg78<Vector>()), rate, y, 0.0,
                          length, std::min(length, 3600.0));
  return {Vec3(y[0], y[1], y[2]), Vec3(y[3], y[4], y[5])};
}

inline Epoch departure() {
  return Epoch::parse("2026-11-09T00:00:00 TDB").value();
}

// Three days after the departure of the heliocentric conic from the Earth (2026-11-09) to Mars (300 days later):
// outside the Earth's sphere of influence. Found by shooting with the Sun alone.
struct Start {
  Epoch epoch;
  State state;
};
inline const Start& cruise_start() {
  static const Start start = [] {
    const Epoch t0 = departure();
    const Duration days = Duration::days(300.0);
    const Vec3 target = barycentric(body::mars_barycenter, t0 + days).p_m;
    State leave = barycentric(body::earth, t0);
    leave.v_m_s += leave.v_m_s.normalized() * 3000.0;
    for (int i = 0; i < 12; ++i) {
      const Vec3 miss = fly(leave, t0, days, 0.0, {}, true).p_m - target;
      if (miss.norm() < 1e6) break;
      Mat3 by_velocity;
      for (int axis = 0; axis < 3; ++axis) {
        State moved = leave;
        moved.v_m_s[axis] += 1.0;
        by_velocity.col(axis) = fly(moved, t0, days, 0.0, {}, true).p_m - target - miss;
      }
      leave.v_m_s -= by_velocity.inverse() * miss;
    }
    const Duration out = Duration::days(3.0);
    return Start{t0 + out, fly(leave, t0, out, 0.0, {}, true)};
  }();
  return start;
}

// Apparent unit direction: iterated light time, exact aberration.
inline Vec3 exact_direction(const State& observer, BodyId body, Epoch epoch) {
  const Vec3 p = light_time(kernel(), body, observer, epoch).value().relative.p_m;
  return aberrate(p.normalized(), observer.v_m_s);
}

// A camera that looks at `direction`, the body `offset` pixels off the middle, with any roll.
inline Mat3 pointed_at(const Vec3& direction, const Intrinsics& camera, const Vec2& offset_px, double roll) {
  const RaDec at = radec_from_direction(direction);
  const Mat3 centred = R_CN_from_pointing({at.ra_rad, at.dec_rad, roll});
  const Vec3 turn(-offset_px.y() / camera.fy_px, offset_px.x() / camera.fx_px, 0.0);
  return rotation_exp(turn) * centred;
}

inline Intrinsics twenty_degree_camera() {
  return Intrinsics::from_field_of_view(1024, 1024, 20.0 * kDegree);
}

// Of a Filter or a SmoothedState: e' P^-1 e of position and velocity.
template <typename Estimate>
double squared_error(const Estimate& estimate, const State& truth) {
  Vec6 e;
  e << estimate.state().p_m - truth.p_m, estimate.state().v_m_s - truth.v_m_s;
  return normalised_square(e, estimate.covariance_pv());
}

}  // namespace astronav::navigation::testing
