// SPDX-License-Identifier: Apache-2.0
// The parts of `astronav trajectory` that make trajectories.
#pragma once

#include <string>

#include "cli/command.h"
#include "foundation/base/error.h"
#include "models/oem/oem.h"
#include "simulator/dynamics/propagation.h"

namespace astronav::cli {

void add_trajectory_design(CLI::App& trajectory, Invocation& invocation);
void add_trajectory_low_thrust(CLI::App& trajectory, Invocation& invocation);
void add_trajectory_fly(CLI::App& trajectory, Invocation& invocation);
void add_trajectory_arrival(CLI::App& trajectory, Invocation& invocation);
void add_trajectory_porkchop(CLI::App& trajectory, Invocation& invocation);

// States of a flight every `step`; errors are those of --step.
Result<Oem> cruise_message(const dynamics::Arc& arc, Epoch begin, Epoch end, Duration step);
// With the date of today as that of its creation. unsupported where the path asks for an SPK kernel.
Result<void> write_oem(const std::string& path, Oem oem);

}  // namespace astronav::cli
