// SPDX-License-Identifier: Apache-2.0
#include "simulator/server/protocol.h"

#include <string>

#include <gtest/gtest.h>

namespace astronav::server {
namespace {

using std::string_literals::operator""s;

TEST(Protocol, HeaderLiesOnTheWireAsThePageSays) {
  std::array<std::byte, kHeaderBytes> bytes;
  encode({1, 103, 0x01020304, 0x0a0b0c0d}, bytes.data());
  const unsigned char expected[16] = {'A', 'N', 'A', 'V', 1, 0, 103, 0, 4, 3, 2, 1, 0x0d, 0x0c, 0x0b, 0x0a};
  for (int i = 0; i < 16; ++i) EXPECT_EQ(std::to_integer<int>(bytes[i]), expected[i]) << i;
  const auto read = decode_header(bytes);
  ASSERT_TRUE(read);
  EXPECT_EQ(read->type, 103);
  EXPECT_EQ(read->json_bytes, 0x01020304u);
  EXPECT_EQ(read->binary_bytes, 0x0a0b0c0du);
  bytes[3] = std::byte{'v'};
  EXPECT_EQ(decode_header(bytes).error().code, ErrorCode::corrupt_data);
}

TEST(Protocol, CodesReadBack) {
  for (int i = 0; i <= static_cast<int>(ErrorCode::internal); ++i) {
    const auto code = static_cast<ErrorCode>(i);
    EXPECT_EQ(error_code(astronav::name(code)), code);
  }
  EXPECT_EQ(error_code("no such code"), ErrorCode::internal);
}

TEST(Protocol, TokensAreTheSameOnlyWhereEveryByteIs) {
  const std::string long_one(kMaxToken, 'x');
  EXPECT_TRUE(same_token("", ""));
  EXPECT_TRUE(same_token("secret", "secret"));
  EXPECT_TRUE(same_token(long_one, long_one));
  EXPECT_FALSE(same_token("secret", "secreT"));
  EXPECT_FALSE(same_token("secret", "secret\0"s.substr(0, 7)));
  EXPECT_FALSE(same_token("secret", ""));
  EXPECT_FALSE(same_token("", "secret"));
  EXPECT_FALSE(same_token(long_one + "a", long_one + "b"));
}

TEST(Protocol, DepthIsCountedOutsideTexts) {
  EXPECT_FALSE(deeper_than("{\"a\":[1,{\"b\":2}]}", 3));
  EXPECT_TRUE(deeper_than("{\"a\":[1,{\"b\":2}]}", 2));
  EXPECT_FALSE(deeper_than("{\"a\":\"[[[[\\\"[[[[\"}", 1));
  EXPECT_TRUE(deeper_than(std::string(1000000, '['), kMaxDepth));
}

}  // namespace
}  // namespace astronav::server
