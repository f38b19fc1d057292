// SPDX-License-Identifier: Apache-2.0
// Timeline: the navigation cycle of the paper: track one planet, slew, track another, coast until the next cycle.
#pragma once

#include "foundation/time/epoch.h"

namespace astronav::executive {

struct CycleSettings {
  Duration tracking = Duration::seconds(3600.0);  // of one window
  Duration image_period = Duration::seconds(100.0);
  Duration slew = Duration::seconds(1500.0);  // no images, the filter only propagates
  Duration cycle = Duration::days(10.0);      // from start to start
  int images_per_window() const { return static_cast<int>(tracking.nanoseconds() / image_period.nanoseconds()); }
};

class Timeline {
 public:
  // The first window opens at `first`; nothing is planned that would not be complete at `end`.
  Timeline(const CycleSettings& settings, Epoch first, Epoch end);

  int cycles() const { return cycles_; }
  int images_per_window() const { return settings_.images_per_window(); }
  Epoch window_begin(int cycle, int window) const;  // window 0 or 1
  Epoch window_end(int cycle, int window) const;
  // Mid-exposure of image k of a window: in the middle of its period.
  Epoch image_epoch(int cycle, int window, int k) const;
  // Where the long propagation after a cycle ends: the start of the next one.
  Epoch coast_end(int cycle) const { return window_begin(cycle + 1, 0); }

 private:
  CycleSettings settings_;
  Epoch first_;
  int cycles_ = 0;
};

}  // namespace astronav::executive
