// SPDX-License-Identifier: Apache-2.0
// Ephemeris: states of bodies from SPK kernels that somebody else holds in memory.
//
// DAF container and SPK segments after NAIF's "DAF Required Reading" and "SPK Required Reading"; types 2 and 3
// (Chebyshev), both byte orders. Centres are chained through the NAIF numbers (399 -> 3 -> 0). Where a planet's centre is
// not in any kernel, its barycentre stands in; resolve() says so. Kernels named later take precedence, as in SPICE.
#pragma once

#include <cstddef>
#include <span>
#include <string_view>
#include <vector>

#include "foundation/base/error.h"
#include "foundation/math/linear.h"
#include "foundation/time/epoch.h"
#include "models/ephemeris/bodies.h"

namespace astronav {

// ICRF axes (N), metres and metres per second.
struct State {
  Vec3 p_m = Vec3::Zero();
  Vec3 v_m_s = Vec3::Zero();
};

class Ephemeris {
 public:
  struct Segment {
    BodyId target;
    BodyId center;
    int type = 0;
    double begin_tdb_s = 0.0;  // seconds past J2000 TDB
    double end_tdb_s = 0.0;
    int kernel = 0;            // index into the kernels given to open()
    std::size_t first_byte = 0;
    std::size_t last_byte = 0;
    // Parsed once from the directory at the segment's end (types 2 and 3).
    double init_s = 0.0, interval_s = 0.0;
    int record_doubles = 0, record_count = 0;
    bool swap_bytes = false;
  };

  // Checks every count and address before use; refuses a broken kernel with the byte offset. The bytes must outlive the
  // object. Allocates here and never again.
  static Result<Ephemeris> open(std::span<const std::span<const std::byte>> kernels);
  static Result<Ephemeris> open(std::span<const std::byte> kernel);

  // State of `target` relative to `center` at an epoch, no light time. not_found (names the body), out_of_range (names
  // the span covered). Does not allocate.
  Result<State> state(BodyId target, BodyId center, Epoch epoch) const;
  // The body whose states are used where `id` is asked for: itself, or the barycentre standing in.
  Result<BodyId> resolve(BodyId id) const;

  std::span<const Segment> segments() const { return segments_; }

 private:
  std::vector<Segment> segments_;
  std::vector<std::span<const std::byte>> kernels_;
};

// Light time. The exact solution of |p_target(t - tau) - p_observer(t)| = c tau by iteration.
struct LightTime {
  State relative;             // target at t - tau minus observer at t; velocity of the target at t - tau minus the
                              // observer's, times the rate of retarded time as in SPICE where asked for
  double light_time_s = 0.0;
};
// `iterations` < 0: to convergence (1e-12 s); 1: SPICE's "LT". The observer's state is barycentric.
Result<LightTime> light_time(const Ephemeris& ephemeris, BodyId target, const State& observer_O, Epoch epoch,
                             int iterations = -1);

}  // namespace astronav
