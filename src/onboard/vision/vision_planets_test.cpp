// SPDX-License-Identifier: Apache-2.0
// Planets that run into stars, into each other and into the frame's edge.
#include <cmath>

#include <gtest/gtest.h>

#include "foundation/math/statistics.h"
#include "onboard/vision/sky_scene_for_tests.h"

namespace astronav::vision {
namespace {

using namespace testing;

constexpr double kSigma = 1e8 / 3.0 / 3e11;  // 1e5 km (3 sigma) at 2 au

// A star between two magnitudes, alone within 14 px and well inside of the frame.
struct Shown {
  Pixel pixel;
  double electrons = 0.0;
};
Shown lonely_star(const Scene& scene, const Intrinsics& camera, double brightest, double faintest) {
  constexpr double kAlonePx = 14.0, kMarginPx = 60.0;
  std::vector<std::pair<Pixel, double>> seen;
  for (const FieldStar& star : sky().field.stars()) {
    const Vec3 direction = scene.R_CN * sky().field.apparent(star, scene.observer);
    const Result<Pixel> p = direction.z() > 0.9 ? project(camera, direction) : Result<Pixel>(Pixel{-100.0, -100.0});
    if (p && camera.contains(*p)) seen.emplace_back(*p, static_cast<double>(star.v_mag));
  }
  for (const auto& [pixel, v] : seen) {
    if (v < brightest || v > faintest || pixel.u < kMarginPx || pixel.v < kMarginPx || pixel.u > 1023 - kMarginPx ||
        pixel.v > 1023 - kMarginPx)
      continue;
    bool alone = true;
    for (const auto& [other, other_v] : seen) {
      const double apart = (other.vec() - pixel.vec()).norm();
      alone &= apart == 0.0 || apart > kAlonePx;
    }
    if (alone) return {pixel, kElectronsV0 * std::pow(10.0, -0.4 * v)};
  }
  return {};
}

Vec3 direction_of(const Scene& scene, const Intrinsics& camera, Pixel pixel) {
  return scene.R_CN.transpose() * *unproject(camera, pixel);
}

PlanetPrediction about(const Scene& scene, const Intrinsics& camera, const Source& body, BodyId id, double sigma,
                       const Truth& truth, RandomStream& random) {
  const Vec3 off(random.normal(), random.normal(), random.normal());
  const double told = body.electrons * std::pow(10.0, 0.06 * random.normal());
  return prediction_of(id, (direction_of(scene, camera, body.pixel) + sigma * off).normalized(), sigma, told, truth);
}

// A faint planet from 1.5 to 7 px beside a star that is as bright or brighter: in one spot with it, in its wings.
TEST(VisionPlanets, NamesAPlanetBesideAStar) {
  const Truth truth{.halo_fraction = 0.015};
  const Intrinsics camera = camera20();
  Vision vision({}, camera, believed(truth), sky().field, sky().index);
  RandomStream random(StreamId{.seed = 14, .purpose = "beside stars"});
  double chi2 = 0.0;
  constexpr int kFrames = 12;
  for (int k = 0; k < kFrames; ++k) {
    Scene scene{moving(), random_attitude(random)};
    const Shown star = k % 2 == 0 ? lonely_star(scene, camera, 4.0, 5.5) : lonely_star(scene, camera, 6.0, 7.0);
    ASSERT_GT(star.electrons, 0.0);
    const double apart_px = 1.5 + 0.5 * k, angle = random.uniform(0.0, 2.0 * kPi);
    const Source planet{{star.pixel.u + apart_px * std::cos(angle), star.pixel.v + apart_px * std::sin(angle)}, 6e3};
    paint(scene, truth, camera, random, {&planet, 1});
    const PlanetPrediction told = about(scene, camera, planet, body::uranus, kSigma, truth, random);
    scene.observer.epoch = scene.observer.epoch + Duration::days(k);
    g_allocations = 0;
    g_counting = true;
    const FrameResult& result = vision.process(scene.image, scene.observer, {}, {&told, 1});
    g_counting = false;
    EXPECT_EQ(g_allocations, 0);
    ASSERT_TRUE(result.planets[0].found) << apart_px << " px";
    const Centroid& spot = result.centroids[result.planets[0].centroid];
    const Vec2 error = spot.pixel.vec() - planet.pixel.vec();
    EXPECT_LT(error.norm(), 0.25) << apart_px << " px";
    chi2 += error.dot(spot.whole_covariance_px2().inverse() * error);
  }
  EXPECT_LT(chi2 / kFrames, chi_square_mean_band(0.999, 2, kFrames).hi);
}

// A star that is twice as bright as the catalogue says is no planet beside a star, nor is the star itself the planet.
TEST(VisionPlanets, TakesNoDoubleStarForAPlanet) {
  const Truth truth{.halo_fraction = 0.015};
  const Intrinsics camera = camera20();
  Vision vision({}, camera, believed(truth), sky().field, sky().index);
  RandomStream random(StreamId{.seed = 15, .purpose = "double stars"});
  for (int k = 0; k < 8; ++k) {
    Scene scene{moving(), random_attitude(random)};
    const Shown star = lonely_star(scene, camera, 6.0, 7.0);
    ASSERT_GT(star.electrons, 0.0);
    const Source companion{{star.pixel.u + 0.05, star.pixel.v}, star.electrons};
    paint(scene, truth, camera, random, {&companion, 1});
    const double apart_px = 0.5 * k, angle = random.uniform(0.0, 2.0 * kPi);
    const Pixel empty{star.pixel.u + apart_px * std::cos(angle), star.pixel.v + apart_px * std::sin(angle)};
    const PlanetPrediction told =
        prediction_of(body::uranus, direction_of(scene, camera, empty), kSigma, star.electrons, truth);
    scene.observer.epoch = scene.observer.epoch + Duration::days(k);
    EXPECT_FALSE(vision.process(scene.image, scene.observer, {}, {&told, 1}).planets[0].found) << apart_px << " px";
  }
}

// A faint planet in the wings of the Earth, of which the Moon's are part.
TEST(VisionPlanets, NamesAThirdBodyBesideTwo) {
  const Truth truth{.halo_fraction = 0.015};
  const Intrinsics camera = camera20();
  Vision vision({}, camera, believed(truth), sky().field, sky().index);
  RandomStream random(StreamId{.seed = 16, .purpose = "three bodies"});
  constexpr BodyId kBodies[3] = {body::earth, body::moon, body::uranus};
  double chi2 = 0.0;
  constexpr int kFrames = 6;
  for (int k = 0; k < kFrames; ++k) {
    Scene scene{moving(), random_attitude(random)};
    const double angle = random.uniform(0.0, 2.0 * kPi);
    const Pixel earth{random.uniform(80, 940), random.uniform(80, 940)};
    const auto beside = [&](double px, double turn) {
      return Pixel{earth.u + px * std::cos(angle + turn), earth.v + px * std::sin(angle + turn)};
    };
    const Source bodies[3] = {{earth, 1.5e7}, {beside(4.0, 0.0), 4e5}, {beside(8.0 + k, 0.5 + k), 1.2e4}};
    paint(scene, truth, camera, random, bodies);
    // The errors of the Earth's and the Moon's places are one.
    constexpr double kNear = 1e8 / 3.0 / 1e11;
    const Vec3 off = kNear * Vec3(random.normal(), random.normal(), random.normal());
    PlanetPrediction told[3];
    for (int i = 0; i < 2; ++i)
      told[i] = prediction_of(kBodies[i], (direction_of(scene, camera, bodies[i].pixel) + off).normalized(), kNear,
                              bodies[i].electrons, truth);
    for (int i = 0; i < 2; ++i) {
      told[i].companion_direction_N = told[1 - i].direction_N;
      told[i].companion_flux_dn = told[1 - i].expected_flux_dn;
    }
    told[2] = about(scene, camera, bodies[2], kBodies[2], 0.1 * kSigma, truth, random);
    scene.observer.epoch = scene.observer.epoch + Duration::days(k);
    const FrameResult& result = vision.process(scene.image, scene.observer, {}, told);
    for (int i = 0; i < 3; ++i) {
      ASSERT_TRUE(result.planets[i].found) << "body " << i << ", " << k;
      const Centroid& spot = result.centroids[result.planets[i].centroid];
      const Vec2 error = spot.pixel.vec() - bodies[i].pixel.vec();
      EXPECT_LT(error.norm(), 0.2) << "body " << i << ", " << k;
      if (i == 2) chi2 += error.dot(spot.whole_covariance_px2().inverse() * error);
    }
  }
  EXPECT_LT(chi2 / kFrames, chi_square_mean_band(0.999, 2, kFrames).hi);
}

// The light of a bright planet reaches over the edge: no spot is made of that, and it is measured where it is foretold.
TEST(VisionPlanets, NamesABrightPlanetAtTheEdge) {
  const Truth truth{.halo_fraction = 0.015};
  const Intrinsics camera = camera20();
  Vision vision({}, camera, believed(truth), sky().field, sky().index);
  RandomStream random(StreamId{.seed = 17, .purpose = "edge"});
  for (int k = 0; k < 8; ++k) {
    Scene scene{moving(), random_attitude(random)};
    const double inside = 8.0 + k, along = random.uniform(100, 900);
    const Source planet{k % 2 == 0 ? Pixel{inside, along} : Pixel{along, 1023.0 - inside}, 1.5e7};
    paint(scene, truth, camera, random, {&planet, 1});
    const PlanetPrediction told = about(scene, camera, planet, body::jupiter, 0.3 * kSigma, truth, random);
    scene.observer.epoch = scene.observer.epoch + Duration::days(k);
    const FrameResult& result = vision.process(scene.image, scene.observer, {}, {&told, 1});
    ASSERT_TRUE(result.planets[0].found) << inside << " px";
    const Centroid& spot = result.centroids[result.planets[0].centroid];
    EXPECT_LT((spot.pixel.vec() - planet.pixel.vec()).norm(), 0.05) << inside << " px";
  }
}

TEST(VisionPlanets, ASpotThatIsThereTwiceCountsOnce) {
  AttitudeSolution attitude;
  attitude.intrinsics = camera20();
  PlanetPrediction mars;
  mars.body = body::mars;
  mars.direction_N = Vec3::UnitZ();
  mars.direction_covariance = Mat3::Identity() * 1e-6;  // 2.9 px
  Centroid spot;
  spot.pixel = {512.5, 511.5};
  spot.covariance_px2 = Mat2::Identity() * 1e-4;
  Centroid again = spot;
  again.pixel.u += 0.02;
  const std::vector<Centroid> twice{spot, again};
  const std::vector<unsigned char> none{0, 0};
  const PlanetMatch match = find_planet(mars, attitude, twice, none);
  EXPECT_TRUE(match.found);
  EXPECT_EQ(match.centroid, 0u);
}

}  // namespace
}  // namespace astronav::vision
