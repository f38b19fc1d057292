// SPDX-License-Identifier: Apache-2.0
// Records of a mission that never flew: a Kalman filter of nine states (position, velocity, a Gauss-Markov
// acceleration) on an orbit about the Sun, with angular measurements of two beacons. Its errors obey its own covariance
// exactly, so that statistics, files and report can be tested without cameras and planets.
#pragma once

#include <cstdint>

#include "verification/loop/records.h"

namespace astronav::testing {

struct SyntheticOptions {
  std::uint64_t seed = 1;
  int cycles = 30;
  int images_per_window = 36;
  int frames = 0;                  // pictures with stars and marks
  double truth_over_filter = 1.0;  // above 1: the filter is overconfident by this factor (noise and initial error)
};
loop::Records synthetic_records(const SyntheticOptions& options = {});

}  // namespace astronav::testing
