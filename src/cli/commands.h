// SPDX-License-Identifier: Apache-2.0
// The list of commands, in the order in which the help shows them. A new command is two lines here.
#pragma once

#include <array>

#include "cli/command.h"

namespace astronav::cli {

void add_run(CLI::App& app, Invocation& invocation);
void add_campaign(CLI::App& app, Invocation& invocation);
void add_ephemeris(CLI::App& app, Invocation& invocation);
void add_render(CLI::App& app, Invocation& invocation);
void add_solve(CLI::App& app, Invocation& invocation);
void add_centroids(CLI::App& app, Invocation& invocation);
void add_fix(CLI::App& app, Invocation& invocation);
void add_compare(CLI::App& app, Invocation& invocation);
void add_trajectory(CLI::App& app, Invocation& invocation);
void add_catalog(CLI::App& app, Invocation& invocation);
void add_beacons(CLI::App& app, Invocation& invocation);
void add_calibrate(CLI::App& app, Invocation& invocation);
void add_serve(CLI::App& app, Invocation& invocation);
void add_bench(CLI::App& app, Invocation& invocation);

inline constexpr std::array kCommands{&add_run,       &add_campaign,  &add_ephemeris, &add_render,  &add_solve,
                                      &add_calibrate, &add_centroids, &add_fix,       &add_compare, &add_trajectory,
                                      &add_catalog,   &add_beacons,   &add_serve,     &add_bench};

}  // namespace astronav::cli
