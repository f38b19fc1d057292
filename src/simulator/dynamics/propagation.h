// SPDX-License-Identifier: Apache-2.0
// Adaptive integration of a trajectory (Boost.Odeint's Runge-Kutta-Fehlberg 7(8)) with continuous output.
//
// A step is accepted when its embedded error estimate and the error of the interpolation across it, which shows as the
// difference between the force and the interpolated acceleration half-way, are both below the tolerances: what
// Arc::at() returns is as good as the nodes (docs/theory/dynamics.md, "Accuracy").
#pragma once

#include <functional>
#include <vector>

#include "foundation/base/error.h"
#include "foundation/math/linear.h"
#include "foundation/time/epoch.h"
#include "simulator/dynamics/forces.h"

namespace astronav::dynamics {

struct PropagationSettings {
  double position_tolerance_m = 1e-3;     // of one step, and of the interpolation; doubles carry no less than 1e-4
  double velocity_tolerance_m_s = 1e-10;  // of one step
  Duration max_step = Duration::days(1.0);
  Duration min_step = Duration::seconds(1e-3);
};

// A trajectory as integrated. Between nodes: the quintic with position, velocity and acceleration of both neighbours.
// Where a force jumps there are two nodes of one epoch, which differ in their accelerations.
class Arc {
 public:
  struct Node {
    Epoch epoch;
    State state;
    Vec3 acceleration_m_s2 = Vec3::Zero();
  };
  explicit Arc(std::vector<Node> nodes);  // at least one, ascending; of one epoch at most two

  Epoch begin() const { return nodes_.front().epoch; }
  Epoch end() const { return nodes_.back().epoch; }
  // out_of_range outside [begin, end]. Safe from several threads.
  Result<State> at(Epoch epoch) const;
  const std::vector<Node>& nodes() const { return nodes_; }

 private:
  std::vector<Node> nodes_;
};

using AccelerationField = std::function<Result<Vec3>(Epoch, const State&)>;

// From `start` at `from` to `to`, forwards or backwards in time. not_converged where the step falls below min_step (a
// fall into a point mass), invalid_argument for a non-finite start; errors of the field are handed on.
Result<Arc> propagate(const ForceModel& forces, const State& start, Epoch from, Epoch to,
                      const PropagationSettings& settings = {});
Result<Arc> propagate(const AccelerationField& field, const State& start, Epoch from, Epoch to,
                      const PropagationSettings& settings = {});

}  // namespace astronav::dynamics
