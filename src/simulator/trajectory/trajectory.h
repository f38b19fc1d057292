// SPDX-License-Identifier: Apache-2.0
// Trajectory: where the spacecraft is, whatever the source.
#pragma once

#include <memory>

#include "foundation/base/error.h"
#include "foundation/time/epoch.h"
#include "models/ephemeris/ephemeris.h"

namespace astronav::trajectory {

class Trajectory {
 public:
  virtual ~Trajectory() = default;
  // Barycentric state (O, ICRF axes N). out_of_range names the span covered. Safe to call from several threads.
  virtual Result<State> state(Epoch epoch) const = 0;
  virtual Epoch begin() const = 0;
  virtual Epoch end() const = 0;
};

}  // namespace astronav::trajectory
