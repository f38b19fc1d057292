// SPDX-License-Identifier: Apache-2.0
#include "onboard/vision/psf_fit.h"

#include <cmath>
#include <cstdio>

#include <gtest/gtest.h>

#include "onboard/vision/psf_group_fit.h"
#include "onboard/vision/synthetic_frame_for_tests.h"

namespace astronav::vision {
namespace {

using testing::Truth;

constexpr int kSide = 41;
constexpr double kMiddle = 20.0, kJupiterE = 2.3e7;

struct Outcome {
  double rms_px = 0.0, worst_chi2 = 0.0, worst_repeating_px = 0.0;
  double normalised = 0.0;  // sqrt(mean d^2 / 2)
};

// Sixty pictures of a saturated planet, each at a random place in its pixel, with a star (electrons) that stands
// `apart_px` away in a random direction; `measure` is told image, window and a guess.
template <typename Measure>
Outcome beside_a_star(const Truth& truth, double star_e, double apart_px, Measure measure) {
  constexpr int kPictures = 60;
  RandomStream random(StreamId{.seed = 3, .purpose = "stranger in the window"});
  Outcome out;
  for (int n = 0; n < kPictures; ++n) {
    ImageF electrons(kSide, kSide, 0.0f);
    ImageU16 image(kSide, kSide);
    const Vec2 place(kMiddle + random.uniform(-0.5, 0.5), kMiddle + random.uniform(-0.5, 0.5));
    add_source(electrons, truth, place.x(), place.y(), kJupiterE);
    const double angle = random.uniform(0.0, 6.28);
    add_source(electrons, truth, place.x() + apart_px * std::cos(angle), place.y() + apart_px * std::sin(angle),
               star_e);
    expose(electrons, truth, random, image);
    const Window window{12, 12, 28, 28};
    const PsfFit fit = measure(image, window, Pixel{place.x() + 0.3, place.y() - 0.2});
    EXPECT_TRUE(fit.converged);
    const Vec2 e = fit.pixel.vec() - place;
    out.rms_px += e.squaredNorm() / (2.0 * kPictures);
    out.normalised += e.dot(fit.covariance_px2.inverse() * e) / (2.0 * kPictures);
    out.worst_chi2 = std::max(out.worst_chi2, fit.chi2_per_dof);
    out.worst_repeating_px = std::max(out.worst_repeating_px, fit.repeating_sigma_px);
  }
  out.rms_px = std::sqrt(out.rms_px);
  out.normalised = std::sqrt(out.normalised);
  std::printf(
      "  star of %6.0f e- %3.0f px away: rms %.4f px, normalised %.2f, worst chi-square %.2f, repeats %.4f px\n",
      star_e, apart_px, out.rms_px, out.normalised, out.worst_chi2, out.worst_repeating_px);
  return out;
}

// A star that no catalogue lists (V 8 where the planet has V -2) neither moves a saturated planet nor widens its
// error bar; so close that it cannot be told from the planet's own wings, the error bar says so.
TEST(PsfFit, AStrangerInTheWindowIsSetAside) {
  const Truth truth;
  const SensorModel sensor = testing::believed(truth);
  const LocalLevel level{.at = {kMiddle, kMiddle},
                         .background_dn = truth.bias_dn + truth.background_e / truth.gain_e_dn,
                         .noise_dn = std::hypot(truth.read_noise_e, std::sqrt(truth.background_e)) / truth.gain_e_dn};
  const auto measure = [&](const ImageU16& image, const Window& window, Pixel guess) {
    return fit_psf(image.view(), window, guess, level, sensor, LocalPsf::from(sensor));
  };
  const Outcome alone = beside_a_star(truth, 0.0, 6.0, measure);
  for (const double apart_px : {6.0, 7.0, 8.0}) {
    const Outcome beside = beside_a_star(truth, 3e3, apart_px, measure);
    EXPECT_LT(beside.worst_chi2, 2.5);
    EXPECT_LT(beside.rms_px, 1.25 * alone.rms_px);
    EXPECT_LT(beside.normalised, 1.25);
    EXPECT_LT(beside.worst_repeating_px, 2e-4);
  }
}

// The same with a light beside it that is told (the Moon): the stranger is set aside, what was told is not.
TEST(PsfFit, AStrangerBesideTwoIsSetAside) {
  const Truth truth;
  const SensorModel sensor = testing::believed(truth);
  const LocalLevel level{.at = {kMiddle, kMiddle},
                         .background_dn = truth.bias_dn + truth.background_e / truth.gain_e_dn,
                         .noise_dn = std::hypot(truth.read_noise_e, std::sqrt(truth.background_e)) / truth.gain_e_dn};
  const auto among = [&](double told_e) {
    return [&, told_e](const ImageU16& image, const Window& window, Pixel guess) {
      const LightBeside moon{.at_px = {5.0, 1.0},
                             .from_body = true,
                             .covariance_px2 = Mat2::Identity() * 1e-6,
                             .flux_dn = told_e / truth.gain_e_dn,
                             .flux_sigma = 0.1};
      return fit_psf_beside(image.view(), window, guess, level, sensor, LocalPsf::from(sensor),
                            kJupiterE / truth.gain_e_dn, {}, {&moon, 1});
    };
  };
  // What is told is not there: neither a stranger nor a better fit.
  const Outcome alone = beside_a_star(truth, 0.0, 6.0, among(10.0));
  const Outcome beside = beside_a_star(truth, 3e3, 7.0, among(10.0));
  EXPECT_LT(beside.worst_chi2, 2.5);
  EXPECT_LT(beside.rms_px, 1.25 * alone.rms_px);
  EXPECT_LT(beside.normalised, 1.25);
}

}  // namespace
}  // namespace astronav::vision
