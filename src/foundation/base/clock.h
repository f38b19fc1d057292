// SPDX-License-Identifier: Apache-2.0
// The machine's clock, for telling how long work took. Results never depend on it.
#pragma once

#include <chrono>

namespace astronav {

// Milliseconds since some moment in the past, never backwards.
inline double now_ms() {
  return std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

}  // namespace astronav
