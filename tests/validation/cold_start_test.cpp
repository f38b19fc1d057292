// SPDX-License-Identifier: Apache-2.0
// Starts from nothing on the way to Mars (benchmarks/accuracy/cold_start.cpp has 240 of them): survey, batch, filter,
// as good from the third cycle on as a filter that was told its place to 10,000 km.
#include <algorithm>
#include <cmath>
#include <cstdio>

#include <gtest/gtest.h>

#include "benchmarks/accuracy/cold_start_flight.h"
#include "foundation/math/statistics.h"
#include "simulator/transfer/ballistic.h"
#include "support/shipped_ephemeris.h"

namespace astronav::cold_start {
namespace {

TEST(ColdStart, AsGoodAsWithAPriorFromTheThirdCycleOn) {
  const Ephemeris& ephemeris = testing::shipped_ephemeris();
  const auto design =
      transfer::design_ballistic(ephemeris, body::earth, body::mars_barycenter,
                                 Epoch::parse("2026-11-09T00:00:00 TDB").value(), Duration::days(300.0));
  ASSERT_TRUE(design) << describe(design.error());
  for (const Level& level : {Level{0.07 * kArcsecond, 0.0}, Level{0.4 * kArcsecond, 0.3 * kArcsecond}}) {
    Pool pool;
    constexpr int kStarts = 40;
    for (int i = 0; i < kStarts; ++i) {
      const Epoch epoch = design->begin + Duration::days(7.0 + 6.0 * i);
      pool.add(
          Flight(ephemeris, epoch, design->arc.at(epoch).value(), level, static_cast<std::uint64_t>(1000 + i)).run());
    }
    pool.finish();
    // At a true share of 99.5 % more than one failure of forty has a probability of 1.7 %; a wrong one, none.
    EXPECT_GE(pool.started, kStarts - 1);
    EXPECT_EQ(pool.wrong, 0);
    for (std::size_t cycle = 2; cycle < kCycles; ++cycle) {
      const auto& cold = pool.cold[cycle];
      const auto& primed = pool.primed[cycle];
      std::printf("  cycle %zu: from nothing %.0f km, %.3f m/s, NEES %.2f; with a prior %.0f km, %.3f m/s (3 sigma)\n",
                  cycle + 1, cold.position_km, cold.velocity_m_s, cold.nees, primed.position_km, primed.velocity_m_s);
      // The same sights, so the difference is the start's alone: within 10 %, actual and formal.
      EXPECT_LT(cold.position_km, 1.1 * primed.position_km);
      EXPECT_LT(cold.velocity_m_s, 1.1 * primed.velocity_m_s);
      EXPECT_NEAR(cold.formal_position_km / primed.formal_position_km, 1.0, 0.05);
    }
    // The batch's own: band of one in 1000, its drift being a straight line (batch_test) 10 % more.
    const Band band = chi_square_mean_band(0.999, 6, pool.started);
    EXPECT_GT(pool.cold[0].nees, band.lo / 1.1);
    EXPECT_LT(pool.cold[0].nees, band.hi * 1.1);
  }
}

}  // namespace
}  // namespace astronav::cold_start
