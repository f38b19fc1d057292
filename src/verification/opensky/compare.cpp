// SPDX-License-Identifier: Apache-2.0
#include "verification/opensky/compare.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <unordered_map>
#include <utility>

#include "foundation/math/statistics.h"
#include "models/photometry/photometry.h"
#include "verification/opensky/compare_model.h"
#include "verification/opensky/compare_star_shape.h"

namespace astronav::opensky {
namespace {

constexpr int kHalfWindow = 7;  // 15 x 15 pixels
constexpr double kAperturePx = 4.0;
constexpr double kCrowdedPx = 4.0;
constexpr double kCrowdedShare = 0.1;
constexpr int kRounds = 4;
constexpr double kClip = 4.0;
constexpr double kFitSnr = 8.0;  // of stars that fits are made with

// Which half a star belongs to: by its number, so that it depends on nothing else.
bool second_half(std::int64_t id) {
  return (static_cast<std::uint64_t>(id) * 0x9E3779B97F4A7C15ull >> 40 & 1) != 0;
}

bool inside(const Frame& frame, Pixel p, int margin) {
  return p.u >= margin - 0.5 && p.v >= margin - 0.5 && p.u < frame.dn.width() - margin - 0.5 &&
         p.v < frame.dn.height() - margin - 0.5;
}

bool saturated_window(const Frame& frame, Pixel at) {
  const int u0 = static_cast<int>(std::lround(at.u)), v0 = static_cast<int>(std::lround(at.v));
  for (int v = v0 - kHalfWindow; v <= v0 + kHalfWindow; ++v)
    for (int u = u0 - kHalfWindow; u <= u0 + kHalfWindow; ++u)
      if (frame.dn.view().contains(u, v) && frame.dn(u, v) >= frame.saturation_dn) return true;
  return false;
}

// Light over what is expected, from plain sums: where the first fit starts.
double light_ratio(const Frame& frame, const Model& model) {
  std::vector<double> ratios;
  for (const render::RenderedSource& source : model.sources()) {
    if (!inside(frame, source.pixel, 6) || saturated_window(frame, source.pixel)) continue;
    const int u0 = static_cast<int>(std::lround(source.pixel.u)), v0 = static_cast<int>(std::lround(source.pixel.v));
    double sum = 0.0;
    for (int v = v0 - 3; v <= v0 + 3; ++v)
      for (int u = u0 - 3; u <= u0 + 3; ++u)
        sum += static_cast<double>(frame.dn(u, v)) - static_cast<double>(frame.sky.level_dn(u, v));
    ratios.push_back(sum * model.camera.detector.gain_e_dn / source.electrons);
    if (ratios.size() == 40) break;
  }
  return ratios.empty() ? 0.0 : median(ratios);
}

// From the request's camera to the one that fits the stars for which `use` says yes.
Result<Model> fitted(const CompareRequest& request, const Frame& frame, Camera start,
                     const std::function<bool(std::int64_t)>& use) {
  Model model(request, frame);
  model.camera.psf = start.psf;
  model.camera.detector = start.detector;
  if (const auto seen = model.look(); !seen) return forward(seen);
  if (!request.camera_known) {
    const double ratio = light_ratio(frame, model);
    if (!(ratio > 0.0)) return fail(ErrorCode::no_match, "no star of the catalogue gives any light in the picture");
    model.camera.optics.pupil_diameter_m *= std::sqrt(ratio);
    if (const auto seen = model.look(); !seen) return forward(seen);
  }
  for (int round = 0; round < kRounds; ++round) {
    if (!model.fit(model.measure(round == 0 ? 2.0 * kFitSnr : kFitSnr), use))
      return fail(ErrorCode::no_match, "fewer than 6 unsaturated stars of the catalogue to fit a camera by");
    if (const auto seen = model.look(); !seen) return forward(seen);
  }
  return model;
}

struct Residuals {
  std::vector<double> px, mag;
};

double rms_of(std::span<const double> values) {
  return values.empty() ? 0.0 : rms(values);
}

// Root mean square of what lies within `kClip` robust sigma; how many do not.
std::pair<double, std::size_t> clipped(std::span<const double> values, double median_to_sigma) {
  std::vector<double> sizes, kept;
  for (const double x : values) sizes.push_back(std::abs(x));
  if (sizes.empty()) return {0.0, 0};
  const double limit = kClip * median_to_sigma * median(sizes);
  for (const double x : values)
    if (std::abs(x) <= limit) kept.push_back(x);
  return {rms_of(kept), values.size() - kept.size()};
}

class Windows {
 public:
  Windows(const Frame& frame, const ImageF& starless_ssim) : frame_(frame), starless_ssim_(starless_ssim) {}
  void add(Pixel at, const ImageF& rendering, const ImageF& ssim) {
    ++figures_.windows;
    const int u0 = static_cast<int>(std::lround(at.u)), v0 = static_cast<int>(std::lround(at.v));
    for (int v = v0 - kHalfWindow; v <= v0 + kHalfWindow; ++v) {
      for (int u = u0 - kHalfWindow; u <= u0 + kHalfWindow; ++u) {
        const double dn = static_cast<double>(frame_.dn(u, v)), expected = static_cast<double>(rendering(u, v));
        if (!std::isfinite(dn)) continue;
        const double sky = static_cast<double>(frame_.sky.level_dn(u, v));
        const double variance = frame_.noise.variance(expected);
        n_ += 1.0;
        square_ += (dn - expected) * (dn - expected);
        variance_ += variance;
        share_ += (dn - expected) * (dn - expected) / variance;
        starless_ += (dn - sky) * (dn - sky) / frame_.noise.variance(sky);
        figures_.ssim_loss += 1.0 - static_cast<double>(ssim(u, v));
        figures_.starless_ssim_loss += 1.0 - static_cast<double>(starless_ssim_(u, v));
      }
    }
  }
  WindowFigures figures() const {
    WindowFigures f = figures_;
    if (n_ == 0.0) return f;
    f.rmse_dn = std::sqrt(square_ / n_);
    f.noise_dn = std::sqrt(variance_ / n_);
    f.rmse_over_noise = std::sqrt(share_ / n_);
    f.starless_over_noise = std::sqrt(starless_ / n_);
    f.ssim_loss /= n_;
    f.starless_ssim_loss /= n_;
    return f;
  }

 private:
  const Frame& frame_;
  const ImageF& starless_ssim_;
  WindowFigures figures_;
  double n_ = 0.0, square_ = 0.0, variance_ = 0.0, share_ = 0.0, starless_ = 0.0;
};

// A model, what it draws, and what it measures.
struct Judge {
  Model model;
  ImageF rendering_dn;
  ImageF ssim;
  std::unordered_map<std::int64_t, Measured> measured;
  std::unordered_map<std::int64_t, render::RenderedSource> sources;
};

Judge judge_of(Model model, const Frame& frame, double least_snr) {
  Judge judge{std::move(model), {}, {}, {}, {}};
  judge.rendering_dn = judge.model.rendering_dn();
  judge.ssim = structural_similarity(frame.dn, judge.rendering_dn, frame.levels);
  for (const Measured& star : judge.model.measure(least_snr)) judge.measured.emplace(star.id, star);
  for (const render::RenderedSource& source : judge.model.sources()) judge.sources.emplace(source.source.id, source);
  return judge;
}

// Full width at half of the highest value, from the light on an even finer grid than pixels.
double fwhm_px(const Camera& camera) {
  constexpr double kFine = 8.0;
  Camera fine = camera;
  fine.psf.sigma_px *= kFine;
  fine.psf.sigma_growth_px = 0.0;
  fine.psf.halo_sigma_px *= kFine;
  fine.psf.halo_offset_u_px *= kFine;
  fine.psf.halo_offset_v_px *= kFine;
  fine.psf.kernel.samples_per_px /= kFine;
  const Pixel middle{0.0, 0.0};
  StarShape shape(fine, middle);
  const ImageF& light = shape.draw(middle);
  const float half = 0.5f * *std::max_element(light.pixels().begin(), light.pixels().end());
  std::size_t above = 0;
  for (const float x : light.pixels()) above += x >= half;
  // The area above half, as a disc.
  return 2.0 * std::sqrt(static_cast<double>(above) / kPi) / kFine;
}

// Light within kAperturePx of a place, in electrons: of the picture, without sky and neighbours. It needs no shape of
// a star, and so holds where a star moved during the exposure.
double aperture_sum(const Frame& frame, const Judge& judge, const render::RenderedSource& star, Pixel at) {
  const double gain = judge.model.camera.detector.gain_e_dn;
  StarShape own(judge.model.camera, star.pixel);
  const ImageF& shape = own.draw(star.pixel);
  double sum = 0.0;
  for (int v = static_cast<int>(at.v) - 8; v <= static_cast<int>(at.v) + 8; ++v) {
    for (int u = static_cast<int>(at.u) - 8; u <= static_cast<int>(at.u) + 8; ++u) {
      if (std::hypot(u - at.u, v - at.v) > kAperturePx || !frame.dn.view().contains(u, v)) continue;
      const int x = u - own.u0(), y = v - own.v0();
      const double mine = shape.view().contains(x, y) ? star.electrons * static_cast<double>(shape(x, y)) : 0.0;
      sum += (static_cast<double>(frame.dn(u, v)) - static_cast<double>(judge.rendering_dn(u, v))) * gain + mine;
    }
  }
  return sum;
}

// Share of a star's light that the camera puts into the aperture.
double aperture_share(const Camera& camera, Pixel at) {
  StarShape own(camera, at);
  const ImageF& shape = own.draw(at);
  double sum = 0.0;
  for (int y = 0; y < StarShape::kSide; ++y)
    for (int x = 0; x < StarShape::kSide; ++x)
      if (std::hypot(own.u0() + x - at.u, own.v0() + y - at.v) <= kAperturePx) sum += static_cast<double>(shape(x, y));
  return sum;
}

// Whether another source shines beside it.
bool crowded(const Model& model, const render::RenderedSource& star) {
  return std::any_of(model.sources().begin(), model.sources().end(), [&](const render::RenderedSource& other) {
    return other.source.id != star.source.id && other.electrons > kCrowdedShare * star.electrons &&
           (other.pixel.vec() - star.pixel.vec()).norm() < kCrowdedPx;
  });
}

// Where pixels are full: by the format, by a known camera's detector, or where several pixels share the highest value.
double largest_level(const Picture& picture, const CompareRequest& request) {
  double limit = picture.bits <= 16 ? picture.white_level : std::numeric_limits<double>::infinity();
  if (request.camera_known) {
    const Detector& d = request.camera.detector;
    limit = std::min({limit, std::exp2(d.bits) - 1.0, d.bias_dn + d.full_well_e / d.gain_e_dn});
  }
  const auto pixels = picture.pixels.pixels();
  const float highest = *std::max_element(pixels.begin(), pixels.end());
  if (std::count(pixels.begin(), pixels.end(), highest) >= 3) limit = std::min(limit, static_cast<double>(highest));
  return limit;
}

// The camera as far as the picture and what is known of it tell before any star is looked at.
Camera first_camera(const CompareRequest& request, const Frame& frame) {
  Camera camera = request.camera;
  Detector& d = camera.detector;
  d.full_well_e = 1e12;
  if (!request.camera_known) {
    d.gain_e_dn = frame.noise.slope_dn > 0.0 ? 1.0 / frame.noise.slope_dn : 1.0;
    d.read_noise_e = d.gain_e_dn * std::sqrt(std::max(frame.noise.floor_dn2, 0.0));
    camera.psf = PointSpread{};
    camera.psf.sigma_px = 0.8;
    camera.psf.halo_fraction = 0.05;
    camera.psf.halo_sigma_px = 2.0;
  }
  return camera;
}

}  // namespace

double ComparedStar::residual_mag() const {
  return -2.5 * std::log10(measured_e / expected_e);
}

Result<Comparison> compare(const Picture& picture, const CompareRequest& request_in) {
  CompareRequest request = request_in;
  const int width = picture.pixels.width(), height = picture.pixels.height();
  if (request.plate.width_px != width || request.plate.height_px != height)
    return fail(ErrorCode::invalid_argument, "the picture has {0} x {1} pixels, its plate {2} x {3}",
                {static_cast<double>(width), static_cast<double>(height), static_cast<double>(request.plate.width_px),
                 static_cast<double>(request.plate.height_px)});
  Frame frame;
  frame.dn = picture.pixels;
  if (request.mirrored)
    for (int v = 0; v < height; ++v) std::reverse(frame.dn.row(v), frame.dn.row(v) + width);
  frame.levels = picture.white_level;
  frame.saturation_dn = 0.98 * largest_level(picture, request);
  const double step = picture.bits <= 16 ? 1.0 : 0.0;
  frame.sky = smooth_sky(frame.dn, step);
  // A known gain counts; what the sky scatters beyond that, the picture tells.
  frame.noise =
      photon_transfer(frame.dn, frame.sky, step,
                      request.camera_known ? std::optional(1.0 / request.camera.detector.gain_e_dn) : std::nullopt);
  request.camera = first_camera(request, frame);

  const auto all = [](std::int64_t) { return true; };
  auto whole = fitted(request, frame, request.camera, all);
  if (!whole) return forward(whole);
  // Where the plate is given, nothing but the shape of a star is fitted, and nothing need be held out.
  std::optional<Model> first, second;
  if (request.fit_plate) {
    auto one = fitted(request, frame, request.camera, [](std::int64_t id) { return !second_half(id); });
    auto other = fitted(request, frame, request.camera, second_half);
    if (one && other) {
      first.emplace(std::move(*one));
      second.emplace(std::move(*other));
    }
  }
  const bool halves = first.has_value();
  constexpr double kFaintest = 1.0;
  const Judge own = judge_of(std::move(*whole), frame, kFaintest);
  std::optional<Judge> by_first, by_second;
  if (halves) {
    by_first.emplace(judge_of(*first, frame, kFaintest));
    by_second.emplace(judge_of(*second, frame, kFaintest));
  }
  const ImageF starless_ssim = structural_similarity(frame.dn, frame.sky.level_dn, frame.levels);

  Comparison out;
  out.camera = own.model.camera;
  out.R_CN = own.model.R_CN;
  out.mirrored = request.mirrored;
  out.exposure_s = request.exposure_s;
  out.halves = halves;
  Windows windows(frame, starless_ssim), own_windows(frame, starless_ssim), deep_windows(frame, starless_ssim);
  std::vector<double> px, mag, own_px, own_mag, sizes_px, sizes_mag;
  for (const render::RenderedSource& source : own.model.sources()) {
    if (source.source.kind != sky::SourceKind::star || !inside(frame, source.pixel, kHalfWindow)) continue;
    // The half that the star has no part in.
    const Judge& judge = !halves ? own : second_half(source.source.id) ? *by_first : *by_second;
    const auto seen = judge.sources.find(source.source.id);
    if (seen == judge.sources.end() || !inside(frame, seen->second.pixel, kHalfWindow)) continue;
    ComparedStar star;
    star.id = source.source.id;
    if (source.source.id >= kNamedStars)
      star.name = request.named[static_cast<std::size_t>(source.source.id - kNamedStars)].name;
    star.v_mag = source.source.v_mag;
    star.b_v = source.source.b_v;
    star.predicted = seen->second.pixel;
    star.expected_e = seen->second.electrons;
    star.saturated = saturated_window(frame, star.predicted);
    star.crowded = crowded(own.model, source);
    const auto measured = judge.measured.find(star.id);
    if (measured != judge.measured.end()) {
      star.measured = measured->second.pixel;
      star.measured_e = measured->second.electrons;
      star.snr = measured->second.snr;
      star.sigma_px = measured->second.sigma_px;
      star.found = measured->second.found;
    }
    if (!star.name.empty() && star.found) {
      star.measured_e = aperture_sum(frame, judge, seen->second, star.measured);
      star.aperture_share = aperture_share(judge.model.camera, star.measured);
      star.measured_e /= star.aperture_share;
    }
    if (!star.saturated) deep_windows.add(star.predicted, judge.rendering_dn, judge.ssim);
    if (star.snr >= request.least_snr) {
      out.saturated += star.saturated;
      out.crowded += !star.saturated && star.crowded;
      if (!star.saturated) {
        windows.add(star.predicted, judge.rendering_dn, judge.ssim);
        own_windows.add(star.predicted, own.rendering_dn, own.ssim);
      }
      const bool candidate = !star.saturated && !star.crowded;
      out.lost += candidate && !star.found;
      star.counts = candidate && star.found;
      if (star.counts) {
        px.push_back(star.residual_px());
        mag.push_back(star.residual_mag());
        const auto mine = own.measured.find(star.id);
        if (mine != own.measured.end() && mine->second.found) {
          own_px.push_back((mine->second.pixel.vec() - source.pixel.vec()).norm());
          own_mag.push_back(-2.5 * std::log10(mine->second.electrons / source.electrons));
        }
      }
    }
    if (request.mirrored) {
      star.predicted.u = width - 1 - star.predicted.u;
      star.measured.u = width - 1 - star.measured.u;
    }
    out.stars.push_back(star);
  }
  out.counted = px.size();
  out.geometric_rms_px = rms_of(px);
  out.photometric_rms_mag = rms_of(mag);
  for (const double x : mag) sizes_mag.push_back(std::abs(x));
  if (!px.empty()) {
    out.geometric_median_px = median(px);
    out.photometric_median_mag = median(sizes_mag);
  }
  std::tie(out.clipped_geometric_rms_px, out.clipped_places) = clipped(px, 1.0 / 1.1774);
  std::tie(out.clipped_photometric_rms_mag, out.clipped_magnitudes) = clipped(mag, 1.4826);
  out.own_geometric_rms_px = rms_of(own_px);
  out.own_photometric_rms_mag = rms_of(own_mag);
  out.windows = windows.figures();
  out.own_windows = own_windows.figures();
  out.deep_windows = deep_windows.figures();

  if (!request.camera_known) {
    // What a frame by this camera needs beyond what was fitted.
    Detector& d = out.camera.detector;
    d.bits = std::clamp(static_cast<int>(std::ceil(std::log2(frame.levels + 1.0))), 1, 16);
    d.full_well_e = std::clamp(frame.levels * d.gain_e_dn, 1.0, 1e9);
    d.background_e_s_px = std::max(0.0, static_cast<double>(frame.sky.level_dn(width / 2, height / 2))) * d.gain_e_dn /
                          request.exposure_s;
    out.camera.optics.focal_length_m = out.camera.intrinsics.fx_px * d.pixel_pitch_m;
  } else {
    out.camera.detector.full_well_e = request_in.camera.detector.full_well_e;
  }
  const BandPhotometry band(out.camera);
  const double gain = out.camera.detector.gain_e_dn;
  out.zero_point_mag = 2.5 * std::log10(band.flux(0.0, 0.65).electrons_per_s / gain);
  out.colour_mag = 2.5 * std::log10(band.flux(0.0, 1.65).electrons_per_s / band.flux(0.0, 0.65).electrons_per_s);
  out.psf_sigma_px = out.camera.psf.sigma_px;
  out.psf_fwhm_px = fwhm_px(out.camera);
  out.background_dn = static_cast<double>(frame.sky.level_dn(width / 2, height / 2));
  out.background_scatter = frame.sky.scatter;
  out.noise_floor_dn = std::sqrt(std::max(frame.noise.floor_dn2, frame.noise.least_dn2));
  out.gain_e_dn = gain;
  out.rendering_dn = own.rendering_dn;
  out.difference_dn = ImageF(width, height);
  for (std::size_t i = 0; i < out.rendering_dn.pixels().size(); ++i)
    out.difference_dn.pixels()[i] = frame.dn.pixels()[i] - own.rendering_dn.pixels()[i];
  if (request.mirrored) {
    for (int v = 0; v < height; ++v) {
      std::reverse(out.rendering_dn.row(v), out.rendering_dn.row(v) + width);
      std::reverse(out.difference_dn.row(v), out.difference_dn.row(v) + width);
    }
  }
  return out;
}

}  // namespace astronav::opensky
