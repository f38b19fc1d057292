// SPDX-License-Identifier: Apache-2.0
#include "simulator/dynamics/kicks.h"

#include <algorithm>
#include <cmath>
#include <iterator>
#include <utility>

namespace astronav::dynamics {
namespace {

// Uniform on the sphere (Archimedes: its height is uniform).
Vec3 random_direction(RandomStream& stream) {
  const double z = stream.uniform(-1.0, 1.0);
  const double longitude = stream.uniform(0.0, 2.0 * kPi);
  const double r = std::sqrt(1.0 - z * z);
  return {r * std::cos(longitude), r * std::sin(longitude), z};
}

}  // namespace

Epoch next_of(const std::vector<Epoch>& knots, Epoch epoch, Epoch limit) {
  if (limit >= epoch) {
    const auto next = std::upper_bound(knots.begin(), knots.end(), epoch);
    return next == knots.end() ? limit : std::min(*next, limit);
  }
  const auto here = std::lower_bound(knots.begin(), knots.end(), epoch);
  return here == knots.begin() ? limit : std::max(*std::prev(here), limit);
}

Result<Kicks> Kicks::draw(const KickSettings& settings, Epoch begin, Epoch end, RandomStream& stream) {
  if (!(settings.smallest_m_s >= 0.0) || !(settings.largest_m_s >= settings.smallest_m_s) ||
      !std::isfinite(settings.largest_m_s)) {
    return fail(ErrorCode::invalid_argument, "kicks of {0} to {1} m/s: expected 0 <= smallest <= largest",
                {settings.smallest_m_s, settings.largest_m_s});
  }
  if (settings.shortest_pause <= settings.length || settings.longest_pause < settings.shortest_pause) {
    return fail(ErrorCode::invalid_argument,
                "pauses of {0} to {1} s between kicks of {2} s: expected length < shortest <= longest",
                {settings.shortest_pause.seconds(), settings.longest_pause.seconds(), settings.length.seconds()});
  }
  if (end < begin) return fail(ErrorCode::invalid_argument, "the kicks end before they begin");
  const auto pause = [&] {
    return Duration::seconds(stream.uniform(settings.shortest_pause.seconds(), settings.longest_pause.seconds()));
  };
  std::vector<Kick> kicks;
  Epoch e = begin + Duration::seconds(pause().seconds() * stream.uniform());
  while (e + settings.length <= end) {
    const double size = stream.uniform(settings.smallest_m_s, settings.largest_m_s);
    kicks.push_back({e, size * random_direction(stream)});
    e = e + pause();
  }
  return at_times(std::move(kicks), settings.length);
}

Result<Kicks> Kicks::at_times(std::vector<Kick> kicks, Duration length) {
  if (length <= Duration{}) {
    return fail(ErrorCode::invalid_argument, "a kick must take longer than {0} s", {length.seconds()});
  }
  Kicks out;
  for (std::size_t i = 0; i < kicks.size(); ++i) {
    if (!kicks[i].delta_v_N_m_s.allFinite()) return fail(ErrorCode::invalid_argument, "a kick is not finite");
    if (i > 0 && kicks[i].begin < kicks[i - 1].begin + length) {
      return fail(ErrorCode::invalid_argument, "kick {0} begins before the one before it has ended",
                  {static_cast<double>(i)});
    }
    if (out.knots_.empty() || out.knots_.back() != kicks[i].begin) out.knots_.push_back(kicks[i].begin);
    out.knots_.push_back(kicks[i].begin + length);
  }
  out.kicks_ = std::move(kicks);
  out.length_ = length;
  return out;
}

Vec3 Kicks::acceleration_N_m_s2(Epoch epoch) const {
  const auto after =
      std::upper_bound(kicks_.begin(), kicks_.end(), epoch, [](Epoch e, const Kick& k) { return e < k.begin; });
  if (after == kicks_.begin()) return Vec3::Zero();
  const Kick& kick = *std::prev(after);
  if (epoch >= kick.begin + length_) return Vec3::Zero();
  return kick.delta_v_N_m_s / length_.seconds();
}

Epoch Kicks::next_knot(Epoch epoch, Epoch limit) const {
  return next_of(knots_, epoch, limit);
}

}  // namespace astronav::dynamics
