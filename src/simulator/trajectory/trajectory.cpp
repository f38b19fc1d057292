// SPDX-License-Identifier: Apache-2.0
#include "simulator/trajectory/trajectory.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <optional>
#include <utility>
#include <vector>

#include <fmt/format.h>

namespace astronav::trajectory {
namespace {

tl::unexpected<Error> not_covered(Epoch epoch, Epoch begin, Epoch end) {
  return fail(ErrorCode::out_of_range, "the trajectory does not cover {s}", {}, {},
              fmt::format("{}; it runs from {} to {}", epoch.iso(), begin.iso(), end.iso()));
}

class ArcTrajectory final : public Trajectory {
 public:
  explicit ArcTrajectory(dynamics::Arc arc) : arc_(std::move(arc)) {}
  Result<State> state(Epoch epoch) const override { return arc_.at(epoch); }
  Epoch begin() const override { return arc_.begin(); }
  Epoch end() const override { return arc_.end(); }

 private:
  dynamics::Arc arc_;
};

class EphemerisTrajectory final : public Trajectory {
 public:
  EphemerisTrajectory(Ephemeris ephemeris, BodyId target, Epoch begin, Epoch end)
      : ephemeris_(std::move(ephemeris)), target_(target), begin_(begin), end_(end) {}
  Result<State> state(Epoch epoch) const override {
    if (epoch < begin_ || epoch > end_) return not_covered(epoch, begin_, end_);
    return ephemeris_.state(target_, body::solar_system_barycenter, epoch);
  }
  Epoch begin() const override { return begin_; }
  Epoch end() const override { return end_; }

 private:
  Ephemeris ephemeris_;
  BodyId target_;
  Epoch begin_, end_;
};

// Polynomial of lowest degree through position and velocity of `count` nodes (Newton's form on nodes taken twice),
// and its derivative.
constexpr std::size_t kWindow = 4;
State hermite(const Epoch* epochs, const State* states, std::size_t count, Epoch at) {
  std::array<double, 2 * kWindow> t{};
  std::array<Vec3, 2 * kWindow> c;
  const std::size_t n = 2 * count;
  for (std::size_t i = 0; i < n; ++i) {
    t[i] = (epochs[i / 2] - epochs[0]).seconds();
    c[i] = states[i / 2].p_m;
  }
  for (std::size_t order = 1; order < n; ++order) {
    for (std::size_t i = n - 1; i >= order; --i) {
      const bool same_node = order == 1 && i % 2 == 1;
      c[i] = same_node ? states[i / 2].v_m_s : Vec3((c[i] - c[i - 1]) / (t[i] - t[i - order]));
    }
  }
  const double x = (at - epochs[0]).seconds();
  State s{c[n - 1], Vec3::Zero()};
  for (std::size_t i = n - 1; i-- > 0;) {
    s.v_m_s = s.p_m + (x - t[i]) * s.v_m_s;
    s.p_m = c[i] + (x - t[i]) * s.p_m;
  }
  return s;
}

class OemTrajectory final : public Trajectory {
 public:
  OemTrajectory(const Oem& oem, std::optional<Ephemeris> ephemeris)
      : epochs_(oem.epochs), states_(oem.states), center_(oem.center), ephemeris_(std::move(ephemeris)) {
    begin_ = std::max(epochs_.front(), oem.useable_begin.value_or(epochs_.front()));
    end_ = std::min(epochs_.back(), oem.useable_end.value_or(epochs_.back()));
  }
  Result<State> state(Epoch epoch) const override {
    if (epoch < begin_ || epoch > end_) return not_covered(epoch, begin_, end_);
    const auto next = std::upper_bound(epochs_.begin(), epochs_.end(), epoch);
    const std::size_t before = static_cast<std::size_t>(next - epochs_.begin()) - 1;
    State s = states_[before];
    if (epochs_[before] != epoch) {
      const std::size_t count = std::min(kWindow, epochs_.size());
      const std::size_t first = std::min(before >= 1 ? before - 1 : 0, epochs_.size() - count);
      s = hermite(&epochs_[first], &states_[first], count, epoch);
    }
    if (!ephemeris_) return s;
    const auto center_O = ephemeris_->state(center_, body::solar_system_barycenter, epoch);
    if (!center_O) return forward(center_O);
    return State{s.p_m + center_O->p_m, s.v_m_s + center_O->v_m_s};
  }
  Epoch begin() const override { return begin_; }
  Epoch end() const override { return end_; }

 private:
  std::vector<Epoch> epochs_;
  std::vector<State> states_;
  BodyId center_;
  std::optional<Ephemeris> ephemeris_;  // only where the centre is not the barycentre
  Epoch begin_, end_;
};

struct Span {
  double begin_s = std::numeric_limits<double>::infinity();
  double end_s = -std::numeric_limits<double>::infinity();
  bool empty() const { return begin_s > end_s; }
};

// Outermost limits within which a body can be followed to the barycentre. A kernel that goes in circles gives nothing.
Span coverage(const Ephemeris& ephemeris, BodyId target, int depth = 0) {
  constexpr int kLongestChain = 16;
  const double infinity = std::numeric_limits<double>::infinity();
  if (target == body::solar_system_barycenter) return {-infinity, infinity};
  Span span;
  if (depth == kLongestChain) return span;
  for (const Ephemeris::Segment& s : ephemeris.segments()) {
    if (s.target != target) continue;
    const Span center = coverage(ephemeris, s.center, depth + 1);
    const Span both{std::max(s.begin_tdb_s, center.begin_s), std::min(s.end_tdb_s, center.end_s)};
    if (both.empty()) continue;
    span.begin_s = std::min(span.begin_s, both.begin_s);
    span.end_s = std::max(span.end_s, both.end_s);
  }
  return span;
}

}  // namespace

Result<TrajectoryPtr> from_ephemeris(const Ephemeris& ephemeris, BodyId target) {
  auto resolved = ephemeris.resolve(target);
  if (!resolved) return forward(resolved);
  // Epochs are 292 years about J2000.
  constexpr double kLimit_s = 9.2e9;
  const Span span = coverage(ephemeris, *resolved);
  const double begin_s = std::max(span.begin_s, -kLimit_s);
  const double end_s = std::min(span.end_s, kLimit_s);
  if (begin_s > end_s) {
    return fail(ErrorCode::not_found, "body {0} cannot be followed to the solar-system barycentre in these kernels",
                {static_cast<double>(target.value)});
  }
  // Rounded inwards, so that both ends are covered.
  Epoch begin = Epoch::tdb_seconds(begin_s);
  Epoch end = Epoch::tdb_seconds(end_s);
  if (begin.tdb_seconds() < begin_s) begin = begin + Duration::nanoseconds(1);
  if (end.tdb_seconds() > end_s) end = end - Duration::nanoseconds(1);
  return std::make_shared<EphemerisTrajectory>(ephemeris, *resolved, begin, end);
}

Result<TrajectoryPtr> from_oem(const Oem& oem, const Ephemeris* ephemeris) {
  if (oem.states.size() < 2 || oem.states.size() != oem.epochs.size()) {
    return fail(ErrorCode::invalid_argument, "a trajectory needs at least two states; the message has {0}",
                {static_cast<double>(oem.states.size())});
  }
  if (oem.center == body::solar_system_barycenter) return std::make_shared<OemTrajectory>(oem, std::nullopt);
  if (ephemeris == nullptr) {
    return fail(ErrorCode::invalid_argument,
                "the message is about body {0}; an ephemeris is needed to refer it to the barycentre",
                {static_cast<double>(oem.center.value)});
  }
  auto center = ephemeris->resolve(oem.center);
  if (!center) return forward(center);
  return std::make_shared<OemTrajectory>(oem, *ephemeris);
}

TrajectoryPtr from_arc(dynamics::Arc arc) {
  return std::make_shared<ArcTrajectory>(std::move(arc));
}

Result<Oem> to_oem(const Trajectory& trajectory, Epoch begin, Epoch end, Duration step) {
  constexpr std::int64_t kMost = 10'000'000;
  if (end < begin)
    return fail(ErrorCode::invalid_argument, "the end lies {0} d before the begin", {(begin - end).days()});
  if (step <= Duration{} || (end - begin).nanoseconds() / step.nanoseconds() > kMost) {
    return fail(ErrorCode::invalid_argument, "cannot take states over {0} s in steps of {1} s (at most {2} of them)",
                {(end - begin).seconds(), step.seconds(), static_cast<double>(kMost)});
  }
  Oem oem;
  for (Epoch e = begin; e < end; e = e + step) oem.epochs.push_back(e);
  oem.epochs.push_back(end);
  oem.states.reserve(oem.epochs.size());
  for (const Epoch e : oem.epochs) {
    auto s = trajectory.state(e);
    if (!s) return forward(s);
    oem.states.push_back(*s);
  }
  return oem;
}

}  // namespace astronav::trajectory
