// SPDX-License-Identifier: Apache-2.0
#include "onboard/executive/timeline.h"

#include <gtest/gtest.h>

namespace astronav::executive {
namespace {

TEST(Timeline, IsThePapersCycle) {
  const Epoch first;
  const Timeline timeline({}, first, first + Duration::days(300.0));
  EXPECT_EQ(timeline.images_per_window(), 36);
  EXPECT_EQ(timeline.cycles(), 30);
  EXPECT_DOUBLE_EQ((timeline.window_begin(0, 1) - first).seconds(), 5100.0);
  EXPECT_DOUBLE_EQ((timeline.image_epoch(2, 0, 0) - timeline.window_begin(2, 0)).seconds(), 50.0);
  EXPECT_LT(timeline.image_epoch(2, 1, 35), timeline.window_end(2, 1));
  EXPECT_EQ(timeline.coast_end(3), timeline.window_begin(4, 0));
}

TEST(Timeline, PlansNothingThatWouldNotBeComplete) {
  const Epoch first;
  const Duration busy = Duration::seconds(8700.0);
  EXPECT_EQ(Timeline({}, first, first + busy - Duration::nanoseconds(1)).cycles(), 0);
  EXPECT_EQ(Timeline({}, first, first + busy).cycles(), 1);
  EXPECT_EQ(Timeline({}, first, first + Duration::days(10.0) + busy).cycles(), 2);
}

}  // namespace
}  // namespace astronav::executive
