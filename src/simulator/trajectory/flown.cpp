// SPDX-License-Identifier: Apache-2.0
#include "simulator/trajectory/flown.h"

#include <algorithm>
#include <utility>

#include "foundation/math/random.h"

namespace astronav::trajectory {
namespace {

Result<dynamics::Kicks> join(const std::vector<dynamics::Kick>& corrections, const std::vector<dynamics::Kick>& drawn,
                             Duration length) {
  std::vector<dynamics::Kick> all = corrections;
  for (const dynamics::Kick& kick : drawn) {
    const bool overlapped = std::any_of(corrections.begin(), corrections.end(), [&](const dynamics::Kick& c) {
      return kick.begin < c.begin + length && c.begin < kick.begin + length;
    });
    if (!overlapped) all.push_back(kick);
  }
  std::sort(all.begin(), all.end(), [](const auto& a, const auto& b) { return a.begin < b.begin; });
  return dynamics::Kicks::at_times(std::move(all), length);
}

}  // namespace

Result<FlightPlan> plan_along(const Trajectory& designed, ThrustPlan thrust) {
  const auto initial = designed.state(designed.begin());
  if (!initial) return forward(initial);
  return FlightPlan{designed.begin(), designed.end(), *initial, std::move(thrust)};
}

Result<Flight> fly(const Ephemeris& ephemeris, const dynamics::ForceSettings& forces, const FlightPlan& plan,
                   const Disturbances& disturbances, std::uint64_t seed, std::uint64_t sample) {
  const auto stream = [&](const char* purpose) {
    return RandomStream({.seed = seed, .sample = sample, .purpose = purpose});
  };
  dynamics::Events events;
  RandomStream unmodelled_stream = stream("unmodelled acceleration");
  auto unmodelled =
      dynamics::UnmodelledAcceleration::draw(disturbances.unmodelled, plan.begin, plan.end, unmodelled_stream);
  if (!unmodelled) return forward(unmodelled);
  events.unmodelled = std::move(*unmodelled);
  if (!plan.thrust.arcs.empty()) {
    RandomStream thrust_stream = stream("thrust errors");
    auto thrust = dynamics::ThrustHistory::fly(plan.thrust, disturbances.thrust, plan.begin, plan.end, thrust_stream);
    if (!thrust) return forward(thrust);
    events.thrust = std::move(*thrust);
  }
  if (disturbances.unloading) {
    RandomStream kicks_stream = stream("kicks");
    auto kicks = dynamics::Kicks::draw(disturbances.kicks, plan.begin, plan.end, kicks_stream);
    if (!kicks) return forward(kicks);
    events.kicks = std::move(*kicks);
  }
  if (!disturbances.corrections.empty()) {
    auto kicks = join(disturbances.corrections, events.kicks.list(), disturbances.kicks.length);
    if (!kicks) return forward(kicks);
    events.kicks = std::move(*kicks);
  }
  auto model = dynamics::ForceModel::create(ephemeris, forces, std::move(events));
  if (!model) return forward(model);
  auto arc = dynamics::propagate(*model, plan.initial, plan.begin, plan.end);
  if (!arc) return forward(arc);
  return Flight{std::move(*model), std::move(*arc)};
}

}  // namespace astronav::trajectory
