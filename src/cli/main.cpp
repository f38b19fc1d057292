// SPDX-License-Identifier: Apache-2.0
#include <cstdio>
#include <exception>

#include "cli/command.h"
#include "cli/commands.h"

int main(int argc, char** argv) {
  using namespace astronav;
  try {
    CLI::App app{"astronav: where am I? Optical navigation between the planets, and its proof.", "astronav"};
    app.set_version_flag("--version", "astronav " ASTRONAV_VERSION);
    app.require_subcommand(1);
    app.footer("Example:\n  astronav run\n\n'astronav <command> --help' tells more.");
    cli::Invocation invocation;
    for (const cli::AddCommand add : cli::kCommands) add(app, invocation);
    try {
      app.parse(argc, argv);
    } catch (const CLI::CallForHelp& e) {
      return app.exit(e);
    } catch (const CLI::CallForAllHelp& e) {
      return app.exit(e);
    } catch (const CLI::CallForVersion& e) {
      return app.exit(e);
    } catch (const CLI::ParseError& e) {
      std::fprintf(stderr, "astronav: %s ('astronav --help' shows the commands)\n", e.what());
      return 2;
    }
    const Result<int> status = invocation.action();
    if (status) return *status;
    std::fprintf(stderr, "astronav: %s\n", describe(status.error()).c_str());
    return exit_status(status.error().code);
  } catch (const std::exception& e) {
    std::fprintf(stderr, "astronav: a defect of ours: %s\n", e.what());
    return 1;
  }
}
