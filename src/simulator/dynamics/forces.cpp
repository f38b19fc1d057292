// SPDX-License-Identifier: Apache-2.0
#include "simulator/dynamics/forces.h"

#include <cmath>
#include <utility>

namespace astronav::dynamics {

Result<ForceModel> ForceModel::create(const Ephemeris& ephemeris, ForceSettings settings,
                                      UnmodelledAcceleration unmodelled) {
  return create(ephemeris, std::move(settings), Events{.unmodelled = std::move(unmodelled), .thrust = {}, .kicks = {}});
}

Result<ForceModel> ForceModel::create(const Ephemeris& ephemeris, ForceSettings settings, Events events) {
  if (!std::isfinite(settings.srp_cr_area_over_mass_m2_kg) || !std::isfinite(settings.srp_scale)) {
    return fail(ErrorCode::invalid_argument, "CR A/m ({0} m^2/kg) and the scale of solar pressure ({1}) must be finite",
                {settings.srp_cr_area_over_mass_m2_kg, settings.srp_scale});
  }
  if (!(settings.mass_kg > 0.0) || !std::isfinite(settings.mass_kg)) {
    return fail(ErrorCode::invalid_argument, "the mass, {0} kg, must be above zero", {settings.mass_kg});
  }
  if (const auto ok = check_plates(settings.plates); !ok) return forward(ok);
  if (!settings.plates.empty() && !settings.attitude) {
    return fail(ErrorCode::invalid_argument, "solar pressure on plates needs an attitude");
  }
  ForceModel model;
  model.ephemeris_ = ephemeris;
  auto sun = body_constants(body::sun);
  if (!sun) return forward(sun);
  model.sun_gm_m3_s2_ = sun->gm_m3_s2;
  for (const BodyId id : settings.bodies) {
    auto resolved = ephemeris.resolve(id);
    if (!resolved) return forward(resolved);
    auto constants = body_constants(id);
    if (!constants) return forward(constants);
    model.masses_.push_back({*resolved, constants->gm_m3_s2});
  }
  model.settings_ = std::move(settings);
  model.events_ = std::move(events);
  return model;
}

double ForceModel::mass_kg(Epoch epoch) const {
  return events_.thrust.active() ? events_.thrust.mass_kg(epoch) : settings_.mass_kg;
}

Epoch ForceModel::next_knot(Epoch epoch, Epoch limit) const {
  limit = events_.unmodelled.next_knot(epoch, limit);
  limit = events_.thrust.next_knot(epoch, limit);
  return events_.kicks.next_knot(epoch, limit);
}

Vec3 ForceModel::solar_pressure(Epoch epoch, const Vec3& from_sun_m) const {
  const double r = from_sun_m.norm();
  const double pressure =
      kSolarPressureAtOneAu * settings_.srp_scale * (kAstronomicalUnit / r) * (kAstronomicalUnit / r);
  if (settings_.plates.empty()) {
    // CR A stays, the mass falls.
    const double lightened = events_.thrust.active() ? events_.thrust.plan().mass_kg / mass_kg(epoch) : 1.0;
    return pressure * settings_.srp_cr_area_over_mass_m2_kg * lightened / r * from_sun_m;
  }
  const Vec3 to_sun_N = -from_sun_m / r;
  const Mat3 R_BN = settings_.attitude(epoch, to_sun_N);
  return pressure / mass_kg(epoch) * (R_BN.transpose() * pressure_area(settings_.plates, R_BN * to_sun_N));
}

Result<Vec3> ForceModel::acceleration(Epoch epoch, const State& state) const {
  Vec3 a = events_.unmodelled.at(epoch) + events_.kicks.acceleration_N_m_s2(epoch);
  if (events_.thrust.active()) a += events_.thrust.force_N_n(epoch) / events_.thrust.mass_kg(epoch);
  for (const PointMass& mass : masses_) {
    const auto body_O = ephemeris_.state(mass.id, body::solar_system_barycenter, epoch);
    if (!body_O) return forward(body_O);
    const Vec3 d = body_O->p_m - state.p_m;
    const double d2 = d.squaredNorm();
    a += mass.gm_m3_s2 / (d2 * std::sqrt(d2)) * d;
  }
  const bool lit = settings_.srp_cr_area_over_mass_m2_kg != 0.0 || !settings_.plates.empty();
  if (!settings_.relativity && !lit) return a;

  const auto sun_O = ephemeris_.state(body::sun, body::solar_system_barycenter, epoch);
  if (!sun_O) return forward(sun_O);
  const Vec3 r = state.p_m - sun_O->p_m;
  if (settings_.relativity) {
    const double r_norm = r.norm();
    const Vec3 v = state.v_m_s - sun_O->v_m_s;
    const double factor = sun_gm_m3_s2_ / (kSpeedOfLight * kSpeedOfLight * r_norm * r_norm * r_norm);
    a += factor * ((4.0 * sun_gm_m3_s2_ / r_norm - v.squaredNorm()) * r + 4.0 * r.dot(v) * v);
  }
  if (lit) a += solar_pressure(epoch, r);
  return a;
}

}  // namespace astronav::dynamics
