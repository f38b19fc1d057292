// SPDX-License-Identifier: Apache-2.0
#include "foundation/image/image.h"

#include <gtest/gtest.h>

namespace astronav {
namespace {

TEST(Image, PixelsLieRowAfterRow) {
  ImageU16 image(4, 3);
  image(2, 1) = 7;
  EXPECT_EQ(image.pixels()[6], 7);
  const ImageView<const std::uint16_t> inner(image.row(1) + 1, 3, 2, 4);
  EXPECT_EQ(inner(1, 0), 7);
  EXPECT_FALSE(inner.contains(3, 0));
}

}  // namespace
}  // namespace astronav
