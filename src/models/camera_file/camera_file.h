// SPDX-License-Identifier: Apache-2.0
// Cameras as TOML files (docs/formats.md). Every key carries its unit; an unknown key is an error with its line.
#pragma once

#include <filesystem>
#include <string>
#include <string_view>

#include "foundation/base/error.h"
#include "models/camera/camera.h"

namespace astronav {

Result<Camera> parse_camera(std::string_view toml, std::string_view name_for_errors);
// A path, or the name of a file in scenarios/cameras without ".toml".
Result<Camera> read_camera(const std::filesystem::path& path_or_name);
// The text that parse_camera reads back to the same camera.
std::string to_toml(const Camera& camera);

}  // namespace astronav
