// SPDX-License-Identifier: Apache-2.0
#include "simulator/dynamics/forces.h"

#include <algorithm>
#include <cmath>
#include <utility>

namespace astronav::dynamics {

Result<UnmodelledAcceleration> UnmodelledAcceleration::draw(const UnmodelledSettings& settings, Epoch begin, Epoch end,
                                                            RandomStream& stream) {
  if (!std::isfinite(settings.sigma_m_s2) || settings.sigma_m_s2 < 0.0) {
    return fail(ErrorCode::invalid_argument, "the sigma of the unmodelled acceleration, {0} m/s^2, is not zero or more",
                {settings.sigma_m_s2});
  }
  if (settings.tau <= Duration{} || settings.grid <= Duration{}) {
    return fail(ErrorCode::invalid_argument,
                "correlation time ({0} s) and grid ({1} s) of the unmodelled acceleration must be above zero",
                {settings.tau.seconds(), settings.grid.seconds()});
  }
  if (end < begin) return fail(ErrorCode::invalid_argument, "the unmodelled acceleration ends before it begins");
  UnmodelledAcceleration out;
  if (settings.sigma_m_s2 == 0.0) return out;
  out.begin_ = begin;
  out.grid_ = settings.grid;
  const std::int64_t intervals =
      ((end - begin).nanoseconds() + settings.grid.nanoseconds() - 1) / settings.grid.nanoseconds();
  constexpr std::int64_t kMost = 10'000'000;
  if (intervals > kMost) {
    return fail(ErrorCode::limit_exceeded, "the unmodelled acceleration has {0} intervals; at most {1} are allowed",
                {static_cast<double>(intervals), static_cast<double>(kMost)});
  }
  const double phi = std::exp(-settings.grid.seconds() / settings.tau.seconds());
  const double step_sigma = settings.sigma_m_s2 * std::sqrt(1.0 - phi * phi);
  const auto normal3 = [&stream] {
    const double x = stream.normal();
    const double y = stream.normal();
    return Vec3(x, y, stream.normal());
  };
  out.values_.reserve(static_cast<std::size_t>(intervals) + 1);
  out.values_.push_back(settings.sigma_m_s2 * normal3());
  for (std::int64_t i = 0; i < intervals; ++i) out.values_.push_back(phi * out.values_.back() + step_sigma * normal3());
  return out;
}

Vec3 UnmodelledAcceleration::at(Epoch epoch) const {
  if (values_.empty() || epoch < begin_) return Vec3::Zero();
  const std::int64_t elapsed = (epoch - begin_).nanoseconds();
  const auto interval = static_cast<std::size_t>(elapsed / grid_.nanoseconds());
  const std::int64_t inside = elapsed % grid_.nanoseconds();
  if (interval + 1 >= values_.size()) {
    return interval + 1 == values_.size() && inside == 0 ? values_.back() : Vec3(Vec3::Zero());
  }
  const double fraction = static_cast<double>(inside) / static_cast<double>(grid_.nanoseconds());
  return (1.0 - fraction) * values_[interval] + fraction * values_[interval + 1];
}

Epoch UnmodelledAcceleration::next_knot(Epoch epoch, Epoch limit) const {
  if (values_.empty()) return limit;
  const bool forward = limit >= epoch;
  const std::int64_t grid = grid_.nanoseconds();
  const std::int64_t elapsed = (epoch - begin_).nanoseconds();
  const auto last = static_cast<std::int64_t>(values_.size()) - 1;
  std::int64_t knot = elapsed / grid;
  if (elapsed < 0 && elapsed % grid != 0) --knot;  // the floor
  if (forward) {
    knot = std::max<std::int64_t>(knot + 1, 0);
    if (knot > last) return limit;
    return std::min(begin_ + grid_ * knot, limit);
  }
  if (elapsed % grid == 0) --knot;
  knot = std::min(knot, last);
  if (knot < 0) return limit;
  return std::max(begin_ + grid_ * knot, limit);
}

Result<ForceModel> ForceModel::create(const Ephemeris& ephemeris, ForceSettings settings,
                                      UnmodelledAcceleration unmodelled) {
  if (!std::isfinite(settings.srp_cr_area_over_mass_m2_kg) || !std::isfinite(settings.srp_scale)) {
    return fail(ErrorCode::invalid_argument, "CR A/m ({0} m^2/kg) and the scale of solar pressure ({1}) must be finite",
                {settings.srp_cr_area_over_mass_m2_kg, settings.srp_scale});
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
  model.unmodelled_ = std::move(unmodelled);
  return model;
}

Result<Vec3> ForceModel::acceleration(Epoch epoch, const State& state) const {
  Vec3 a = unmodelled_.at(epoch);
  for (const PointMass& mass : masses_) {
    const auto body_O = ephemeris_.state(mass.id, body::solar_system_barycenter, epoch);
    if (!body_O) return forward(body_O);
    const Vec3 d = body_O->p_m - state.p_m;
    const double d2 = d.squaredNorm();
    a += mass.gm_m3_s2 / (d2 * std::sqrt(d2)) * d;
  }
  if (!settings_.relativity && settings_.srp_cr_area_over_mass_m2_kg == 0.0) return a;

  const auto sun_O = ephemeris_.state(body::sun, body::solar_system_barycenter, epoch);
  if (!sun_O) return forward(sun_O);
  const Vec3 r = state.p_m - sun_O->p_m;
  const double r_norm = r.norm();
  if (settings_.relativity) {
    const Vec3 v = state.v_m_s - sun_O->v_m_s;
    const double factor = sun_gm_m3_s2_ / (kSpeedOfLight * kSpeedOfLight * r_norm * r_norm * r_norm);
    a += factor * ((4.0 * sun_gm_m3_s2_ / r_norm - v.squaredNorm()) * r + 4.0 * r.dot(v) * v);
  }
  const double au_over_r = kAstronomicalUnit / r_norm;
  a += kSolarPressureAtOneAu * settings_.srp_scale * settings_.srp_cr_area_over_mass_m2_kg * au_over_r * au_over_r /
       r_norm * r;
  return a;
}

}  // namespace astronav::dynamics
