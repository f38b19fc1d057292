// SPDX-License-Identifier: Apache-2.0
// Ephemeris: states of bodies from SPK kernels that somebody else holds in memory.
//
// DAF container and SPK segments after NAIF's "DAF Required Reading" and "SPK Required Reading", in both byte orders:
// types 1 and 21 (difference lines), 2, 3 and 20 (Chebyshev), 5 (conics between states), 8, 9, 12, 13, 18 and 19
// (interpolated states), 15 (precessing conic) and 17 (equinoctial elements). Centres are chained through the NAIF
// numbers (399 -> 3 -> 0). Where a planet's centre is not in any kernel, its barycentre stands in; resolve() says so.
// Kernels named later take precedence, and within a kernel the later segment, as in SPICE. Asteroids are found under
// both numbers that are in use (other_number()). Segments of other types, or of other frames than J2000 and ECLIPJ2000,
// do not hinder opening; asking for them does fail.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
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
    int frame = 1;             // 1 is J2000, which stands for ICRF axes
    double begin_tdb_s = 0.0;  // seconds past J2000 TDB
    double end_tdb_s = 0.0;
    int kernel = 0;  // index into the kernels given to open()
    std::size_t first_byte = 0;
    std::size_t last_byte = 0;
    // Parsed once from the directory at the segment's end, as far as the type has them: first epoch and step of records
    // at equal intervals, size and number of records, states that one interpolation takes.
    double init_s = 0.0, interval_s = 0.0;
    int record_doubles = 0, record_count = 0, window = 0;
    bool swap_bytes = false;
  };
  struct Span {
    Epoch begin;
    Epoch end;
  };
  // That a planet, with all that goes round it, stands elsewhere: along its orbit and across the orbit's plane (towards
  // its pole), turning with it. `system`: its barycentre, which must hang on the solar system's.
  struct Displacement {
    BodyId system;
    double along_m = 0.0, across_m = 0.0;
  };

  // Checks every count and address before use; refuses a broken kernel with the byte offset (`kernel 0` or the place in
  // the list is named where there are several). The bytes must outlive the object. Allocates here and never again.
  static Result<Ephemeris> open(std::span<const std::span<const std::byte>> kernels);
  static Result<Ephemeris> open(std::span<const std::byte> kernel);

  // State of `target` relative to `center` at an epoch, no light time. not_found (names the body), out_of_range (names
  // the span covered), unsupported (names the SPK type), corrupt_data (byte offset). Does not allocate; safe to call
  // from several threads.
  Result<State> state(BodyId target, BodyId center, Epoch epoch) const;
  // The same kernels, the planets moved. Of several of one system the last counts.
  Ephemeris displaced(std::vector<Displacement> displacements) const;
  // The body whose states are used where `id` is asked for: itself, or the barycentre standing in.
  Result<BodyId> resolve(BodyId id) const;
  // From the first to the last moment for which some segment holds the body (gaps between segments are not looked for).
  Result<Span> span(BodyId id) const;

  std::span<const Segment> segments() const { return segments_; }

 private:
  struct Bodies {  // segments of one target in by_target_, the one that takes precedence first
    std::int32_t target = 0;
    std::uint32_t first = 0;
    std::uint32_t count = 0;
  };
  // How a body hangs on another: its number, and the segment that leads on to its centre (none at the end).
  static constexpr int kMaxDepth = 16;
  struct Link {
    std::int32_t body = 0;
    const Segment* segment = nullptr;
  };
  struct Chain {
    std::array<Link, kMaxDepth> links;
    int size = 0;
  };

  const Bodies* find(std::int32_t target) const;
  Result<const Segment*> choose(const Bodies& bodies, Epoch epoch) const;
  Result<Chain> chain(BodyId from, Epoch epoch) const;
  Result<void> add(const Segment& segment, const Epoch& epoch, double sign, State& sum) const;

  std::vector<Segment> segments_;  // in the order of the files
  std::vector<std::uint32_t> by_target_;
  std::vector<Bodies> bodies_;  // sorted by target
  std::vector<std::int32_t> centers_;
  std::vector<std::span<const std::byte>> kernels_;
  std::vector<Displacement> displacements_;
};

// Light time: the solution of |p_target(t - tau) - p_observer(t)| = c tau by iteration.
// docs/theory/light-time-and-aberration.md eq. 1 and 2.
struct LightTime {
  // Target at t - tau minus observer at t, and the rate of that difference by t: the target's velocity counts
  // (1 - d tau/dt) times. The same convention as SPICE's.
  State relative;
  double light_time_s = 0.0;
};
// `iterations` < 0: to convergence (the last step below 1e-12 s or the resolution of Epoch); 0: geometric, with
// light_time_s = distance / c; 1: SPICE's "LT". The observer's state is barycentric (O, N). Does not allocate.
Result<LightTime> light_time(const Ephemeris& ephemeris, BodyId target, const State& observer_O, Epoch epoch,
                             int iterations = -1);

}  // namespace astronav
