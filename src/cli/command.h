// SPDX-License-Identifier: Apache-2.0
// How a command joins the program: one file command_<name>.cpp with one function, listed in main.cpp.
//
//   void add_ephemeris(CLI::App& app, Invocation& invocation) {
//     auto options = std::make_shared<Options>();
//     CLI::App* sub = app.add_subcommand("ephemeris", "state of a body");
//     sub->footer("Example:\n  astronav ephemeris mars --epoch '2028-03-01T12:00:00 TDB'");
//     sub->add_option("body", options->body, "name or NAIF number")->required();
//     sub->callback([options, &invocation] { invocation.action = [options] { return run(*options); }; });
//   }
//
// The action returns Result<int>: an exit status (0; 3 for "ran, but no result"), or an Error, which main prints as one
// line "astronav: <sentence>" on standard error and maps to its exit status. With --json one JSON object a line goes to
// standard output and nothing else does; people's text and progress go to standard error... without --json the answer
// for people goes to standard output.
#pragma once

#include <functional>

#include <CLI/CLI.hpp>

#include "foundation/base/error.h"

namespace astronav::cli {

struct Invocation {
  std::function<Result<int>()> action;
};

using AddCommand = void (*)(CLI::App&, Invocation&);

}  // namespace astronav::cli
