// SPDX-License-Identifier: Apache-2.0
// The search with nothing known, on fields of the catalogue: any width, any lens within reason, false spots, missing
// stars, mirrored pictures; and the search near a rough pointing.
#include "verification/opensky/blind.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <numeric>
#include <vector>

#include <gtest/gtest.h>

#include "foundation/files/mapped_file.h"
#include "foundation/math/random.h"
#include "foundation/math/rotation.h"
#include "verification/opensky/rough.h"

namespace astronav::opensky {
namespace {

const StarCatalogue& catalogue() {
  static const Result<MappedFile> file = MappedFile::open(home_directory() / "data/hipparcos.stars");
  static const Result<StarCatalogue> stars = StarCatalogue::open(file.value().bytes());
  return stars.value();
}
const Epoch kEpoch = Epoch::tdb_seconds(25.0 * 365.25 * 86400.0);
const vision::StarField& field() {
  static const vision::StarField stars = vision::StarField::build(catalogue(), 11.0, kEpoch);
  return stars;
}
const std::vector<SkyStar>& sky() {
  static const std::vector<SkyStar> stars = apparent_stars(catalogue(), 9.5, kEpoch, {});
  return stars;
}

Mat3 any_attitude(RandomStream& random) {
  return R_CN_from_pointing(
      {random.uniform(0.0, 2.0 * kPi), std::asin(random.uniform(-1.0, 1.0)), random.uniform(0.0, 2.0 * kPi)});
}

struct Scene {
  int stars = 40;         // the brightest in the field
  int false_spots = 0;    // brighter ones among them
  double missing = 0.0;   // share of the stars
  double sigma_px = 0.2;  // an axis
  bool mirrored = false;
};
std::vector<vision::Centroid> spots_of(const Intrinsics& camera, const Mat3& R_CN, const Scene& scene,
                                       RandomStream& random) {
  std::vector<vision::Centroid> spots;
  const auto add = [&](Pixel p, double v_mag) {
    vision::Centroid& spot = spots.emplace_back();
    spot.pixel = p;
    spot.covariance_px2 = Mat2::Identity() * scene.sigma_px * scene.sigma_px;
    spot.flux_dn = std::pow(10.0, 0.4 * (12.0 - v_mag));
    spot.pixels = 9;
  };
  std::vector<double> magnitudes{4.0};
  for (const SkyStar& star : sky()) {
    if (static_cast<int>(spots.size()) == scene.stars) break;
    const auto p = project(camera, R_CN * star.direction_N);
    if (!p || p->u < 0.0 || p->v < 0.0 || p->u > camera.width_px - 1 || p->v > camera.height_px - 1) continue;
    if (random.uniform() < scene.missing) continue;
    add({p->u + scene.sigma_px * random.normal(), p->v + scene.sigma_px * random.normal()}, star.v_mag);
    magnitudes.push_back(star.v_mag);
  }
  for (int k = 0; k < scene.false_spots; ++k)
    add({random.uniform(0.0, camera.width_px - 1.0), random.uniform(0.0, camera.height_px - 1.0)},
        magnitudes[static_cast<std::size_t>(random.uniform() * static_cast<double>(magnitudes.size()))]);
  std::sort(spots.begin(), spots.end(), [](const auto& a, const auto& b) { return a.flux_dn > b.flux_dn; });
  for (vision::Centroid& spot : spots) {
    if (scene.mirrored) spot.pixel.u = camera.width_px - 1 - spot.pixel.u;
  }
  return spots;
}

// In pixels, at the corner that is worst off.
double off_px(const BlindSolution& found, const Intrinsics& camera, const Mat3& R_CN) {
  double worst = 0.0;
  for (const double x : {0.1, 0.9}) {
    for (const double y : {0.1, 0.9}) {
      const Pixel p{x * camera.width_px, y * camera.height_px};
      const Vec3 direction_N = R_CN.transpose() * *unproject(camera, p);
      const auto seen =
          project(found.identification.attitude.intrinsics, found.identification.attitude.R_CN * direction_N);
      worst = std::max(worst, seen ? (seen->vec() - p.vec()).norm() : 1e9);
    }
  }
  return worst;
}

BlindSearch& blind() {
  static BlindSearch search(field());
  return search;
}

struct Tally {
  int right = 0, wrong = 0, none = 0;
};
Tally solve_many(int pictures, double fov_deg, const Distortion& distortion, const Scene& scene, std::uint64_t seed,
                 const FieldRange& field = {4.0 * kDegree, 62.0 * kDegree}) {
  RandomStream random({.seed = seed, .purpose = "blind_test"});
  Intrinsics camera = Intrinsics::from_field_of_view(1280, 960, fov_deg * kDegree);
  camera.distortion = distortion;
  BlindSearch& search = blind();
  Tally tally;
  for (int k = 0; k < pictures; ++k) {
    const Mat3 R_CN = any_attitude(random);
    const auto spots = spots_of(camera, R_CN, scene, random);
    BlindSettings settings;
    settings.match_px = 2.5;
    const auto found = search.search(spots, 1280, 960, field, {.epoch = kEpoch}, settings);
    if (!found) {
      ++tally.none;
      continue;
    }
    const bool right = off_px(*found, camera, R_CN) < 6.0 && found->mirrored == scene.mirrored;
    ++(right ? tally.right : tally.wrong);
    EXPECT_LT(found->identification.attitude.chance_probability, 1e-6);
  }
  return tally;
}

class BlindFields : public ::testing::TestWithParam<double> {};

TEST_P(BlindFields, AnyPartOfTheSkyIsFound) {
  const Tally tally = solve_many(30, GetParam(), {}, {}, 11);
  EXPECT_EQ(tally.wrong, 0);
  EXPECT_EQ(tally.right, 30);
}

INSTANTIATE_TEST_SUITE_P(Widths, BlindFields, ::testing::Values(4.3, 6.0, 10.0, 16.0, 25.0, 40.0, 58.0));

TEST(Blind, FalseSpotsMissingStarsMirrorsAndBentLines) {
  // As many false spots as stars, and as bright.
  const Tally dirty = solve_many(30, 10.0, {}, {.stars = 25, .false_spots = 25}, 12);
  EXPECT_EQ(dirty.wrong, 0);
  std::printf("  dirty %d, ", dirty.right);
  EXPECT_GE(dirty.right, 28);
  const Tally gaps = solve_many(30, 10.0, {}, {.stars = 25, .missing = 0.33, .sigma_px = 0.5}, 13);
  EXPECT_EQ(gaps.wrong, 0);
  std::printf("gaps %d, ", gaps.right);
  EXPECT_GE(gaps.right, 29);
  const Tally mirrored = solve_many(30, 14.0, {}, {.stars = 20, .mirrored = true}, 14);
  EXPECT_EQ(mirrored.wrong, 0);
  std::printf("mirrored %d, ", mirrored.right);
  EXPECT_GE(mirrored.right, 29);
  const Tally bent = solve_many(30, 30.0, {.k1 = -0.15}, {}, 15);
  EXPECT_EQ(bent.wrong, 0);
  std::printf("bent %d of 30\n", bent.right);
  EXPECT_GE(bent.right, 28);
}

// Who is told the field finds no less than who is not.
TEST(Blind, AKnownFieldIsNoHindranceWhereStarsAreMissing) {
  const Scene sparse{.stars = 60, .missing = 0.6};
  const Tally unknown = solve_many(40, 11.0, {}, sparse, 21);
  const Tally known = solve_many(40, 11.0, {}, sparse, 21, {10.8 * kDegree, 11.2 * kDegree});
  std::printf("  six stars of ten missing: %d of 40 with any field, %d with the right one\n", unknown.right,
              known.right);
  EXPECT_EQ(unknown.wrong + known.wrong, 0);
  EXPECT_GE(known.right, unknown.right);
}

TEST(Blind, FewStarsAreEnoughAndTooFewAreNot) {
  const Tally eight = solve_many(30, 10.0, {}, {.stars = 8}, 16);
  EXPECT_EQ(eight.wrong, 0);
  std::printf("  eight stars: %d of 30\n", eight.right);
  EXPECT_GE(eight.right, 24);
  const Tally four = solve_many(30, 10.0, {}, {.stars = 4}, 17);
  EXPECT_EQ(four.none, 30);
}

// 12 pictures at 1e-6: a false alarm in one of 80,000 runs of this test.
TEST(Blind, RandomSpotsAreNoSky) {
  RandomStream random({.seed = 18, .purpose = "blind_test random"});
  BlindSearch& search = blind();
  for (int k = 0; k < 12; ++k) {
    std::vector<vision::Centroid> spots(20 + 15 * static_cast<std::size_t>(k));
    for (vision::Centroid& spot : spots) {
      spot.pixel = {random.uniform(0.0, 1279.0), random.uniform(0.0, 959.0)};
      spot.covariance_px2 = Mat2::Identity() * 0.04;
      spot.flux_dn = std::exp(random.uniform(3.0, 9.0));
      spot.pixels = 9;
    }
    const auto found = search.search(spots, 1280, 960, {4.0 * kDegree, 62.0 * kDegree}, {.epoch = kEpoch}, {});
    ASSERT_FALSE(found);
    EXPECT_EQ(found.error().code, ErrorCode::no_match);
  }
}

TEST(Blind, AKnownLensIsBelievedAndTheRoughPlaceKept) {
  RandomStream random({.seed = 19, .purpose = "blind_test camera"});
  Intrinsics camera = Intrinsics::from_field_of_view(1280, 960, 30.0 * kDegree);
  camera.cx_px += 90.0;
  camera.distortion = {.k1 = -0.3, .k2 = 0.1, .k3 = 0.0, .p1 = 0.004, .p2 = -0.003};
  BlindSearch& search = blind();
  for (int k = 0; k < 10; ++k) {
    const Mat3 R_CN = any_attitude(random);
    const auto spots = spots_of(camera, R_CN, {.stars = 30, .sigma_px = 0.1}, random);
    BlindSettings settings;
    settings.camera = camera;
    settings.near = Near{R_CN.row(2).transpose(), 2.0 * kDegree};
    const FieldRange range{29.9 * kDegree, 30.1 * kDegree};
    const auto found = search.search(spots, 1280, 960, range, {.epoch = kEpoch}, settings);
    ASSERT_TRUE(found) << describe(found.error());
    EXPECT_LT(off_px(*found, camera, R_CN), 0.5);
    EXPECT_EQ(found->identification.attitude.intrinsics.fx_px, camera.fx_px);
    settings.near = Near{-R_CN.row(2).transpose(), 20.0 * kDegree};
    EXPECT_FALSE(search.search(spots, 1280, 960, range, {.epoch = kEpoch}, settings));
  }
}

TEST(QuadShape, IsTheSameTurnedAndScaledAndTellsAMirror) {
  RandomStream random({.seed = 20, .purpose = "blind_test shape"});
  for (int k = 0; k < 200; ++k) {
    const Mat3 turn = any_attitude(random);
    std::array<Vec3, 4> small, large, turned, mirror;
    std::array<std::size_t, 4> order{2, 0, 3, 1};
    for (std::size_t i = 0; i < 4; ++i) {
      const double x = random.uniform(-0.01, 0.01), y = random.uniform(-0.01, 0.01);
      small[i] = Vec3(x, y, 1.0).normalized();
      large[i] = Vec3(1.5 * x, 1.5 * y, 1.0).normalized();
      mirror[i] = Vec3(-x, y, 1.0).normalized();
      turned[order[i]] = turn * small[i];
    }
    const QuadShape shape = quad_shape(small);
    EXPECT_NEAR(quad_shape(large).size_rad / shape.size_rad, 1.5, 1e-3);
    for (std::size_t i = 0; i < 4; ++i) {
      EXPECT_NEAR(quad_shape(turned).xy[i], shape.xy[i], 1e-5);
      EXPECT_NEAR(quad_shape(large).xy[i], shape.xy[i], 1e-3);
      EXPECT_NEAR(quad_shape(mirror).mirrored().xy[i], shape.xy[i], 1e-5);
      EXPECT_EQ(quad_shape(turned).corners[i], order[shape.corners[i]]);
    }
  }
}

TEST(QuadIndex, FindsItsOwnQuads) {
  std::vector<std::uint32_t> by_brightness(field().stars().size());
  std::iota(by_brightness.begin(), by_brightness.end(), 0u);
  std::sort(by_brightness.begin(), by_brightness.end(),
            [](std::uint32_t a, std::uint32_t b) { return field().stars()[a].v_mag < field().stars()[b].v_mag; });
  const double fov = 12.0 * kDegree;
  const auto chosen = even_stars(field(), by_brightness, 0.3 * fov, 4, 20'000);
  // Even: nowhere is the sky empty, nowhere crowded.
  const vision::StarField stars = field().subset(chosen);
  std::vector<std::uint32_t> near(stars.stars().size());
  RandomStream random({.seed = 21, .purpose = "blind_test even"});
  for (int k = 0; k < 300; ++k) {
    const std::size_t in_field = stars.cone(any_attitude(random).row(2).transpose(), 0.5 * fov, near);
    EXPECT_GE(in_field, 5u);
    EXPECT_LE(in_field, 24u);
  }
  const QuadIndex index(stars, {.radius_rad = 0.4 * fov});
  EXPECT_GT(index.size(), 10'000u);
  int found = 0;
  for (int k = 0; k < 200; ++k) {
    // A star and its three nearest are a quad unless brighter neighbours displace one.
    const auto& star = stars.stars()[static_cast<std::size_t>(random.uniform() * static_cast<double>(chosen.size()))];
    const std::size_t n = stars.cone(star.direction_N, 0.4 * fov, near);
    std::sort(near.begin(), near.begin() + static_cast<std::ptrdiff_t>(n),
              [&](auto a, auto b) { return stars.stars()[a].v_mag < stars.stars()[b].v_mag; });
    if (n < 4 || stars.stars()[near[0]].id != star.id) continue;
    ++found;
    std::array<Vec3, 4> d;
    for (std::size_t i = 0; i < 4; ++i) d[i] = stars.stars()[near[i]].direction_N;
    int hits = 0;
    index.look_up(quad_shape(d), 1e-3f, [&](const QuadIndex::Quad& quad) {
      std::array<std::uint32_t, 4> own{near[0], near[1], near[2], near[3]}, theirs = quad.stars;
      std::sort(own.begin(), own.end());
      std::sort(theirs.begin(), theirs.end());
      hits += own == theirs;
    });
    EXPECT_EQ(hits, 1);
  }
  EXPECT_GT(found, 5);
}

// Six stars and three other spots: too few for a blind search to be sure of.
TEST(LookNear, FewSpotsAreEnoughWhereThePointingIsRoughlyKnown) {
  RandomStream random({.seed = 22, .purpose = "blind_test rough"});
  const Intrinsics camera = Intrinsics::from_field_of_view(1392, 1040, 8.0 * kDegree);
  int right = 0, wrong = 0;
  for (int k = 0; k < 40; ++k) {
    const Mat3 R_CN = any_attitude(random);
    const auto spots = spots_of(camera, R_CN, {.stars = 6, .false_spots = 3}, random);
    const Vec3 roughly = (R_CN.transpose() * Vec3(0.02, -0.03, 1.0)).normalized();
    const auto look = look_near(spots, camera, sky(), {}, {roughly, 5.0 * kDegree});
    if (!look) continue;
    const double off = angle_between(look->R_CN.row(2).transpose(), R_CN.row(2).transpose()) * camera.fx_px;
    ++(off < 10.0 && !look->mirrored ? right : wrong);
    EXPECT_LT(look->chance_probability, 1e-5);
  }
  std::printf("  rough pointing, six stars: %d of 40\n", right);
  EXPECT_EQ(wrong, 0);
  EXPECT_GE(right, 10);
  // And random spots, near any place, are nothing.
  for (int k = 0; k < 40; ++k) {
    const Mat3 R_CN = any_attitude(random);
    const auto spots = spots_of(camera, R_CN, {.stars = 0, .false_spots = 16}, random);
    EXPECT_FALSE(look_near(spots, camera, sky(), {}, {R_CN.row(2).transpose(), 5.0 * kDegree}));
  }
}

}  // namespace
}  // namespace astronav::opensky
