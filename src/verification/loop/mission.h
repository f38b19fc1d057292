// SPDX-License-Identifier: Apache-2.0
// One mission: the truth flies, the onboard software navigates, and the records of both come back.
#pragma once

#include <cstdint>

#include "foundation/base/error.h"
#include "foundation/base/progress.h"
#include "verification/loop/records.h"
#include "verification/scenario/scenario.h"

namespace astronav::loop {

enum class Level : unsigned char {
  cov,  // covariance analysis: no images, no random numbers, the filter's bound
  mil,  // model in the loop: measurements without images
  sil,  // software in the loop: images rendered and processed
};

struct FlyOptions {
  Level level = Level::sil;
  std::uint64_t seed = 1;
  std::uint64_t sample = 0;
  int keep_frames = 4;    // pictures for the report
  int most_cycles = 0;    // the flight ends after so many; 0: at the mission's end
  bool smooth = false;    // Records::smoothed is filled; not at the level cov
  ProgressSink progress;  // may be empty
};

// Everything in the records follows from scenario, seed and sample: the same bits on the same build.
Result<Records> fly(const scenario::Scenario& scenario, const FlyOptions& options);

}  // namespace astronav::loop
