// SPDX-License-Identifier: Apache-2.0
#include "simulator/render/renderer.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <mutex>

#include "simulator/render/dn_law.h"
#include "simulator/render/point_spread.h"

namespace astronav::render {

Effects Effects::expected() {
  Effects e;
  e.shot = e.read = e.photo_nonuniformity = e.dark_nonuniformity = e.hot_pixels = e.cosmic_rays = false;
  return e;
}

namespace {

struct NamedEffect {
  std::string_view name;
  bool Effects::*field;
};
constexpr std::array<NamedEffect, 17> kEffects{{
    {"shot", &Effects::shot},
    {"dark", &Effects::dark},
    {"read", &Effects::read},
    {"photo_nonuniformity", &Effects::photo_nonuniformity},
    {"dark_nonuniformity", &Effects::dark_nonuniformity},
    {"hot_pixels", &Effects::hot_pixels},
    {"cosmic_rays", &Effects::cosmic_rays},
    {"full_well", &Effects::full_well},
    {"blooming", &Effects::blooming},
    {"quantisation", &Effects::quantisation},
    {"frame_transfer", &Effects::frame_transfer},
    {"vignetting", &Effects::vignetting},
    {"stray_light", &Effects::stray_light},
    {"background", &Effects::background},
    {"psf_aberrations", &Effects::psf_aberrations},
    {"motion", &Effects::motion},
    {"discs", &Effects::discs},
}};

}  // namespace

std::span<const std::string_view> effect_names() {
  static const auto names = [] {
    std::array<std::string_view, kEffects.size()> all;
    for (std::size_t i = 0; i < all.size(); ++i) all[i] = kEffects[i].name;
    return all;
  }();
  return names;
}

bool* effect(Effects& effects, std::string_view name) {
  for (const NamedEffect& e : kEffects) {
    if (e.name == name) return &(effects.*e.field);
  }
  return nullptr;
}

namespace {

DnChain chain_of(const Detector& detector, const Effects& switches) {
  DnChain chain;
  chain.shot = switches.shot;
  chain.full_well_e = switches.full_well ? detector.full_well_e : std::numeric_limits<double>::infinity();
  chain.read_noise_e = switches.read ? detector.read_noise_e : 0.0;
  chain.gain_e_dn = detector.gain_e_dn;
  chain.bias_dn = detector.bias_dn;
  chain.max_dn = switches.quantisation ? (1 << detector.bits) - 1 : 65535;
  return chain;
}

// Means are rounded to this share of the pixel's noise.
constexpr double kMeanStepSigma = 0.004;
constexpr std::size_t kMaxLevels = 4096;

Image<float> normal_map(int width, int height, double sigma, const StreamId& id) {
  Image<float> map(width, height);
  RandomStream random(id);
  // A pixel never loses more than all of its signal.
  for (float& x : map.pixels()) x = static_cast<float>(std::max(-1.0, sigma * random.normal()));
  return map;
}

}  // namespace

std::vector<RenderedSource> place_sources(std::span<const sky::SkySource> sky, const Camera& camera, const Mat3& R_CN,
                                          double exposure_s, double margin_px) {
  std::vector<RenderedSource> placed;
  placed.reserve(sky.size());
  const double u_max = camera.intrinsics.width_px - 0.5 + margin_px;
  const double v_max = camera.intrinsics.height_px - 0.5 + margin_px;
  for (const sky::SkySource& source : sky) {
    const Result<Pixel> pixel = project(camera.intrinsics, R_CN * source.direction_N);
    if (!pixel || pixel->u < -0.5 - margin_px || pixel->u > u_max || pixel->v < -0.5 - margin_px || pixel->v > v_max) {
      continue;
    }
    placed.push_back({source, *pixel, source.flux.electrons_per_s * exposure_s});
  }
  return placed;
}

// Level of each pixel's mean, and the tables of the levels.
struct Renderer::Background {
  double exposure_s = 0.0;
  Effects switches;
  DnTables tables;
  std::vector<std::uint16_t> level;
  std::vector<std::uint32_t> apart;  // pixels whose mean no level fits: drawn one by one
  bool tabulated = true;             // false: every pixel is drawn one by one
};

struct Renderer::BackgroundCache {
  std::mutex mutex;
  std::shared_ptr<const Background> last;
};

Renderer::Renderer(const Camera& camera, std::uint64_t detector_seed)
    : camera_(camera),
      prnu_(normal_map(camera.intrinsics.width_px, camera.intrinsics.height_px, camera.detector.photo_nonuniformity,
                       {.seed = detector_seed, .purpose = "photo response of the detector"})),
      dsnu_(normal_map(camera.intrinsics.width_px, camera.intrinsics.height_px, camera.detector.dark_nonuniformity,
                       {.seed = detector_seed, .purpose = "dark signal of the detector"})),
      cache_(std::make_shared<BackgroundCache>()) {}

void Renderer::electrons(std::span<const RenderedSource> sources, const Exposure& exposure, ImageF& out,
                         const Effects&) const {
  const double exposure_s = exposure.duration_s;
  const Detector& d = camera_.detector;
  out = ImageF(camera_.intrinsics.width_px, camera_.intrinsics.height_px,
               static_cast<float>((d.background_e_s_px + d.dark_current_e_s) * exposure_s));
  Scratch scratch;
  for (const RenderedSource& source : sources) add_source(out, camera_, source.pixel, source.electrons, scratch);
}

namespace {

// Expected electrons of every pixel without sources: light (1 + PRNU) + dark (1 + DSNU).
struct Means {
  double light_e;
  double dark_e;
  bool prnu;
  bool dsnu;
  double operator()(float photo, float dark) const {
    return light_e * (prnu ? 1.0 + static_cast<double>(photo) : 1.0) +
           dark_e * (dsnu ? 1.0 + static_cast<double>(dark) : 1.0);
  }
};

Means means_of(const Detector& d, double exposure_s, const Effects& switches) {
  return {d.background_e_s_px * exposure_s, switches.dark ? d.dark_current_e_s * exposure_s : 0.0,
          switches.photo_nonuniformity, switches.dark_nonuniformity};
}

}  // namespace

std::shared_ptr<const Renderer::Background> Renderer::background(double exposure_s, const Effects& switches) const {
  {
    const std::lock_guard lock(cache_->mutex);
    if (cache_->last && cache_->last->exposure_s == exposure_s && cache_->last->switches == switches) {
      return cache_->last;
    }
  }
  const Detector& d = camera_.detector;
  const DnChain chain = chain_of(d, switches);
  const Means means = means_of(d, exposure_s, switches);
  const double typical = means.light_e + means.dark_e;
  const double spread = 5.5 * std::hypot(switches.photo_nonuniformity ? means.light_e * d.photo_nonuniformity : 0.0,
                                         switches.dark_nonuniformity ? means.dark_e * d.dark_nonuniformity : 0.0);
  const double lowest = std::max(0.0, typical - spread);
  const double highest = typical + spread;
  const double noise = std::sqrt((switches.shot ? typical : 0.0) + chain.read_noise_e * chain.read_noise_e +
                                 chain.gain_e_dn * chain.gain_e_dn / 12.0);
  const double wanted = std::ceil((highest - lowest) / (kMeanStepSigma * noise)) + 1.0;

  auto made = std::make_shared<Background>();
  made->exposure_s = exposure_s;
  made->switches = switches;
  if (!(wanted <= kMaxLevels) || DnTables::too_costly(chain, lowest, highest, static_cast<std::size_t>(wanted))) {
    made->tabulated = false;
  } else {
    const auto levels = static_cast<std::size_t>(wanted);
    const double step = levels > 1 ? (highest - lowest) / static_cast<double>(levels - 1) : 1.0;
    std::vector<double> level_means(levels);
    for (std::size_t i = 0; i < levels; ++i) level_means[i] = lowest + step * static_cast<double>(i);
    made->tables = DnTables(chain, level_means);
    const auto photo = prnu_.pixels();
    const auto dark = dsnu_.pixels();
    made->level.resize(photo.size());
    for (std::size_t i = 0; i < photo.size(); ++i) {
      const double index = (means(photo[i], dark[i]) - lowest) / step + 0.5;
      if (index >= 0.0 && index < static_cast<double>(levels)) {
        made->level[i] = static_cast<std::uint16_t>(index);
      } else {
        made->apart.push_back(static_cast<std::uint32_t>(i));
      }
    }
  }
  const std::lock_guard lock(cache_->mutex);
  cache_->last = made;
  return made;
}

void Renderer::frame(std::span<const RenderedSource> sources, const Exposure& exposure, const StreamId& noise,
                     ImageU16& out, const Effects& switches) const {
  const double exposure_s = exposure.duration_s;
  const int width = camera_.intrinsics.width_px;
  const int height = camera_.intrinsics.height_px;
  if (out.width() != width || out.height() != height) out = ImageU16(width, height);
  const auto dn = out.pixels();
  const auto photo = prnu_.pixels();
  const auto dark = dsnu_.pixels();
  const DnChain chain = chain_of(camera_.detector, switches);
  const Means means = means_of(camera_.detector, exposure_s, switches);

  // Everything without sources.
  const std::shared_ptr<const Background> tables = background(exposure_s, switches);
  const auto stream = [&](std::string_view purpose) {
    return RandomStream({.seed = noise.seed, .sample = noise.sample, .image = noise.image, .purpose = purpose});
  };
  RandomStream sky_noise = stream("background noise");
  if (tables->tabulated) {
    tables->tables.draw(tables->level, sky_noise, dn.data());
    for (const std::uint32_t p : tables->apart) dn[p] = chain.draw(means(photo[p], dark[p]), sky_noise);
  } else {
    for (std::size_t i = 0; i < dn.size(); ++i) dn[i] = chain.draw(means(photo[i], dark[i]), sky_noise);
  }

  // Light of the sources, gathered where they overlap. The sheet is all zero between frames.
  thread_local ImageF sheet;
  thread_local Scratch scratch;
  thread_local std::vector<Window> windows;
  if (sheet.width() != width || sheet.height() != height) sheet = ImageF(width, height);
  windows.clear();
  for (const RenderedSource& source : sources) {
    const Windows touched = add_source(sheet, camera_, source.pixel, source.electrons, scratch);
    if (!touched.core.empty()) windows.push_back(touched.core);
    if (!touched.halo.empty()) windows.push_back(touched.halo);
  }
  RandomStream source_noise = stream("source noise");
  for (const Window& window : windows) {
    for (int v = window.v_begin; v < window.v_end; ++v) {
      float* light = sheet.row(v);
      for (int u = window.u_begin; u < window.u_end; ++u) {
        if (light[u] == 0.0f) continue;  // drawn already, with a window that overlaps this one
        const double response = switches.photo_nonuniformity ? 1.0 + static_cast<double>(prnu_(u, v)) : 1.0;
        const double mean = means(prnu_(u, v), dsnu_(u, v)) + static_cast<double>(light[u]) * response;
        out(u, v) = chain.draw(mean, source_noise);
        light[u] = 0.0f;
      }
    }
  }
}

}  // namespace astronav::render
