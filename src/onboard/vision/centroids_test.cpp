// SPDX-License-Identifier: Apache-2.0
#include "onboard/vision/centroids.h"

#include <cmath>
#include <vector>

#include <gtest/gtest.h>

#include "onboard/vision/synthetic_frame_for_tests.h"

namespace astronav::vision {
namespace {

using testing::Truth;

struct Outcome {
  int placed = 0, found = 0;
  double mean_u = 0.0, mean_v = 0.0;  // px, bias
  double rms_px = 0.0;                // per axis
  double predicted_px = 0.0;          // rms of the predicted sigma, per axis
  double normalised = 0.0;            // sqrt(mean d^2 / 2), 1 where the covariance is true
};

// Stars of one flux on a grid, each at a random place within its pixel; `frames` frames of 225.
Outcome run(CentroidMethod method, const Truth& truth, double flux_e, int frames, std::uint64_t seed,
            double fixed_phase = -1.0, int spacing = 32) {
  constexpr int kStars = 15;
  const int size = spacing * (kStars + 1);
  CentroidSettings settings;
  settings.method = method;
  settings.max_centroids = 2000;
  CentroidFinder finder(settings, testing::believed(truth), size, size);
  std::vector<Centroid> spots(2000);
  RandomStream random(StreamId{.seed = seed, .purpose = "centroid test"});
  Outcome out;
  double sum2 = 0.0, predicted2 = 0.0, normalised2 = 0.0;
  for (int frame = 0; frame < frames; ++frame) {
    ImageF electrons(size, size, 0.0f);
    ImageU16 image(size, size);
    std::vector<Pixel> places;
    for (int j = 1; j <= kStars; ++j) {
      for (int i = 1; i <= kStars; ++i) {
        const double du = fixed_phase >= 0.0 ? fixed_phase : random.uniform(-0.5, 0.5);
        const double dv = fixed_phase >= 0.0 ? 0.0 : random.uniform(-0.5, 0.5);
        places.push_back({spacing * i + du, spacing * j + dv});
        add_source(electrons, truth, places.back().u, places.back().v, flux_e);
      }
    }
    expose(electrons, truth, random, image);
    const std::size_t count = finder.find(image, spots);
    for (const Pixel& place : places) {
      ++out.placed;
      for (std::size_t k = 0; k < count; ++k) {
        const Vec2 e = spots[k].pixel.vec() - place.vec();
        if (e.norm() > 2.0) continue;
        ++out.found;
        out.mean_u += e.x();
        out.mean_v += e.y();
        sum2 += e.squaredNorm() / 2.0;
        predicted2 += spots[k].covariance_px2.trace() / 2.0;
        normalised2 += e.dot(spots[k].covariance_px2.inverse() * e) / 2.0;
        break;
      }
    }
  }
  const double n = std::max(1, out.found);
  out.mean_u /= n;
  out.mean_v /= n;
  out.rms_px = std::sqrt(sum2 / n);
  out.predicted_px = std::sqrt(predicted2 / n);
  out.normalised = std::sqrt(normalised2 / n);
  return out;
}

void tell(const char* what, double flux, const Outcome& o) {
  std::printf("  %-28s %9.3g e-  found %4d/%4d  rms %.4f  predicted %.4f px  ratio %.3f  normalised %.3f  bias %+.4f\n",
              what, flux, o.found, o.placed, o.rms_px, o.predicted_px, o.rms_px / o.predicted_px, o.normalised,
              o.mean_u);
}

// Electrons for a signal-to-noise ratio of 10, 30, 100 and 300 in 5x5 pixels with the default noise.
constexpr double kFluxes[] = {700, 1.9e3, 1.2e4, 9.5e4};

// 2,250 stars: the ratio of standard deviations scatters by 1/sqrt(2 * 4500) = 1.1 %, so 15 % is 14 sigma of it.
TEST(Centroids, SquaredIntensityCovarianceIsTrue) {
  for (const double flux : kFluxes) {
    const Outcome o = run(CentroidMethod::squared_intensity, {}, flux, 10, 1);
    tell("squares", flux, o);
    EXPECT_GT(o.found, 0.98 * o.placed);
    EXPECT_NEAR(o.rms_px / o.predicted_px, 1.0, 0.15) << flux;
    EXPECT_NEAR(o.normalised, 1.0, 0.15) << flux;
  }
}

TEST(Centroids, PsfFitCovarianceIsTrue) {
  for (const double flux : kFluxes) {
    const Outcome o = run(CentroidMethod::psf_fit, {}, flux, 10, 2);
    tell("psf fit", flux, o);
    EXPECT_GT(o.found, 0.98 * o.placed);
    EXPECT_NEAR(o.rms_px / o.predicted_px, 1.0, 0.15) << flux;
    EXPECT_NEAR(o.normalised, 1.0, 0.15) << flux;
  }
}

// From a star that just saturates to Jupiter and Venus.
constexpr double kSaturatedFluxes[] = {6e5, 2.5e6, 2.3e7, 1.4e8};

TEST(Centroids, SaturatedFitCovarianceIsTrue) {
  for (const double flux : kSaturatedFluxes) {
    const Outcome o = run(CentroidMethod::psf_fit, {}, flux, 4, 3, -1.0, 64);
    tell("saturated", flux, o);
    EXPECT_GT(o.found, 0.98 * o.placed);
    EXPECT_LT(o.rms_px, 0.02);
    EXPECT_LT(o.normalised, 1.15) << flux;
    EXPECT_GT(o.normalised, 0.4) << flux;
  }
}

TEST(Centroids, SaturatedFitSurvivesAHaloItDoesNotKnow) {
  Truth truth;
  truth.halo_fraction = 0.01;
  for (const double sigma : {0.76, 0.8, 0.84}) {
    truth.sigma_px = sigma;
    for (const double flux : kSaturatedFluxes) {
      const Outcome o = run(CentroidMethod::psf_fit, truth, flux, 4, 4, -1.0, 64);
      tell("saturated, halo", flux, o);
      EXPECT_GT(o.found, 0.98 * o.placed);
      EXPECT_LT(o.rms_px, 0.04);
      EXPECT_LT(o.normalised, 1.2) << flux;
    }
  }
}

TEST(Centroids, DisplacedHaloUnsaturatedAndSaturated) {
  Truth truth;
  truth.halo_fraction = 0.02;
  truth.halo_offset_u = 0.2;
  for (const double flux : {1.2e4, 9.5e4, 3e5, 6e5, 2.5e6, 2.3e7, 1.4e8}) {
    const Outcome o = run(CentroidMethod::psf_fit, truth, flux, 4, 5, -1.0, 64);
    tell("displaced halo", flux, o);
    EXPECT_LT(std::abs(o.mean_u), 0.05);
  }
}

TEST(Centroids, SCurve) {
  Truth truth;
  for (const double sigma : {0.5, 0.7, 0.8, 0.9}) {
    truth.sigma_px = sigma;
    for (const CentroidMethod method : {CentroidMethod::squared_intensity, CentroidMethod::psf_fit}) {
      double worst = 0.0;
      for (const double phase : {0.05, 0.15, 0.25, 0.35, 0.45}) {
        const Outcome o = run(method, truth, 9e4, 2, 6, phase);
        worst = std::max(worst, std::abs(o.mean_u));
      }
      std::printf("  S-curve, sigma %.2f, %s: %.4f px\n", sigma, method == CentroidMethod::psf_fit ? "fit" : "squares",
                  worst);
      // 30 stars a phase with 0.0036 px each: 0.0007 px of noise. Published maxima of the squares: 0.071 at 0.5 px,
      // 0.011 at 0.7, 0.003 at 0.8. The fit believes in 0.8 px whatever the truth.
      const double published = sigma == 0.5 ? 0.071 : sigma == 0.7 ? 0.011 : 0.003;
      if (method == CentroidMethod::squared_intensity)
        EXPECT_NEAR(worst, published, 0.0035) << sigma;
      else
        EXPECT_LT(worst, 0.007) << sigma;
    }
  }
}

}  // namespace
}  // namespace astronav::vision
