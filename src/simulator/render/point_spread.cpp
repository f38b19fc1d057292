// SPDX-License-Identifier: Apache-2.0
#include "simulator/render/point_spread.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "simulator/render/gaussian.h"

namespace astronav::render {
namespace {

// Of the halo's light, and of its width.
constexpr double kOuterHaloShare = 0.4;
constexpr double kOuterHaloWidth = 2.0;

constexpr double kFaintest = 0.1;   // electrons a pixel, below which a source's wing is left out
constexpr double kCoreReach = 4.0;  // sigma, at least

// What is smaller than this is not drawn: it would widen a spot by 1e-5 px or less.
constexpr double kLeastMotion = 0.02;  // px, from end to end
constexpr double kLeastComa = 0.02;    // px, of the whole pattern
constexpr double kLeastDisc = 0.25;    // radius over the core's sigma

// How densely motion and discs are sampled, in sigmas of the Gaussian that smooths them.
constexpr double kSampleStep = 0.35;

// The pattern of third-order coma (docs/theory/rendering.md eq. 9): the zone rho of the pupil makes a circle of radius
// C rho^2 about a point 2 C rho^2 outwards; equal areas of the pupil bring equal light. Three zones (Gauss-Legendre in
// rho^2), six angles; in units of C, about the centre of light.
struct ComaPoint {
  double outwards;
  double across;
  double share;
};
const std::array<ComaPoint, 18>& coma_pattern() {
  static const auto pattern = [] {
    std::array<ComaPoint, 18> points;
    constexpr std::array<double, 3> kArea{0.11270166537925831, 0.5, 0.88729833462074169};
    constexpr std::array<double, 3> kWeight{5.0 / 18.0, 8.0 / 18.0, 5.0 / 18.0};
    for (std::size_t zone = 0; zone < 3; ++zone) {
      for (std::size_t i = 0; i < 6; ++i) {
        const double angle = kPi / 3.0 * static_cast<double>(i);
        points[zone * 6 + i] = {kArea[zone] * (2.0 + std::cos(angle)) - 1.0, kArea[zone] * std::sin(angle),
                                kWeight[zone] / 6.0};
      }
    }
    return points;
  }();
  return pattern;
}

Window window_about(const ImageF& image, Pixel centre, double reach) {
  // A source far outside stays out of the conversion to int.
  if (!(centre.u + reach > -1.0 && centre.u - reach < image.width() && centre.v + reach > -1.0 &&
        centre.v - reach < image.height())) {
    return {};
  }
  return {std::max(0, static_cast<int>(std::floor(centre.u - reach))),
          std::min(image.width(), static_cast<int>(std::ceil(centre.u + reach)) + 1),
          std::max(0, static_cast<int>(std::floor(centre.v - reach))),
          std::min(image.height(), static_cast<int>(std::ceil(centre.v + reach)) + 1)};
}

// Adds electrons x column share x row share inside a window.
void add_product(const Window& w, double electrons, Sheet& sheet) {
  const int width = w.u_end - w.u_begin;
  const float* const columns = sheet.columns.data();
  double of_rows = 0.0;
  for (int v = w.v_begin; v < w.v_end; ++v) {
    const float row = sheet.rows[static_cast<std::size_t>(v - w.v_begin)];
    const float share = static_cast<float>(electrons) * row;
    of_rows += static_cast<double>(row);
    float* out = sheet.light.row(v) + w.u_begin;
    for (int i = 0; i < width; ++i) out[i] += share * columns[i];
  }
  for (int i = 0; i < width; ++i) {
    sheet.column_sums[static_cast<std::size_t>(w.u_begin + i)] += electrons * of_rows * static_cast<double>(columns[i]);
  }
  sheet.touch(w);
}

void add_gaussian(Pixel centre, double sigma_px, double reach, double electrons, Sheet& sheet) {
  const Window w = window_about(sheet.light, centre, reach);
  if (w.empty()) return;
  const int width = w.u_end - w.u_begin;
  const int height = w.v_end - w.v_begin;
  if (sheet.columns.size() < static_cast<std::size_t>(width)) sheet.columns.resize(static_cast<std::size_t>(width));
  if (sheet.rows.size() < static_cast<std::size_t>(height)) sheet.rows.resize(static_cast<std::size_t>(height));
  integrate_gaussian(centre.u, sigma_px, w.u_begin, width, sheet.columns.data());
  integrate_gaussian(centre.v, sigma_px, w.v_begin, height, sheet.rows.data());
  add_product(w, electrons, sheet);
}

// A disc through a Gaussian: first along the rows of the disc's grid, then along the columns.
void add_disc(const LitDisc& disc, Pixel photocentre, double radius_px, double sigma_px, double reach, double electrons,
              Sheet& sheet) {
  const Pixel centre{photocentre.u - radius_px * disc.photocentre.x(),
                     photocentre.v - radius_px * disc.photocentre.y()};
  const Window w = window_about(sheet.light, centre, radius_px + reach);
  if (w.empty()) return;
  const auto width = static_cast<std::size_t>(w.u_end - w.u_begin);
  const auto cells = static_cast<std::size_t>(disc.cells);
  sheet.strip.assign(cells * width, 0.0f);
  const auto cell_at = [&](double middle, std::size_t i) {
    return middle + radius_px * ((2.0 * static_cast<double>(i) + 1.0) / static_cast<double>(cells) - 1.0);
  };
  const auto span_of = [&](double at, int begin, int end) {
    return std::pair{std::clamp(static_cast<int>(std::floor(at - reach)), begin, end),
                     std::clamp(static_cast<int>(std::ceil(at + reach)) + 1, begin, end)};
  };
  sheet.columns.resize(std::max(sheet.columns.size(), std::max(width, static_cast<std::size_t>(w.v_end - w.v_begin))));
  for (std::size_t i = 0; i < cells; ++i) {
    const double at = cell_at(centre.u, i);
    const auto [begin, end] = span_of(at, w.u_begin, w.u_end);
    if (begin >= end) continue;
    integrate_gaussian(at, sigma_px, begin, end - begin, sheet.columns.data());
    for (std::size_t j = 0; j < cells; ++j) {
      const float light = disc.intensity[j * cells + i];
      if (light == 0.0f) continue;
      float* out = sheet.strip.data() + j * width + static_cast<std::size_t>(begin - w.u_begin);
      for (int k = 0; k < end - begin; ++k) out[k] += light * sheet.columns[static_cast<std::size_t>(k)];
    }
  }
  for (std::size_t j = 0; j < cells; ++j) {
    const double at = cell_at(centre.v, j);
    const auto [begin, end] = span_of(at, w.v_begin, w.v_end);
    if (begin >= end) continue;
    integrate_gaussian(at, sigma_px, begin, end - begin, sheet.columns.data());
    const float* const strip = sheet.strip.data() + j * width;
    double of_rows = 0.0;
    for (int v = begin; v < end; ++v) {
      const float share = static_cast<float>(electrons) * sheet.columns[static_cast<std::size_t>(v - begin)];
      of_rows += static_cast<double>(share);
      float* out = sheet.light.row(v) + w.u_begin;
      for (std::size_t k = 0; k < width; ++k) out[k] += share * strip[k];
    }
    for (std::size_t k = 0; k < width; ++k) {
      sheet.column_sums[static_cast<std::size_t>(w.u_begin) + k] += of_rows * static_cast<double>(strip[k]);
    }
  }
  sheet.touch(w);
}

// How far a core is drawn: further where its electrons are seen further out.
double core_reach(double sigma_px, double electrons) {
  return sigma_px * std::max(kCoreReach, std::sqrt(2.0 * std::log(std::max(1.0, electrons / kFaintest))));
}

// How far a wing is drawn: to where a pixel holds kFaintest electrons of it. 0 where it never holds e times that.
double wing_reach(double sigma_px, double electrons) {
  const double peak = electrons / (2.0 * kPi * sigma_px * sigma_px);
  return peak > std::exp(1.0) * kFaintest ? sigma_px * std::sqrt(2.0 * std::log(peak / kFaintest)) : 0.0;
}

}  // namespace

void Sheet::touch(const Window& window) {
  const auto holds = [](const Window& a, const Window& b) {
    return a.u_begin <= b.u_begin && a.u_end >= b.u_end && a.v_begin <= b.v_begin && a.v_end >= b.v_end;
  };
  if (windows.empty() || (!holds(windows.back(), window) && !holds(window, windows.back()))) {
    windows.push_back(window);
  } else if (!holds(windows.back(), window)) {
    windows.back() = window;
  }
}

void Sheet::prepare(int width, int height) {
  if (light.width() != width || light.height() != height) light = ImageF(width, height);
  column_sums.assign(static_cast<std::size_t>(width), 0.0);
  windows.clear();
}

void prefetch(const Sheet& sheet, Pixel at) {
  const Window w = window_about(sheet.light, at, 4.0);
  for (int v = w.v_begin; v < w.v_end; ++v) __builtin_prefetch(sheet.light.row(v) + w.u_begin, 1);
}

double core_sigma(const Camera& camera, Pixel at) {
  const Intrinsics& c = camera.intrinsics;
  const double du = at.u - c.cx_px;
  const double dv = at.v - c.cy_px;
  const double corner = c.half_diagonal_px();
  return camera.psf.sigma_px + camera.psf.sigma_growth_px * (du * du + dv * dv) / (corner * corner);
}

LitDisc lambert_disc(int cells, double phase_angle_rad, const Vec2& sunward) {
  constexpr int kFine = 4;  // samples along a cell's edge
  LitDisc disc;
  disc.cells = cells;
  disc.intensity.resize(static_cast<std::size_t>(cells) * static_cast<std::size_t>(cells));
  const double towards = std::sin(phase_angle_rad);
  const double outwards = std::cos(phase_angle_rad);
  double sum = 0.0;
  Vec2 moment = Vec2::Zero();
  for (int j = 0; j < cells; ++j) {
    for (int i = 0; i < cells; ++i) {
      double light = 0.0;
      for (int k = 0; k < kFine * kFine; ++k) {
        const double x = 2.0 * (i + (k % kFine + 0.5) / kFine) / cells - 1.0;
        const double y = 2.0 * (j + (k / kFine + 0.5) / kFine) / cells - 1.0;
        const double z2 = 1.0 - x * x - y * y;
        if (z2 <= 0.0) continue;
        light += std::max(0.0, towards * (x * sunward.x() + y * sunward.y()) + outwards * std::sqrt(z2));
      }
      disc.intensity[static_cast<std::size_t>(j) * static_cast<std::size_t>(cells) + static_cast<std::size_t>(i)] =
          static_cast<float>(light);
      sum += light;
      moment += light * Vec2((2.0 * i + 1.0) / cells - 1.0, (2.0 * j + 1.0) / cells - 1.0);
    }
  }
  if (!(sum > 0.0)) {  // exactly behind: the edge that is nearest to the Sun
    disc.cells = 0;
    return disc;
  }
  for (float& light : disc.intensity) light = static_cast<float>(static_cast<double>(light) / sum);
  disc.photocentre = moment / sum;
  return disc;
}

Painter::Painter(const Camera& camera, const Effects& effects)
    : camera_(&camera),
      aberrations_(effects.psf_aberrations),
      motion_(effects.motion),
      discs_(effects.discs),
      half_diagonal_px_(camera.intrinsics.half_diagonal_px()) {}

void Painter::add(const RenderedSource& source, Sheet& sheet) const {
  if (!(source.electrons > 0.0) || !std::isfinite(source.pixel.u) || !std::isfinite(source.pixel.v)) return;
  const Vec2 way = source.smear_px;
  if (!motion_ || way.norm() < kLeastMotion) {
    add_at(source, source.pixel, source.electrons, sheet);
    return;
  }
  const double length = way.norm() + 2.0 * source.bend_px.norm();
  const int count = 1 + static_cast<int>(length / (kSampleStep * core_sigma(*camera_, source.pixel)));
  for (int i = 0; i < count; ++i) {
    const double t = (i + 0.5) / count - 0.5;  // of the exposure
    const Vec2 at = source.pixel.vec() + way * t + source.bend_px * (4.0 * t * t);
    add_at(source, {at.x(), at.y()}, source.electrons / count, sheet);
  }
}

void Painter::add_light(int u, int v, double electrons, Sheet& sheet) {
  if (!sheet.light.view().contains(u, v)) return;
  sheet.light(u, v) += static_cast<float>(electrons);
  sheet.windows.push_back({u, u + 1, v, v + 1});
}

void Painter::add_at(const RenderedSource& source, Pixel at, double electrons, Sheet& sheet) const {
  const PointSpread& psf = camera_->psf;
  LitDisc lit;
  const LitDisc* disc = nullptr;
  const double sigma = core_sigma(*camera_, at);
  if (discs_ && source.radius_px > kLeastDisc * sigma) {
    const int cells = std::clamp(static_cast<int>(2.0 * source.radius_px / (kSampleStep * sigma)), 32, 1024);
    lit = lambert_disc(cells, source.source.phase_angle_rad, source.sunward_px);
    if (lit.cells > 0) disc = &lit;
  }
  if (!aberrations_) {
    add_shape(source, disc, at, sigma, core_reach(sigma, electrons), electrons, sheet);
    return;
  }
  double core = electrons;
  if (psf.halo_fraction > 0.0) {
    const Pixel centre{at.u + psf.halo_offset_u_px, at.v + psf.halo_offset_v_px};
    for (const bool outer : {false, true}) {
      const double halo_sigma = psf.halo_sigma_px * (outer ? kOuterHaloWidth : 1.0);
      const double wing = psf.halo_fraction * electrons * (outer ? kOuterHaloShare : 1.0 - kOuterHaloShare);
      // A faint star's wing of a hundredth of an electron a pixel would touch most of the frame. What lies beyond the
      // reach is put back within it, and a wing that is nowhere seen into the core: no light is lost.
      const double reach = wing_reach(halo_sigma, wing);
      if (reach == 0.0) continue;
      const double within = std::pow(std::erf((reach + 1.0) / (std::sqrt(2.0) * halo_sigma)), 2);
      add_shape(source, disc, centre, halo_sigma, reach, wing / within, sheet);
      core -= wing;
    }
  }
  add_core(source, disc, at, core, sheet);
}

void Painter::add_core(const RenderedSource& source, const LitDisc* disc, Pixel at, double electrons,
                       Sheet& sheet) const {
  if (!camera_->psf.kernel.empty()) {
    add_kernel(at, electrons, sheet);
    return;
  }
  const double sigma = core_sigma(*camera_, at);
  const double reach = core_reach(sigma, electrons);
  const Vec2 from_axis(at.u - camera_->intrinsics.cx_px, at.v - camera_->intrinsics.cy_px);
  const double distance = from_axis.norm();
  const double length = camera_->psf.coma_px * distance / half_diagonal_px_;
  if (std::abs(length) < kLeastComa) {
    add_shape(source, disc, at, sigma, reach, electrons, sheet);
    return;
  }
  // From its tip to the far side of its largest circle the pattern is 3 C long.
  const Vec2 outwards = from_axis / distance * (length / 3.0);
  const Vec2 across(-outwards.y(), outwards.x());
  for (const ComaPoint& p : coma_pattern()) {
    const Vec2 there = at.vec() + outwards * p.outwards + across * p.across;
    add_shape(source, disc, {there.x(), there.y()}, sigma, reach, electrons * p.share, sheet);
  }
}

void Painter::add_shape(const RenderedSource& source, const LitDisc* disc, Pixel at, double sigma_px, double reach,
                        double electrons, Sheet& sheet) const {
  if (disc != nullptr) {
    add_disc(*disc, at, source.radius_px, sigma_px, reach, electrons, sheet);
  } else {
    add_gaussian(at, sigma_px, reach, electrons, sheet);
  }
}

// Every sample of the kernel is a small square of even light; pixels collect what falls on them.
void Painter::add_kernel(Pixel at, double electrons, Sheet& sheet) const {
  const PsfKernel& kernel = camera_->psf.kernel;
  const double step = 1.0 / kernel.samples_per_px;
  const double left = at.u - 0.5 * kernel.width * step;
  const double top = at.v - 0.5 * kernel.height * step;
  const double reach = 0.5 * std::max(kernel.width, kernel.height) * step + 0.5;
  const Window w = window_about(sheet.light, at, reach);
  if (w.empty()) return;
  const auto width = static_cast<std::size_t>(w.u_end - w.u_begin);
  sheet.strip.assign(static_cast<std::size_t>(kernel.height) * width, 0.0f);
  // Share of sample i, which begins at `begin + i step`, in the pixel p.
  const auto share = [step](double begin, int i, int p) {
    const double from = begin + i * step;
    return static_cast<float>(std::max(0.0, std::min(from + step, p + 0.5) - std::max(from, p - 0.5)) / step);
  };
  const auto samples_of = [&](double begin, int p, int count) {
    return std::pair{std::clamp(static_cast<int>(std::floor((p - 0.5 - begin) / step)), 0, count),
                     std::clamp(static_cast<int>(std::ceil((p + 0.5 - begin) / step)) + 1, 0, count)};
  };
  for (int u = w.u_begin; u < w.u_end; ++u) {
    const auto [begin, end] = samples_of(left, u, kernel.width);
    for (int i = begin; i < end; ++i) {
      const float s = share(left, i, u);
      for (int j = 0; j < kernel.height; ++j) {
        sheet.strip[static_cast<std::size_t>(j) * width + static_cast<std::size_t>(u - w.u_begin)] +=
            s * kernel.values[static_cast<std::size_t>(j) * static_cast<std::size_t>(kernel.width) +
                              static_cast<std::size_t>(i)];
      }
    }
  }
  for (int v = w.v_begin; v < w.v_end; ++v) {
    const auto [begin, end] = samples_of(top, v, kernel.height);
    float* const out = sheet.light.row(v) + w.u_begin;
    for (int j = begin; j < end; ++j) {
      const float s = static_cast<float>(electrons) * share(top, j, v);
      const float* const strip = sheet.strip.data() + static_cast<std::size_t>(j) * width;
      for (std::size_t k = 0; k < width; ++k) {
        out[k] += s * strip[k];
        sheet.column_sums[static_cast<std::size_t>(w.u_begin) + k] += static_cast<double>(s * strip[k]);
      }
    }
  }
  sheet.touch(w);
}

}  // namespace astronav::render
