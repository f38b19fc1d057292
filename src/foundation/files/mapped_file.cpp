// SPDX-License-Identifier: Apache-2.0
#include "foundation/files/mapped_file.h"

#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <utility>

#include <fcntl.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

namespace astronav {

Result<MappedFile> MappedFile::open(const std::filesystem::path& path) {
  const std::string where = path.string();
  // Without O_NONBLOCK a pipe would be waited for before it can be refused.
  const int fd = ::open(path.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK);
  if (fd < 0) {
    if (errno == ENOENT || errno == ENOTDIR) return fail(ErrorCode::not_found, "no such file", {}, where);
    return fail(ErrorCode::io_failure, "cannot be opened ({s})", {}, where, std::strerror(errno));
  }
  struct stat info {};
  if (::fstat(fd, &info) != 0 || !S_ISREG(info.st_mode)) {
    ::close(fd);
    return fail(ErrorCode::io_failure, "is not a regular file", {}, where);
  }
  MappedFile file;
  file.path_ = path;
  file.size_ = static_cast<std::size_t>(info.st_size);
  if (file.size_ > 0) {
    void* address = ::mmap(nullptr, file.size_, PROT_READ, MAP_PRIVATE, fd, 0);
    const int error = errno;
    ::close(fd);
    if (address == MAP_FAILED) {
      file.size_ = 0;
      return fail(ErrorCode::io_failure, "cannot be mapped ({s})", {}, where, std::strerror(error));
    }
    file.data_ = static_cast<const std::byte*>(address);
  } else {
    ::close(fd);
  }
  return file;
}

MappedFile::~MappedFile() {
  if (data_ != nullptr) ::munmap(const_cast<std::byte*>(data_), size_);
}

MappedFile::MappedFile(MappedFile&& other) noexcept
    : data_(std::exchange(other.data_, nullptr)), size_(std::exchange(other.size_, 0)), path_(std::move(other.path_)) {}

MappedFile& MappedFile::operator=(MappedFile&& other) noexcept {
  if (this != &other) {
    if (data_ != nullptr) ::munmap(const_cast<std::byte*>(data_), size_);
    data_ = std::exchange(other.data_, nullptr);
    size_ = std::exchange(other.size_, 0);
    path_ = std::move(other.path_);
  }
  return *this;
}

Result<void> write_file(const std::filesystem::path& path, std::string_view bytes) {
  const std::filesystem::path part = path.string() + ".part";
  {
    std::ofstream out(part, std::ios::binary);
    out.write(bytes.data(), static_cast<std::streamsize>(bytes.size()));
    out.flush();
    if (!out) return fail(ErrorCode::io_failure, "cannot be written ({s})", {}, path.string(), std::strerror(errno));
  }
  std::error_code error;
  std::filesystem::rename(part, path, error);
  if (error) return fail(ErrorCode::io_failure, "cannot be written ({s})", {}, path.string(), error.message());
  return {};
}

std::filesystem::path home_directory() {
  const char* home = std::getenv("ASTRONAV_HOME");
  return home != nullptr && *home != '\0' ? home : ASTRONAV_SOURCE_DIR;
}

}  // namespace astronav
