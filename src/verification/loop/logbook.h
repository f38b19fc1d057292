// SPDX-License-Identifier: Apache-2.0
// Logbook: what stands in a mission's records beside its events. Internal to this folder.
#pragma once

#include "foundation/time/epoch.h"
#include "models/ephemeris/ephemeris.h"
#include "onboard/navigation/beacons.h"
#include "verification/loop/mission.h"
#include "verification/loop/records.h"
#include "verification/scenario/scenario.h"

namespace astronav::loop {

// Which planets the onboard software could have tracked, and why it did not.
BeaconChoice beacon_choice(int cycle, Epoch epoch, const navigation::BeaconSelection& selection, BodyId first,
                           BodyId second);
// Where the planets are between the records' begin and end.
void record_orbits(const Ephemeris& ephemeris, Records& records);
// Who flew what: level, seed, version, the scenario as it was; and the memory that it took.
void sign(const scenario::Scenario& scenario, const FlyOptions& options, Records& records);

}  // namespace astronav::loop
