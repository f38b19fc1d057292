// SPDX-License-Identifier: Apache-2.0
#include "onboard/executive/timeline.h"

#include "foundation/base/check.h"

namespace astronav::executive {

Timeline::Timeline(const CycleSettings& settings, Epoch first, Epoch end) : settings_(settings), first_(first) {
  const Duration busy = settings.tracking * 2 + settings.slew;
  ASTRONAV_CHECK(settings.images_per_window() > 0);
  ASTRONAV_CHECK(settings.cycle >= busy);
  const Duration span = end - first;
  if (span >= busy) cycles_ = static_cast<int>((span - busy).nanoseconds() / settings.cycle.nanoseconds()) + 1;
}

Epoch Timeline::window_begin(int cycle, int window) const {
  return first_ + settings_.cycle * cycle + (settings_.tracking + settings_.slew) * window;
}

Epoch Timeline::window_end(int cycle, int window) const {
  return window_begin(cycle, window) + settings_.tracking;
}

Epoch Timeline::image_epoch(int cycle, int window, int k) const {
  return window_begin(cycle, window) + settings_.image_period * k +
         Duration::nanoseconds(settings_.image_period.nanoseconds() / 2);
}

}  // namespace astronav::executive
