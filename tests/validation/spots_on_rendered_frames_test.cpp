// SPDX-License-Identifier: Apache-2.0
// The onboard centroids on frames of the simulator: as good as the noise lets them be, true about it, and not deceived
// by what is no star. The short form of benchmarks/accuracy/centroids.cpp. Every draw has a fixed seed.
#include <gtest/gtest.h>

#include "benchmarks/accuracy/centroid_scene.h"
#include "foundation/math/random.h"
#include "foundation/math/statistics.h"

namespace astronav::accuracy {
namespace {

using vision::Centroid;
using vision::CentroidFinder;
using vision::SpotKind;

// Stars at rest on a jittered grid, S/N 10 to the brightest that does not saturate.
std::vector<render::RenderedSource> stars_for(const TestCamera& camera, std::uint64_t seed, double spacing = 64.0) {
  RandomStream random({.seed = seed, .purpose = "stars"});
  const double faintest = electrons_for_snr(camera.truth, 12.0), brightest = electrons_for_peak(camera.truth, 0.8);
  std::vector<render::RenderedSource> stars;
  for (double v = 32.0; v < 1000.0; v += spacing) {
    for (double u = 32.0; u < 1000.0; u += spacing)
      stars.push_back(star_at(u + random.uniform(-9.0, 9.0), v + random.uniform(-9.0, 9.0),
                              faintest * std::pow(brightest / faintest, random.uniform())));
  }
  return stars;
}

ImageU16 shot(const render::Renderer& renderer, const TestCamera& camera,
              std::span<const render::RenderedSource> sources, std::uint64_t image) {
  ImageU16 frame;
  renderer.frame(sources, exposure_of(camera), {.image = image, .purpose = ""}, frame);
  return frame;
}

struct Seen {
  std::vector<Centroid> spots;
  std::vector<Centroid> others;
  int of(SpotKind kind) const {
    return static_cast<int>(
        std::count_if(others.begin(), others.end(), [&](const Centroid& c) { return c.kind == kind; }));
  }
};
template <typename T>
Seen look(CentroidFinder& finder, const Image<T>& frame) {
  Seen seen;
  seen.spots.resize(600);
  seen.spots.resize(finder.find(frame.view(), seen.spots));
  seen.others.assign(finder.others().begin(), finder.others().end());
  return seen;
}
CentroidFinder finder_for(const TestCamera& camera) {
  return {{.max_centroids = 600}, vision::SensorModel::from(camera.believed), 1024, 1024};
}
int false_spots(const Seen& seen, std::span<const render::RenderedSource> stars) {
  int count = 0;
  for (const Centroid& spot : seen.spots) {
    bool true_one = false;
    for (const auto& star : stars) true_one |= (star.pixel.vec() - spot.pixel.vec()).norm() < 2.0;
    count += true_one ? 0 : 1;
  }
  return count;
}

// Sums over stars: against the bound, and against what was told.
struct Score {
  int asked = 0, found = 0;
  double over_bound2 = 0.0, chi2 = 0.0;
  void add(const TestCamera& camera, const Seen& seen, std::span<const render::RenderedSource> stars) {
    for (const auto& star : stars) {
      ++asked;
      const Centroid* spot = nearest(seen.spots, star.pixel);
      if (spot == nullptr) continue;
      ++found;
      const Bound bound = cramer_rao(camera.truth, star.pixel, star.electrons, stray_electrons(camera, star.pixel));
      const Vec2 error = spot->pixel.vec() - star.pixel.vec();
      over_bound2 += error.dot(bound.covariance_px2.inverse() * error) / 2.0;
      chi2 += error.dot(spot->covariance_px2.inverse() * error) / 2.0;
    }
  }
  double over_bound() const { return std::sqrt(over_bound2 / found); }
  double chi2_per_dof() const { return chi2 / found; }
};

Score score_of(const TestCamera& camera, int frames) {
  const render::Renderer renderer(camera.truth, 1);
  CentroidFinder finder = finder_for(camera);
  Score score;
  for (int i = 0; i < frames; ++i) {
    const auto stars = stars_for(camera, static_cast<std::uint64_t>(i));
    score.add(camera, look(finder, shot(renderer, camera, stars, static_cast<std::uint64_t>(i))), stars);
  }
  return score;
}

// 4 frames of 225 stars, 1800 errors: a ratio of variances scatters by sqrt(2/1800) = 3.3 %.
TEST(SpotsOnRenderedFrames, AreAtThePhotonLimitAndSaySo) {
  struct Case {
    double sigma_px;
    double most_over_bound;
  };
  for (const Case& c : {Case{0.8, 1.10}, Case{0.5, 1.15}, Case{1.2, 1.10}}) {
    const TestCamera camera = test_camera("extrema-20deg", c.sigma_px, Optics::hard, "");
    const Score score = score_of(camera, 4);
    std::printf("  sigma %.1f px: %.3f of the bound, chi2 %.3f\n", c.sigma_px, score.over_bound(),
                score.chi2_per_dof());
    EXPECT_GE(score.found, 0.99 * score.asked);
    EXPECT_LE(score.over_bound(), c.most_over_bound);
    EXPECT_NEAR(score.chi2_per_dof(), 1.0, 0.25);
  }
}

TEST(SpotsOnRenderedFrames, StrayLightGetsAMapAndAnEvenFrameDoesNot) {
  const TestCamera even = test_camera("extrema-20deg", 0.0, Optics::hard, "");
  const TestCamera uneven = in_stray_light(even);
  CentroidFinder finder = finder_for(even);
  look(finder, shot(render::Renderer(even.truth, 1), even, stars_for(even, 1), 1));
  EXPECT_FALSE(finder.uneven());
  look(finder, shot(render::Renderer(uneven.truth, 1), uneven, stars_for(even, 1), 1));
  EXPECT_TRUE(finder.uneven());
  const render::Renderer renderer(uneven.truth, 1);
  Score score;
  for (std::uint64_t i = 0; i < 4; ++i) {
    auto stars = stars_for(uneven, i);
    // Asked for are those that reach S/N 10 in the light that is there.
    std::erase_if(stars, [&](const auto& s) {
      return cramer_rao(uneven.truth, s.pixel, s.electrons, stray_electrons(uneven, s.pixel)).snr < 10.0;
    });
    const Seen seen = look(finder, shot(renderer, uneven, stars, i));
    score.add(uneven, seen, stars);
    EXPECT_LE(false_spots(seen, stars), 3);
  }
  std::printf("  stray light: %d of %d, %.3f of the bound, chi2 %.3f\n", score.found, score.asked, score.over_bound(),
              score.chi2_per_dof());
  EXPECT_GE(score.found, 0.97 * score.asked);
  EXPECT_LE(score.over_bound(), 1.15);
  EXPECT_NEAR(score.chi2_per_dof(), 1.0, 0.25);
}

// Jupiter and Venus saturate; the halo sits 0.2 px beside the core, and nobody said so.
TEST(SpotsOnRenderedFrames, ASaturatedPlanetIsPlacedByWingsThatWereLearned) {
  for (const bool blooming : {false, true}) {
    TestCamera camera = test_camera("extrema-20deg", 0.0, Optics::hard, "");
    camera.truth.detector.blooming = camera.believed.detector.blooming = blooming;
    const render::Renderer renderer(camera.truth, 1);
    for (const double electrons : {2.3e7, 1.4e8}) {
      CentroidFinder finder = finder_for(camera);
      RandomStream random({.seed = 3, .purpose = "planet"});
      Vec2 sum = Vec2::Zero();
      double sum2 = 0.0;
      constexpr int kLearning = 2, kFrames = 14;
      for (int i = 0; i < kLearning + kFrames; ++i) {
        auto stars = stars_for(camera, static_cast<std::uint64_t>(i));
        const Pixel at{random.uniform(450.0, 550.0), random.uniform(450.0, 550.0)};
        std::erase_if(stars, [&](const auto& s) { return std::abs(s.pixel.u - at.u) < 30.0; });
        stars.push_back(star_at(at.u, at.v, electrons));
        const Seen seen = look(finder, shot(renderer, camera, stars, static_cast<std::uint64_t>(i)));
        const Centroid* spot = nearest(seen.spots, at);
        ASSERT_NE(spot, nullptr);
        EXPECT_TRUE(spot->saturated);
        if (i < kLearning) continue;
        const Vec2 error = spot->pixel.vec() - at.vec();
        sum += error;
        sum2 += error.squaredNorm() / 2.0;
      }
      const double rms_px = std::sqrt(sum2 / kFrames), mean_px = (sum / kFrames).cwiseAbs().maxCoeff();
      std::printf("  %.1e electrons%s: rms %.4f px, mean %.4f px\n", electrons, blooming ? ", blooming" : "", rms_px,
                  mean_px);
      EXPECT_LE(rms_px, 0.02);
      EXPECT_LE(mean_px, 0.004 + 3.0 * rms_px / std::sqrt(kFrames));
    }
  }
}

// Mars before arrival, as the renderer draws it: a disc wider than the core, lit from one side. As a point's its place
// is pulled towards the light, the same way in all images.
TEST(SpotsOnRenderedFrames, ANearPlanetIsPlacedAsTheDiscThatItIs) {
  for (const bool blooming : {false, true}) {
    TestCamera camera = test_camera("extrema-20deg", 0.0, Optics::hard, "");
    camera.truth.detector.blooming = camera.believed.detector.blooming = blooming;
    const render::Renderer renderer(camera.truth, 1);
    CentroidFinder finder = finder_for(camera);
    RandomStream random({.seed = 4, .purpose = "disc"});
    std::vector<Centroid> spots(600);
    const vision::LitDisc disc{1.25, Vec2(0.6, 0.8), 66.0 * kDegree};
    double along = 0.0, along_as_point = 0.0, chi2 = 0.0;
    constexpr int kLearning = 3, kFrames = 20;
    for (int i = 0; i < kLearning + kFrames; ++i) {
      auto sources = stars_for(camera, static_cast<std::uint64_t>(i));
      const Pixel at{random.uniform(450.0, 550.0), random.uniform(450.0, 550.0)};
      std::erase_if(sources, [&](const auto& s) { return std::abs(s.pixel.u - at.u) < 30.0; });
      render::RenderedSource mars = star_at(at.u, at.v, 2.5e8);
      mars.source.kind = sky::SourceKind::planet;
      mars.radius_px = disc.radius_px;
      mars.sunward_px = disc.sunward;
      mars.source.phase_angle_rad = disc.phase_rad;
      sources.push_back(mars);
      const ImageU16 frame = shot(renderer, camera, sources, static_cast<std::uint64_t>(i));
      vision::FrameLevel level;
      const std::size_t count = finder.find(frame.view(), spots, &level);
      const Centroid* seen = nearest({spots.data(), count}, at);
      ASSERT_NE(seen, nullptr);
      Centroid spot = *seen;
      const bool measured = finder.measure_disc(frame.view(), level, disc, spot);
      if (i < kLearning) continue;
      ASSERT_TRUE(measured) << i;
      const Vec2 error = spot.pixel.vec() - at.vec();
      along += error.dot(disc.sunward) / kFrames;
      along_as_point += (seen->pixel.vec() - at.vec()).dot(disc.sunward) / kFrames;
      chi2 += error.dot(spot.whole_covariance_px2().inverse() * error) / (2.0 * kFrames);
    }
    std::printf("  a disc%s: %.4f px along the Sun's direction, chi2 %.2f; as a point %.4f px\n",
                blooming ? ", blooming" : "", along, chi2, along_as_point);
    EXPECT_GT(std::abs(along_as_point), 0.01);
    EXPECT_LT(std::abs(along), blooming ? 0.012 : 0.003);
    // 40 degrees of freedom, which share what repeats: a true sigma fails this once in 10,000.
    EXPECT_LT(chi2, 2.0);
    EXPECT_GT(chi2, 0.3);
  }
}

TEST(SpotsOnRenderedFrames, HotPixelsComeAgain) {
  TestCamera camera = test_camera("extrema-20deg", 0.0, Optics::mission, "");
  camera.truth.detector.hot_pixel_share = 1e-4;
  camera.truth.detector.hot_pixel_e_s = 1e4;
  const render::Renderer renderer(camera.truth, 1);
  CentroidFinder finder = finder_for(camera);
  const auto stars = stars_for(camera, 1, 100.0);
  const Seen first = look(finder, shot(renderer, camera, stars, 1));
  const Seen second = look(finder, shot(renderer, camera, stars, 2));
  std::printf("  %zu set apart, %d of them known from the frame before; %d false spots\n", second.others.size(),
              second.of(SpotKind::hot_pixel), false_spots(second, stars));
  EXPECT_EQ(first.of(SpotKind::hot_pixel), 0);
  EXPECT_GE(second.others.size(), 80u);
  EXPECT_GE(second.of(SpotKind::hot_pixel), 0.9 * static_cast<double>(second.others.size()));
  EXPECT_LE(false_spots(second, stars), 4);
  for (const auto& star : stars) EXPECT_NE(nearest(second.spots, star.pixel), nullptr);
}

TEST(SpotsOnRenderedFrames, ProtonsAreNoStars) {
  TestCamera camera = test_camera("extrema-20deg", 0.0, Optics::mission, "");
  CentroidFinder finder = finder_for(camera);
  const auto stars = stars_for(camera, 1, 100.0);
  // A quiet frame first: the width of a star is learned there.
  look(finder, shot(render::Renderer(camera.truth, 1), camera, stars, 99));
  camera.truth.detector.cosmic_rays_cm2_s = 100.0;
  const render::Renderer renderer(camera.truth, 1);
  int apart = 0, mistaken = 0;
  for (std::uint64_t i = 0; i < 3; ++i) {
    const Seen seen = look(finder, shot(renderer, camera, stars, i));
    apart += seen.of(SpotKind::cosmic_ray) + seen.of(SpotKind::column);
    mistaken += false_spots(seen, stars);
  }
  std::printf("  protons: %d set apart, %d taken for stars\n", apart, mistaken);
  EXPECT_GE(apart, 150);
  EXPECT_LE(mistaken, apart / 5);  // tracks over three and more pixels may be as wide as a star
}

TEST(SpotsOnRenderedFrames, AStreakAmongStarsIsNone) {
  const TestCamera camera = test_camera("extrema-20deg", 0.0, Optics::mission, "");
  const render::Renderer renderer(camera.truth, 1);
  CentroidFinder finder = finder_for(camera);
  auto sources = stars_for(camera, 1, 100.0);
  std::erase_if(sources, [](const auto& s) { return (s.pixel.vec() - Vec2(500.0, 500.0)).norm() < 40.0; });
  const std::size_t stars = sources.size();
  render::RenderedSource satellite = star_at(500.3, 500.8, 6e4);
  satellite.smear_px = {20.0, 8.0};
  sources.push_back(satellite);
  const Seen seen = look(finder, shot(renderer, camera, sources, 1));
  EXPECT_EQ(seen.of(SpotKind::streak), 1);
  EXPECT_EQ(nearest(seen.spots, satellite.pixel, 12.0), nullptr);
  EXPECT_EQ(seen.spots.size(), stars);
}

// Where the camera turns all stars are streaks: they stay stars, at their places in the middle of the exposure.
TEST(SpotsOnRenderedFrames, StarsOfATurningCameraStayStars) {
  const TestCamera camera = test_camera("extrema-20deg", 0.0, Optics::mission, "");
  const render::Renderer renderer(camera.truth, 1);
  CentroidFinder finder = finder_for(camera);
  auto stars = stars_for(camera, 1, 100.0);
  for (auto& star : stars) {
    star.smear_px = {9.0, 4.0};
    star.electrons = std::max(star.electrons, 2e4);
  }
  const Seen seen = look(finder, shot(renderer, camera, stars, 1));
  EXPECT_TRUE(finder.moving());
  EXPECT_EQ(seen.of(SpotKind::streak), 0);
  Score score;
  score.add(camera, seen, stars);
  EXPECT_GE(score.found, 0.97 * score.asked);
  for (const auto& star : stars) {
    const Centroid* spot = nearest(seen.spots, star.pixel);
    if (spot == nullptr) continue;
    EXPECT_LT((spot->pixel.vec() - star.pixel.vec()).norm(), 0.6);
  }
}

TEST(SpotsOnRenderedFrames, ADiscIsExtended) {
  const TestCamera camera = test_camera("extrema-20deg", 0.0, Optics::mission, "");
  const render::Renderer renderer(camera.truth, 1);
  CentroidFinder finder = finder_for(camera);
  auto sources = stars_for(camera, 1, 100.0);
  std::erase_if(sources, [](const auto& s) { return (s.pixel.vec() - Vec2(500.0, 500.0)).norm() < 40.0; });
  render::RenderedSource disc = star_at(500.3, 500.8, 3e5);
  disc.source.kind = sky::SourceKind::planet;
  disc.radius_px = 5.0;
  disc.sunward_px = {1.0, 0.0};
  sources.push_back(disc);
  const Seen seen = look(finder, shot(renderer, camera, sources, 1));
  EXPECT_EQ(seen.of(SpotKind::extended), 1);
  EXPECT_EQ(nearest(seen.spots, disc.pixel, 8.0), nullptr);
}

// The image of a bright planet moves under light on its way to the store, and raises whole columns.
TEST(SpotsOnRenderedFrames, SmearedColumnsHideNoStar) {
  TestCamera camera = test_camera("extrema-20deg", 0.0, Optics::mission, "");
  camera.truth.detector.frame_transfer_row_us = 1.0;
  const render::Renderer renderer(camera.truth, 1);
  CentroidFinder finder = finder_for(camera);
  auto sources = stars_for(camera, 1, 100.0);
  std::erase_if(sources, [](const auto& s) { return (s.pixel.vec() - Vec2(500.0, 500.0)).norm() < 40.0; });
  sources.push_back(star_at(500.3, 500.8, 1.4e8));
  sources.push_back(star_at(500.9, 700.2, 2e4));  // in the smear
  const Seen seen = look(finder, shot(renderer, camera, sources, 1));
  EXPECT_TRUE(finder.uneven());
  EXPECT_LE(false_spots(seen, sources), 1);
  for (const auto& source : sources) {
    const Centroid* spot = nearest(seen.spots, source.pixel);
    ASSERT_NE(spot, nullptr) << source.pixel.u << " " << source.pixel.v;
    if (source.electrons < 1e7) continue;
    EXPECT_LT((spot->pixel.vec() - source.pixel.vec()).norm(), 0.05);
  }
}

// The same sky in 8, 10, 12, 14 and 16 bits and as float: the covariance is true in each.
TEST(SpotsOnRenderedFrames, WorkInEveryKindOfPixel) {
  for (const int bits : {8, 10, 12, 14, 16}) {
    TestCamera camera = test_camera("extrema-20deg", 0.0, Optics::mission, "");
    for (Camera* c : {&camera.truth, &camera.believed}) {
      c->detector.bits = bits;
      c->detector.bias_dn = bits == 8 ? 8.0 : 64.0;
      c->detector.gain_e_dn = 1e5 / ((1 << bits) - 1 - c->detector.bias_dn);
    }
    const render::Renderer renderer(camera.truth, 1);
    CentroidFinder finder = finder_for(camera), same = finder_for(camera);
    Score score, as_float;
    for (std::uint64_t i = 0; i < 2; ++i) {
      const auto stars = stars_for(camera, i);
      const ImageU16 frame = shot(renderer, camera, stars, i);
      Image<std::uint8_t> bytes(1024, 1024);
      ImageF floats(1024, 1024);
      for (std::size_t k = 0; k < frame.pixels().size(); ++k) {
        bytes.pixels()[k] = static_cast<std::uint8_t>(frame.pixels()[k]);
        floats.pixels()[k] = static_cast<float>(frame.pixels()[k]);
      }
      score.add(camera, bits == 8 ? look(finder, bytes) : look(finder, frame), stars);
      as_float.add(camera, look(same, floats), stars);
    }
    std::printf("  %2d bits: %d of %d, %.3f of the bound, chi2 %.3f; as float %d, %.3f\n", bits, score.found,
                score.asked, score.over_bound(), score.chi2_per_dof(), as_float.found, as_float.chi2_per_dof());
    EXPECT_GE(score.found, 0.97 * score.asked) << bits;
    EXPECT_LE(score.over_bound(), 1.2) << bits;
    EXPECT_NEAR(score.chi2_per_dof(), 1.0, 0.3) << bits;
    EXPECT_NEAR(as_float.found, score.found, 1);
    // A float frame does not say how coarse its steps are; below 12 bits they hide the noise.
    if (bits < 12) continue;
    EXPECT_NEAR(as_float.chi2_per_dof(), score.chi2_per_dof(), 0.1);
  }
}

}  // namespace
}  // namespace astronav::accuracy
