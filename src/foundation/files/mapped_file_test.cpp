// SPDX-License-Identifier: Apache-2.0
#include "foundation/files/mapped_file.h"

#include <filesystem>

#include <gtest/gtest.h>

namespace astronav {
namespace {

TEST(MappedFile, GivesBackWhatWasWritten) {
  const auto path = std::filesystem::temp_directory_path() / "astronav_mapped_file_test";
  ASSERT_TRUE(write_file(path, "twelve bytes"));
  const auto file = MappedFile::open(path);
  ASSERT_TRUE(file);
  EXPECT_EQ(file->text(), "twelve bytes");
  ASSERT_TRUE(write_file(path, ""));
  EXPECT_EQ(MappedFile::open(path)->bytes().size(), 0u);
  std::filesystem::remove(path);
}

TEST(MappedFile, SaysWhatIsWrong) {
  EXPECT_EQ(describe(MappedFile::open("/no/such/file").error()), "/no/such/file: no such file");
  EXPECT_EQ(describe(MappedFile::open("/tmp").error()), "/tmp: is not a regular file");
  EXPECT_EQ(write_file("/no/such/folder/x", "").error().code, ErrorCode::io_failure);
}

}  // namespace
}  // namespace astronav
