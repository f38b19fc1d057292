// SPDX-License-Identifier: Apache-2.0
// Momentum unloading: thrusters that slow the reaction wheels also push the spacecraft.
//
// Each kick is a constant acceleration over a short time, so that the trajectory stays continuous.
#pragma once

#include <vector>

#include "foundation/base/error.h"
#include "foundation/math/linear.h"
#include "foundation/math/random.h"
#include "foundation/time/epoch.h"

namespace astronav::dynamics {

// As seen in the reconstructed arcs of Dawn and Parker.
struct KickSettings {
  double smallest_m_s = 2e-3;  // size: uniform between these, in a random direction
  double largest_m_s = 13e-3;
  Duration shortest_pause = Duration::days(1.0);  // from kick to kick: uniform between these
  Duration longest_pause = Duration::days(5.0);
  Duration length = Duration::seconds(60.0);
};

struct Kick {
  Epoch begin;
  Vec3 delta_v_N_m_s = Vec3::Zero();
};

class Kicks {
 public:
  Kicks() = default;  // none
  // The first kick comes as if the last one before `begin` had been at a random time; a longer span begins with the
  // same kicks. invalid_argument: sizes or pauses that are below zero, out of order, or pauses not longer than a kick.
  static Result<Kicks> draw(const KickSettings& settings, Epoch begin, Epoch end, RandomStream& stream);
  // invalid_argument: not ascending, or nearer to one another than their length.
  static Result<Kicks> at_times(std::vector<Kick> kicks, Duration length = Duration::seconds(60.0));

  Vec3 acceleration_N_m_s2(Epoch epoch) const;
  const std::vector<Kick>& list() const { return kicks_; }
  Duration length() const { return length_; }
  // The next epoch on the way from `epoch` to `limit` at which the acceleration jumps; `limit` where there is none.
  Epoch next_knot(Epoch epoch, Epoch limit) const;

 private:
  std::vector<Kick> kicks_;
  Duration length_;
  std::vector<Epoch> knots_;
};

// The next of ascending `knots` on the way from `epoch` to `limit`, in either direction of time; `limit` if none.
Epoch next_of(const std::vector<Epoch>& knots, Epoch epoch, Epoch limit);

}  // namespace astronav::dynamics
