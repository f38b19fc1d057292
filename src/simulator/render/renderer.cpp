// SPDX-License-Identifier: Apache-2.0
#include "simulator/render/renderer.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <deque>
#include <limits>
#include <map>
#include <mutex>
#include <unordered_map>

#include "simulator/render/coarse_map.h"
#include "simulator/render/detector_pattern.h"
#include "simulator/render/dn_law.h"
#include "simulator/render/point_spread.h"
#include "simulator/render/protons.h"

namespace astronav::render {
namespace {

constexpr double kMeanStepSigma = 0.004;  // to which background means are rounded, in noise of the pixel
constexpr double kSmearReserve = 200.0;   // steps that the background's tables reach further, for smeared columns
constexpr std::size_t kKept = 3;          // backgrounds, of different exposures
// A pixel this near to its full well (in sigmas) may overflow.
constexpr double kNearlyFull = 8.0;

DnChain chain_of(const Detector& detector, const Effects& effects) {
  DnChain chain;
  chain.shot = effects.shot;
  chain.full_well_e = effects.full_well ? detector.full_well_e : std::numeric_limits<double>::infinity();
  chain.read_noise_e = effects.read ? detector.read_noise_e : 0.0;
  chain.gain_e_dn = detector.gain_e_dn;
  chain.bias_dn = detector.bias_dn;
  chain.max_dn = effects.quantisation ? (1 << detector.bits) - 1 : 65535;
  return chain;
}

RandomStream stream_of(const StreamId& frame, std::string_view purpose) {
  return RandomStream({.seed = frame.seed, .sample = frame.sample, .image = frame.image, .purpose = purpose});
}
RandomBlock block_of(const StreamId& frame, std::string_view purpose) {
  return RandomBlock({.seed = frame.seed, .sample = frame.sample, .image = frame.image, .purpose = purpose});
}

// Time that the image spends under a row on its way to the store, as a share of the exposure.
double transfer_share(const Camera& camera, const Exposure& exposure, const Effects& effects) {
  return effects.frame_transfer && exposure.duration_s > 0.0
             ? camera.detector.frame_transfer_row_us * 1e-6 / exposure.duration_s
             : 0.0;
}

bool has_stray_light(const Camera& camera, const Exposure& exposure, const Effects& effects) {
  return effects.stray_light && camera.optics.stray_light_e_s_px > 0.0 && exposure.sun_C_m.norm() > 0.0;
}

// Stray sunlight over the picture, electrons a pixel (docs/theory/rendering.md eq. 12).
CoarseMap<16> stray_light(const Camera& camera, const Exposure& exposure) {
  const double distance = exposure.sun_C_m.norm();
  const Vec3 sun_C = exposure.sun_C_m / distance;
  const double at_30_degrees =
      camera.optics.stray_light_e_s_px * exposure.duration_s * std::pow(kAstronomicalUnit / distance, 2);
  return {camera.intrinsics, [&](Pixel at) {
            const Result<Vec3> direction_C = unproject(camera.intrinsics, at);
            if (!direction_C) return 0.0;
            // The law holds outside of the Sun's disc.
            const double angle = std::max(0.25 * kDegree, angle_between(*direction_C, sun_C));
            return at_30_degrees * std::pow(30.0 * kDegree / angle, camera.optics.stray_light_power);
          }};
}

// Charge of one column, as far as it is known: pixels are drawn when overflowing charge reaches them.
class Column {
 public:
  Column(int height, double full_well_e) : full_well_(full_well_e), charge_(static_cast<std::size_t>(height), -1.0) {}

  // Marks a pixel with what it collected, the well's limit aside.
  void set(int v, double electrons) { charge_[static_cast<std::size_t>(v)] = electrons; }
  double charge(int v) const { return charge_[static_cast<std::size_t>(v)]; }
  bool known(int v) const { return charge(v) >= 0.0; }

  // Half of what a well cannot hold runs up, half down; each fills what room it meets. At the edge it drains away.
  template <typename Draw>
  void overflow(const Draw& draw) {
    const int height = static_cast<int>(charge_.size());
    std::vector<double> excess(charge_.size(), 0.0);
    for (std::size_t v = 0; v < charge_.size(); ++v) {
      if (charge_[v] <= full_well_) continue;
      excess[v] = charge_[v] - full_well_;
      charge_[v] = full_well_;
    }
    for (const int step : {1, -1}) {
      double running = 0.0;
      for (int v = step > 0 ? 0 : height - 1; v >= 0 && v < height; v += step) {
        if (running > 0.0) {
          if (!known(v)) set(v, std::min(full_well_, draw(v)));
          const double taken = std::min(running, full_well_ - charge(v));
          set(v, charge(v) + taken);
          running -= taken;
        }
        const double whole = std::floor(0.5 * excess[static_cast<std::size_t>(v)]);
        running += step > 0 ? whole : excess[static_cast<std::size_t>(v)] - whole;
      }
    }
  }

 private:
  double full_well_;
  std::vector<double> charge_;
};

// Light that columns have caught on their way to the store.
struct Smear {
  std::vector<float> electrons;       // a pixel, of columns that the background's tables can raise
  std::vector<std::uint16_t> raised;  // by how many of its levels; empty where no column is
};

// Pixels under sources: those that tables can draw, and those drawn singly, too bright for tables or hit by protons.
struct Gathered {
  std::size_t count = 0;  // of what follows; there may be room for more
  std::vector<std::uint32_t> index;
  std::vector<float> mean_e;
  std::vector<std::uint16_t> dn;
  struct Single {
    std::uint32_t index = 0;
    double mean_e = 0.0;
    double deposit_e = 0.0;  // by protons: charge, not light
  };
  std::vector<Single> singles;

  void prepare(std::size_t most) {
    count = 0;
    singles.clear();
    if (index.size() >= most) return;
    index.resize(most);
    mean_e.resize(most);
    dn.resize(most);
  }
};

}  // namespace

struct Renderer::Background {
  Exposure exposure;
  Effects effects;
  DnChain chain;
  struct Pixel {
    float mean_e;    // expected electrons without sources
    float response;  // of the light of sources
  };
  Image<Pixel> pixels;
  std::optional<EvenLaws> laws;
  std::vector<std::uint16_t> level;  // of each pixel in `laws`
  double most_raised = 0.0;          // levels that are left above the brightest of these pixels
  std::vector<std::uint32_t> apart;  // pixels whose mean no level fits: drawn by themselves
  std::shared_ptr<const std::optional<GradedLaws>> graded;

  bool is_for(const Exposure& e, const Effects& f) const {
    return exposure.duration_s == e.duration_s && effects == f && exposure.sun_C_m == e.sun_C_m;
  }
  // Without sources.
  double mean_e(std::size_t i, const Smear& smear) const {
    const Pixel& pixel = pixels.pixels()[i];
    return static_cast<double>(pixel.mean_e +
                               smear.electrons[i % static_cast<std::size_t>(pixels.width())] * pixel.response);
  }

  void smear_columns(double transfer, Sheet& sheet, Smear& smear) const;
  void draw(const Smear& smear, const StreamId& noise, RandomStream& single, std::span<std::uint16_t> dn) const;
  void gather(const Smear& smear, Sheet& sheet, Gathered& gathered) const;
  void draw_gathered(const StreamId& noise, Gathered& gathered, std::span<std::uint16_t> dn) const;
  void gather_hits(std::vector<ProtonPixel> hits, const Smear& smear, const Sheet& sheet,
                   std::vector<Gathered::Single>& out) const;
  void draw_singles(const Smear& smear, const Gathered& gathered, bool blooming, RandomStream& single,
                    ImageU16& out) const;
};

struct Renderer::Cache {
  std::mutex mutex;
  std::deque<std::shared_ptr<const Background>> backgrounds;
  std::vector<std::pair<DnChain, std::shared_ptr<const std::optional<GradedLaws>>>> graded;
};

Renderer::Renderer(const Camera& camera, std::uint64_t detector_seed)
    : camera_(camera),
      pattern_(std::make_shared<DetectorPattern>(camera, detector_seed)),
      cache_(std::make_shared<Cache>()) {}

std::shared_ptr<const Renderer::Background> Renderer::background(const Exposure& asked, const Effects& effects) const {
  // The Sun's place matters to stray light alone.
  Exposure exposure{.duration_s = asked.duration_s};
  const bool has_stray = has_stray_light(camera_, asked, effects);
  if (has_stray) exposure.sun_C_m = asked.sun_C_m;

  auto made = std::make_shared<Background>();
  made->exposure = exposure;
  made->effects = effects;
  made->chain = chain_of(camera_.detector, effects);
  {
    const std::lock_guard lock(cache_->mutex);
    for (const auto& kept : cache_->backgrounds) {
      if (kept->is_for(exposure, effects)) return kept;
    }
    for (const auto& [chain, laws] : cache_->graded) {
      if (chain == made->chain) made->graded = laws;
    }
  }
  const Detector& d = camera_.detector;
  const int width = camera_.intrinsics.width_px;
  const int height = camera_.intrinsics.height_px;
  const double light_e = effects.background ? d.background_e_s_px * exposure.duration_s : 0.0;
  const double dark_e = effects.dark ? d.dark_current_e_s * exposure.duration_s * dark_factor(d) : 0.0;
  const bool vignetted = effects.vignetting && pattern_->vignetting.width() > 0;
  const CoarseMap<16> stray = has_stray ? stray_light(camera_, exposure) : CoarseMap<16>();
  made->pixels = Image<Background::Pixel>(width, height);
  // Diffuse light smears as well: every pixel passes under its whole column.
  std::vector<double> column_sums(static_cast<std::size_t>(width), 0.0);
  for (int v = 0; v < height; ++v) {
    for (int u = 0; u < width; ++u) {
      Background::Pixel& pixel = made->pixels(u, v);
      const float seen = vignetted ? pattern_->vignetting(u, v) : 1.0f;
      pixel.mean_e = (static_cast<float>(light_e) + (has_stray ? stray(u, v) : 0.0f)) * seen;
      pixel.response = effects.photo_nonuniformity ? 1.0f + pattern_->prnu(u, v) : 1.0f;
      column_sums[static_cast<std::size_t>(u)] += static_cast<double>(pixel.mean_e);
    }
  }
  const double transfer = transfer_share(camera_, exposure, effects);
  double lowest = std::numeric_limits<double>::infinity();
  double highest = 0.0;
  for (int v = 0; v < height; ++v) {
    for (int u = 0; u < width; ++u) {
      Background::Pixel& pixel = made->pixels(u, v);
      const auto smear = static_cast<float>(transfer * column_sums[static_cast<std::size_t>(u)]);
      const float dark = effects.dark_nonuniformity ? 1.0f + pattern_->dsnu(u, v) : 1.0f;
      pixel.mean_e = (pixel.mean_e + smear) * pixel.response + static_cast<float>(dark_e) * dark;
      lowest = std::min(lowest, static_cast<double>(pixel.mean_e));
      highest = std::max(highest, static_cast<double>(pixel.mean_e));
    }
  }
  if (effects.dark && effects.hot_pixels) {
    for (const HotPixel& hot : pattern_->hot) {
      made->pixels.pixels()[hot.index].mean_e += static_cast<float>(hot.leak * exposure.duration_s * dark_factor(d));
    }
  }

  const double step = kMeanStepSigma * made->chain.noise_e(0.5 * (lowest + highest));
  const double reserve = transfer > 0.0 ? kSmearReserve * step : 0.0;
  made->laws = EvenLaws::make(made->chain, lowest, highest + reserve, step);
  if (made->laws) {
    const auto means = made->pixels.pixels();
    const auto levels = static_cast<double>(made->laws->levels());
    const double top = made->laws->level(highest);
    made->most_raised = std::max(0.0, std::floor(levels - 1.0 - top));
    made->level.resize(means.size());
    for (std::size_t i = 0; i < means.size(); ++i) {
      const double level = made->laws->level(static_cast<double>(means[i].mean_e));
      if (level >= 0.0 && level < levels && static_cast<double>(means[i].mean_e) <= highest) {
        made->level[i] = static_cast<std::uint16_t>(level);
      } else {
        made->apart.push_back(static_cast<std::uint32_t>(i));
      }
    }
  }
  if (!made->graded) made->graded = std::make_shared<std::optional<GradedLaws>>(GradedLaws::make(made->chain));

  const std::lock_guard lock(cache_->mutex);
  cache_->backgrounds.push_front(made);
  if (cache_->backgrounds.size() > kKept) cache_->backgrounds.pop_back();
  const bool known = std::any_of(cache_->graded.begin(), cache_->graded.end(),
                                 [&](const auto& kept) { return kept.first == made->chain; });
  if (!known) {
    if (cache_->graded.size() >= kKept) cache_->graded.erase(cache_->graded.begin());
    cache_->graded.emplace_back(made->chain, made->graded);
  }
  return made;
}

void Renderer::electrons(std::span<const RenderedSource> sources, const Exposure& exposure, ImageF& out,
                         const Effects& effects) const {
  Effects even = effects;
  even.photo_nonuniformity = even.dark_nonuniformity = even.hot_pixels = even.shot = false;
  const std::shared_ptr<const Background> ground = background(exposure, even);
  const int width = camera_.intrinsics.width_px;
  const int height = camera_.intrinsics.height_px;
  Sheet sheet;
  sheet.prepare(width, height);
  const Painter painter(camera_, effects);
  for (const RenderedSource& source : sources) painter.add(source, sheet);
  const double transfer = transfer_share(camera_, exposure, effects);
  out = std::move(sheet.light);
  for (int v = 0; v < height; ++v) {
    for (int u = 0; u < width; ++u) {
      out(u, v) +=
          ground->pixels(u, v).mean_e + static_cast<float>(transfer * sheet.column_sums[static_cast<std::size_t>(u)]);
    }
  }
}

// Sources lie far apart in memory: the next ones are asked for while one is painted or gathered.
constexpr std::size_t kAhead = 1;

// Most columns need a few levels more all over, those of planets a drawing of their own.
void Renderer::Background::smear_columns(double transfer, Sheet& sheet, Smear& smear) const {
  const int width = sheet.light.width();
  smear.electrons.assign(static_cast<std::size_t>(width), 0.0f);
  smear.raised.clear();
  if (!(transfer > 0.0)) return;
  smear.raised.assign(static_cast<std::size_t>(width), 0);
  for (int u = 0; u < width; ++u) {
    const auto column = static_cast<std::size_t>(u);
    const double electrons = transfer * sheet.column_sums[column];
    if (electrons == 0.0) continue;
    const double levels = laws ? std::round(electrons / laws->step_e()) : 0.0;
    if (laws && levels <= most_raised) {
      smear.electrons[column] = static_cast<float>(electrons);
      smear.raised[column] = static_cast<std::uint16_t>(levels);
      continue;
    }
    for (int v = 0; v < sheet.light.height(); ++v) sheet.light(u, v) += static_cast<float>(electrons);
    sheet.touch({u, u + 1, 0, sheet.height});
  }
}

// Everything without sources.
void Renderer::Background::draw(const Smear& smear, const StreamId& noise, RandomStream& single,
                                std::span<std::uint16_t> dn) const {
  const auto draw_one = [&](std::size_t i) { dn[i] = chain.draw(mean_e(i, smear), single); };
  if (!laws) {
    for (std::size_t i = 0; i < dn.size(); ++i) draw_one(i);
    return;
  }
  RandomBlock random = block_of(noise, "background noise");
  laws->draw(level, smear.raised, random, dn.data());
  for (const std::uint32_t i : apart) draw_one(i);
}

// Takes the light off the sheet.
void Renderer::Background::gather(const Smear& smear, Sheet& sheet, Gathered& gathered) const {
  const auto tabulated_up_to = static_cast<float>(*graded ? (*graded)->max_mean_e() : -1.0);
  std::size_t most = 0;
  for (const Window& w : sheet.windows) most += static_cast<std::size_t>((w.u_end - w.u_begin) * (w.v_end - w.v_begin));
  gathered.prepare(most);
  std::uint32_t* const index = gathered.index.data();
  float* const mean_e = gathered.mean_e.data();
  std::size_t count = 0;
  const float* const smeared = smear.electrons.data();
  for (std::size_t i = 0; i < sheet.windows.size(); ++i) {
    if (i + kAhead < sheet.windows.size()) {
      const Window& next = sheet.windows[i + kAhead];
      for (int v = next.v_begin; v < next.v_end; ++v) {
        // Lines of 64 bytes: 16 of light, 8 pixels.
        for (int u = next.u_begin; u < next.u_end + 8; u += 8) __builtin_prefetch(pixels.row(v) + u);
      }
    }
    const Window& window = sheet.windows[i];
    for (int v = window.v_begin; v < window.v_end; ++v) {
      float* const lights = sheet.light.row(v);
      const Pixel* const row = pixels.row(v);
      const auto first = static_cast<std::uint32_t>(v) * static_cast<std::uint32_t>(pixels.width());
      for (int u = window.u_begin; u < window.u_end; ++u) {
        const float light = lights[u];
        lights[u] = 0.0f;
        const float mean = row[u].mean_e + (light + smeared[u]) * row[u].response;
        // Written always, and kept where there is light: no branch to foretell.
        index[count] = first + static_cast<std::uint32_t>(u);
        mean_e[count] = mean;
        const bool shines = light > 0.0f;
        count += static_cast<std::size_t>(shines && mean <= tabulated_up_to);
        if (shines && mean > tabulated_up_to) {
          gathered.singles.push_back({first + static_cast<std::uint32_t>(u), static_cast<double>(mean), 0.0});
        }
      }
    }
  }
  gathered.count = count;
}

void Renderer::Background::draw_gathered(const StreamId& noise, Gathered& gathered, std::span<std::uint16_t> dn) const {
  if (!*graded || gathered.count == 0) return;
  RandomBlock random = block_of(noise, "source noise");
  (*graded)->draw(std::span(gathered.mean_e).first(gathered.count), random, gathered.dn.data());
  for (std::size_t i = 0; i < gathered.count; ++i) dn[gathered.index[i]] = gathered.dn[i];
}

// What each pixel that protons hit would hold without them, and what they leave.
void Renderer::Background::gather_hits(std::vector<ProtonPixel> hits, const Smear& smear, const Sheet& sheet,
                                       std::vector<Gathered::Single>& out) const {
  const auto index = [&](const ProtonPixel& hit) {
    return static_cast<std::uint32_t>(hit.v) * static_cast<std::uint32_t>(sheet.width) +
           static_cast<std::uint32_t>(hit.u);
  };
  std::sort(hits.begin(), hits.end(), [&](const auto& a, const auto& b) { return index(a) < index(b); });
  for (const ProtonPixel& hit : hits) {
    const std::uint32_t i = index(hit);
    if (out.empty() || out.back().index != i) {
      const float light = sheet.light(hit.u, hit.v) * pixels.pixels()[i].response;
      out.push_back({i, mean_e(i, smear) + static_cast<double>(light), 0.0});
    }
    out.back().deposit_e += hit.electrons;
  }
}

void Renderer::Background::draw_singles(const Smear& smear, const Gathered& gathered, bool blooming,
                                        RandomStream& single, ImageU16& out) const {
  const int width = out.width();
  const double nearly_full = chain.full_well_e - kNearlyFull * std::sqrt(chain.full_well_e);
  std::map<int, Column> overflowing;
  for (const Gathered::Single& one : gathered.singles) {
    const int u = static_cast<int>(one.index) % width;
    const int v = static_cast<int>(one.index) / width;
    const double collected = chain.collect(one.mean_e, single) + one.deposit_e;
    if (blooming && one.mean_e + one.deposit_e > nearly_full) {
      overflowing.try_emplace(u, out.height(), chain.full_well_e).first->second.set(v, collected);
    } else {
      out(u, v) = chain.read(collected, single);
    }
  }
  if (overflowing.empty()) return;
  // What the charge may run into; of a pixel that was gathered and hit, the hit knows all.
  std::unordered_map<std::uint32_t, Gathered::Single> lit;
  for (std::size_t i = 0; i < gathered.count; ++i) {
    if (overflowing.contains(static_cast<int>(gathered.index[i]) % width)) {
      lit[gathered.index[i]] = {gathered.index[i], static_cast<double>(gathered.mean_e[i]), 0.0};
    }
  }
  for (const Gathered::Single& one : gathered.singles) lit[one.index] = one;
  for (auto& [column_u, column] : overflowing) {
    const int u = column_u;
    column.overflow([&](int v) {
      const auto index =
          static_cast<std::uint32_t>(v) * static_cast<std::uint32_t>(width) + static_cast<std::uint32_t>(u);
      const auto found = lit.find(index);
      return found != lit.end() ? chain.collect(found->second.mean_e, single) + found->second.deposit_e
                                : chain.collect(mean_e(index, smear), single);
    });
    for (int v = 0; v < out.height(); ++v) {
      if (column.known(v)) out(u, v) = chain.read(column.charge(v), single);
    }
  }
}

void Renderer::frame(std::span<const RenderedSource> sources, const Exposure& exposure, const StreamId& noise,
                     ImageU16& out, const Effects& effects) const {
  const int width = camera_.intrinsics.width_px;
  const int height = camera_.intrinsics.height_px;
  if (out.width() != width || out.height() != height) out = ImageU16(width, height);
  const std::shared_ptr<const Background> ground = background(exposure, effects);

  // Light is gathered where it overlaps. The sheet is dark between frames.
  thread_local Sheet sheet;
  thread_local Smear smear;
  thread_local Gathered gathered;
  sheet.prepare(width, height);
  const Painter painter(camera_, effects);
  for (std::size_t i = 0; i < sources.size(); ++i) {
    if (i + kAhead < sources.size()) prefetch(sheet, sources[i + kAhead].pixel);
    painter.add(sources[i], sheet);
  }
  ground->smear_columns(transfer_share(camera_, exposure, effects), sheet, smear);
  std::vector<Gathered::Single> hits;
  if (effects.cosmic_rays && camera_.detector.cosmic_rays_cm2_s > 0.0) {
    RandomStream protons = stream_of(noise, "protons");
    ground->gather_hits(proton_hits(camera_, exposure.duration_s, protons), smear, sheet, hits);
  }

  RandomStream single = stream_of(noise, "single pixels");
  // The light is taken from the sheet while it is still near in memory.
  ground->gather(smear, sheet, gathered);
  gathered.singles.insert(gathered.singles.end(), hits.begin(), hits.end());
  ground->draw(smear, noise, single, out.pixels());
  ground->draw_gathered(noise, gathered, out.pixels());
  const bool blooming = effects.blooming && effects.full_well && camera_.detector.blooming;
  ground->draw_singles(smear, gathered, blooming, single, out);
}

double time_tag_error_s(const Detector& detector, const StreamId& frame) {
  const double jitter = detector.time_tag_jitter_ms > 0.0 ? stream_of(frame, "time tag").normal() : 0.0;
  return 1e-3 * (detector.time_tag_latency_ms + detector.time_tag_jitter_ms * jitter);
}

}  // namespace astronav::render
