// SPDX-License-Identifier: Apache-2.0
// The list of commands, in the order in which the help shows them. A new command is two lines here.
#pragma once

#include <array>

#include "cli/command.h"

namespace astronav::cli {

void add_ephemeris(CLI::App& app, Invocation& invocation);

inline constexpr std::array kCommands{&add_ephemeris};

}  // namespace astronav::cli
