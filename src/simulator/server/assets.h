// SPDX-License-Identifier: Apache-2.0
// The page of the live view, built into the program from web/live by embed.cmake. Internal to this folder.
#pragma once

#include <string_view>

namespace astronav::server {

extern const std::string_view kLivePage;

}  // namespace astronav::server
