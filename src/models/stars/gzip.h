// SPDX-License-Identifier: Apache-2.0
// gunzip: published star tables come compressed.
#pragma once

#include <cstddef>
#include <span>
#include <string>

#include "foundation/base/error.h"

namespace astronav {

bool is_gzip(std::span<const std::byte> bytes);

// The content of a gzip file (all of its members, up to `limit` bytes); corrupt_data with the byte offset where it
// breaks off, limit_exceeded.
Result<std::string> gunzip(std::span<const std::byte> bytes, std::size_t limit = std::size_t{1} << 31);

}  // namespace astronav
