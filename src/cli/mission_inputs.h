// SPDX-License-Identifier: Apache-2.0
// What `run` and `campaign` read from the command line alike.
#pragma once

#include <string>
#include <string_view>
#include <vector>

#include "foundation/base/error.h"
#include "verification/loop/mission.h"
#include "verification/scenario/scenario.h"

namespace astronav::cli {

Result<loop::Level> parse_level(std::string_view text);
// A scenario (TOML file, or a name in scenarios/) with `key=value` assignments on top.
Result<scenario::Draft> read_draft(const std::string& scenario, const std::vector<std::string>& assignments);
// A mission's name as the name of a folder.
std::string folder_name(std::string_view mission);

}  // namespace astronav::cli
