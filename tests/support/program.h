// SPDX-License-Identifier: Apache-2.0
// Programs run as a person would run them: in a folder of their own, with a time limit, and everything they say kept.
#pragma once

#include <filesystem>
#include <string>
#include <string_view>
#include <vector>

namespace astronav::testing {

struct Outcome {
  int status = 0;  // exit status; minus the signal's number where one ended the program (-14: the time limit)
  std::string out;
  std::string err;
};

// Runs in `folder`; nothing comes in on standard input.
Outcome run_program(const std::filesystem::path& program, const std::vector<std::string>& arguments,
                    const std::filesystem::path& folder, unsigned limit_s = 60);

// Blanks part words; 'single quotes' hold them together.
std::vector<std::string> words(std::string_view line);

std::vector<std::string> lines_of(const std::string& text);

// Every command that a program's help lists, with those below it: "run", "campaign", "campaign merge", ...
std::vector<std::string> commands_of(const std::filesystem::path& program, const std::filesystem::path& folder);

std::string read_text(const std::filesystem::path& path);
void write_text(const std::filesystem::path& path, std::string_view text);

// An empty folder for as long as the object lives.
class ScratchFolder {
 public:
  ScratchFolder();
  ~ScratchFolder();
  ScratchFolder(const ScratchFolder&) = delete;
  ScratchFolder& operator=(const ScratchFolder&) = delete;
  const std::filesystem::path& path() const { return path_; }

 private:
  std::filesystem::path path_;
};

}  // namespace astronav::testing
