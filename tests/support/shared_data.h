// SPDX-License-Identifier: Apache-2.0
// Where tests find the shared reference data (never a part of the project).
//
//   TEST(Ephemeris, AgreesWithDe440) {
//     const auto path = ASTRONAV_SHARED_DATA("ephemeris/de440s_excerpt_20221231_20260104.bsp");
//
// The folder is ASTRONAV_SHARED_DATA, else ../shared/data beside the source tree. Where it is absent the test shows as
// skipped; with ASTRONAV_REQUIRE_SHARED_DATA=1 (CI) it fails instead.
#pragma once

#include <filesystem>
#include <string>

#include <gtest/gtest.h>

namespace astronav::testing {

std::filesystem::path shared_data_root();
bool shared_data_required();

}  // namespace astronav::testing

#define ASTRONAV_SHARED_DATA(name)                                                                     \
  [&]() -> std::filesystem::path { return ::astronav::testing::shared_data_root() / (name); }();       \
  if (!std::filesystem::exists(::astronav::testing::shared_data_root() / (name))) {                    \
    if (::astronav::testing::shared_data_required())                                                   \
      FAIL() << "shared data are required, but " << (::astronav::testing::shared_data_root() / (name)) \
             << " is not there";                                                                       \
    GTEST_SKIP() << "no shared data: " << (::astronav::testing::shared_data_root() / (name));          \
  }                                                                                                    \
  static_assert(true)
