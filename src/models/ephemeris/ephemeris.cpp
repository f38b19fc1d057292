// SPDX-License-Identifier: Apache-2.0
#include "models/ephemeris/ephemeris.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <limits>
#include <numeric>

#include "models/ephemeris/daf.h"
#include "models/ephemeris/ecliptic.h"
#include "models/ephemeris/spk_segment.h"

namespace astronav {
namespace {

constexpr int kFrameJ2000 = 1;
constexpr int kFrameEcliptic = 17;     // ecliptic and equinox of J2000, obliquity of IAU 1976
constexpr double kEpochLimit = 9.2e9;  // s; an Epoch holds a little more

Vec3 from_ecliptic(const Vec3& v) {
  static const double c = std::cos(kObliquityJ2000), s = std::sin(kObliquityJ2000);
  return {v.x(), c * v.y() - s * v.z(), s * v.y() + c * v.z()};
}

// Text on the stack, cut where it is full: errors must not allocate either.
class Sentence {
 public:
  template <typename... Args>
  void add(const char* format, Args... args) {
    const int n = std::snprintf(text_ + used_, sizeof text_ - used_, format, args...);
    if (n > 0) used_ = std::min(used_ + static_cast<std::size_t>(n), sizeof text_ - 1);
  }
  void add_body(BodyId id) {
    const std::string_view known = body_name(id);
    if (known.empty())
      add("body %d", static_cast<int>(id.value));
    else
      add("%.*s (%d)", static_cast<int>(known.size()), known.data(), static_cast<int>(id.value));
  }
  void add_time(double tdb_s) {
    using namespace std::chrono;
    if (!(std::abs(tdb_s) < kEpochLimit)) return add("%.4g s past J2000", tdb_s);
    const auto since_midnight = static_cast<std::int64_t>(std::floor(tdb_s)) + 43200;
    const auto day = floor<days>(seconds(since_midnight));
    const year_month_day date(sys_days(year(2000) / January / 1) + day);
    const hh_mm_ss time(seconds(since_midnight) - day);
    add("%04d-%02u-%02uT%02d:%02d:%02d", static_cast<int>(date.year()), static_cast<unsigned>(date.month()),
        static_cast<unsigned>(date.day()), static_cast<int>(time.hours().count()),
        static_cast<int>(time.minutes().count()), static_cast<int>(time.seconds().count()));
  }
  std::string_view view() const { return {text_, used_}; }

 private:
  char text_[200] = {};
  std::size_t used_ = 0;
};

}  // namespace

Result<Ephemeris> Ephemeris::open(std::span<const std::byte> kernel) {
  return open(std::span(&kernel, 1));
}

Result<Ephemeris> Ephemeris::open(std::span<const std::span<const std::byte>> kernels) {
  Ephemeris out;
  out.kernels_.assign(kernels.begin(), kernels.end());
  for (std::size_t i = 0; i < kernels.size(); ++i) {
    const auto read = daf::read_segments(kernels[i], static_cast<int>(i), out.segments_);
    if (read) continue;
    Sentence place;
    place.add("kernel %zu", i);
    return kernels.size() > 1 ? forward(read, place.view()) : forward(read);
  }
  out.by_target_.resize(out.segments_.size());
  std::iota(out.by_target_.begin(), out.by_target_.end(), 0U);
  std::sort(out.by_target_.begin(), out.by_target_.end(), [&](std::uint32_t a, std::uint32_t b) {
    const auto ta = out.segments_[a].target, tb = out.segments_[b].target;
    return ta != tb ? ta < tb : a > b;
  });
  for (std::uint32_t i = 0; i < out.by_target_.size(); ++i) {
    const Segment& segment = out.segments_[out.by_target_[i]];
    if (out.bodies_.empty() || out.bodies_.back().target != segment.target.value)
      out.bodies_.push_back({segment.target.value, i, 0});
    ++out.bodies_.back().count;
    out.centers_.push_back(segment.center.value);
  }
  std::sort(out.centers_.begin(), out.centers_.end());
  out.centers_.erase(std::unique(out.centers_.begin(), out.centers_.end()), out.centers_.end());
  return out;
}

const Ephemeris::Bodies* Ephemeris::find(std::int32_t target) const {
  const auto at = std::lower_bound(bodies_.begin(), bodies_.end(), target,
                                   [](const Bodies& bodies, std::int32_t id) { return bodies.target < id; });
  return at != bodies_.end() && at->target == target ? &*at : nullptr;
}

Result<BodyId> Ephemeris::resolve(BodyId id) const {
  const auto held = [&](BodyId b) {
    return find(b.value) != nullptr || std::binary_search(centers_.begin(), centers_.end(), b.value);
  };
  // A planet that is nothing but the centre of its moons' segments is where its barycentre is.
  const auto stand_in = barycenter_of(id);
  if (find(id.value) == nullptr && stand_in && find(stand_in->value) != nullptr) return *stand_in;
  if (held(id)) return id;
  if (stand_in && held(*stand_in)) return *stand_in;
  const auto other = other_number(id);
  if (other && held(*other)) return *other;
  Sentence who;
  who.add_body(id);
  return fail(ErrorCode::not_found, "no kernel holds {s}", {}, {}, who.view());
}

Result<Ephemeris::Span> Ephemeris::span(BodyId id) const {
  const auto used = resolve(id);
  if (!used) return forward(used);
  double begin = kEpochLimit, end = -kEpochLimit;
  if (const Bodies* const bodies = find(used->value)) {
    for (std::uint32_t i = 0; i < bodies->count; ++i) {
      const Segment& segment = segments_[by_target_[bodies->first + i]];
      begin = std::min(begin, segment.begin_tdb_s);
      end = std::max(end, segment.end_tdb_s);
    }
  } else {
    std::swap(begin, end);  // a root is always there
  }
  return Span{Epoch::tdb_seconds(std::clamp(begin, -kEpochLimit, kEpochLimit)),
              Epoch::tdb_seconds(std::clamp(end, -kEpochLimit, kEpochLimit))};
}

Result<const Ephemeris::Segment*> Ephemeris::choose(const Bodies& bodies, Epoch epoch) const {
  const double t = epoch.tdb_seconds();
  double begin = std::numeric_limits<double>::infinity(), end = -begin;
  for (std::uint32_t i = 0; i < bodies.count; ++i) {
    const Segment& segment = segments_[by_target_[bodies.first + i]];
    if (t >= segment.begin_tdb_s && t <= segment.end_tdb_s) return &segment;
    begin = std::min(begin, segment.begin_tdb_s);
    end = std::max(end, segment.end_tdb_s);
  }
  const bool gap = t >= begin && t <= end;
  Sentence what;
  what.add_body(BodyId{bodies.target});
  what.add("%s", gap ? " has a gap between " : " is known from ");
  what.add_time(begin);
  what.add("%s", gap ? " and " : " to ");
  what.add_time(end);
  what.add(" TDB, not at ");
  what.add_time(t);
  return fail(ErrorCode::out_of_range, "the kernels do not reach: {s}", {}, {}, what.view());
}

Result<Ephemeris::Chain> Ephemeris::chain(BodyId from, Epoch epoch) const {
  Chain out;
  std::int32_t body = from.value;
  while (out.size < kMaxDepth) {
    const Bodies* const bodies = find(body);
    Link& link = out.links[static_cast<std::size_t>(out.size++)];
    link.body = body;
    if (bodies == nullptr) {
      const auto stand_in = barycenter_of(BodyId{body});
      if (!stand_in || find(stand_in->value) == nullptr) return out;
      --out.size;
      body = stand_in->value;
      continue;
    }
    const auto segment = choose(*bodies, epoch);
    if (!segment) return out;  // perhaps nobody asks for what lies beyond
    link.segment = *segment;
    body = (*segment)->center.value;
  }
  return fail(ErrorCode::corrupt_data, "the centres of body {0} form a circle, or a chain of more than 16",
              {static_cast<double>(from.value), 0, 0, 0});
}

namespace {

// The orbit about the barycentre, whose distance from the Sun is 1 % of one au at most: so are the axes turned.
void displace(const Ephemeris::Displacement& d, State& planet) {
  const Vec3 momentum = planet.p_m.cross(planet.v_m_s);
  const Vec3 pole = momentum.normalized();
  const Vec3 moved = d.along_m * pole.cross(planet.p_m).normalized() + d.across_m * pole;
  planet.p_m += moved;
  planet.v_m_s += (momentum / planet.p_m.squaredNorm()).cross(moved);
}

}  // namespace

Ephemeris Ephemeris::displaced(std::vector<Displacement> displacements) const {
  Ephemeris out = *this;
  for (const Displacement& d : displacements) {
    std::erase_if(out.displacements_, [&](const Displacement& other) { return other.system == d.system; });
    out.displacements_.push_back(d);
  }
  return out;
}

Result<void> Ephemeris::add(const Segment& segment, const Epoch& epoch, double sign, State& sum) const {
  if (segment.frame != kFrameJ2000 && segment.frame != kFrameEcliptic)
    return fail(ErrorCode::unsupported,
                "SPK frame {0} (body {1}, segment at byte {2}): 1 (J2000) and 17 (ECLIPJ2000) are read",
                {static_cast<double>(segment.frame), static_cast<double>(segment.target.value),
                 static_cast<double>(segment.first_byte), 0});
  State part;
  const auto evaluated = spk::evaluate(kernels_[static_cast<std::size_t>(segment.kernel)], segment, epoch, part);
  if (!evaluated) return evaluated;
  if (segment.frame == kFrameEcliptic) {
    part.p_m = from_ecliptic(part.p_m);
    part.v_m_s = from_ecliptic(part.v_m_s);
  }
  for (const Displacement& d : displacements_)
    if (segment.target == d.system && segment.center == body::solar_system_barycenter) displace(d, part);
  sum.p_m += sign * part.p_m;
  sum.v_m_s += sign * part.v_m_s;
  // One comparison for six numbers: a NaN or an infinity survives sums.
  const double all = sum.p_m.squaredNorm() + sum.v_m_s.squaredNorm();
  if (!(all < std::numeric_limits<double>::infinity()))
    return daf::corrupt("byte {0}: the segment gives no finite place", segment.first_byte);
  return {};
}

Result<State> Ephemeris::state(BodyId target, BodyId center, Epoch epoch) const {
  const auto from = resolve(target);
  if (!from) return forward(from);
  const auto to = resolve(center);
  if (!to) return forward(to);
  State sum;
  if (*from == *to) return sum;
  const auto down = chain(*to, epoch);
  if (!down) return forward(down);
  const auto up = chain(*from, epoch);
  if (!up) return forward(up);

  // The first body that both chains pass: what lies beyond it would cancel.
  for (int i = 0; i < up->size; ++i) {
    for (int j = 0; j < down->size; ++j) {
      if (up->links[static_cast<std::size_t>(i)].body != down->links[static_cast<std::size_t>(j)].body) continue;
      for (int k = 0; k < i; ++k) {
        const auto added = add(*up->links[static_cast<std::size_t>(k)].segment, epoch, 1.0, sum);
        if (!added) return forward(added);
      }
      for (int k = 0; k < j; ++k) {
        const auto added = add(*down->links[static_cast<std::size_t>(k)].segment, epoch, -1.0, sum);
        if (!added) return forward(added);
      }
      return sum;
    }
  }
  // Not connected at all, or a chain stopped early since no segment covers the time: that error says which body.
  for (const Chain* const c : {&*up, &*down}) {
    const Bodies* const last = find(c->links[static_cast<std::size_t>(c->size - 1)].body);
    if (last == nullptr) continue;
    const auto segment = choose(*last, epoch);
    if (!segment) return forward(segment);
  }
  Sentence who;
  who.add_body(*from);
  who.add(" and ");
  who.add_body(*to);
  return fail(ErrorCode::not_found, "no kernel connects {s}", {}, {}, who.view());
}

Result<LightTime> light_time(const Ephemeris& ephemeris, BodyId target, const State& observer_O, Epoch epoch,
                             int iterations) {
  // Each step gains the factor v/c: four reach 1e-12 s from anywhere in the solar system.
  constexpr int kMaxIterations = 10;
  constexpr double kConverged = 1e-12;  // s
  constexpr double kFarthest = 1e8;     // s; three light years, so that epochs cannot overflow
  constexpr BodyId kBarycenter = body::solar_system_barycenter;
  auto there = ephemeris.state(target, kBarycenter, epoch);
  if (!there) return forward(there);
  double tau = (there->p_m - observer_O.p_m).norm() / kSpeedOfLight;
  const int limit = iterations < 0 ? kMaxIterations : std::min(iterations, kMaxIterations);
  Duration applied;
  for (int i = 0; i < limit; ++i) {
    if (!(tau < kFarthest))
      return fail(ErrorCode::out_of_range, "body {0} is {1} light-seconds away",
                  {static_cast<double>(target.value), tau, 0, 0});
    const Duration delay = Duration::seconds(tau);
    if (iterations < 0 && i > 0 && delay == applied) break;  // finer than an Epoch can tell
    applied = delay;
    there = ephemeris.state(target, kBarycenter, epoch - delay);
    if (!there) return forward(there);
    // What the nanosecond leaves over is made good with the velocity.
    there->p_m -= (tau - delay.seconds()) * there->v_m_s;
    const double next = (there->p_m - observer_O.p_m).norm() / kSpeedOfLight;
    const double step = std::abs(next - tau);
    tau = next;
    if (iterations < 0 && step < kConverged) break;
  }
  LightTime out;
  out.light_time_s = tau;
  out.relative.p_m = there->p_m - observer_O.p_m;
  out.relative.v_m_s = there->v_m_s - observer_O.v_m_s;
  if (iterations == 0 || tau == 0.0) return out;
  // d tau/dt from the derivative of c tau = |p_target(t - tau) - p_observer(t)|.
  const Vec3 toward = out.relative.p_m.normalized() / kSpeedOfLight;
  const double rate = toward.dot(out.relative.v_m_s) / (1.0 + toward.dot(there->v_m_s));
  out.relative.v_m_s -= rate * there->v_m_s;
  return out;
}

}  // namespace astronav
