// SPDX-License-Identifier: Apache-2.0
// The parts of the report page, built into the program from web/report and the npm package uplot (MIT).
#pragma once

#include <string_view>

namespace astronav::report::assets {

extern const std::string_view kPage, kStyle, kScript, kUplotStyle, kUplotScript;

}  // namespace astronav::report::assets
