// SPDX-License-Identifier: Apache-2.0
// What the image processing does to a mission: errors of a planet's place that all images of a window share are what a
// filter ends with, so means over windows are held against the truth.
#include <cstdio>
#include <map>
#include <string>
#include <utility>

#include <gtest/gtest.h>

#include "verification/loop/mission.h"
#include "verification/scenario/scenario.h"

namespace astronav {
namespace {

// Mean error of the planet's place over each window, px, by cycle and window.
std::map<std::pair<int, int>, Vec2> window_means(const char* name, std::uint64_t seed, int cycles,
                                                 std::initializer_list<const char*> set = {}) {
  scenario::Draft draft = scenario::Draft::read(name).value();
  for (const char* assignment : set) EXPECT_TRUE(draft.set(assignment)) << assignment;
  loop::FlyOptions options;
  options.seed = seed;
  options.keep_frames = 0;
  options.most_cycles = cycles;
  const auto records = loop::fly(draft.resolve(seed).value(), options);
  EXPECT_TRUE(records) << describe(records.error());
  std::map<std::pair<int, int>, Vec2> means;
  if (!records) return means;
  std::map<std::pair<int, int>, int> counts;
  for (const loop::Event& e : records->events) {
    if (e.kind != loop::EventKind::image || !e.accepted) continue;
    const std::pair key(e.cycle, e.window);
    Vec2& mean = means.try_emplace(key, Vec2::Zero()).first->second;
    mean += (e.planet_error_px - mean) / ++counts[key];
  }
  return means;
}

// On the way to Venus the Earth is a disc of 1.1 px beside the Moon. Measured together, neither may teach the
// point-spread function as the point that it is not: the Earth was off by 0.0045 px and Venus, later, by 0.003, with
// 0.0006 told.
TEST(VisionMission, ADiscBesideItsMoonTeachesNothingWrong) {
  const auto means = window_means("earth-venus", 2, 9);
  ASSERT_EQ(means.size(), 18u);
  for (const auto& key : {std::pair(6, 0), std::pair(7, 0), std::pair(8, 0), std::pair(8, 1)}) {
    std::printf("  cycle %d, window %d: %.5f px\n", key.first, key.second, means.at(key).norm());
    EXPECT_LT(means.at(key).norm(), 0.0015);
  }
}

// Points, and told so: nothing is fitted as a disc.
TEST(VisionMission, PointsAreFittedAsPoints) {
  const auto means =
      window_means("earth-venus", 2, 9, {"truth.photocentre.on=false", "onboard.filter.photocentre=false"});
  ASSERT_EQ(means.size(), 18u);
  for (const auto& [key, mean] : means) EXPECT_LT(mean.norm(), 0.0015) << key.first << " " << key.second;
}

// A star of V 7.9, seven pixels from Venus for an hour, is not among those that name the sky, and too faint to stand
// out from Venus's wings: taken for a part of Venus's halo it moved Venus by 0.0013 px in that window and by 0.0015 in
// the next, with 0.0003 told.
TEST(VisionMission, AFaintStarInAPlanetsWingsIsNoHalo) {
  const auto means = window_means("earth-venus", 6, 4, {"onboard.vision.exposure=fixed"});
  ASSERT_EQ(means.size(), 8u);
  for (const int cycle : {2, 3}) {
    std::printf("  cycle %d: %.5f px\n", cycle, means.at({cycle, 0}).norm());
    EXPECT_LT(means.at({cycle, 0}).norm(), 0.0008);
  }
}

}  // namespace
}  // namespace astronav
