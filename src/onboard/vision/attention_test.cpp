// SPDX-License-Identifier: Apache-2.0
#include "onboard/vision/attention.h"

#include <algorithm>
#include <cmath>
#include <utility>
#include <vector>

#include <gtest/gtest.h>

#include "foundation/math/random.h"

namespace astronav::vision {
namespace {

// Against a frame of bytes, for sizes that are no multiples of anything.
TEST(Attention, IsTheUnionOfItsSquares) {
  RandomStream random(StreamId{.seed = 1, .purpose = "attention"});
  for (const auto& [width, height] : {std::pair{1024, 1024}, std::pair{333, 77}, std::pair{4500, 19}}) {
    Attention attention(width, height);
    for (int round = 0; round < 3; ++round) {
      attention.clear();
      EXPECT_EQ(attention.area_px(), 0.0);
      std::vector<unsigned char> looked(static_cast<std::size_t>(width * height));
      for (int k = 0; k < 6; ++k) {
        const Pixel middle{random.uniform(-40.0, width + 40.0), random.uniform(-40.0, height + 40.0)};
        const double reach = random.uniform(0.0, 50.0);
        attention.add(middle, reach);
        for (int v = 0; v < height; ++v) {
          for (int u = 0; u < width; ++u)
            looked[static_cast<std::size_t>(v * width + u)] |=
                std::abs(u - middle.u) <= reach && std::abs(v - middle.v) <= reach;
        }
      }
      double area = 0.0;
      for (int v = 0; v < height; ++v) {
        for (int u = 0; u < width; ++u) {
          const bool at = attention.covers({u, v, u, v});
          // What was asked for, and else only pixels above or below it in the same eight rows.
          bool asked = looked[static_cast<std::size_t>(v * width + u)] != 0;
          ASSERT_TRUE(at || !asked) << u << ", " << v;
          for (int other = v / 8 * 8; other < std::min(v / 8 * 8 + 8, height); ++other)
            asked |= looked[static_cast<std::size_t>(other * width + u)] != 0;
          ASSERT_TRUE(asked || !at) << u << ", " << v;
          area += at;
          ASSERT_TRUE(attention.next_block(v, u / 64) == u / 64 || !at);
          ASSERT_EQ((attention.bits(v, u / 64) >> (u % 64) & 1) != 0, at);
        }
      }
      EXPECT_EQ(attention.area_px(), area);
    }
  }
}

TEST(Attention, CoversWindowsAsFarAsTheyAreInTheFrame) {
  Attention attention(200, 100);
  attention.add({10.0, 10.0}, 20.0);
  EXPECT_TRUE(attention.covers({-5, -5, 30, 30}));
  EXPECT_FALSE(attention.covers({-5, -5, 31, 30}));
  EXPECT_EQ(attention.next_block(0, 1), -1);
}

}  // namespace
}  // namespace astronav::vision
