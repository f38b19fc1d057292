// SPDX-License-Identifier: Apache-2.0
#include "foundation/base/error.h"

#include <gtest/gtest.h>

#include "foundation/base/check.h"

namespace astronav {
namespace {

TEST(Error, SentenceHasPlaceNumbersAndSubject) {
  const Error e{
      ErrorCode::corrupt_data, "{s}: record at byte {0} is {1} bytes long", {128, 40.5}, "a.bsp", "segment 3"};
  EXPECT_EQ(describe(e), "a.bsp: segment 3: record at byte 128 is 40.5 bytes long");
}

TEST(Error, KeepsTheMorePrecisePlace) {
  const Error e{ErrorCode::not_found, "no such key", {}, "a.toml:3:1", ""};
  EXPECT_EQ(describe(e.at("a.toml")), "a.toml:3:1: no such key");
  EXPECT_EQ(describe(Error{ErrorCode::not_found, "gone", {}, {}, {}}.at("x")), "x: gone");
}

TEST(Error, LongTextKeepsItsEnd) {
  const FixedText<10> t("abcdefghijklmnop");
  EXPECT_EQ(t.view(), "...jklmnop");
}

TEST(Error, CodesMapToExitStatus) {
  EXPECT_EQ(exit_status(ErrorCode::corrupt_data), 2);
  EXPECT_EQ(exit_status(ErrorCode::no_match), 3);
  EXPECT_EQ(exit_status(ErrorCode::internal), 1);
}

TEST(CheckDeathTest, PrintsBothValues) {
  const int three = 3;
  EXPECT_DEATH(ASTRONAV_CHECK_OP(three, <, 2), "three < 2 \\(3, 2\\)");
}

}  // namespace
}  // namespace astronav
