// SPDX-License-Identifier: Apache-2.0
#include "simulator/render/point_spread.h"

#include <algorithm>
#include <cmath>

namespace astronav::render {
namespace {

// Of the halo's light, and of its width.
constexpr double kOuterHaloShare = 0.4;
constexpr double kOuterHaloWidth = 2.0;

constexpr double kFaintest = 0.1;  // electrons a pixel, below which a source's wing is left out

// Shares of a unit Gaussian in the pixels begin..end-1 of one axis.
void integrate(double centre, double sigma, int begin, int end, std::vector<float>& shares) {
  shares.resize(static_cast<std::size_t>(end - begin));
  const double scale = 1.0 / (sigma * std::sqrt(2.0));
  double left = std::erf((begin - 0.5 - centre) * scale);
  for (int i = begin; i < end; ++i) {
    const double right = std::erf((i + 0.5 - centre) * scale);
    shares[static_cast<std::size_t>(i - begin)] = static_cast<float>(0.5 * (right - left));
    left = right;
  }
}

}  // namespace

Window add_gaussian(ImageView<float> image, Pixel centre, double sigma_px, double electrons, Scratch& scratch) {
  if (!(electrons > 0.0)) return {};
  const double reach = sigma_px * std::max(4.0, std::sqrt(2.0 * std::log(std::max(1.0, electrons / kFaintest))));
  // A source far outside stays out of the conversion to int.
  if (!(centre.u + reach > -1.0 && centre.u - reach < image.width() && centre.v + reach > -1.0 &&
        centre.v - reach < image.height())) {
    return {};
  }
  const Window window{std::max(0, static_cast<int>(std::floor(centre.u - reach))),
                      std::min(image.width(), static_cast<int>(std::ceil(centre.u + reach)) + 1),
                      std::max(0, static_cast<int>(std::floor(centre.v - reach))),
                      std::min(image.height(), static_cast<int>(std::ceil(centre.v + reach)) + 1)};
  if (window.empty()) return {};
  integrate(centre.u, sigma_px, window.u_begin, window.u_end, scratch.columns);
  integrate(centre.v, sigma_px, window.v_begin, window.v_end, scratch.rows);
  const int width = window.u_end - window.u_begin;
  for (int v = window.v_begin; v < window.v_end; ++v) {
    const float share = static_cast<float>(electrons) * scratch.rows[static_cast<std::size_t>(v - window.v_begin)];
    float* out = image.row(v) + window.u_begin;
    for (int i = 0; i < width; ++i) out[i] += share * scratch.columns[static_cast<std::size_t>(i)];
  }
  return window;
}

double core_sigma(const Camera& camera, Pixel at) {
  const Intrinsics& c = camera.intrinsics;
  const double du = at.u - c.cx_px;
  const double dv = at.v - c.cy_px;
  const double half_diagonal2 = 0.25 * (static_cast<double>(c.width_px) * c.width_px +
                                        static_cast<double>(c.height_px) * c.height_px);
  return camera.psf.sigma_px + camera.psf.sigma_growth_px * (du * du + dv * dv) / half_diagonal2;
}

// The smallest window that holds both.
Window hull(const Window& a, const Window& b) {
  if (a.empty()) return b;
  if (b.empty()) return a;
  return {std::min(a.u_begin, b.u_begin), std::max(a.u_end, b.u_end), std::min(a.v_begin, b.v_begin),
          std::max(a.v_end, b.v_end)};
}

Windows add_source(ImageView<float> image, const Camera& camera, Pixel at, double electrons, Scratch& scratch) {
  const PointSpread& psf = camera.psf;
  Windows windows;
  windows.core = add_gaussian(image, at, core_sigma(camera, at), (1.0 - psf.halo_fraction) * electrons, scratch);
  if (psf.halo_fraction > 0.0) {
    // Real wings fall more slowly than one Gaussian does.
    const Pixel centre{at.u + psf.halo_offset_u_px, at.v + psf.halo_offset_v_px};
    const double halo = psf.halo_fraction * electrons;
    const Window inner = add_gaussian(image, centre, psf.halo_sigma_px, (1.0 - kOuterHaloShare) * halo, scratch);
    const Window outer = add_gaussian(image, centre, kOuterHaloWidth * psf.halo_sigma_px, kOuterHaloShare * halo, scratch);
    windows.halo = hull(inner, outer);
  }
  return windows;
}

}  // namespace astronav::render
