// SPDX-License-Identifier: Apache-2.0
#include "onboard/navigation/beacons.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <set>
#include <string>

#include "models/photometry/photometry.h"
#include "onboard/navigation/arc_for_tests.h"

namespace astronav::navigation {
namespace {

using namespace testing;

class Beacons : public ::testing::Test {
 protected:
  static constexpr int kDays = 280;
  // The observer every ten days of the cruise.
  static const std::vector<State>& cruise() {
    static const std::vector<State> states = [] {
      std::vector<State> out{cruise_start().state};
      for (int day = 0; day + 10 <= kDays; day += 10)
        out.push_back(fly(out.back(), cruise_start().epoch + Duration::days(day), Duration::days(10.0)));
      return out;
    }();
    return states;
  }
  static Epoch epoch(std::size_t i) { return cruise_start().epoch + Duration::days(10.0 * static_cast<double>(i)); }
  static BeaconSelection select(std::size_t i, const BeaconSettings& settings) {
    return select_beacons(kernel(), cruise()[i], epoch(i), settings).value();
  }
  BeaconSettings settings;
};

TEST_F(Beacons, FigureOfMeritIsTheTraceOfTheInvertedInformation) {
  settings.ephemeris_sigma_m = {1e3, 2e3, 3e3, 4e3, 1e5, 2e5};
  for (std::size_t i = 0; i < cruise().size(); ++i) {
    const BeaconSelection s = select(i, settings);
    double last = 0.0;
    for (const BeaconPair& pair : s.pairs()) {
      Mat3 information = Mat3::Zero();
      for (const BeaconCandidate& c : s.candidates()) {
        if (c.body != pair.first && c.body != pair.second) continue;
        information +=
            (Mat3::Identity() - c.direction_N * c.direction_N.transpose()) / (c.sigma_across_m * c.sigma_across_m);
      }
      const double trace = information.inverse().trace();
      EXPECT_NEAR(pair.figure_of_merit_m / std::sqrt(trace), 1.0, 1e-6);
      EXPECT_GE(pair.figure_of_merit_m, last);
      last = pair.figure_of_merit_m;
    }
  }
}

TEST_F(Beacons, NamesTheFirstReasonAgainstEachPlanet) {
  int usable_seen = 0, sun_seen = 0;
  for (std::size_t i = 0; i < cruise().size(); ++i) {
    for (const BeaconSelection s = select(i, settings); const BeaconCandidate& c : s.candidates()) {
      const Vec3 to_sun = barycentric(body::sun, epoch(i)).p_m - cruise()[i].p_m;
      const Vec3 to_body = barycentric(c.body, epoch(i)).p_m - cruise()[i].p_m;
      EXPECT_NEAR(c.sun_elongation_rad, angle_between(to_sun, to_body), 1e-3);
      EXPECT_NEAR(c.distance_m / to_body.norm(), 1.0, 1e-3);
      if (c.verdict == BeaconVerdict::sun_exclusion) {
        EXPECT_LT(c.sun_elongation_rad, 35.0 * kDegree);
        ++sun_seen;
      }
      if (c.usable()) {
        EXPECT_GE(c.sun_elongation_rad, 35.0 * kDegree);
        EXPECT_LE(c.v_magnitude, 6.0);
        EXPECT_GE(c.nearest_rad, settings.min_separation_rad);
        ++usable_seen;
      }
    }
  }
  EXPECT_GT(usable_seen, 60);
  EXPECT_GT(sun_seen, 20);

  settings.v_magnitude_limit = -10.0;
  settings.sun_exclusion_rad = 0.0;
  for (const BeaconSelection s = select(5, settings); const BeaconCandidate& c : s.candidates())
    EXPECT_EQ(c.verdict, BeaconVerdict::too_faint);
  settings.v_magnitude_limit = 20.0;
  settings.max_angular_diameter_rad = 0.0;
  for (const BeaconSelection s = select(5, settings); const BeaconCandidate& c : s.candidates())
    EXPECT_EQ(c.verdict, BeaconVerdict::too_large);
  settings.max_angular_diameter_rad = 1.0;
  settings.min_separation_rad = kPi;
  settings.blend_magnitudes = 100.0;
  for (const BeaconSelection s = select(5, settings); const BeaconCandidate& c : s.candidates())
    EXPECT_EQ(c.verdict, BeaconVerdict::blended);
  settings.candidates = {BodyId{2000001}, body::mars};
  const BeaconSelection s = select(5, settings);
  ASSERT_EQ(s.candidate_count, 2);
  EXPECT_EQ(s.candidates()[0].verdict, BeaconVerdict::no_ephemeris);
  EXPECT_EQ(s.pair_count, 0);
  EXPECT_EQ(s.best_single(), nullptr);
}

// Far from the Earth the Moon stands beside it and pulls its centroid.
TEST_F(Beacons, TheMoonSpoilsTheEarthWhenItStandsTooNear) {
  int blended = 0, total = 0;
  for (std::size_t i = 8; i < cruise().size(); ++i) {
    for (const BeaconSelection s = select(i, settings); const BeaconCandidate& c : s.candidates()) {
      if (c.body != body::earth || c.verdict == BeaconVerdict::sun_exclusion) continue;
      EXPECT_EQ(c.nearest, body::moon);
      ++total;
      blended += c.verdict == BeaconVerdict::blended;
    }
  }
  EXPECT_GT(blended, 0);
  EXPECT_LT(blended, total);
}

// The pairs that an independent covariance analysis of this transfer takes: Venus and Earth, Venus and Mars, Mars and
// Jupiter, Earth and Mars. (It knows of no Moon.)
TEST_F(Beacons, PicksThePairsThatAnotherAnalysisPicks) {
  settings.blend_magnitudes = -100.0;
  settings.max_angular_diameter_rad = 1.0;
  const std::set<std::set<int>> known = {{299, 399}, {299, 499}, {499, 599}, {399, 499}};
  int as_known = 0;
  std::string picks;
  for (std::size_t i = 0; i < cruise().size(); ++i) {
    const BeaconSelection s = select(i, settings);
    ASSERT_GT(s.pair_count, 0);
    const BeaconPair& best = s.pairs()[0];
    as_known += known.contains({best.first.value, best.second.value}) ? 1 : 0;
    picks += std::string(body_name(best.first)) + "+" + std::string(body_name(best.second)) + " ";
    ASSERT_NE(s.best_single(), nullptr);
  }
  EXPECT_GE(as_known, 26) << picks;  // of 29
}

TEST_F(Beacons, WorseSunExclusionIsNeverBetter) {
  for (std::size_t i = 0; i < cruise().size(); ++i) {
    double last = 0.0;
    for (const double degrees : {20.0, 35.0, 50.0}) {
      settings.sun_exclusion_rad = degrees * kDegree;
      const BeaconSelection s = select(i, settings);
      const double now = s.pair_count ? s.pairs()[0].figure_of_merit_m : 1e30;
      EXPECT_GE(now, last);
      last = now;
    }
  }
}

TEST_F(Beacons, WithoutTheSunThereIsNoAnswer) {
  EXPECT_EQ(select_beacons(kernel(), cruise()[0], Epoch::parse("2199-01-01 TDB").value(), settings).error().code,
            ErrorCode::out_of_range);
}

// The turn, integrated: speeding up, coasting, slowing down.
TEST_F(Beacons, SlewTimeIsThatOfTheFastestTurn) {
  const Agility agility{.max_rate_rad_s = 0.01, .max_acceleration_rad_s2 = 0.0005, .settle_s = 45.0};
  for (const double angle : {0.01, 0.1, 0.2, 0.5, 2.0}) {
    constexpr double kStep = 1e-3;
    double turned = 0.0, rate = 0.0, t = 0.0;
    for (; turned < angle && t < 1e3; t += kStep) {
      // Slow down when what is left is the way that slowing down takes.
      const bool brake = angle - turned <= 0.5 * rate * rate / agility.max_acceleration_rad_s2;
      rate = brake ? std::max(rate - agility.max_acceleration_rad_s2 * kStep, 1e-6)
                   : std::min(rate + agility.max_acceleration_rad_s2 * kStep, agility.max_rate_rad_s);
      turned += rate * kStep;
    }
    EXPECT_NEAR(slew_time_s(agility, angle), t + agility.settle_s, 0.3) << angle;
  }
}

TEST_F(Beacons, ATurnThatTakesTooLongRulesAPairOut) {
  settings.agility = {.max_rate_rad_s = 0.05 * kDegree, .max_acceleration_rad_s2 = 0.01 * kDegree, .settle_s = 60.0};
  int kept = 0, all = 0;
  for (std::size_t i = 0; i < cruise().size(); ++i) {
    const BeaconSelection slow = select(i, settings), any = select(i, {});
    for (const BeaconPair& pair : slow.pairs()) EXPECT_LE(pair.slew_s, settings.slew_s);
    for (const BeaconPair& pair : slow.pairs()) EXPECT_LE(pair.separation_rad, 72.0 * kDegree);
    kept += slow.pair_count;
    all += any.pair_count;
  }
  EXPECT_GT(kept, 0);
  EXPECT_LT(kept, all);
}

// By information, in which sights simply add up, about the moment of the second.
TEST_F(Beacons, FilterMeritIsTheTraceAfterBothUpdates) {
  RandomStream random(StreamId{.seed = 9, .purpose = "covariance"});
  Mat6 root;
  for (int i = 0; i < 36; ++i) root(i / 6, i % 6) = random.normal();
  Vec6 scale;
  scale << 1e6, 1e6, 1e6, 1.0, 1.0, 1.0;
  const Mat6 P = scale.asDiagonal() * (root * root.transpose() + 0.1 * Mat6::Identity()) * scale.asDiagonal();
  settings.mode = BeaconMode::filter_merit;
  int differ = 0;
  for (std::size_t i = 0; i < cruise().size(); ++i) {
    const BeaconSelection s = select_beacons(kernel(), cruise()[i], epoch(i), settings, &P).value();
    const auto candidate = [&](BodyId id) {
      return *std::find_if(s.all.begin(), s.all.end(), [&](const BeaconCandidate& c) { return c.body == id; });
    };
    double last = 0.0;
    for (const BeaconPair& pair : s.pairs()) {
      const double gap = settings.window_s + settings.slew_s;
      Mat6 back = Mat6::Identity();  // from the second moment to the first
      back.topRightCorner<3, 3>() = -gap * Mat3::Identity();
      const auto information = [](const BeaconCandidate& c) {
        Mat6 out = Mat6::Zero();
        out.topLeftCorner<3, 3>() =
            (Mat3::Identity() - c.direction_N * c.direction_N.transpose()) / (c.sigma_across_m * c.sigma_across_m);
        return out;
      };
      const Mat6 sum = back.transpose() * (P.inverse() + information(candidate(pair.first))) * back +
                       information(candidate(pair.second));
      const double trace = Mat6(sum.inverse()).diagonal().head<3>().sum();
      EXPECT_NEAR(pair.filter_merit_m / std::sqrt(trace), 1.0, 1e-4);
      EXPECT_GE(pair.filter_merit_m, last);
      last = pair.filter_merit_m;
    }
    const BeaconSelection by_static = select(i, {});
    if (s.pair_count > 0)
      differ += s.ranked[0].first != by_static.ranked[0].first || s.ranked[0].second != by_static.ranked[0].second;
  }
  std::printf("  the filter's merit picks another pair in %d of %zu\n", differ, cruise().size());
  EXPECT_EQ(select_beacons(kernel(), cruise()[0], epoch(0), settings).error().code, ErrorCode::invalid_argument);
}

}  // namespace
}  // namespace astronav::navigation
