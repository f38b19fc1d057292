// SPDX-License-Identifier: Apache-2.0
#include "simulator/render/point_spread.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "simulator/render/gaussian.h"
#include "simulator/sky/sky.h"

namespace astronav::render {
namespace {

// Of the halo's light, and of its width.
constexpr double kOuterHaloShare = 0.4;
constexpr double kOuterHaloWidth = 2.0;

constexpr double kFaintest = 0.1;   // electrons a pixel, below which a source's wing is left out
constexpr double kCoreReach = 4.0;  // sigma, at least

// What is smaller than this is not drawn: it would widen a spot by 1e-5 px or less. (A disc that did so by 0.005 px
// still moved a fit of two bodies, where the brighter one is full, by 0.003 px.)
constexpr double kLeastMotion = 0.02;  // px, from end to end
constexpr double kLeastComa = 0.02;    // px, of the whole pattern
constexpr double kLeastDisc = 0.03;    // radius over the core's sigma

// How densely motion and discs are sampled, in sigmas of the Gaussian that smooths them; through a measured kernel, in
// pixels.
constexpr double kSampleStep = 0.35;
constexpr double kKernelStep = 0.5;
// Cells along the diameter of a disc. One that would need more, or as many stamps of a kernel, is sampled once a pixel:
// what every pixel gets from such a grid is the same, however narrow the Gaussian is.
constexpr int kLeastCells = 32;
constexpr int kMostCells = 1024;
constexpr int kMostStamps = 256;

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

Window window_about(const Sheet& sheet, double left, double right, double top, double bottom) {
  // A source far outside stays out of the conversion to int.
  if (!(right > -1.0 && left < sheet.width && bottom > -1.0 && top < sheet.height)) return {};
  const auto begin = [](double at) { return static_cast<int>(std::floor(std::max(at, 0.0))); };
  const auto end = [](double at, int size) {
    return static_cast<int>(std::ceil(std::min(at, static_cast<double>(size - 1)))) + 1;
  };
  return {begin(left), end(right, sheet.width), begin(top), end(bottom, sheet.height)};
}
Window window_about(const Sheet& sheet, Pixel centre, double reach) {
  return window_about(sheet, centre.u - reach, centre.u + reach, centre.v - reach, centre.v + reach);
}

double area(const Window& w) {
  return static_cast<double>(w.u_end - w.u_begin) * static_cast<double>(w.v_end - w.v_begin);
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
  const Window w = window_about(sheet, centre, reach);
  if (w.empty()) return;
  if (sheet.counting) {
    sheet.work += area(w);
    return;
  }
  const int width = w.u_end - w.u_begin;
  const int height = w.v_end - w.v_begin;
  if (sheet.columns.size() < static_cast<std::size_t>(width)) sheet.columns.resize(static_cast<std::size_t>(width));
  if (sheet.rows.size() < static_cast<std::size_t>(height)) sheet.rows.resize(static_cast<std::size_t>(height));
  integrate_gaussian(centre.u, sigma_px, w.u_begin, width, sheet.columns.data());
  integrate_gaussian(centre.v, sigma_px, w.v_begin, height, sheet.rows.data());
  add_product(w, electrons, sheet);
}

// A disc through a Gaussian: first along the rows of the disc's grid, then along the columns. `centre` is the disc's.
void add_disc(const LitDisc& disc, Pixel centre, double sigma_px, double reach, double electrons, Sheet& sheet) {
  const double half = 0.5 * disc.step_px + reach;
  const Window w = window_about(sheet, centre.u + disc.u_px(0) - half, centre.u + disc.u_px(disc.columns - 1) + half,
                                centre.v + disc.v_px(0) - half, centre.v + disc.v_px(disc.rows - 1) + half);
  if (w.empty()) return;
  const auto width = static_cast<std::size_t>(w.u_end - w.u_begin);
  const auto columns = static_cast<std::size_t>(disc.columns), rows = static_cast<std::size_t>(disc.rows);
  const auto span_of = [&](double at, int begin, int end) {
    return std::pair{std::clamp(static_cast<int>(std::floor(at - reach)), begin, end),
                     std::clamp(static_cast<int>(std::ceil(at + reach)) + 1, begin, end)};
  };
  if (sheet.counting) {
    sheet.work += static_cast<double>(rows) * (static_cast<double>(columns) + static_cast<double>(width)) * 2.0 * reach;
    return;
  }
  sheet.strip.assign(rows * width, 0.0f);
  sheet.columns.resize(std::max(sheet.columns.size(), std::max(width, static_cast<std::size_t>(w.v_end - w.v_begin))));
  for (std::size_t i = 0; i < columns; ++i) {
    const double at = centre.u + disc.u_px(static_cast<int>(i));
    const auto [begin, end] = span_of(at, w.u_begin, w.u_end);
    if (begin >= end) continue;
    integrate_gaussian(at, sigma_px, begin, end - begin, sheet.columns.data());
    for (std::size_t j = 0; j < rows; ++j) {
      const float light = disc.light[j * columns + i];
      if (light == 0.0f) continue;
      float* out = sheet.strip.data() + j * width + static_cast<std::size_t>(begin - w.u_begin);
      for (int k = 0; k < end - begin; ++k) out[k] += light * sheet.columns[static_cast<std::size_t>(k)];
    }
  }
  for (std::size_t j = 0; j < rows; ++j) {
    const double at = centre.v + disc.v_px(static_cast<int>(j));
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

// The outline alone; making it takes about as long as painting kSampled pixels a cell.
LitDisc unlit_disc(const Globe& globe, int cells, Sheet& sheet) {
  constexpr double kSampled = 16.0;
  sheet.work += kSampled * cells * cells;
  LitDisc disc;
  disc.columns = disc.rows = cells;
  disc.step_px = 2.0 * globe.radius_px / cells;
  disc.left_px = disc.top_px = -globe.radius_px + 0.5 * disc.step_px;
  return disc;
}

// A disc about its centre of light, or a point.
void add_shape(const LitDisc* disc, Pixel at, double sigma_px, double reach, double electrons, Sheet& sheet) {
  if (disc != nullptr) {
    const Vec2 centre = at.vec() - disc->photocentre_px;
    add_disc(*disc, {centre.x(), centre.y()}, sigma_px, reach, electrons, sheet);
  } else {
    add_gaussian(at, sigma_px, reach, electrons, sheet);
  }
}

// A measured kernel on the pixels about a place: every sample is a small square of even light.
struct KernelStamp {
  KernelStamp(const PsfKernel& kernel, double u, double v)
      : u_begin(first(u, kernel.width, kernel)),
        v_begin(first(v, kernel.height, kernel)),
        shares(size(kernel.width, kernel), size(kernel.height, kernel)) {
    const double step = 1.0 / kernel.samples_per_px;
    const double left = u - 0.5 * kernel.width * step - u_begin;
    const double top = v - 0.5 * kernel.height * step - v_begin;
    // Share of sample i, which begins at `begin + i step`, in the pixel p.
    const auto share = [step](double begin, int i, int p) {
      const double from = begin + i * step;
      return static_cast<float>(std::max(0.0, std::min(from + step, p + 0.5) - std::max(from, p - 0.5)) / step);
    };
    const auto samples_of = [&](double begin, int p, int count) {
      return std::pair{std::clamp(static_cast<int>(std::floor((p - 0.5 - begin) / step)), 0, count),
                       std::clamp(static_cast<int>(std::ceil((p + 0.5 - begin) / step)) + 1, 0, count)};
    };
    ImageF strip(shares.width(), kernel.height);
    for (int u_pixel = 0; u_pixel < shares.width(); ++u_pixel) {
      const auto [begin, end] = samples_of(left, u_pixel, kernel.width);
      for (int i = begin; i < end; ++i) {
        const float s = share(left, i, u_pixel);
        for (int j = 0; j < kernel.height; ++j) {
          strip(u_pixel, j) += s * kernel.values[static_cast<std::size_t>(j) * static_cast<std::size_t>(kernel.width) +
                                                 static_cast<std::size_t>(i)];
        }
      }
    }
    for (int v_pixel = 0; v_pixel < shares.height(); ++v_pixel) {
      const auto [begin, end] = samples_of(top, v_pixel, kernel.height);
      for (int j = begin; j < end; ++j) {
        const float s = share(top, j, v_pixel);
        for (int k = 0; k < shares.width(); ++k) shares(k, v_pixel) += s * strip(k, j);
      }
    }
  }
  static int first(double at, int samples, const PsfKernel& kernel) {
    return static_cast<int>(std::floor(at - 0.5 * samples / kernel.samples_per_px + 0.5));
  }
  static int size(int samples, const PsfKernel& kernel) {
    return static_cast<int>(std::ceil(static_cast<double>(samples) / kernel.samples_per_px)) + 1;
  }

  int u_begin;
  int v_begin;
  ImageF shares;
};

// `moved_u`, `moved_v`: by how many pixels the stamp is used away from where it was made.
void add_stamp(const KernelStamp& stamp, int moved_u, int moved_v, double electrons, Sheet& sheet) {
  const int u_begin = stamp.u_begin + moved_u;
  const int v_begin = stamp.v_begin + moved_v;
  const int left = std::max(0, -u_begin), right = std::min(stamp.shares.width(), sheet.width - u_begin);
  const int top = std::max(0, -v_begin), bottom = std::min(stamp.shares.height(), sheet.height - v_begin);
  if (left >= right || top >= bottom) return;
  for (int j = top; j < bottom; ++j) {
    const float* const shares = stamp.shares.row(j);
    float* const out = sheet.light.row(v_begin + j) + u_begin;
    double* const sums = sheet.column_sums.data() + u_begin;
    for (int k = left; k < right; ++k) {
      const float light = static_cast<float>(electrons) * shares[k];
      out[k] += light;
      sums[k] += static_cast<double>(light);
    }
  }
  sheet.touch({u_begin + left, u_begin + right, v_begin + top, v_begin + bottom});
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
    touched_ += static_cast<std::size_t>(area(window));
    if (touched_ > static_cast<std::size_t>(width) * static_cast<std::size_t>(height)) {
      windows.assign(1, {0, width, 0, height});
    }
  } else if (!holds(windows.back(), window)) {
    windows.back() = window;
  }
}

void Sheet::prepare(int wide, int high) {
  width = wide;
  height = high;
  touched_ = 0;
  if (light.width() != width || light.height() != height) light = ImageF(width, height);
  column_sums.assign(static_cast<std::size_t>(width), 0.0);
  windows.clear();
}

void prefetch(const Sheet& sheet, Pixel at) {
  const Window w = window_about(sheet, at, 4.0);
  for (int v = w.v_begin; v < w.v_end; ++v) __builtin_prefetch(sheet.light.row(v) + w.u_begin, 1);
}

double core_sigma(const Camera& camera, Pixel at) {
  const Intrinsics& c = camera.intrinsics;
  const double du = at.u - c.cx_px;
  const double dv = at.v - c.cy_px;
  const double corner = c.half_diagonal_px();
  return camera.psf.sigma_px + camera.psf.sigma_growth_px * (du * du + dv * dv) / (corner * corner);
}

Painter::Painter(const Camera& camera, const Effects& effects)
    : camera_(&camera),
      aberrations_(effects.psf_aberrations),
      motion_(effects.motion),
      discs_(effects.discs),
      half_diagonal_px_(camera.intrinsics.half_diagonal_px()) {}

void Painter::add(const RenderedSource& source, Sheet& sheet) const {
  if (!(source.electrons > 0.0) || !std::isfinite(source.pixel.u) || !std::isfinite(source.pixel.v)) return;
  const LitDisc whole = whole_disc(source, sheet);
  const LitDisc* const disc = whole.columns > 0 ? &whole : nullptr;
  const Vec2 way = source.smear_px;
  if (!motion_ || way.norm() < kLeastMotion) {
    add_at(source, disc, source.pixel, source.electrons, sheet);
    return;
  }
  const double length = way.norm() + 2.0 * source.bend_px.norm();
  const int count = 1 + static_cast<int>(length / (kSampleStep * core_sigma(*camera_, source.pixel)));
  if (sheet.counting) {
    const double before = sheet.work;
    add_at(source, disc, source.pixel, source.electrons / count, sheet);
    sheet.work = before + count * (sheet.work - before);
    return;
  }
  for (int i = 0; i < count; ++i) {
    const double t = (i + 0.5) / count - 0.5;  // of the exposure
    const Vec2 at = source.pixel.vec() + way * t + source.bend_px * (4.0 * t * t);
    add_at(source, disc, {at.x(), at.y()}, source.electrons / count, sheet);
  }
}

double Painter::cell_px(Pixel at) const {
  return camera_->psf.kernel.empty() ? kSampleStep * core_sigma(*camera_, at) : kKernelStep;
}

bool Painter::is_large(const RenderedSource& source) const {
  const int most = camera_->psf.kernel.empty() ? kMostCells : kMostStamps;
  return 2.0 * source.radius_px > most * cell_px(source.pixel);
}

LitDisc Painter::whole_disc(const RenderedSource& source, Sheet& sheet) const {
  if (!discs_ || !(source.radius_px > kLeastDisc * core_sigma(*camera_, source.pixel)) || is_large(source)) return {};
  const int cells = std::max(kLeastCells, static_cast<int>(2.0 * source.radius_px / cell_px(source.pixel)));
  const Globe globe{source.radius_px, source.source.phase_angle_rad, source.sunward_px, source.source.minnaert};
  return sheet.counting ? unlit_disc(globe, cells, sheet) : lit_disc(globe, cells);
}

LitDisc Painter::large_disc(const RenderedSource& source, Pixel at, Sheet& sheet) const {
  // Lambert's: of the closed form.
  const Globe globe{source.radius_px, source.source.phase_angle_rad, source.sunward_px};
  // As far beside the picture as light comes from.
  const PointSpread& psf = camera_->psf;
  double beyond = std::max(core_reach(core_sigma(*camera_, at), source.electrons),
                           wing_reach(psf.halo_sigma_px * kOuterHaloWidth, psf.halo_fraction * source.electrons));
  if (!psf.kernel.empty()) {
    beyond = std::max(beyond, std::max(psf.kernel.width, psf.kernel.height) / psf.kernel.samples_per_px);
  }
  const Vec2 centre = at.vec() - sky::lambert_photocentre_shift(globe.radius_px, globe.phase_angle_rad) * globe.sunward;
  const Part part{-beyond - centre.x(), sheet.width + beyond - centre.x(), -beyond - centre.y(),
                  sheet.height + beyond - centre.y()};
  if (!sheet.counting) return lit_disc_part(globe, part);
  const int cells =
      static_cast<int>(std::min(2.0 * source.radius_px, std::max(sheet.width, sheet.height) + 2.0 * beyond));
  return unlit_disc(globe, cells, sheet);
}

void Painter::add_at(const RenderedSource& source, const LitDisc* disc, Pixel at, double electrons,
                     Sheet& sheet) const {
  LitDisc part;
  if (discs_ && is_large(source)) {
    part = large_disc(source, at, sheet);
    if (part.columns == 0) return;  // beside the picture
    disc = &part;
  }
  const PointSpread& psf = camera_->psf;
  if (!aberrations_) {
    const double sigma = core_sigma(*camera_, at);
    add_shape(disc, at, sigma, core_reach(sigma, electrons), electrons, sheet);
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
      add_shape(disc, centre, halo_sigma, reach, wing / within, sheet);
      core -= wing;
    }
  }
  add_core(disc, at, core, sheet);
}

void Painter::add_core(const LitDisc* disc, Pixel at, double electrons, Sheet& sheet) const {
  if (!camera_->psf.kernel.empty()) {
    add_kernel(disc, at, electrons, sheet);
    return;
  }
  const double sigma = core_sigma(*camera_, at);
  const double reach = core_reach(sigma, electrons);
  const Vec2 from_axis(at.u - camera_->intrinsics.cx_px, at.v - camera_->intrinsics.cy_px);
  const double distance = from_axis.norm();
  const double length = camera_->psf.coma_px * distance / half_diagonal_px_;
  if (std::abs(length) < kLeastComa) {
    add_shape(disc, at, sigma, reach, electrons, sheet);
    return;
  }
  // From its tip to the far side of its largest circle the pattern is 3 C long.
  const Vec2 outwards = from_axis / distance * (length / 3.0);
  const Vec2 across(-outwards.y(), outwards.x());
  for (const ComaPoint& p : coma_pattern()) {
    const Vec2 there = at.vec() + outwards * p.outwards + across * p.across;
    add_shape(disc, {there.x(), there.y()}, sigma, reach, electrons * p.share, sheet);
  }
}

void Painter::add_kernel(const LitDisc* disc, Pixel at, double electrons, Sheet& sheet) const {
  const PsfKernel& kernel = camera_->psf.kernel;
  if (sheet.counting) {
    const double stamp = 2.0 * kernel.width * kernel.height;
    sheet.work += stamp * (disc != nullptr ? static_cast<double>(disc->columns) * disc->rows : 1.0);
    return;
  }
  if (disc == nullptr) {
    add_stamp(KernelStamp(kernel, at.u, at.v), 0, 0, electrons, sheet);
    return;
  }
  const Vec2 centre = at.vec() - disc->photocentre_px;
  const double first_u = centre.x() + disc->u_px(0), first_v = centre.y() + disc->v_px(0);
  const bool same = disc->step_px == 1.0;  // every cell lies in its pixel as the first one does
  const KernelStamp stamp(kernel, first_u, first_v);
  for (int j = 0; j < disc->rows; ++j) {
    for (int i = 0; i < disc->columns; ++i) {
      const float light = disc->light[static_cast<std::size_t>(j) * static_cast<std::size_t>(disc->columns) +
                                      static_cast<std::size_t>(i)];
      if (light == 0.0f) continue;
      const double share = electrons * static_cast<double>(light);
      if (same) {
        add_stamp(stamp, i, j, share, sheet);
      } else {
        add_stamp(KernelStamp(kernel, first_u + i * disc->step_px, first_v + j * disc->step_px), 0, 0, share, sheet);
      }
    }
  }
}

double painting_work(std::span<const RenderedSource> sources, const Camera& camera, const Effects& effects) {
  Sheet sheet;
  sheet.counting = true;
  sheet.width = camera.intrinsics.width_px;
  sheet.height = camera.intrinsics.height_px;
  const Painter painter(camera, effects);
  for (const RenderedSource& source : sources) painter.add(source, sheet);
  return sheet.work;
}

}  // namespace astronav::render
