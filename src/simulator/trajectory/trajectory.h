// SPDX-License-Identifier: Apache-2.0
// Trajectory: where the spacecraft is, whatever the source.
#pragma once

#include <memory>

#include "foundation/base/error.h"
#include "foundation/time/epoch.h"
#include "models/ephemeris/ephemeris.h"
#include "models/oem/oem.h"
#include "simulator/dynamics/propagation.h"

namespace astronav::trajectory {

class Trajectory {
 public:
  virtual ~Trajectory() = default;
  // Barycentric state (O, ICRF axes N). out_of_range names the span covered. Safe to call from several threads.
  virtual Result<State> state(Epoch epoch) const = 0;
  virtual Epoch begin() const = 0;
  virtual Epoch end() const = 0;
};

using TrajectoryPtr = std::shared_ptr<const Trajectory>;

// A body of the ephemeris: the spacecraft of a kernel, or a planet. The kernels' bytes must outlive the trajectory, the
// Ephemeris object need not. not_found where the body, or a centre on its way to the barycentre, has no segment. The
// span is that of the outermost segments: gaps between them show as errors of state().
Result<TrajectoryPtr> from_ephemeris(const Ephemeris& ephemeris, BodyId target);

// Interpolated between the message's states: Hermite polynomials of degree 7 through position and velocity of the four
// nearest nodes (fewer near the ends of messages with fewer than four). A centre other than the barycentre needs the
// ephemeris (may be null otherwise). invalid_argument for fewer than two states.
Result<TrajectoryPtr> from_oem(const Oem& oem, const Ephemeris* ephemeris);

// As integrated, with its own interpolation.
TrajectoryPtr from_arc(dynamics::Arc arc);

// States every `step` from begin to end (the end included) as a message about the barycentre.
Result<Oem> to_oem(const Trajectory& trajectory, Epoch begin, Epoch end, Duration step);

}  // namespace astronav::trajectory
