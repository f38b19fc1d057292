// SPDX-License-Identifier: Apache-2.0
#include "onboard/navigation/filter.h"

#include <atomic>
#include <new>

#include <Eigen/Eigenvalues>

#include "onboard/navigation/campaign_for_tests.h"

namespace {
std::atomic<long> allocations{0};
}  // namespace

[[gnu::noinline]] void* operator new(std::size_t size) {
  ++allocations;
  if (void* p = std::malloc(size)) return p;
  std::abort();
}
[[gnu::noinline]] void operator delete(void* p) noexcept {
  std::free(p);
}
[[gnu::noinline]] void operator delete(void* p, std::size_t) noexcept {
  std::free(p);
}

namespace astronav::navigation {
namespace {

using namespace testing;

// ---- consistency

// 40 runs of 10 cycles. False-alarm probability 1e-3 each: NIS by its chi-square law (innovations of a right filter are
// white); NEES by Student's law over the means of the runs, which are independent though a run's cycles are not.
TEST(FilterConsistency, NeesAndNisAreThoseOfAFilterThatKnowsItsErrors) {
  const FilterSettings settings = campaign_settings();
  const Consistency c = fly_campaign(settings, settings, 40, 10);
  const double nis = c.nis_sum / static_cast<double>(c.nis_count);
  EXPECT_TRUE(chi_square_mean_band(0.999, 2.0, static_cast<double>(c.nis_count)).contains(nis)) << nis;
  const double nees = mean(c.nees_of_run);
  const double sigma = standard_deviation(c.nees_of_run) / std::sqrt(40.0);
  EXPECT_NEAR(nees, 6.0, 3.56 * sigma) << "t of 39 degrees at 0.9995";
  EXPECT_LT(sigma, 0.75);     // or the band could not fail
  EXPECT_LT(c.rejected, 15);  // 1e-4 of 28,800 are 2.9: more than 14 once in 1e6
  RecordProperty("nees", std::to_string(nees));
  RecordProperty("nees_sigma", std::to_string(sigma));
  RecordProperty("nis", std::to_string(nis));
  RecordProperty("rejected", std::to_string(c.rejected));
}

// The same judge must find a filter that takes the window's bias for white noise guilty.
TEST(FilterConsistency, AFilterWithoutTheBiasIsFoundOut) {
  FilterSettings truth = campaign_settings();
  truth.bias.sigma = 0.07;
  FilterSettings believed = truth;
  believed.bias.sigma = 0.0;
  const Consistency c = fly_campaign(truth, believed, 8, 6);
  EXPECT_GT(mean(c.nees_of_run), 12.0);
}

// ---- bounds

struct Bound {
  double pixel, attitude_arcsec, bias_arcsec, acceleration;
  double position_km,
      velocity_m_s;  // worst axis, 3 sigma: linear covariance analysis, docs/theory/navigation.md table 3
};

class FilterBound : public ::testing::TestWithParam<Bound> {};

// 300 days from 2026-11-09, mean square over days 50 to 260 right after the second window.
TEST_P(FilterBound, IsThatOfLinearCovarianceAnalysis) {
  const Bound& b = GetParam();
  FilterSettings settings = plain_settings();
  settings.process.acceleration.sigma = b.acceleration;
  settings.bias = {.sigma = b.bias_arcsec * kArcsecond * settings.camera.fx_px, .tau_s = 10.0 * 86400.0};
  const ImageNoise noise{
      .pixel = b.pixel, .cross = b.attitude_arcsec * kArcsecond, .roll = 10.0 * b.attitude_arcsec * kArcsecond};
  const Start& start = cruise_start();
  Filter filter(settings, kernel());
  ASSERT_TRUE(filter.initialise({start.epoch, start.state, diagonal_covariance(1e7, 100.0)}));
  State truth = start.state;
  Epoch at = start.epoch;
  Vec6 sum = Vec6::Zero();
  int count = 0;
  for (int cycle = 0; cycle < 29; ++cycle) {
    const std::array<BodyId, 2> pair = best_pair(truth, at);
    for (int image = 0; image < 2 * kImages; ++image) {
      const Epoch epoch = start.epoch + kCycle * cycle + (image < kImages ? Duration() : kSecondWindow) +
                          kImagePeriod * (image % kImages);
      truth = fly(truth, at, epoch - at);
      at = epoch;
      ASSERT_TRUE(
          filter.update(photograph(truth, pair[image / kImages], epoch, settings.camera, noise, nullptr)).accepted);
    }
    const double day = (at - departure()).days();
    if (day > 50.0 && day < 260.0) {
      sum += filter.covariance_pv().diagonal();
      ++count;
    }
    const Epoch next = start.epoch + kCycle * (cycle + 1);
    truth = fly(truth, at, next - at);
    at = next;
  }
  const double position_km = 3.0 * std::sqrt(sum.head<3>().maxCoeff() / count) * 1e-3;
  const double velocity = 3.0 * std::sqrt(sum.tail<3>().maxCoeff() / count);
  RecordProperty("position_km", std::to_string(position_km));
  RecordProperty("velocity_m_s", std::to_string(velocity));
  EXPECT_NEAR(position_km, b.position_km, 0.2 * b.position_km);
  EXPECT_NEAR(velocity, b.velocity_m_s, 0.2 * b.velocity_m_s);
}
INSTANTIATE_TEST_SUITE_P(Cases, FilterBound,
                         ::testing::Values(Bound{0.05, 1.3, 0.0, 1e-8, 711.0, 0.135},
                                           Bound{0.05, 1.3, 0.5, 1e-8, 868.0, 0.166},
                                           Bound{0.03, 0.4, 0.3, 1e-8, 574.0, 0.112},
                                           Bound{0.005, 0.0, 0.0, 1e-8, 168.0, 0.051}));

// ---- numerics

// Every state in use; an orbit that passes no planet.
TEST(FilterNumerics, CovarianceStaysSymmetricAndPositiveOver2000Days) {
  FilterSettings settings = campaign_settings();
  settings.process.acceleration.sigma = 1e-9;
  settings.process.solar_pressure.sigma = 0.05;
  settings.clock.sigma = 0.1;
  const BodyId bodies[] = {body::mercury, body::venus,  body::earth,  body::mars,
                           body::jupiter, body::saturn, body::uranus, body::neptune};
  for (std::size_t i = 0; i < settings.beacon_errors.size(); ++i)
    settings.beacon_errors[i] = {
        .body = bodies[i], .ephemeris_m = 1e3, .photocentre_fraction = 0.07, .lasting_ephemeris_m = 1e5};
  const Start& start = cruise_start();
  State truth = start.state;
  truth.v_m_s *= 1.02;
  Filter filter(settings, kernel());
  ASSERT_TRUE(filter.initialise({start.epoch, truth, diagonal_covariance(1e9, 1000.0), 25.0, 2.5}));
  RandomStream random({.seed = 5, .purpose = "numerics"});
  const BodyId beacons[] = {body::earth, body::mars, body::jupiter};
  const Duration pause = Duration::days(2.0);
  for (int look = 0; look < 1000; ++look) {
    const Epoch epoch = start.epoch + pause * look;
    if (look > 0) truth = fly(truth, epoch - pause, pause);
    filter.update(photograph(truth, beacons[look % 3], epoch, settings.camera,
                             {.pixel = 0.001, .cross = 0.0, .roll = 0.0}, &random));
    const int day = 2 * look;
    const StateMatrix P = filter.covariance();
    const StateVector scale = P.diagonal().cwiseSqrt().cwiseInverse();
    ASSERT_TRUE(scale.allFinite()) << day;
    const StateMatrix normalised = scale.asDiagonal() * P * scale.asDiagonal();
    ASSERT_LT((normalised - normalised.transpose()).cwiseAbs().maxCoeff(), 1e-12);
    const double least =
        Eigen::SelfAdjointEigenSolver<StateMatrix>(normalised, Eigen::EigenvaluesOnly).eigenvalues()[0];
    ASSERT_GT(least, 0.0) << day;
    ASSERT_NEAR(filter.covariance_pv()(1, 4) / P(1, 4), 1.0, 1e-9);
  }
}

TEST(FilterNumerics, PropagationAndUpdateDoNotAllocate) {
  FilterSettings settings = campaign_settings();
  settings.adaptive_noise = true;
  const Start& start = cruise_start();
  const Epoch later = start.epoch + Duration::days(10.0);
  const State truth = fly(start.state, start.epoch, Duration::days(10.0));
  const BeaconMeasurement m = photograph(truth, body::mars, later, settings.camera, {}, nullptr);
  Filter filter(settings, kernel());
  ASSERT_TRUE(filter.initialise({start.epoch, start.state, diagonal_covariance(1e7, 100.0)}));
  const long before = allocations;
  const bool propagated = filter.propagate_to(later).has_value();
  const bool accepted = filter.update(m).accepted;
  const bool predicted = filter.predict_direction(body::mars).has_value();
  const bool refused = !filter.propagate_to(start.epoch);
  EXPECT_EQ(allocations - before, 0);
  EXPECT_TRUE(propagated && accepted && predicted && refused);
  delete new int;
  EXPECT_GT(allocations, before);  // the hook is in place
}

// ---- single updates

class FilterUpdate : public ::testing::Test {
 protected:
  FilterSettings settings = plain_settings();
  Epoch epoch = cruise_start().epoch;
  State truth = cruise_start().state;

  Filter started(const State& state, double position_m, double velocity_m_s) const {
    Filter filter(settings, kernel());
    EXPECT_TRUE(filter.initialise({epoch, state, diagonal_covariance(position_m, velocity_m_s)}));
    return filter;
  }
};

// theta, with the sign that measurement.h states, moves the pixel as H_theta says; together with its correlation to the
// centroid's error the innovation has the covariance that R claims. 4,000 draws: each ratio is off by 2.2 % (1 sigma).
TEST_F(FilterUpdate, NoiseHasTheAttitudesCovarianceAndTheCrossTermsSign) {
  RandomStream random({.seed = 11, .purpose = "R"});
  const Vec3 direction = exact_direction(truth, body::mars, epoch);
  const Mat3 R = pointed_at(direction, settings.camera, {300.0, 200.0}, 0.4);
  const Vec2 exact = project(settings.camera, R * direction).value().vec();
  // Errors of centroid (2) and attitude (3) with a strong correlation.
  Eigen::Matrix<double, 5, 5> root = Eigen::Matrix<double, 5, 5>::Zero();
  root.diagonal() << 0.05, 0.05, 1e-5, 1e-5, 5e-5;
  root(2, 1) = 1.2e-5;
  root(3, 0) = -1.5e-5;
  root(4, 0) = 2e-5;
  const Eigen::Matrix<double, 5, 5> joint = root * root.transpose();
  Mat2 sum = Mat2::Zero();
  UpdateResult result;
  const int draws = 4000;
  for (int i = 0; i < draws; ++i) {
    Eigen::Matrix<double, 5, 1> white;
    for (double& x : white) x = random.normal();
    const Eigen::Matrix<double, 5, 1> e = root * white;
    BeaconMeasurement m;
    m.body = body::mars;
    m.mid_exposure = epoch;
    m.pixel = {exact.x() + e[0], exact.y() + e[1]};
    m.pixel_covariance_px2 = joint.topLeftCorner<2, 2>();
    m.R_CN = rotation_exp(Vec3(e.tail<3>())) * R;
    m.attitude_covariance_rad2 = joint.bottomRightCorner<3, 3>();
    m.pixel_attitude_covariance = joint.topRightCorner<2, 3>();
    Filter filter = started(truth, 1.0, 1e-6);
    result = filter.update(m);
    sum += result.innovation_px * result.innovation_px.transpose() / draws;
  }
  const Mat2 whitened = result.innovation_covariance_px2.inverse() * sum;
  EXPECT_NEAR(whitened(0, 0), 1.0, 0.09);
  EXPECT_NEAR(whitened(1, 1), 1.0, 0.09);
  EXPECT_NEAR(whitened.trace(), 2.0, 0.13);
}

TEST_F(FilterUpdate, IterationFindsTheWayFromAHundredThousandKilometres) {
  RandomStream random({.seed = 3, .purpose = "far"});
  double once = 0.0, iterated = 0.0;
  for (int i = 0; i < 20; ++i) {
    State guess = truth;
    for (double& p : guess.p_m) p += 1e8 * random.normal();
    for (const int iterations : {1, 4}) {
      settings.max_iterations = iterations;
      Filter filter = started(guess, 1e8, 100.0);
      // The Earth is near (8e5 km): a bent sight.
      const UpdateResult r = filter.update(
          photograph(truth, body::earth, epoch, settings.camera, {.pixel = 0.01, .cross = 0.0, .roll = 0.0}, nullptr));
      if (!r.accepted) continue;
      const Vec3 sight = (barycentric(body::earth, epoch).p_m - truth.p_m).normalized();
      const double across = sight.cross(filter.state().p_m - truth.p_m).norm();
      (iterations == 1 ? once : iterated) += across;
    }
  }
  EXPECT_LT(iterated, 0.3 * once);
}

TEST_F(FilterUpdate, EditsAWildMeasurementAndSaysWhy) {
  Filter filter = started(truth, 1e6, 1.0);
  BeaconMeasurement m = photograph(truth, body::mars, epoch, settings.camera, {}, nullptr);
  m.pixel.u += 5.0;
  const StateVector before = filter.state_vector();
  UpdateResult r = filter.update(m);
  EXPECT_FALSE(r.accepted);
  EXPECT_EQ(r.reason, UpdateReason::gated);
  EXPECT_GT(r.nis, 18.42);
  EXPECT_NEAR(r.innovation_px.x(), 5.0, 1e-3);
  EXPECT_EQ(filter.state_vector(), before);
  m.pixel.u -= 5.0;
  EXPECT_TRUE(filter.update(m).accepted);

  m.pixel.u = std::nan("");
  EXPECT_EQ(filter.update(m).reason, UpdateReason::bad_measurement);
  m = photograph(truth, body::mars, epoch, settings.camera, {}, nullptr);
  m.pixel_covariance_px2 = -Mat2::Identity();
  EXPECT_EQ(filter.update(m).reason, UpdateReason::bad_measurement);
  m = photograph(truth, body::mars, epoch, settings.camera, {}, nullptr);
  m.R_CN = Vec3(1.0, -1.0, -1.0).asDiagonal() * m.R_CN;
  EXPECT_EQ(filter.update(m).reason, UpdateReason::out_of_view);
  m.mid_exposure = epoch - Duration::seconds(1.0);
  EXPECT_EQ(filter.update(m).reason, UpdateReason::before_filter);
  m.mid_exposure = epoch;
  m.body = BodyId{2000001};
  EXPECT_EQ(filter.update(m).reason, UpdateReason::no_ephemeris);
}

TEST_F(FilterUpdate, RecoversWhenAWholeWindowDisagrees) {
  State wrong = truth;
  wrong.p_m += Vec3(3e8, -2e8, 1e8);  // 370 sigma
  Filter filter = started(wrong, 1e6, 0.1);
  RandomStream random({.seed = 4, .purpose = "recovery"});
  State now = truth;
  Epoch at = epoch;
  int recovered_at = -1, accepted = 0;
  for (int image = 0; image < 2 * kImages; ++image) {
    const Epoch next = epoch + kImagePeriod * (image + 1);
    now = fly(now, at, next - at);
    at = next;
    const BodyId beacon = image < kImages ? body::mars : body::jupiter;
    const UpdateResult r = filter.update(photograph(now, beacon, at, settings.camera, {}, &random));
    if (r.recovered && recovered_at < 0) recovered_at = image;
    accepted += r.accepted;
  }
  EXPECT_EQ(recovered_at, settings.recovery_rejections - 1);
  EXPECT_GT(accepted, 30);
  EXPECT_LT(squared_error(filter, now), 60.0);
}

// A spot that jumps about from image to image is not a reason to doubt oneself.
TEST_F(FilterUpdate, DoesNotRecoverForScatteredNonsense) {
  Filter filter = started(truth, 1e6, 0.1);
  RandomStream random({.seed = 6, .purpose = "nonsense"});
  for (int image = 0; image < 100; ++image) {
    BeaconMeasurement m = photograph(truth, body::mars, epoch, settings.camera, {}, nullptr);
    m.pixel.u += random.uniform(50.0, 200.0);
    m.pixel.v += random.uniform(-100.0, 100.0);
    const UpdateResult r = filter.update(m);
    EXPECT_FALSE(r.accepted);
    EXPECT_FALSE(r.recovered);
  }
}

TEST_F(FilterUpdate, StartsTheBiasAnewForAnotherBeaconAndAfterAGap) {
  settings.bias = {.sigma = 0.1, .tau_s = 12.0 * 3600.0};
  settings.beacon_errors[0] = {.body = body::jupiter, .ephemeris_m = 5e7};
  Filter filter = started(truth, 1e4, 0.01);
  const auto look = [&](BodyId body, double seconds) {
    const Epoch at = epoch + Duration::seconds(seconds);
    return filter.update(photograph(fly(truth, epoch, Duration::seconds(seconds)), body, at, settings.camera,
                                    {.cross = 0, .roll = 0}, nullptr));
  };
  const auto bias_sigma = [&] { return std::sqrt(filter.covariance()(index::bias, index::bias)); };
  EXPECT_TRUE(look(body::mars, 100).window_started);
  EXPECT_LT(bias_sigma(), 0.06);  // seen through one image of 0.05 px
  EXPECT_FALSE(look(body::mars, 200).window_started);
  EXPECT_LT(bias_sigma(), 0.04);
  EXPECT_TRUE(look(body::mars, 1200).window_started);  // gap
  EXPECT_GT(bias_sigma(), 0.04);
  const UpdateResult r = look(body::jupiter, 1300);
  EXPECT_TRUE(r.window_started);
  // Bias and the ephemeris' share of it, plus noise: all that makes S (the state is known).
  const double by_ephemeris = 5e7 / filter.predict_direction(body::jupiter)->distance_m * settings.camera.fx_px;
  EXPECT_NEAR(std::sqrt(r.innovation_covariance_px2(0, 0)),
              std::sqrt(0.05 * 0.05 + 0.1 * 0.1 + by_ephemeris * by_ephemeris), 1e-3);
}

// The attitude's share that the same stars bring again is not averaged away: 36 images leave it in the bias.
TEST_F(FilterUpdate, WhatTheStarsBringAgainIsCarriedInTheBias) {
  settings.bias = {.sigma = 0.0, .tau_s = 12.0 * 3600.0};
  const double across_rad = 1e-5, repeating_px = 0.5 * across_rad * settings.camera.fx_px;
  for (const bool repeats : {false, true}) {
    Filter filter = started(truth, 1e4, 0.01);
    UpdateResult first, last;
    for (int i = 0; i < 36; ++i) {
      const Duration later = Duration::seconds(100.0 * i);
      BeaconMeasurement m =
          photograph(fly(truth, epoch, later), body::mars, epoch + later, settings.camera, {}, nullptr);
      m.attitude_covariance_rad2 = Vec3(across_rad * across_rad, across_rad * across_rad, 0.0).asDiagonal();
      if (repeats) m.attitude_repeating_rad2 = 0.25 * m.attitude_covariance_rad2;
      last = filter.update(m);
      if (i == 0) first = last;
    }
    const double before = first.innovation_covariance_px2(0, 0), after = last.innovation_covariance_px2(0, 0);
    const double bias_px = std::sqrt(filter.covariance()(index::bias, index::bias));
    // One image is as uncertain either way.
    EXPECT_NEAR(std::sqrt(before), std::hypot(0.05, across_rad * settings.camera.fx_px), 3e-3) << repeats;
    EXPECT_GT(after, 0.5 * before);
    if (repeats) {
      EXPECT_GT(bias_px, 0.1 * repeating_px);
      EXPECT_LT(bias_px, repeating_px);
    } else {
      EXPECT_EQ(bias_px, 0.0);
    }
  }
}

// Windows of one beacon that follow each other closely are much alike: none of them alone is worth what the first was.
TEST_F(FilterUpdate, AWindowThatResemblesTheLastIsWorthLess) {
  settings.bias = {.sigma = 0.1, .tau_s = 12.0 * 3600.0};
  settings.window_memory = Duration::days(3.0);
  Filter filter = started(truth, 1e4, 0.01);
  const auto bias_after = [&](BodyId body, double days) {
    const Duration later = Duration::days(days);
    const State there = fly(truth, epoch, later);
    const UpdateResult r = filter.update(photograph(there, body, epoch + later, settings.camera, {}, nullptr));
    EXPECT_TRUE(r.window_started);
    // All of the innovation but the state's and the image's noise.
    return r.innovation_covariance_px2(0, 0) - r.noise_covariance_px2(0, 0);
  };
  const double first = bias_after(body::mars, 0.001), other = bias_after(body::jupiter, 0.02);
  const double again = bias_after(body::mars, 1.001), alike = std::exp(-1.0 / 3.0);
  EXPECT_NEAR(first, 0.01, 2e-3);
  EXPECT_NEAR(other, 0.01, 2e-3);
  EXPECT_NEAR(again, 0.01 * (1.0 + alike) / (1.0 - alike), 5e-3);
}

// The beacon seen an hour ago, and no other between: what its bias is known to be still holds.
TEST_F(FilterUpdate, AWindowOfTheSameBeaconGoesOnAfterAPause) {
  settings.bias = {.sigma = 0.1, .tau_s = 12.0 * 3600.0};
  settings.window_memory = Duration::days(3.0);
  Filter filter = started(truth, 10.0, 1e-5);
  const auto look = [&](double hours) {
    const Duration later = Duration::seconds(3600.0 * hours);
    return filter.update(photograph(fly(truth, epoch, later), body::mars, epoch + later, settings.camera, {}, nullptr));
  };
  const auto but_for_noise = [](const UpdateResult& r) {
    return r.innovation_covariance_px2(0, 0) - r.noise_covariance_px2(0, 0);
  };
  const UpdateResult first = look(0.1), after_an_hour = look(1.1), next_day = look(25.0);
  EXPECT_TRUE(first.window_started);
  EXPECT_FALSE(after_an_hour.window_started);
  EXPECT_LT(but_for_noise(after_an_hour), 0.5 * but_for_noise(first));
  EXPECT_TRUE(next_day.window_started);
  EXPECT_GT(but_for_noise(next_day), but_for_noise(first));
}

// What one image of a window is told to repeat, and the first was not, is noise: no window begins anew.
TEST_F(FilterUpdate, WhatOneImageRepeatsBeyondItsWindowIsNoise) {
  settings.bias = {.sigma = 0.01, .tau_s = 12.0 * 3600.0};
  Filter filter = started(truth, 1e4, 0.01);
  const auto look = [&](double seconds, double repeating_px) {
    const Duration later = Duration::seconds(seconds);
    BeaconMeasurement m = photograph(fly(truth, epoch, later), body::mars, epoch + later, settings.camera, {}, nullptr);
    m.repeating_sigma_px = repeating_px;
    return filter.update(m).noise_covariance_px2(0, 0);
  };
  const double plain = look(100.0, 0.02);
  EXPECT_NEAR(look(200.0, 0.02), plain, 1e-6);
  EXPECT_NEAR(look(300.0, 0.3), plain + 0.3 * 0.3 - 0.02 * 0.02, 1e-6);
  EXPECT_NEAR(look(400.0, 0.01), plain, 1e-6);
  EXPECT_NEAR(look(5000.0, 0.3), plain, 1e-6);  // another window: all of it is in its bias
}

// A scattering law that is wrong by 5 % where 7 % are allowed for: learnt in one window, known in the next, of no
// concern to another planet.
TEST_F(FilterUpdate, LearnsHowFarTheLightStandsFromTheCentre) {
  settings.sight.centre_of_light = true;
  settings.beacon_errors[0] = {.body = body::mars, .photocentre_fraction = 0.07};
  settings.beacon_errors[1] = {.body = body::venus, .photocentre_fraction = 0.07};
  Filter filter = started(truth, 1e3, 0.001);
  SightSettings real = settings.sight;
  real.centre_of_light_scale = 1.05;
  const double radius_m = body_constants(body::mars).value().mean_radius_m;
  RandomStream random({.seed = 12, .purpose = "photocentre"});
  constexpr double kNoisePx = 1e-3;
  const auto look = [&](double seconds) {
    const Epoch at = epoch + Duration::seconds(seconds);
    const State here = fly(truth, epoch, Duration::seconds(seconds));
    const Sight sight =
        apparent_sight(here, barycentric(body::mars, at), barycentric(body::sun, at).p_m, radius_m, real);
    BeaconMeasurement m;
    m.body = body::mars;
    m.mid_exposure = at;
    m.R_CN = pointed_at(sight.direction_N, settings.camera, {40.0, -30.0}, 0.7);
    const Vec2 pixel = predict_pixel(sight, m.R_CN, settings.camera, Eigen::Vector4d::Zero()).value().pixel +
                       kNoisePx * Vec2(random.normal(), random.normal());
    m.pixel = {pixel.x(), pixel.y()};
    m.pixel_covariance_px2 = kNoisePx * kNoisePx * Mat2::Identity();
    return filter.update(m);
  };
  const double shift_px =
      apparent_sight(truth, barycentric(body::mars, epoch), barycentric(body::sun, epoch).p_m, radius_m, real)
          .shift_N.norm() *
      settings.camera.fx_px;
  const auto sigma = [&](int beacon) {
    return std::sqrt(filter.covariance()(index::photocentre + beacon, index::photocentre + beacon));
  };
  for (int k = 1; k <= 400; ++k) EXPECT_TRUE(look(10.0 * k).accepted);
  const double expected = 1.0 / std::hypot(1.0 / 0.07, std::sqrt(400.0) * shift_px / kNoisePx);
  EXPECT_NEAR(sigma(0), expected, 0.1 * expected);  // state and attitude are known: only the shift is to be learnt
  EXPECT_NEAR(filter.state_vector()[index::photocentre], 0.05, 3.0 * sigma(0));
  const double before = sigma(0);
  EXPECT_TRUE(look(6000.0).window_started);
  EXPECT_LE(sigma(0), 1.01 * before);
  EXPECT_NEAR(sigma(1), 0.07, 1e-4);
}

TEST_F(FilterUpdate, PredictsADirectionWithItsCovariance) {
  settings.beacon_errors[0] = {.body = body::mars, .ephemeris_m = 3e6};
  const Filter filter = started(truth, 1e7, 100.0);
  const DirectionPrediction p = filter.predict_direction(body::mars).value();
  EXPECT_LT(angle_between(p.direction_N, exact_direction(truth, body::mars, epoch)) / kMilliarcsecond, 1.0);
  const double sigma = std::sqrt(p.covariance.trace() / 2.0);  // two directions across
  EXPECT_NEAR(sigma, std::hypot(std::hypot(1e7, 3e6) / p.distance_m, 100.0 / kSpeedOfLight), 1e-3 * sigma);
  EXPECT_LT(std::abs(p.direction_N.dot(p.covariance * p.direction_N)),
            1e-6 * sigma * sigma);  // nothing along the sight
  EXPECT_EQ(filter.predict_direction(BodyId{2000001}).error().code, ErrorCode::not_found);
}

// Noise twice what the measurements claim (scale 4): learnt to 15 % from 1,000 residuals (1 sigma 3 %).
TEST_F(FilterUpdate, AdaptiveNoiseLearnsTheScale) {
  settings.adaptive_noise = true;
  settings.gate_probability = 1.0;
  settings.adaptive_prior_count = 20.0;
  Filter filter = started(truth, 1e7, 100.0);
  RandomStream random({.seed = 8, .purpose = "adaptive"});
  State now = truth;
  for (int image = 1; image <= 1000; ++image) {
    const Epoch at = epoch + Duration::seconds(100.0 * image);
    now = fly(now, at - Duration::seconds(100.0), Duration::seconds(100.0));
    BeaconMeasurement m =
        photograph(now, body::mars, at, settings.camera, {.pixel = 0.1, .cross = 0, .roll = 0}, &random);
    m.pixel_covariance_px2 = 0.05 * 0.05 * Mat2::Identity();
    EXPECT_TRUE(filter.update(m).accepted);
  }
  EXPECT_NEAR(filter.noise_scale(body::mars), 4.0, 0.6);
  EXPECT_EQ(filter.noise_scale(body::venus), 1.0);
}

// Where nothing bends it does not matter along which way the mean is carried; what has not begun elsewhere is the same
// to the last digits.
TEST_F(FilterUpdate, CarriedBesideAnotherWayTheMeanIsTheSame) {
  const Filter filter = started(truth, 1e5, 0.1);
  const auto flown = [&](const Vec3& aside_m, const Vec3& aside_m_s) {
    Filter other = filter;
    State from = filter.state();
    from.p_m += aside_m;
    from.v_m_s += aside_m_s;
    other.fly_beside(from);
    State now = truth;
    Epoch at = epoch;
    for (int image = 0; image < 8; ++image) {
      const Epoch next = epoch + Duration::days(2.0) + kImagePeriod * image;
      now = fly(now, at, next - at);
      at = next;
      const BodyId beacon = image < 4 ? body::mars : body::jupiter;
      EXPECT_TRUE(other.update(photograph(now, beacon, at, settings.camera, {}, nullptr)).accepted);
    }
    other.join();
    return other;
  };
  const Filter own = flown(Vec3::Zero(), Vec3::Zero()), near = flown(Vec3(2e6, -1e6, 5e5), Vec3(0.5, 1.0, -0.3));
  const Vec6 sigma = own.covariance_pv().diagonal().cwiseSqrt();
  const Vec3 off = near.state().p_m - own.state().p_m;
  EXPECT_LT(off.cwiseQuotient(sigma.head<3>()).norm(), 0.01);
  EXPECT_TRUE(near.covariance_pv().isApprox(own.covariance_pv(), 1e-3));
  // Sensitivity: where the way ends, less where that of the mean does.
  Filter way = filter;
  State from = filter.state();
  from.v_m_s.x() += 1.0;
  way.fly_beside(from);
  ASSERT_TRUE(way.propagate_to(filter.epoch() + Duration::days(2.0)));
  Filter mean = filter;
  ASSERT_TRUE(mean.propagate_to(way.epoch()));
  const Vec3 moved = way.state().p_m - mean.state().p_m;
  EXPECT_LT((moved - way.sensitivity().block<3, 1>(0, 3)).norm(), 1e-5 * moved.norm());
}

TEST_F(FilterUpdate, AKickMovesVelocityAndItsCovarianceAlone) {
  Filter filter = started(truth, 1e6, 0.1);
  const Mat6 before = filter.covariance_pv();
  const Vec3 push(0.3, -0.2, 0.1);
  ASSERT_TRUE(filter.kick(push, 0.05));
  EXPECT_LT((filter.state().v_m_s - truth.v_m_s - push).norm(), 1e-9);
  EXPECT_LT((filter.state().p_m - truth.p_m).norm(), 1e-3);
  Mat6 expected = before;
  expected.diagonal().tail<3>().array() += 0.05 * 0.05;
  EXPECT_LT((filter.covariance_pv() - expected).cwiseAbs().maxCoeff(), 1e-9 * before.maxCoeff());
  EXPECT_FALSE(filter.kick(push, -1.0));
  EXPECT_FALSE(filter.kick(push * std::nan(""), 0.1));
}

TEST_F(FilterUpdate, RefusesAnImpossibleStart) {
  Filter filter(settings, kernel());
  Mat6 P = diagonal_covariance(1e7, 100.0);
  P(0, 1) = P(1, 0) = 2e14;
  EXPECT_EQ(filter.initialise({epoch, truth, P}).error().code, ErrorCode::invalid_argument);
  EXPECT_FALSE(filter.initialise({epoch, truth, diagonal_covariance(1e7, 100.0), 0.0, 0.0}));
  ASSERT_TRUE(filter.initialise({epoch, truth, diagonal_covariance(1e7, 100.0)}));
  EXPECT_EQ(filter.propagate_to(epoch - Duration::seconds(1.0)).error().code, ErrorCode::invalid_argument);
  EXPECT_EQ(filter.propagate_to(Epoch::parse("2055-01-01 TDB").value()).error().code, ErrorCode::out_of_range);
  EXPECT_GT(filter.epoch(), Epoch::parse("2049-01-01 TDB").value());  // as far as it could
}

}  // namespace
}  // namespace astronav::navigation
