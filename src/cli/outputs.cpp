// SPDX-License-Identifier: Apache-2.0
#include "cli/outputs.h"

#include <cerrno>
#include <cstring>
#include <filesystem>

#include <fmt/ranges.h>
#include <unistd.h>

namespace astronav::cli {
namespace {

Result<void> check_writable_file(const std::string& path) {
  std::error_code error;
  const bool there = std::filesystem::exists(path, error);
  const std::filesystem::path folder = std::filesystem::path(path).parent_path();
  const auto cannot = [&](const char* why) {
    return fail(ErrorCode::io_failure, "cannot be written ({s})", {}, path, why);
  };
  if (std::filesystem::is_directory(path, error)) return cannot(std::strerror(EISDIR));
  const std::string asked = there ? path : folder.empty() ? "." : folder.string();
  if (access(asked.c_str(), there ? W_OK : W_OK | X_OK) != 0) return cannot(std::strerror(errno));
  return {};
}

}  // namespace

Result<void> check_writable(std::initializer_list<std::string> paths) {
  for (const std::string& path : paths) {
    if (path.empty()) continue;
    if (const auto writable = check_writable_file(path); !writable) return writable;
  }
  return {};
}

Result<void> check_ending(const std::string& path, std::initializer_list<std::string_view> endings,
                          const char* option) {
  if (path.empty()) return {};
  for (const std::string_view ending : endings)
    if (path.ends_with(ending)) return {};
  return fail(ErrorCode::invalid_argument, "{s}", {}, option,
              fmt::format("'{}' does not end in {}", path, fmt::join(endings, " or ")));
}

Result<void> check_apart(const std::string& path, const std::string& other, const char* option) {
  if (path.empty() || other.empty()) return {};
  std::error_code error;
  const auto whole = [&](const std::string& p) {
    return std::filesystem::weakly_canonical(std::filesystem::absolute(p, error), error);
  };
  const bool same = whole(path) == whole(other) || std::filesystem::equivalent(path, other, error);
  if (!same) return {};
  return fail(ErrorCode::invalid_argument, "'{s}' is named twice: one would overwrite the other", {}, option, path);
}

}  // namespace astronav::cli
