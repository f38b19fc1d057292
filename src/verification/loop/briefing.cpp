// SPDX-License-Identifier: Apache-2.0
#include "verification/loop/briefing.h"

#include <algorithm>

#include "foundation/math/random.h"
#include "verification/loop/belief.h"

namespace astronav::loop {

Briefing::Briefing(const scenario::Scenario& scenario, const FlyOptions& options, const World& world)
    : scenario_(scenario), options_(options), world_(world) {
  for (const ThrustArc& arc : world_.thrust_plan().arcs)
    commands_.push_back({arc.begin, arc.end, {arc.force_n, arc.specific_impulse_s, arc.direction_N}});
  const scenario::OnboardFilter& belief = scenario_.onboard.filter;
  if (belief.knows_unloading) hear_of_kicks(belief.unloading_error_relative);
  if (const auto& correction = world_.correction(); correction && belief.knows_maneuver) {
    const double sigma_m_s = scenario_.truth.upsets.maneuver_error_relative * correction->delta_v_N_m_s.norm();
    kicks_.push_back({correction->begin, correction->delta_v_N_m_s, sigma_m_s});
    std::sort(kicks_.begin(), kicks_.end(), [](const auto& a, const auto& b) { return a.epoch < b.epoch; });
  }
}

void Briefing::hear_of_kicks(double error_relative) {
  RandomStream stream({.seed = options_.seed, .sample = options_.sample, .purpose = "reported kicks"});
  for (const dynamics::Kick& kick : world_.kicks()) {
    const double sigma_m_s = error_relative * kick.delta_v_N_m_s.norm();
    const Vec3 error(stream.normal(0.0, sigma_m_s), stream.normal(0.0, sigma_m_s), stream.normal(0.0, sigma_m_s));
    kicks_.push_back({kick.begin, kick.delta_v_N_m_s + error, sigma_m_s});
  }
}

double Briefing::mass_kg() const {
  return world_.thrust_plan().arcs.empty() ? kBelievedMassKg : world_.thrust_plan().mass_kg;
}

Result<navigation::InitialState> Briefing::first_state(Epoch epoch) const {
  const auto truth = world_.truth_from_onboard_origin(epoch);
  if (!truth) return forward(truth);
  const scenario::OnboardFilter& belief = scenario_.onboard.filter;
  const double sigma_p = belief.initial_position_sigma_km * 1e3;
  const double sigma_v = belief.initial_velocity_sigma_km_s * 1e3;
  RandomStream stream({.seed = options_.seed, .sample = options_.sample, .purpose = "initial error"});
  navigation::InitialState initial;
  initial.epoch = world_.onboard_clock(epoch);
  initial.state = *truth;
  if (options_.level != Level::cov) {
    for (int i = 0; i < 3; ++i) initial.state.p_m[i] += stream.normal(0.0, sigma_p);
    for (int i = 0; i < 3; ++i) initial.state.v_m_s[i] += stream.normal(0.0, sigma_v);
  }
  initial.covariance.diagonal() << Vec3::Constant(sigma_p * sigma_p), Vec3::Constant(sigma_v * sigma_v);
  initial.mass_kg = mass_kg();
  return initial;
}

}  // namespace astronav::loop
