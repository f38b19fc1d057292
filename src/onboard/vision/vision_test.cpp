// SPDX-License-Identifier: Apache-2.0
#include "onboard/vision/vision.h"

#include <atomic>
#include <cmath>
#include <cstdlib>
#include <new>
#include <tuple>

#include <gtest/gtest.h>

#include "foundation/files/mapped_file.h"
#include "foundation/math/rotation.h"
#include "foundation/math/statistics.h"
#include "models/aberration/aberration.h"
#include "onboard/vision/sky_scene_for_tests.h"

namespace astronav::vision::testing {
std::atomic<bool> g_counting{false};
std::atomic<long> g_allocations{0};
}  // namespace astronav::vision::testing

// Every allocation of this program passes here. (g++ 12 sees the malloc through the inlined operator and warns.)
#pragma GCC diagnostic ignored "-Wmismatched-new-delete"
void* operator new(std::size_t size) {
  if (astronav::vision::testing::g_counting) ++astronav::vision::testing::g_allocations;
  if (void* p = std::malloc(size)) return p;
  std::abort();
}
void operator delete(void* p) noexcept {
  std::free(p);
}
void operator delete(void* p, std::size_t) noexcept {
  std::free(p);
}

namespace astronav::vision {
namespace {

using namespace testing;

TEST(Vision, FindsItsWayFromNothing) {
  const Truth truth;
  Vision vision({}, camera20(), testing::believed(truth), sky().field, sky().index);
  RandomStream random(StreamId{.seed = 7, .purpose = "lost in space"});
  constexpr int kFrames = 25;
  int solved = 0;
  double chi2 = 0.0, worst_cross = 0.0, matched = 0.0;
  std::vector<double> total_ms, centroid_ms, identify_ms;
  double worst_ms = 0.0;
  for (int k = 0; k < kFrames; ++k) {
    Scene scene{moving(), random_attitude(random)};
    paint(scene, truth, camera20(), random);
    const FrameResult& result = vision.process(scene.image, scene.observer);
    if (result.source == AttitudeSource::none) continue;
    ++solved;
    const Vec3 theta = -rotation_log(scene.R_CN * result.attitude.R_CN.transpose());
    worst_cross = std::max(worst_cross, theta.head<2>().norm());
    chi2 += theta.dot(result.attitude.covariance_rad2.inverse() * theta);
    matched += static_cast<double>(result.stars.size());
    total_ms.push_back(result.time_ms.total);
    centroid_ms.push_back(result.time_ms.centroid);
    identify_ms.push_back(result.time_ms.identify);
    worst_ms = std::max(worst_ms, result.time_ms.total);
  }
  std::printf(
      "  %d of %d, %.0f stars a frame, chi2/3 %.3f, worst cross-axis %.2f arcsec; ms: centroid %.2f identify %.2f "
      "total %.2f worst %.2f\n",
      solved, kFrames, matched / solved, chi2 / (3.0 * solved), worst_cross / kArcsecond, median(centroid_ms),
      median(identify_ms), median(total_ms), worst_ms);
  EXPECT_EQ(solved, kFrames);
  EXPECT_LT(worst_cross, 1.5 * kArcsecond);
  // False alarm 1 in 1000.
  EXPECT_TRUE(chi_square_mean_band(0.999, 3, solved).contains(chi2 / solved)) << chi2 / solved;
}

TEST(Vision, FollowsAPriorAndAllocatesNothing) {
  const Truth truth;
  Vision vision({}, camera20(), testing::believed(truth), sky().field, sky().index);
  RandomStream random(StreamId{.seed = 8, .purpose = "prior"});
  for (int k = 0; k < 5; ++k) {
    Scene scene{moving(), random_attitude(random)};
    paint(scene, truth, camera20(), random);
    const Mat3 prior =
        rotation_exp(Vec3(random.normal(), random.normal(), random.normal()) * 100.0 * kArcsecond) * scene.R_CN;
    g_allocations = 0;
    g_counting = true;
    const FrameResult& tracked = vision.process(scene.image, scene.observer, prior);
    const long with_prior = g_allocations;
    const AttitudeSource source = tracked.source;
    const double ms = tracked.time_ms.total;
    EXPECT_FALSE(tracked.whole);
    const Vec3 theta = -rotation_log(scene.R_CN * tracked.attitude.R_CN.transpose());
    // False alarm 1 in 100,000 for each of five.
    EXPECT_LT(theta.dot(tracked.attitude.covariance_rad2.inverse() * theta), 25.9);
    const FrameResult& lost = vision.process(scene.image, scene.observer);
    g_counting = false;
    EXPECT_EQ(source, AttitudeSource::prior);
    EXPECT_EQ(lost.source, AttitudeSource::lost_in_space);
    EXPECT_EQ(with_prior, 0);
    EXPECT_EQ(g_allocations, 0);
    std::printf("  tracked in %.2f ms\n", ms);
  }
}

// The spots about what is expected are those that a look at the whole frame finds there.
TEST(Vision, SeesThePartsAsItSeesTheWhole) {
  const Truth truth;
  Vision parts({}, camera20(), testing::believed(truth), sky().field, sky().index);
  VisionSettings everywhere;
  everywhere.guide_stars = 0;
  Vision whole(everywhere, camera20(), testing::believed(truth), sky().field, sky().index);
  RandomStream random(StreamId{.seed = 12, .purpose = "parts"});
  for (int k = 0; k < 3; ++k) {
    Scene scene{moving(), random_attitude(random)};
    paint(scene, truth, camera20(), random);
    const FrameResult& some = parts.process(scene.image, scene.observer, scene.R_CN);
    const FrameResult& all = whole.process(scene.image, scene.observer, scene.R_CN);
    ASSERT_FALSE(some.whole);
    ASSERT_TRUE(all.whole);
    EXPECT_GT(some.stars.size(), 30u);
    EXPECT_LT(some.centroids.size(), all.centroids.size());
    for (const MatchedStar& star : some.stars) {
      const Centroid& spot = some.centroids[star.centroid];
      bool found = false;
      for (const Centroid& other : all.centroids) {
        // Level and belief differ a little, and what they move a spot by is far below its noise.
        const Vec2 off = other.pixel.vec() - spot.pixel.vec();
        found |= off.norm() < 0.2 * std::sqrt(spot.covariance_px2.trace()) && other.pixels == spot.pixels;
      }
      EXPECT_TRUE(found) << "star " << star.id << " at " << spot.pixel.u << ", " << spot.pixel.v;
    }
  }
}

// A prior that is wrong by a degree, and a sky that no level fits: the whole frame is looked at.
TEST(Vision, LooksAtTheWholeWhereThePartsDoNotConvince) {
  const Truth truth;
  Vision vision({}, camera20(), testing::believed(truth), sky().field, sky().index);
  RandomStream random(StreamId{.seed = 13, .purpose = "whole"});
  Scene scene{moving(), random_attitude(random)};
  paint(scene, truth, camera20(), random);
  const Mat3 wrong = rotation_exp(Vec3(0.0, 1.0 * kDegree, 0.0)) * scene.R_CN;
  const FrameResult& lost = vision.process(scene.image, scene.observer, wrong);
  EXPECT_TRUE(lost.whole);
  EXPECT_EQ(lost.source, AttitudeSource::lost_in_space);
  for (int v = 0; v < 1024; ++v) {
    for (int u = 0; u < 1024; ++u) scene.image(u, v) = static_cast<std::uint16_t>(scene.image(u, v) + u / 8);
  }
  const FrameResult& uneven = vision.process(scene.image, scene.observer, scene.R_CN);
  EXPECT_TRUE(uneven.whole);
  EXPECT_EQ(uneven.source, AttitudeSource::prior);
}

// A saturated Jupiter and a faint Mars, predicted with the error of 1e5 km (3 sigma) at 1 AU.
TEST(Vision, FindsPlanetsWhereTheyArePredicted) {
  const Truth truth;
  const Intrinsics camera = camera20();
  Vision vision({}, camera, testing::believed(truth), sky().field, sky().index);
  RandomStream random(StreamId{.seed = 9, .purpose = "planets"});
  constexpr double kSigma = 1e8 / 3.0 / 1.5e11;
  constexpr int kFrames = 12;
  double chi2 = 0.0;
  int found = 0;
  for (int k = 0; k < kFrames; ++k) {
    Scene scene{moving(), random_attitude(random)};
    const Source planets[2] = {{{random.uniform(50, 970), random.uniform(50, 970)}, 2.3e7},
                               {{random.uniform(50, 970), random.uniform(50, 970)}, 4e5}};
    paint(scene, truth, camera, random, planets);
    PlanetPrediction predictions[2];
    for (int i = 0; i < 2; ++i) {
      const Vec3 direction = scene.R_CN.transpose() * *unproject(camera, planets[i].pixel);
      const Vec3 off(random.normal(), random.normal(), random.normal());
      predictions[i] = prediction_of(i == 0 ? body::jupiter : body::mars, (direction + kSigma * off).normalized(),
                                     kSigma, planets[i].electrons, truth);
    }
    // Another sky altogether: what was seen an hour ago is forgotten.
    scene.observer.epoch = scene.observer.epoch + Duration::days(k);
    const FrameResult& result = vision.process(scene.image, scene.observer, {}, predictions);
    ASSERT_EQ(result.planets.size(), 2u);
    for (int i = 0; i < 2; ++i) {
      if (!result.planets[i].found) continue;
      ++found;
      chi2 += result.planets[i].mahalanobis;
      const Vec2 error = result.centroids[result.planets[i].centroid].pixel.vec() - planets[i].pixel.vec();
      EXPECT_LT(error.norm(), 0.05);
    }
  }
  EXPECT_GE(found, 2 * kFrames - 1);  // a star on top of a planet spoils 1 in 50
  EXPECT_TRUE(chi_square_mean_band(0.999, 2, found).contains(chi2 / found)) << chi2 / found;
}

// The Moon, a fortieth of the Earth's light, from the same pixel to beyond the Earth's wings; both saturated or the
// Moon not. Where they stand in one spot only the foretold offset, wrong by what 1e5 km make of it, tells them apart.
TEST(Vision, NamesTheEarthAndTheMoonInOneSpot) {
  const Truth truth{.halo_fraction = 0.015};
  const Intrinsics camera = camera20();
  Vision vision({}, camera, testing::believed(truth), sky().field, sky().index);
  RandomStream random(StreamId{.seed = 12, .purpose = "Earth and Moon"});
  constexpr double kSigma = 1e8 / 3.0 / 1.0e11;
  double chi2 = 0.0;
  int found = 0;
  for (int k = 0; k < 12; ++k) {
    Scene scene{moving(), random_attitude(random)};
    const double apart_px = 2.0 * k, angle = random.uniform(0.0, 2.0 * kPi), earth_e = k % 2 == 0 ? 1.5e7 : 6e7;
    Source both[2] = {{{random.uniform(80, 940), random.uniform(80, 940)}, earth_e}, {{}, earth_e / 40.0}};
    both[1].pixel = {both[0].pixel.u + apart_px * std::cos(angle), both[0].pixel.v + apart_px * std::sin(angle)};
    paint(scene, truth, camera, random, both);
    const Vec3 off = kSigma * Vec3(random.normal(), random.normal(), random.normal());
    PlanetPrediction predictions[2];
    for (int i = 0; i < 2; ++i) {
      const Vec3 direction = scene.R_CN.transpose() * *unproject(camera, both[i].pixel);
      predictions[i] = prediction_of(i == 0 ? body::earth : body::moon, (direction + off).normalized(), kSigma,
                                     both[i].electrons * std::pow(10.0, 0.06 * random.normal()), truth);
    }
    for (int i = 0; i < 2; ++i) {
      predictions[i].companion_direction_N = predictions[1 - i].direction_N;
      predictions[i].companion_flux_dn = predictions[1 - i].expected_flux_dn;
    }
    scene.observer.epoch = scene.observer.epoch + Duration::days(k);
    const FrameResult& result = vision.process(scene.image, scene.observer, {}, predictions);
    for (int i = 0; i < 2; ++i) {
      ASSERT_TRUE(result.planets[i].found) << apart_px << " px, body " << i;
      const Centroid& spot = result.centroids[result.planets[i].centroid];
      const Vec2 error = spot.pixel.vec() - both[i].pixel.vec();
      EXPECT_LT(error.norm(), 0.1) << apart_px << " px, body " << i;
      chi2 += error.dot(spot.covariance_px2.inverse() * error);
      ++found;
    }
  }
  // Two bodies of one fit share their errors: as if half of them were there.
  EXPECT_LT(chi2 / found, chi_square_mean_band(0.999, 2, found / 2).hi);
}

// A disc of 3 to 30 px, half of it lit, far from saturation: at its centre of light.
TEST(Vision, FindsADiscWhereItIsPredicted) {
  const Truth truth;
  const Intrinsics camera = camera20();
  Vision vision({}, camera, testing::believed(truth), sky().field, sky().index);
  RandomStream random(StreamId{.seed = 13, .purpose = "discs"});
  constexpr double kSigma = 2e-4;
  constexpr int kRays = 24;
  double chi2 = 0.0;
  constexpr int kFrames = 10;
  for (int k = 0; k < kFrames; ++k) {
    Scene scene{moving(), random_attitude(random)};
    const double radius_px = 1.5 + 1.5 * k, angle = random.uniform(0.0, 2.0 * kPi);
    const Vec2 sunward(std::cos(angle), std::sin(angle));
    const Vec2 middle(random.uniform(80, 940), random.uniform(80, 940));
    // Lit from one side and somewhat from the front; 20,000 electrons in a pixel at most.
    std::vector<Source> disc;
    Vec2 light = Vec2::Zero();
    double sum = 0.0;
    for (int j = -kRays; j <= kRays; ++j) {
      for (int i = -kRays; i <= kRays; ++i) {
        const Vec2 at = Vec2(i, j) / kRays;
        if (at.squaredNorm() >= 1.0) continue;
        const double lit = 0.8 * at.dot(sunward) + 0.6 * std::sqrt(1.0 - at.squaredNorm());
        if (lit <= 0.0) continue;
        const Vec2 pixel = middle + radius_px * at;
        const double electrons = 2e4 * lit * radius_px * radius_px / (kRays * kRays);
        disc.push_back({{pixel.x(), pixel.y()}, electrons});
        light += electrons * pixel;
        sum += electrons;
      }
    }
    light /= sum;
    paint(scene, truth, camera, random, disc);
    const Vec3 direction = scene.R_CN.transpose() * *unproject(camera, {light.x(), light.y()});
    const Vec3 off(random.normal(), random.normal(), random.normal());
    PlanetPrediction mars =
        prediction_of(body::mars, (direction + kSigma * off).normalized(), kSigma, sum * 1.1, truth);
    mars.angular_radius_rad = radius_px / camera.fx_px;
    scene.observer.epoch = scene.observer.epoch + Duration::days(k);
    const FrameResult& result = vision.process(scene.image, scene.observer, {}, {&mars, 1});
    ASSERT_TRUE(result.planets[0].found) << radius_px << " px";
    const Centroid& spot = result.centroids[result.planets[0].centroid];
    const Vec2 error = spot.pixel.vec() - light;
    EXPECT_LT(error.norm(), 0.05) << radius_px << " px";
    chi2 += error.dot(spot.covariance_px2.inverse() * error);
  }
  EXPECT_LT(chi2 / kFrames, chi_square_mean_band(0.999, 2, kFrames).hi);
}

TEST(Vision, NamesNoPlanetWhereThereIsNone) {
  const Truth truth;
  const Intrinsics camera = camera20();
  Vision vision({}, camera, testing::believed(truth), sky().field, sky().index);
  RandomStream random(StreamId{.seed = 10, .purpose = "no planets"});
  for (int k = 0; k < 6; ++k) {
    Scene scene{moving(), random_attitude(random)};
    paint(scene, truth, camera, random);
    PlanetPrediction predictions[8];
    for (PlanetPrediction& p : predictions)
      p = prediction_of(body::mars,
                        scene.R_CN.transpose() * *unproject(camera, {random.uniform(50, 970), random.uniform(50, 970)}),
                        2e-4, 4e5, truth);
    for (const PlanetMatch& match : vision.process(scene.image, scene.observer, {}, predictions).planets)
      EXPECT_FALSE(match.found);
  }
}

// Neither noise nor a sky of invented stars is ever given an attitude.
TEST(Vision, NoAttitudeFromNonsense) {
  const Truth truth;
  Vision vision({}, camera20(), testing::believed(truth), sky().field, sky().index);
  RandomStream random(StreamId{.seed = 11, .purpose = "nonsense"});
  for (int k = 0; k < 8; ++k) {
    ImageF electrons(1024, 1024, 0.0f);
    ImageU16 image(1024, 1024);
    for (int i = 0; i < 25 * k; ++i)
      add_source(electrons, truth, random.uniform(5, 1018), random.uniform(5, 1018),
                 2e3 * std::pow(10.0, random.uniform(0, 2.5)));
    expose(electrons, truth, random, image);
    EXPECT_EQ(vision.process(image, moving()).source, AttitudeSource::none) << k;
  }
}

TEST(Planets, ASpotThatJumpsIsNotBelievedOnce) {
  PlanetMemory memory(4);
  const PlanetSettings settings;
  const Epoch start = Epoch::tdb_seconds(9e8);
  const Vec3 here(1.0, 0.0, 0.0), there = Vec3(1.0, 1e-3, 0.0).normalized();
  const auto after = [&](double s) { return start + Duration::seconds(s); };
  constexpr double kSigma = 1e-6;
  EXPECT_TRUE(memory.agrees(body::mars, here, kSigma, after(0), settings));
  EXPECT_TRUE(memory.agrees(body::mars, Vec3(1.0, 5e-5, 0.0).normalized(), kSigma, after(100), settings));
  EXPECT_TRUE(memory.agrees(body::venus, there, kSigma, after(100), settings));
  EXPECT_FALSE(memory.agrees(body::mars, there, kSigma, after(200), settings));
  EXPECT_TRUE(memory.agrees(body::mars, there, kSigma, after(300), settings));  // it persists
  EXPECT_TRUE(memory.agrees(body::mars, here, kSigma, after(1e5), settings));   // long forgotten
}

// The odds of one spot against another, and against none.
TEST(Planets, ProbabilityWeighsSpotsAndTheirAbsence) {
  AttitudeSolution attitude;
  attitude.intrinsics = camera20();
  PlanetPrediction mars;
  mars.body = body::mars;
  mars.direction_N = Vec3::UnitZ();
  mars.direction_covariance = Mat3::Identity() * 1e-6;  // 2.9 px
  Centroid spot;
  spot.pixel = {512.5, 511.5};
  spot.covariance_px2 = Mat2::Identity() * 1e-4;
  Centroid other = spot;
  other.pixel.u += 2.0;
  const std::vector<Centroid> one{spot}, two{spot, other};
  const std::vector<unsigned char> none{0, 0}, star{0, 1};
  EXPECT_TRUE(find_planet(mars, attitude, one, std::span(none).first(1)).found);
  const PlanetMatch torn = find_planet(mars, attitude, two, none);
  EXPECT_FALSE(torn.found);
  EXPECT_GT(torn.probability, 0.5);
  EXPECT_LT(torn.probability, 0.7);
  EXPECT_TRUE(find_planet(mars, attitude, two, star).found);
  // A gate as wide as the frame: the spot may as well be something else.
  mars.direction_covariance *= 1e4;
  EXPECT_FALSE(find_planet(mars, attitude, one, std::span(none).first(1)).found);
}

TEST(PairIndex, FindsEveryPairAndRefusesBrokenBytes) {
  const PairIndex& index = sky().index;
  RandomStream random(StreamId{.seed = 12, .purpose = "pairs"});
  for (int k = 0; k < 2000; ++k) {
    const auto a = static_cast<std::uint32_t>(random.uniform() * static_cast<double>(index.star_count()));
    const auto b = static_cast<std::uint32_t>(random.uniform() * static_cast<double>(index.star_count()));
    const double cosine = index.direction(a).dot(index.direction(b));
    if (a == b || cosine < std::cos(index.max_angle_rad()) + 1e-6) continue;
    bool listed = false;
    for (const PairIndex::Pair& pair : index.pairs(cosine - 1e-6, cosine + 1e-6))
      listed |= (pair.a == a && pair.b == b) || (pair.a == b && pair.b == a);
    EXPECT_TRUE(listed) << a << ' ' << b;
  }
  std::vector<std::byte> bytes = sky().bytes;
  EXPECT_FALSE(PairIndex::open(std::span(bytes).first(10)));
  EXPECT_FALSE(PairIndex::open(std::span(bytes).first(bytes.size() - 4)));
  bytes[0] = std::byte{'X'};
  EXPECT_FALSE(PairIndex::open(bytes));
  bytes = sky().bytes;
  bytes.back() = std::byte{0xff};  // a star that is not there
  bytes[bytes.size() - 2] = std::byte{0xff};
  EXPECT_FALSE(PairIndex::open(bytes));
}

TEST(Identifier, ChanceIsAnUpperBound) {
  // Against the exact binomial tail.
  for (const auto& [n, k, p] : {std::tuple{20, 5, 0.01}, std::tuple{100, 12, 0.03}, std::tuple{10, 10, 0.2}}) {
    double tail = 0.0;
    for (int i = k; i <= n; ++i)
      tail += std::exp(std::lgamma(n + 1.0) - std::lgamma(i + 1.0) - std::lgamma(n - i + 1.0) + i * std::log(p) +
                       (n - i) * std::log1p(-p));
    EXPECT_GE(chance_of_matches(n, k, p), tail * (1.0 - 1e-9));
    EXPECT_LT(chance_of_matches(n, k, p), 30.0 * tail);
  }
  EXPECT_EQ(chance_of_matches(10, 1, 0.2), 1.0);
}

}  // namespace
}  // namespace astronav::vision
