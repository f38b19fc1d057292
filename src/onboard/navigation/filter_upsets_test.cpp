// SPDX-License-Identifier: Apache-2.0
// The filter comes back from what goes wrong in flight.
#include "onboard/navigation/campaign_for_tests.h"
#include "onboard/navigation/filter.h"

namespace astronav::navigation {
namespace {

using namespace testing;

// Six runs, something happens; two cycles later, and when the last one ends, the error is what the covariance says.
void comes_back(const Upsets& upsets, const char* what, int two_cycles_later = 5, int last = 7,
                double least_nees = 1.0) {
  constexpr int kRuns = 6;
  const Consistency c = fly_campaign(campaign_settings(), campaign_settings(), kRuns, last + 1, upsets);
  // Chi-square with 36 degrees of freedom leaves this band once in a thousand times.
  const Band band = chi_square_mean_band(0.999, 6.0, kRuns);
  for (const int cycle : {two_cycles_later, last}) {
    const double nees = mean(c.nees_of_cycle[static_cast<std::size_t>(cycle)]);
    EXPECT_GT(nees, least_nees * band.lo) << what << ", cycle " << cycle;
    EXPECT_LT(nees, band.hi) << what << ", cycle " << cycle;
  }
}

TEST(FilterComesBack, AfterALostWindow) {
  comes_back({.image = [](int cycle, int window, auto&, auto&) { return cycle != 3 || window != 1; }}, "lost window");
}

TEST(FilterComesBack, AfterThirtyDaysOfSafeMode) {
  comes_back({.image = [](int cycle, int, auto&, auto&) { return cycle < 3 || cycle > 5; }}, "safe mode", 7, 8);
}

// Before, a single cycle: the velocity is known to 100 m/s, and the first sight afterwards turns by a degree.
TEST(FilterComesBack, AfterThirtyDaysOfSafeModeThatFollowOneCycle) {
  comes_back({.image = [](int cycle, int, auto&, auto&) { return cycle < 1 || cycle > 3; }}, "early safe mode", 5, 7);
}

TEST(FilterComesBack, AfterAProtonStorm) {
  const auto storm = [](int cycle, int, BeaconMeasurement& m, RandomStream& random) {
    if (cycle == 3 && random.uniform() < 0.6) m.pixel = {random.uniform(0.0, 1024.0), random.uniform(0.0, 1024.0)};
    return true;
  };
  comes_back({.image = storm}, "proton storm");
}

TEST(FilterComesBack, AfterTheClockJumpedByASecond) {
  const auto jumped = [](int cycle, int, BeaconMeasurement& m, RandomStream&) {
    if (cycle >= 3) m.mid_exposure = m.mid_exposure + Duration::seconds(1.0);
    return true;
  };
  comes_back({.image = jumped}, "clock step");
}

TEST(FilterComesBack, AfterAManoeuvreWithItsError) {
  const auto correct = [](int cycle, Truth& truth, Filter& filter) {
    if (cycle != 3) return;
    const Vec3 planned(3.0, -2.0, 1.0);
    constexpr double kExecution = 0.02;
    Vec3 flown = planned;
    for (double& v : flown) v += kExecution * planned.norm() * truth.random().normal();
    truth.push(flown);
    EXPECT_TRUE(filter.kick(planned, kExecution * planned.norm()));
  };
  comes_back({.after_cycle = correct}, "manoeuvre");
}

// 20 m/s that nobody reported: every sight is refused until the filter doubts itself, and then rather too much.
TEST(FilterComesBack, AfterAManoeuvreThatItWasNotTold) {
  const auto push = [](int cycle, Truth& truth, Filter&) {
    if (cycle == 3) truth.push({15.0, -10.0, 8.0});
  };
  comes_back({.after_cycle = push}, "untold manoeuvre", 5, 7, 0.3);
}

// One sight in twenty is off by ten sigmas: so is the first of some windows, when the gate is still wide.
TEST(FilterComesBack, FromSightsWithHeavyTails) {
  const auto tails = [](int, int, BeaconMeasurement& m, RandomStream& random) {
    if (random.uniform() < 0.05) {
      m.pixel.u += 0.5 * random.normal();
      m.pixel.v += 0.5 * random.normal();
    }
    return true;
  };
  comes_back({.image = tails}, "heavy tails");
}

}  // namespace
}  // namespace astronav::navigation
