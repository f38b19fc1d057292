// SPDX-License-Identifier: Apache-2.0
#include "support/program.h"

#include <cstdlib>
#include <fstream>
#include <iterator>
#include <sstream>
#include <system_error>

#include <fcntl.h>
#include <gtest/gtest.h>
#include <sys/wait.h>
#include <unistd.h>

namespace astronav::testing {

namespace fs = std::filesystem;

Outcome run_program(const fs::path& program, const std::vector<std::string>& arguments, const fs::path& folder,
                    unsigned limit_s) {
  const ScratchFolder said;
  const fs::path out = said.path() / "out", err = said.path() / "err";
  std::vector<char*> argv{const_cast<char*>(program.c_str())};
  for (const std::string& argument : arguments) argv.push_back(const_cast<char*>(argument.c_str()));
  argv.push_back(nullptr);
  const pid_t child = fork();
  if (child == 0) {
    const int none = open("/dev/null", O_RDONLY);
    const int out_fd = open(out.c_str(), O_WRONLY | O_CREAT, 0600),
              err_fd = open(err.c_str(), O_WRONLY | O_CREAT, 0600);
    if (dup2(none, 0) < 0 || dup2(out_fd, 1) < 0 || dup2(err_fd, 2) < 0 || chdir(folder.c_str()) != 0) _exit(126);
    alarm(limit_s);  // outlives exec: the program ends by SIGALRM
    execv(argv[0], argv.data());
    _exit(127);
  }
  int status = 0;
  if (child < 0 || waitpid(child, &status, 0) != child) return {.status = 125, .out = {}, .err = {}};
  return {.status = WIFEXITED(status) ? WEXITSTATUS(status) : -WTERMSIG(status),
          .out = read_text(out),
          .err = read_text(err)};
}

std::vector<std::string> words(std::string_view line) {
  std::vector<std::string> out;
  bool quoted = false, open = false;
  for (const char c : line) {
    if (c == '\'') {
      quoted = !quoted;
      if (!open) out.emplace_back();
      open = true;
    } else if (c == ' ' && !quoted) {
      open = false;
    } else {
      if (!open) out.emplace_back();
      open = true;
      out.back() += c;
    }
  }
  return out;
}

std::vector<std::string> lines_of(const std::string& text) {
  std::vector<std::string> out;
  std::istringstream stream(text);
  for (std::string line; std::getline(stream, line);) out.push_back(line);
  return out;
}

namespace {

void add_commands(const fs::path& program, const fs::path& folder, const std::string& above,
                  std::vector<std::string>& out) {
  std::vector<std::string> arguments = words(above);
  arguments.push_back("--help");
  bool listed = false;
  for (const std::string& line : lines_of(run_program(program, arguments, folder).out)) {
    if (line.starts_with("Subcommands:")) {
      listed = true;
    } else if (listed && line.size() > 2 && line.starts_with("  ") && line[2] != ' ') {
      out.push_back((above.empty() ? "" : above + " ") + words(line).front());
      add_commands(program, folder, std::string(out.back()), out);
    } else if (!line.starts_with(' ')) {
      listed = false;
    }
  }
}

}  // namespace

std::vector<std::string> commands_of(const fs::path& program, const fs::path& folder) {
  std::vector<std::string> out;
  add_commands(program, folder, "", out);
  return out;
}

std::string read_text(const fs::path& path) {
  std::ifstream file(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(file), {}};
}

void write_text(const fs::path& path, std::string_view text) {
  std::ofstream file(path, std::ios::binary);
  file << text;
  ASSERT_TRUE(file.flush()) << path;
}

ScratchFolder::ScratchFolder() {
  std::string pattern = (fs::temp_directory_path() / "astronav_test_XXXXXX").string();
  if (mkdtemp(pattern.data()) == nullptr) std::abort();
  path_ = pattern;
}

ScratchFolder::~ScratchFolder() {
  std::error_code ignored;
  fs::remove_all(path_, ignored);
}

}  // namespace astronav::testing
