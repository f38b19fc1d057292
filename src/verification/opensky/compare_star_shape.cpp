// SPDX-License-Identifier: Apache-2.0
#include "verification/opensky/compare_star_shape.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

namespace astronav::opensky {
namespace {

// Two fifths of the halo are twice as wide as the rest.
constexpr double kOuterShare = 0.4;
constexpr double kOuterWidth = 2.0;

}  // namespace

StarShape::StarShape(const Camera& camera, Pixel near)
    : psf_(camera.psf),
      u0_(static_cast<int>(std::lround(near.u)) - kReach),
      v0_(static_cast<int>(std::lround(near.v)) - kReach),
      light_(kSide, kSide) {
  const Intrinsics& c = camera.intrinsics;
  const double du = near.u - c.cx_px, dv = near.v - c.cy_px;
  const double corner = c.half_diagonal_px();
  core_sigma_px_ = psf_.sigma_px + psf_.sigma_growth_px * (du * du + dv * dv) / (corner * corner);
}

const ImageF& StarShape::draw(Pixel at) {
  std::fill(light_.pixels().begin(), light_.pixels().end(), 0.0f);
  if (psf_.kernel.empty())
    add_gaussian(at, core_sigma_px_, 1.0 - psf_.halo_fraction);
  else
    add_kernel(at, 1.0 - psf_.halo_fraction);
  if (psf_.halo_fraction > 0.0) {
    const Pixel centre{at.u + psf_.halo_offset_u_px, at.v + psf_.halo_offset_v_px};
    add_gaussian(centre, psf_.halo_sigma_px, psf_.halo_fraction * (1.0 - kOuterShare));
    add_gaussian(centre, psf_.halo_sigma_px * kOuterWidth, psf_.halo_fraction * kOuterShare);
  }
  return light_;
}

void StarShape::add_gaussian(Pixel at, double sigma_px, double share) {
  const double scale = 1.0 / (sigma_px * std::sqrt(2.0));
  const auto shares = [&](double centre) {
    std::array<double, kSide> out;
    double left = std::erf((-0.5 - centre) * scale);
    for (int i = 0; i < kSide; ++i) {
      const double right = std::erf((i + 0.5 - centre) * scale);
      out[static_cast<std::size_t>(i)] = 0.5 * (right - left);
      left = right;
    }
    return out;
  };
  const auto columns = shares(at.u - u0_), rows = shares(at.v - v0_);
  for (int y = 0; y < kSide; ++y)
    for (int x = 0; x < kSide; ++x)
      light_(x, y) +=
          static_cast<float>(share * rows[static_cast<std::size_t>(y)] * columns[static_cast<std::size_t>(x)]);
}

void StarShape::add_kernel(Pixel at, double share) {
  const PsfKernel& kernel = psf_.kernel;
  const double step = 1.0 / kernel.samples_per_px;
  // Every sample is a small square of even light; how much of sample i lies in pixel x.
  struct Part {
    int pixel, sample;
    double share;
  };
  const auto parts = [&](double centre, int samples) {
    std::vector<Part> out;
    for (int i = 0; i < samples; ++i) {
      const double begin = centre + (i - 0.5 * samples) * step, end = begin + step;
      const int first = static_cast<int>(std::floor(begin + 0.5)), last = static_cast<int>(std::floor(end + 0.5));
      for (int x = std::max(first, 0); x <= std::min(last, kSide - 1); ++x) {
        const double overlap = std::min(end, x + 0.5) - std::max(begin, x - 0.5);
        if (overlap > 0.0) out.push_back({x, i, overlap / step});
      }
    }
    return out;
  };
  const auto columns = parts(at.u - u0_, kernel.width), rows = parts(at.v - v0_, kernel.height);
  for (const Part& row : rows)
    for (const Part& column : columns)
      light_(column.pixel, row.pixel) += static_cast<float>(
          share * row.share * column.share *
          static_cast<double>(kernel.values[static_cast<std::size_t>(row.sample) * kernel.width + column.sample]));
}

}  // namespace astronav::opensky
