// SPDX-License-Identifier: Apache-2.0
#include "simulator/transfer/porkchop.h"

#include <iterator>
#include <utility>

#include <fmt/format.h>

#include "foundation/base/check.h"

namespace astronav::transfer {

Result<Porkchop> porkchop(const Ephemeris& ephemeris, BodyId from, BodyId to, const PorkchopSettings& s) {
  if (s.departure_step <= Duration{} || s.flight_step <= Duration{} || s.shortest <= Duration{}) {
    return fail(ErrorCode::invalid_argument, "steps ({0} d, {1} d) and times of flight ({2} d) must be above zero",
                {s.departure_step.days(), s.flight_step.days(), s.shortest.days()});
  }
  if (s.departure_end < s.departure_begin || s.longest < s.shortest) {
    return fail(ErrorCode::invalid_argument, "departures or times of flight end before they begin");
  }
  const std::int64_t rows = (s.departure_end - s.departure_begin).nanoseconds() / s.departure_step.nanoseconds() + 1;
  const std::int64_t columns = (s.longest - s.shortest).nanoseconds() / s.flight_step.nanoseconds() + 1;
  constexpr std::int64_t kMost = 1'000'000;
  if (rows > kMost || columns > kMost || rows * columns > kMost) {
    return fail(ErrorCode::limit_exceeded, "{0} departures by {1} times of flight are more than {2} transfers",
                {static_cast<double>(rows), static_cast<double>(columns), static_cast<double>(kMost)});
  }
  Porkchop out{.from = from, .to = to, .departures = {}, .flights = {}, .legs = {}};
  for (std::int64_t i = 0; i < rows; ++i) out.departures.push_back(s.departure_begin + s.departure_step * i);
  for (std::int64_t i = 0; i < columns; ++i) out.flights.push_back(s.shortest + s.flight_step * i);
  out.legs.reserve(static_cast<std::size_t>(rows * columns));
  bool any = false;
  for (const Epoch departure : out.departures) {
    for (const Duration flight : out.flights) {
      auto leg = lambert_leg(ephemeris, from, to, departure, flight);
      if (!leg && leg.error().code != ErrorCode::invalid_argument) return forward(leg);
      any = any || leg.has_value();
      out.legs.push_back(leg ? std::optional(std::move(*leg)) : std::nullopt);
    }
  }
  if (!any) return fail(ErrorCode::invalid_argument, "no two places on this grid are joined by a conic");
  return out;
}

LambertLeg Porkchop::least_c3() const {
  const std::optional<LambertLeg>* best = nullptr;
  for (const auto& leg : legs) {
    if (leg && (best == nullptr || leg->c3_m2_s2() < (*best)->c3_m2_s2())) best = &leg;
  }
  ASTRONAV_CHECK(best != nullptr);
  return **best;
}

std::string to_csv(const Porkchop& p) {
  fmt::memory_buffer buffer;
  const auto out = std::back_inserter(buffer);
  fmt::format_to(out, "departure_tdb,arrival_tdb,days,c3_km2_s2,v_infinity_departure_km_s,v_infinity_arrival_km_s\n");
  const auto iso = [](Epoch e) { return e.iso(TimeScale::tdb, 0, false); };
  for (const auto& leg : p.legs) {
    if (!leg) continue;
    fmt::format_to(out, "{},{},{},{:.6f},{:.6f},{:.6f}\n", iso(leg->departure), iso(leg->arrival),
                   (leg->arrival - leg->departure).days(), leg->c3_m2_s2() * 1e-6,
                   leg->v_infinity_departure_m_s.norm() * 1e-3, leg->v_infinity_arrival_m_s.norm() * 1e-3);
  }
  return fmt::to_string(buffer);
}

}  // namespace astronav::transfer
