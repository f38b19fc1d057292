// SPDX-License-Identifier: Apache-2.0
// What commands look at before a long work whose result goes into a file.
#pragma once

#include <string>

#include "foundation/base/error.h"

namespace astronav::cli {

// io_failure where no file of that path could be written now: the folder is missing or closed, or a folder is in its
// place. The error carries the path.
Result<void> check_writable(const std::string& path);

// invalid_argument, said of `option`, where two paths are one file.
Result<void> check_apart(const std::string& path, const std::string& other, const char* option);

}  // namespace astronav::cli
