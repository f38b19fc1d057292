// SPDX-License-Identifier: Apache-2.0
// MappedFile: a file's bytes, read-only, in memory for as long as the object lives.
#pragma once

#include <cstddef>
#include <filesystem>
#include <span>
#include <string>
#include <string_view>

#include "foundation/base/error.h"

namespace astronav {

class MappedFile {
 public:
  // not_found, io_failure; an empty file gives empty bytes, a directory is refused.
  static Result<MappedFile> open(const std::filesystem::path& path);

  MappedFile() = default;
  ~MappedFile();
  MappedFile(MappedFile&& other) noexcept;
  MappedFile& operator=(MappedFile&& other) noexcept;
  MappedFile(const MappedFile&) = delete;
  MappedFile& operator=(const MappedFile&) = delete;

  std::span<const std::byte> bytes() const { return {data_, size_}; }
  std::string_view text() const { return {reinterpret_cast<const char*>(data_), size_}; }
  const std::filesystem::path& path() const { return path_; }

 private:
  const std::byte* data_ = nullptr;
  std::size_t size_ = 0;
  std::filesystem::path path_;
};

// Writes the whole file, or says why not; an existing file is replaced in one step (rename).
Result<void> write_file(const std::filesystem::path& path, std::string_view bytes);

// The folder that holds data/, scenarios/ and web/: ASTRONAV_HOME, else the source tree this program was built from.
std::filesystem::path home_directory();

}  // namespace astronav
