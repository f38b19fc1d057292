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

Window add_within(ImageView<float> image, Pixel centre, double sigma_px, double reach, double electrons,
                  Scratch& scratch) {
  if (!(electrons > 0.0)) return {};
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

// How far a wing is drawn: to where a pixel holds kFaintest electrons of it. 0 where it never holds e times that.
double wing_reach(double sigma_px, double electrons) {
  const double peak = electrons / (2.0 * kPi * sigma_px * sigma_px);
  return peak > std::exp(1.0) * kFaintest ? sigma_px * std::sqrt(2.0 * std::log(peak / kFaintest)) : 0.0;
}

// The smallest window that holds both.
Window hull(const Window& a, const Window& b) {
  if (a.empty()) return b;
  if (b.empty()) return a;
  return {std::min(a.u_begin, b.u_begin), std::max(a.u_end, b.u_end), std::min(a.v_begin, b.v_begin),
          std::max(a.v_end, b.v_end)};
}

}  // namespace

Window add_gaussian(ImageView<float> image, Pixel centre, double sigma_px, double electrons, Scratch& scratch) {
  const double reach = sigma_px * std::max(4.0, std::sqrt(2.0 * std::log(std::max(1.0, electrons / kFaintest))));
  return add_within(image, centre, sigma_px, reach, electrons, scratch);
}

double core_sigma(const Camera& camera, Pixel at) {
  const Intrinsics& c = camera.intrinsics;
  const double du = at.u - c.cx_px;
  const double dv = at.v - c.cy_px;
  const double half_diagonal2 =
      0.25 * (static_cast<double>(c.width_px) * c.width_px + static_cast<double>(c.height_px) * c.height_px);
  return camera.psf.sigma_px + camera.psf.sigma_growth_px * (du * du + dv * dv) / half_diagonal2;
}

Windows add_source(ImageView<float> image, const Camera& camera, Pixel at, double electrons, Scratch& scratch) {
  const PointSpread& psf = camera.psf;
  Windows windows;
  double core = electrons;
  if (psf.halo_fraction > 0.0) {
    const Pixel centre{at.u + psf.halo_offset_u_px, at.v + psf.halo_offset_v_px};
    for (const bool outer : {false, true}) {
      const double sigma = psf.halo_sigma_px * (outer ? kOuterHaloWidth : 1.0);
      const double wing = psf.halo_fraction * electrons * (outer ? kOuterHaloShare : 1.0 - kOuterHaloShare);
      // A faint star's wing of a hundredth of an electron a pixel would touch most of the frame. What lies beyond the
      // reach is put back within it, and a wing that is nowhere seen into the core: no light is lost.
      const double reach = wing_reach(sigma, wing);
      if (reach == 0.0) continue;
      const double within = std::pow(std::erf((reach + 1.0) / (std::sqrt(2.0) * sigma)), 2);
      windows.halo = hull(windows.halo, add_within(image, centre, sigma, reach, wing / within, scratch));
      core -= wing;
    }
  }
  windows.core = add_gaussian(image, at, core_sigma(camera, at), core, scratch);
  return windows;
}

}  // namespace astronav::render
