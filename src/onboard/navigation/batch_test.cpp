// SPDX-License-Identifier: Apache-2.0
#include "onboard/navigation/batch.h"

#include <cmath>
#include <vector>

#include <gtest/gtest.h>

#include "foundation/math/statistics.h"
#include "onboard/navigation/arc_for_tests.h"

namespace astronav::navigation {
namespace {

using testing::barycentric;
using testing::cruise_start;
using testing::exact_direction;
using testing::fly;
using testing::kernel;

constexpr double kMassKg = 25.0;

// Sixty days out: the Earth is a quarter of an au away by then.
const testing::Start& departed() {
  static const testing::Start start = [] {
    const Duration days = Duration::days(60.0);
    return testing::Start{cruise_start().epoch + days, fly(cruise_start().state, cruise_start().epoch, days)};
  }();
  return start;
}

struct Errors {
  double noise_rad = 0.0;  // white, an axis
  GaussMarkov bias{.sigma = 0.0, .tau_s = 12.0 * 3600.0};
  double mass_kg = kMassKg;  // what solar pressure truly goes by
  GaussMarkov acceleration{.sigma = 0.0, .tau_s = 5.0 * 86400.0};
};

struct Window {
  BodyId body;
  double begin_s;  // after the cruise's start
};
// An hour on one planet, a slew, an hour on another; days between the cycles.
std::vector<Window> cycles(int count, double every_days = 10.0) {
  std::vector<Window> out;
  for (int k = 0; k < count; ++k) {
    out.push_back({body::earth, 86400.0 * every_days * k});
    out.push_back({body::jupiter_barycenter, 86400.0 * every_days * k + 5100.0});
  }
  return out;
}

struct Sky {
  std::vector<BatchSight> sights;
  State end;  // the truth at the last sight
};

// What an hour of sights each 100 s looks like, when the spacecraft flies by forces that the batch knows only as
// statistics.
Sky look(const std::vector<Window>& windows, const Errors& errors, RandomStream& random) {
  Sky sky;
  State here = departed().state;
  Epoch now = departed().epoch;
  Vec3 a = errors.acceleration.sigma * Vec3(random.normal(), random.normal(), random.normal());
  const double pressure = 4.56e-6 * ProcessSettings{}.reflectivity_area_m2 / errors.mass_kg;
  const auto fly_to = [&](Epoch to) {
    // The acceleration is constant for a quarter of a day at most, as against five days in which it forgets.
    while (now < to) {
      const Duration h = std::min(to - now, Duration::seconds(21600.0));
      here = fly(here, now, h, pressure, [&](double) { return a; });
      now = now + h;
      const double keep = std::exp(-h.seconds() / errors.acceleration.tau_s);
      a = keep * a + errors.acceleration.sigma * std::sqrt(1.0 - keep * keep) *
                         Vec3(random.normal(), random.normal(), random.normal());
    }
  };
  for (const Window& window : windows) {
    Vec3 bias = errors.bias.sigma * Vec3(random.normal(), random.normal(), random.normal());
    for (int k = 0; k < 36; ++k) {
      fly_to(departed().epoch + Duration::seconds(window.begin_s + 50.0 + 100.0 * k));
      const double keep = std::exp(-100.0 / errors.bias.tau_s);
      bias = keep * bias +
             errors.bias.sigma * std::sqrt(1.0 - keep * keep) * Vec3(random.normal(), random.normal(), random.normal());
      BatchSight sight;
      sight.epoch = now;
      sight.sight.body = window.body;
      const Vec3 direction = exact_direction(here, window.body, now);
      sight.sight.direction_N =
          (direction + bias + errors.noise_rad * Vec3(random.normal(), random.normal(), random.normal())).normalized();
      sight.sight.covariance_rad2 = Mat3::Identity() * std::max(errors.noise_rad * errors.noise_rad, 1e-18);
      sight.boresight_N = direction;
      sight.v_stars_m_s = here.v_m_s;
      sky.sights.push_back(sight);
    }
  }
  sky.end = here;
  return sky;
}

BatchSettings believed(const Errors& errors) {
  BatchSettings settings;
  settings.bias = errors.bias;
  settings.mass_kg = kMassKg;
  settings.process.acceleration = errors.acceleration;
  return settings;
}

TEST(Batch, ExactSightsGiveTheExactState) {
  RandomStream random(StreamId{.seed = 1, .purpose = "exact"});
  Errors errors;
  errors.noise_rad = 1e-11;
  errors.bias.sigma = 1e-9;
  const Sky sky = look(cycles(1), errors, random);
  const auto start = start_from_sights(kernel(), sky.sights);
  ASSERT_TRUE(start) << describe(start.error());
  const auto found = solve_batch(kernel(), sky.sights, *start, believed(errors));
  ASSERT_TRUE(found) << describe(found.error());
  EXPECT_EQ(found->epoch, sky.sights.back().epoch);
  // First-order aberration and closed-form light time leave 0.6 mas: half a kilometre by Earth, 4 by Jupiter.
  EXPECT_LT((found->state.p_m - sky.end.p_m).norm(), 5e3);
  EXPECT_LT((found->state.v_m_s - sky.end.v_m_s).norm(), 0.5);
}

struct Tally {
  double nees = 0.0, chi2 = 0.0, position_km = 0.0, velocity_m_s = 0.0;
  int runs = 0, rejected = 0;
};

Tally try_many(int runs, int cycle_count, const Errors& truth, const BatchSettings& settings, const char* name) {
  RandomStream random(StreamId{.seed = 2, .purpose = name});
  Tally t;
  for (int run = 0; run < runs; ++run) {
    Errors errors = truth;
    errors.mass_kg = kMassKg * (1.0 + 0.1 * random.normal());
    const Sky sky = look(cycles(cycle_count, 2.0), errors, random);
    const auto start = start_from_sights(kernel(), sky.sights);
    EXPECT_TRUE(start) << describe(start.error());
    if (!start) continue;
    const auto found = solve_batch(kernel(), sky.sights, *start, settings);
    EXPECT_TRUE(found) << describe(found.error());
    if (!found) continue;
    Vec6 error;
    error << found->state.p_m - sky.end.p_m, found->state.v_m_s - sky.end.v_m_s;
    t.nees += error.dot(found->covariance.inverse() * error);
    t.chi2 += found->chi2 / found->degrees_of_freedom;
    t.position_km += error.head<3>().norm() / 1e3;
    t.velocity_m_s += error.tail<3>().norm();
    t.rejected += found->rejected;
    ++t.runs;
  }
  std::printf("  %s: NEES %.2f, chi2 %.3f a degree, error %.0f km, %.2f m/s (means), rejected %d\n", name,
              t.nees / t.runs, t.chi2 / t.runs, t.position_km / t.runs, t.velocity_m_s / t.runs, t.rejected);
  t.nees /= t.runs;
  t.chi2 /= t.runs;
  return t;
}

// One cycle, planets never looked at before: 2.5 hours give position and velocity. The drift of a Gauss-Markov bias is
// more than a straight line: 10 % beyond the band that a right program leaves once in 1000 times.
TEST(Batch, OneCycleIsConsistent) {
  Errors errors;
  errors.noise_rad = 0.3 * kArcsecond;
  errors.bias.sigma = 0.3 * kArcsecond;
  errors.acceleration.sigma = 1e-8;
  const Tally t = try_many(150, 1, errors, believed(errors), "one cycle");
  const Band band = chi_square_mean_band(0.999, 6, 150);
  EXPECT_GT(t.nees, band.lo / 1.1);
  EXPECT_LT(t.nees, band.hi * 1.1);
  EXPECT_NEAR(t.chi2, 1.0, 0.02);
}

// Three cycles in four days.
TEST(Batch, ThreeCyclesAreConsistent) {
  Errors errors;
  errors.noise_rad = 0.1 * kArcsecond;
  errors.bias.sigma = 0.1 * kArcsecond;
  errors.acceleration.sigma = 1e-8;
  const Tally t = try_many(60, 3, errors, believed(errors), "three cycles");
  const Band band = chi_square_mean_band(0.999, 6, 60);
  EXPECT_GT(t.nees, band.lo / 1.1);
  EXPECT_LT(t.nees, band.hi * 1.1);
}

// A bias that is believed to be noise makes a batch far too sure of itself: this is what the windows' biases are for.
TEST(Batch, ABiasTakenForNoiseIsSeen) {
  Errors errors;
  errors.noise_rad = 0.3 * kArcsecond;
  errors.bias.sigma = 0.3 * kArcsecond;
  BatchSettings settings = believed(errors);
  settings.bias.sigma = 0.0;
  const Tally t = try_many(20, 1, errors, settings, "no bias believed");
  EXPECT_GT(t.nees, 15.0);
}

TEST(Batch, WrongSightsTakeNoPart) {
  RandomStream random(StreamId{.seed = 3, .purpose = "outliers"});
  Errors errors;
  errors.noise_rad = 0.3 * kArcsecond;
  errors.bias.sigma = 0.1 * kArcsecond;
  Sky sky = look(cycles(1), errors, random);
  for (const std::size_t i : {3u, 20u, 21u, 40u, 60u})
    sky.sights[i].sight.direction_N =
        (sky.sights[i].sight.direction_N + 1e-3 * Vec3(random.normal(), random.normal(), random.normal())).normalized();
  const auto found =
      solve_batch(kernel(), sky.sights, start_from_sights(kernel(), sky.sights).value(), believed(errors));
  ASSERT_TRUE(found) << describe(found.error());
  EXPECT_GE(found->rejected, 5);
  EXPECT_LE(found->rejected, 6);
  Vec6 error;
  error << found->state.p_m - sky.end.p_m, found->state.v_m_s - sky.end.v_m_s;
  EXPECT_LT(error.dot(found->covariance.inverse() * error), chi_square_quantile(0.9999, 6.0));
}

// Stars that were aberrated by no velocity at all, and a planet eight degrees off the boresight.
TEST(Batch, StarsWithoutAberrationAreCounted) {
  RandomStream random(StreamId{.seed = 4, .purpose = "stars at rest"});
  const Errors errors;
  Sky sky = look(cycles(1), errors, random);
  for (BatchSight& sight : sky.sights) {
    const Vec3 v = sight.v_stars_m_s, s = sight.sight.direction_N;
    const Vec3 b = (s + 0.14 * s.unitOrthogonal()).normalized();
    const Mat3 turned = Eigen::Quaterniond::FromTwoVectors(aberrate(b, v), b).toRotationMatrix();
    sight.sight.direction_N = turned * s;
    sight.boresight_N = b;
    sight.v_stars_m_s.setZero();
  }
  const auto found =
      solve_batch(kernel(), sky.sights, start_from_sights(kernel(), sky.sights).value(), believed(errors));
  ASSERT_TRUE(found) << describe(found.error());
  EXPECT_LT((found->state.p_m - sky.end.p_m).norm(), 2e4);
}

TEST(Batch, SaysWhatIsMissing) {
  RandomStream random(StreamId{.seed = 5, .purpose = "missing"});
  Errors errors;
  errors.noise_rad = 1e-6;
  const Sky sky = look(cycles(1), errors, random);
  const std::span<const BatchSight> earth(sky.sights.data(), 36);
  const auto lonely = start_from_sights(kernel(), earth);
  ASSERT_FALSE(lonely);
  EXPECT_EQ(lonely.error().subject.view(), "unobservable");
  // One body and no prior: what is along the sight stays unknown, and that is an error, not a state.
  const BatchStart near_truth{sky.sights[0].epoch, departed().state};
  const auto one_body = solve_batch(kernel(), earth, near_truth, believed(errors));
  if (one_body) {
    // Gravity bends the way within the hour by what tells the distance, barely: then the covariance says so.
    EXPECT_GT(std::sqrt(one_body->covariance.topLeftCorner<3, 3>().trace()), 1e10);
  } else {
    EXPECT_EQ(one_body.error().subject.view(), "unobservable");
  }
  std::vector<BatchSight> swapped(sky.sights.begin(), sky.sights.end());
  std::swap(swapped.front(), swapped.back());
  EXPECT_EQ(solve_batch(kernel(), swapped, near_truth).error().code, ErrorCode::invalid_argument);
  EXPECT_EQ(solve_batch(kernel(), earth.first(2), near_truth).error().code, ErrorCode::invalid_argument);
  const Sky long_arc = look(cycles(2), errors, random);
  EXPECT_EQ(solve_batch(kernel(), long_arc.sights, near_truth).error().code, ErrorCode::invalid_argument);
}

}  // namespace
}  // namespace astronav::navigation
