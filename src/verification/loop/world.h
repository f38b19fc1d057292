// SPDX-License-Identifier: Apache-2.0
// World: the truth of one mission: where everything is, what the camera really is, and what it sees.
#pragma once

#include <memory>
#include <optional>
#include <span>
#include <vector>

#include "foundation/base/error.h"
#include "foundation/files/mapped_file.h"
#include "models/ephemeris/ephemeris.h"
#include "models/oem/thrust_plan.h"
#include "models/photometry/photometry.h"
#include "models/stars/catalogue.h"
#include "simulator/dynamics/kicks.h"
#include "simulator/render/renderer.h"
#include "simulator/sky/sky.h"
#include "simulator/trajectory/flown.h"
#include "simulator/trajectory/trajectory.h"
#include "verification/scenario/scenario.h"

namespace astronav::loop {

class World {
 public:
  static Result<std::unique_ptr<World>> create(const scenario::Scenario& scenario, std::uint64_t seed,
                                               std::uint64_t sample);
  World(const World&) = delete;
  World& operator=(const World&) = delete;

  const Ephemeris& ephemeris() const { return ephemeris_; }
  // What the onboard software believes in; the same where the scenario names no other.
  const Ephemeris& onboard_ephemeris() const { return onboard_ephemeris_; }
  bool has_own_ephemeris() const { return truth_ephemeris_file_.bytes().data() != nullptr; }
  const ThrustPlan& thrust_plan() const { return thrust_plan_; }
  std::span<const dynamics::Kick> kicks() const { return kicks_; }
  // As it was commanded; flown with its error.
  const std::optional<dynamics::Kick>& correction() const { return correction_; }
  const StarCatalogue& catalogue() const { return catalogue_; }
  const trajectory::Trajectory& trajectory() const { return *trajectory_; }
  const Camera& camera() const { return camera_; }
  const sky::Sky& sky() const { return *sky_; }
  const sky::SkySettings& sky_settings() const { return sky_settings_; }
  const BandPhotometry& band() const { return *band_; }
  // Made at the first call: a mission without images does without its maps. In a storm another.
  const render::Renderer& renderer(Epoch epoch);
  // What the onboard clock shows.
  Epoch onboard_clock(Epoch epoch) const;
  // Whether the spacecraft lies in a safe mode.
  bool is_safe(Epoch epoch) const;

  // Where the spacecraft is, counted as the onboard software counts: from the Sun of its own ephemeris. Two ephemerides
  // put the barycentre at different places beside it (DE405 and DE430: 1 km, DE440: 116 km).
  Result<State> truth_from_onboard_origin(Epoch epoch) const;

  // A planet as the spacecraft sees it, and all of them within an angle of a direction.
  Result<sky::SkySource> planet(BodyId body, Epoch epoch, const State& spacecraft_O) const;
  Result<std::vector<sky::SkySource>> planets(Epoch epoch, const State& spacecraft_O, const Vec3& direction_N,
                                              double radius_rad) const;

 private:
  World() = default;
  // Since the trajectory began, in days.
  bool within(double begin_day, double days, Epoch epoch) const;
  std::optional<dynamics::Kick> plan_correction(const trajectory::FlightPlan& plan, std::uint64_t seed,
                                                std::uint64_t sample, dynamics::Kick& flown) const;
  // The plan as it is flown: with the forces that nobody modelled, errors of the engine, kicks.
  Result<void> fly(const scenario::Scenario& scenario, const trajectory::FlightPlan& plan,
                   const dynamics::ForceSettings& forces, std::uint64_t seed, std::uint64_t sample);

  MappedFile ephemeris_file_, truth_ephemeris_file_, catalogue_file_, trajectory_file_;
  Ephemeris ephemeris_, onboard_ephemeris_;
  ThrustPlan thrust_plan_;             // what the engine is told
  std::vector<dynamics::Kick> kicks_;  // that happened beside the correction
  std::optional<dynamics::Kick> correction_;
  scenario::TruthUpsets upsets_;
  double clock_offset_s_ = 0.0;
  StarCatalogue catalogue_;
  trajectory::TrajectoryPtr trajectory_;
  Camera camera_;
  std::uint64_t detector_seed_ = 0;
  sky::SkySettings sky_settings_;
  std::unique_ptr<sky::Sky> sky_;
  std::unique_ptr<BandPhotometry> band_;
  std::unique_ptr<render::Renderer> renderer_, renderer_in_storm_;
};

}  // namespace astronav::loop
