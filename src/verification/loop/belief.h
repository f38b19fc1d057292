// SPDX-License-Identifier: Apache-2.0
// Belief: what the onboard software is told before the flight, from the [onboard] half of a scenario.
#pragma once

#include "foundation/base/error.h"
#include "models/camera/camera.h"
#include "onboard/executive/cold_start.h"
#include "onboard/executive/stance.h"
#include "onboard/executive/timeline.h"
#include "onboard/navigation/beacons.h"
#include "onboard/navigation/filter.h"
#include "onboard/vision/exposure.h"
#include "onboard/vision/vision.h"
#include "verification/loop/mission.h"
#include "verification/scenario/scenario.h"

namespace astronav::loop {

// A ballistic arc knows the mass only through CR A/m, so any number serves.
inline constexpr double kBelievedMassKg = 25.0;

// Sights without images (mil) carry no camera errors: the camera states are off there.
Result<navigation::FilterSettings> filter_settings(const scenario::Scenario& scenario, const Camera& camera,
                                                   Level level, double mass_kg = kBelievedMassKg);
vision::VisionSettings vision_settings(const scenario::Scenario& scenario);
// Of the list in which stars beside planets are looked up. What is two magnitudes fainter than the stars that name the
// sky still moves a planet in whose wings it stands.
double neighbours_max_v_mag(const scenario::Scenario& scenario);
Result<vision::ExposureSettings> exposure_settings(const scenario::Scenario& scenario, const Camera& camera);
executive::StanceSettings stance_settings(const scenario::Scenario& scenario);
// Candidates, limits, merit, and what the platform can do between two windows.
navigation::BeaconSettings beacon_settings(const scenario::Scenario& scenario, const Camera& camera);
executive::ColdStartSettings cold_start_settings(const scenario::Scenario& scenario,
                                                 const navigation::FilterSettings& filter, double mass_kg,
                                                 int images_per_window);
Result<executive::CycleSettings> cycle_settings(const scenario::Scenario& scenario);

}  // namespace astronav::loop
