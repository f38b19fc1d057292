// SPDX-License-Identifier: Apache-2.0
// The acceleration that nobody models: one realisation of an Ornstein-Uhlenbeck process per axis
// (docs/theory/dynamics.md eq. 4).
#pragma once

#include <vector>

#include "foundation/base/error.h"
#include "foundation/math/linear.h"
#include "foundation/math/random.h"
#include "foundation/time/epoch.h"

namespace astronav::dynamics {

struct UnmodelledSettings {
  double sigma_m_s2 = 0.0;             // steady one sigma per axis; 0 = off
  Duration tau = Duration::days(5.0);  // correlation time
  // Spacing of the drawn values; between them the acceleration is linear, so that its variance half-way is lower by
  // (1 - exp(-grid/tau))/2: 2.4 % with the defaults.
  Duration grid = Duration::days(0.25);
};

// One realisation over [begin, end], the same for the same stream; a longer span begins with the same values. Zero
// outside the span.
class UnmodelledAcceleration {
 public:
  UnmodelledAcceleration() = default;  // none
  // invalid_argument: a negative or non-finite sigma, tau or grid not above zero, end before begin.
  static Result<UnmodelledAcceleration> draw(const UnmodelledSettings& settings, Epoch begin, Epoch end,
                                             RandomStream& stream);

  Vec3 at(Epoch epoch) const;
  bool active() const { return !values_.empty(); }
  // The next epoch after (forward) or before (backward) `epoch` at which the slope jumps; steps of integration end
  // there. `limit` where there is none before it.
  Epoch next_knot(Epoch epoch, Epoch limit) const;

 private:
  Epoch begin_;
  Duration grid_;
  std::vector<Vec3> values_;
};

}  // namespace astronav::dynamics
