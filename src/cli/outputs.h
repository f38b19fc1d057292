// SPDX-License-Identifier: Apache-2.0
// What commands look at before a long work whose result goes into a file.
#pragma once

#include <initializer_list>
#include <string>
#include <string_view>

#include "foundation/base/error.h"

namespace astronav::cli {

// io_failure where no file of one of these paths could be written now: the folder is missing or closed, or a folder is
// in its place. The error carries the path. An empty path is an output that nobody asked for.
Result<void> check_writable(std::initializer_list<std::string> paths);

// invalid_argument, said of `option`, where a path that is not empty ends in none of what that option writes.
Result<void> check_ending(const std::string& path, std::initializer_list<std::string_view> endings, const char* option);

// invalid_argument, said of `option`, where two paths that are not empty are one file.
Result<void> check_apart(const std::string& path, const std::string& other, const char* option);

}  // namespace astronav::cli
