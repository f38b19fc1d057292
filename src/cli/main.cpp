// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cstdio>
#include <exception>
#include <string>
#include <vector>

#include "cli/command.h"
#include "cli/commands.h"
#include "foundation/base/nearest_word.h"

namespace astronav::cli {
namespace {

// One line, whatever a file name or a file's text brought into the sentence.
void complain(std::string sentence) {
  for (char& c : sentence) {
    if (static_cast<unsigned char>(c) < 0x20 || c == 0x7f) c = ' ';
  }
  std::fprintf(stderr, "astronav: %s\n", sentence.c_str());
}

// An unknown command is told its nearest neighbour; to everything else the command's own help is the answer.
std::string say_parse_error(CLI::App& app, const CLI::ParseError& error, const std::vector<std::string>& arguments) {
  const auto name_of = [](const CLI::App* each) { return each->get_name(); };
  CLI::App* command = &app;
  std::string path = "astronav";
  for (const std::string& word : arguments) {
    const std::vector<CLI::App*> below = command->get_subcommands([](CLI::App*) { return true; });
    const auto known =
        std::find_if(below.begin(), below.end(), [&](CLI::App* each) { return each->get_name() == word; });
    if (known != below.end()) {
      command = *known;
      path += " " + word;
      continue;
    }
    if (command->get_require_subcommand_min() == 0 || word.starts_with('-')) break;
    return "there is no command '" + path + " " + word + "'; did you mean '" + path + " " +
           (*nearest_word(word, below, name_of))->get_name() + "'?";
  }
  return std::string(error.what()) + " ('" + path + " --help' tells more)";
}

}  // namespace
}  // namespace astronav::cli

int main(int argc, char** argv) {
  using namespace astronav;
  using namespace astronav::cli;
  try {
    CLI::App app{"astronav: where am I? Optical navigation between the planets, and its proof.", "astronav"};
    app.set_version_flag("--version", "astronav " ASTRONAV_VERSION);
    app.require_subcommand(1);
    app.footer("'astronav <command> --help' tells more.\n\nExample:\n  astronav run");
    Invocation invocation;
    for (const AddCommand add : kCommands) add(app, invocation);
    try {
      app.parse(argc, argv);
    } catch (const CLI::CallForHelp& e) {
      return app.exit(e);
    } catch (const CLI::CallForAllHelp& e) {
      return app.exit(e);
    } catch (const CLI::CallForVersion& e) {
      return app.exit(e);
    } catch (const CLI::ParseError& e) {
      complain(say_parse_error(app, e, {argv + 1, argv + argc}));
      return 2;
    }
    const Result<int> status = invocation.action();
    if (status) return *status;
    complain(describe(status.error()));
    return exit_status(status.error().code);
  } catch (const std::exception& e) {
    complain(std::string("a defect of ours: ") + e.what());
    return 1;
  }
}
