// SPDX-License-Identifier: Apache-2.0
#include "support/shared_data.h"

#include <cstdlib>

namespace astronav::testing {

std::filesystem::path shared_data_root() {
  const char* root = std::getenv("ASTRONAV_SHARED_DATA");
  if (root != nullptr && *root != '\0') return root;
  return std::filesystem::path(ASTRONAV_SOURCE_DIR).parent_path() / "shared" / "data";
}

bool shared_data_required() {
  const char* required = std::getenv("ASTRONAV_REQUIRE_SHARED_DATA");
  return required != nullptr && std::string(required) == "1";
}

}  // namespace astronav::testing
