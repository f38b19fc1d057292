// SPDX-License-Identifier: Apache-2.0
#include "onboard/vision/centroids.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <type_traits>

namespace astronav::vision {
namespace {

constexpr std::size_t kMaxRuns = 65536;
constexpr std::size_t kMaxRegions = 8192;
constexpr std::size_t kMaxSamples = 32768;
constexpr int kBlock = 64;  // pixels looked at together when hunting for the rare bright one

// Rms over one pixel of (centre of squares - truth) for a pixel-integrated Gaussian, noise-free (eq. 3). On one axis:
// the squares separate.
double s_curve_rms(double sigma) {
  constexpr int kPhases = 32, kHalf = 6;
  double sum2 = 0.0;
  for (int phase = 0; phase < kPhases; ++phase) {
    const double truth = (phase + 0.5) / kPhases - 0.5;
    double w = 0.0, wx = 0.0;
    for (int i = -kHalf; i <= kHalf; ++i) {
      const double e = 0.5 * (std::erf((i + 0.5 - truth) / (std::sqrt(2.0) * sigma)) -
                              std::erf((i - 0.5 - truth) / (std::sqrt(2.0) * sigma)));
      w += e * e;
      wx += e * e * i;
    }
    const double error = wx / w - truth;
    sum2 += error * error;
  }
  return std::sqrt(sum2 / kPhases);
}

// Share of the light of the 3x3 pixels around it that a centred star leaves in its brightest pixel.
double central_share(double sigma) {
  const double one = std::erf(0.5 / (std::sqrt(2.0) * sigma));
  const double three = std::erf(1.5 / (std::sqrt(2.0) * sigma));
  return one * one / (three * three);
}

template <typename T>
T largest(const T* p, int n) {
  T m = p[0];
  for (int i = 1; i < n; ++i) m = p[i] > m ? p[i] : m;
  return m;
}

void widen(Window& window, int u0, int v, int u1) {
  window.u0 = std::min(window.u0, u0);
  window.u1 = std::max(window.u1, u1);
  window.v0 = std::min(window.v0, v);
  window.v1 = std::max(window.v1, v);
}

constexpr Window kNowhere{std::numeric_limits<int>::max(), std::numeric_limits<int>::max(), -1, -1};

Window grow(const Window& window, int margin, int width, int height) {
  return {std::max(window.u0 - margin, 0), std::max(window.v0 - margin, 0), std::min(window.u1 + margin, width - 1),
          std::min(window.v1 + margin, height - 1)};
}

// Wings that are not as believed (a halo that sits beside the core) pull a saturated spot the same way in every frame.
// The pull grows with brightness as the formal sigma does: with the halo 0.05 px off it was 0.3 to 1.6 times that sigma
// for planets of V -2 to -6 (docs/adr/0002-what-repeats.md).
double repeating_sigma(const Mat2& covariance_px2) {
  return 0.75 * std::sqrt(0.5 * covariance_px2.trace());
}

}  // namespace

CentroidFinder::CentroidFinder(const CentroidSettings& settings, const SensorModel& sensor, int max_width,
                               int max_height)
    : settings_(settings), sensor_(sensor) {
  ASTRONAV_CHECK(max_width > 2 && max_height > 2 && max_width < 32768 && max_height < 32768);
  ASTRONAV_CHECK(sensor.psf_sigma_px > 0.0 && sensor.gain_e_dn > 0.0);
  s_curve_rms_px_ = s_curve_rms(sensor.psf_sigma_px);
  sharpest_star_ = central_share(sensor.psf_sigma_px * (1.0 - 2.0 * sensor.psf_sigma_relative));
  runs_.reserve(kMaxRuns);
  region_of_run_.reserve(kMaxRuns);
  regions_.reserve(kMaxRegions);
  order_.reserve(kMaxRegions);
  histogram_.resize(65536);
  samples_.reserve(kMaxSamples);
}

template <typename T>
FrameLevel CentroidFinder::measure_level(ImageView<const T> image) {
  const std::size_t width = static_cast<std::size_t>(image.width());
  const std::size_t total = width * static_cast<std::size_t>(image.height());
  // A stride that shares no factor with the width visits all columns.
  std::size_t stride = std::max<std::size_t>(1, (total + kMaxSamples - 1) / kMaxSamples);
  while (stride > 1 && width % stride == 0) ++stride;
  double median = 0.0, mad = 0.0;
  samples_.clear();
  const auto visit = [&](auto&& use) {
    std::size_t u = 0, v = 0;
    for (std::size_t i = 0; i < total; i += stride) {
      use(image.row(static_cast<int>(v))[u]);
      for (u += stride; u >= width; u -= width) ++v;
    }
  };
  FrameLevel level;
  if constexpr (std::is_same_v<T, std::uint16_t>) {
    std::fill(histogram_.begin(), histogram_.end(), 0u);
    std::size_t count = 0;
    visit([&](std::uint16_t x) {
      ++histogram_[x];
      ++count;
    });
    std::size_t below = 0;
    int m = 0;
    while (below + histogram_[m] <= count / 2) below += histogram_[m++];
    std::size_t within = histogram_[m];
    int k = 0;
    while (2 * within < count) {
      ++k;
      if (m - k >= 0) within += histogram_[m - k];
      if (m + k < 65536) within += histogram_[m + k];
    }
    median = m;
    mad = k;
    // Quantised data: the median is a whole number, so the mean of what lies around it decides (twice).
    double center = median, sigma = std::max(1.4826 * mad, 0.5);
    for (int pass = 0; pass < 3; ++pass) {
      const int lo = std::max(0, static_cast<int>(std::floor(center - 4.0 * sigma - 0.5)));
      const int hi = std::min(65535, static_cast<int>(std::ceil(center + 4.0 * sigma + 0.5)));
      double n = 0.0, sum = 0.0, sum2 = 0.0;
      for (int x = lo; x <= hi; ++x) {
        const double c = histogram_[x], d = x - median;
        n += c;
        sum += c * d;
        sum2 += c * d * d;
      }
      if (n == 0.0) break;
      center = median + sum / n;
      sigma = std::max(std::sqrt(std::max(sum2 / n - (sum / n) * (sum / n), 0.0)), 0.3);
    }
    level.background_dn = center;
    level.noise_dn = sigma;
  } else {
    visit([&](T x) {
      if (std::isfinite(x) && samples_.size() < kMaxSamples) samples_.push_back(static_cast<float>(x));
    });
    if (samples_.empty()) return level;
    const auto middle = samples_.begin() + static_cast<std::ptrdiff_t>(samples_.size() / 2);
    std::nth_element(samples_.begin(), middle, samples_.end());
    median = *middle;
    double lower_spread = 0.0;
    {
      // The quartile below the median: sources do not reach it.
      const auto quarter = samples_.begin() + static_cast<std::ptrdiff_t>(samples_.size() / 4);
      std::nth_element(samples_.begin(), quarter, middle);
      lower_spread = median - *quarter;
    }
    double center = median, sigma = std::max(1.4826 * lower_spread, 1e-6 * std::max(1.0, std::abs(median)));
    for (int pass = 0; pass < 3; ++pass) {
      double n = 0.0, sum = 0.0, sum2 = 0.0;
      for (const float x : samples_) {
        const double d = x - median;
        if (std::abs(x - center) > 4.0 * sigma) continue;
        n += 1.0;
        sum += d;
        sum2 += d * d;
      }
      if (n == 0.0) break;
      center = median + sum / n;
      sigma = std::max(std::sqrt(std::max(sum2 / n - (sum / n) * (sum / n), 0.0)), 1e-9);
    }
    level.background_dn = center;
    level.noise_dn = sigma;
  }
  level.threshold_dn =
      level.background_dn +
      (settings_.threshold_dn > 0.0 ? settings_.threshold_dn : settings_.threshold_sigma * level.noise_dn);
  return level;
}

template <typename T>
void CentroidFinder::add_run(ImageView<const T> image, const FrameLevel& level, int v, int u0, int u1) {
  if (runs_.size() == kMaxRuns) {
    overflowed_ = true;
    return;
  }
  const T* row = image.row(v);
  double sum = 0.0;
  T peak = row[u0];
  for (int u = u0; u <= u1; ++u) {
    sum += static_cast<double>(row[u]);
    peak = std::max(peak, row[u]);
  }
  // The saturated part of the run: its wings may reach far beyond.
  int s0 = u0, s1 = u0 - 1;
  if (static_cast<double>(peak) >= sensor_.saturation_dn) {
    s1 = u1;
    while (static_cast<double>(row[s0]) < sensor_.saturation_dn) ++s0;
    while (static_cast<double>(row[s1]) < sensor_.saturation_dn) --s1;
  }
  const double background = level.background_dn;
  runs_.push_back({static_cast<std::int32_t>(runs_.size()), static_cast<std::int16_t>(v), static_cast<std::int16_t>(u0),
                   static_cast<std::int16_t>(u1), static_cast<std::int16_t>(s0), static_cast<std::int16_t>(s1),
                   static_cast<float>(sum - background * (u1 - u0 + 1)),
                   static_cast<float>(static_cast<double>(peak) - background)});
}

std::int32_t CentroidFinder::root(std::int32_t run) {
  while (runs_[run].parent != run) {
    runs_[run].parent = runs_[runs_[run].parent].parent;
    run = runs_[run].parent;
  }
  return run;
}

// Runs of neighbouring rows that touch, corners included, belong together.
void CentroidFinder::join_rows(std::size_t above_first, std::size_t above_last, std::size_t first, std::size_t last) {
  std::size_t above = above_first;
  for (std::size_t run = first; run < last; ++run) {
    while (above < above_last && runs_[above].u1 + 1 < runs_[run].u0) ++above;
    for (std::size_t other = above; other < above_last && runs_[other].u0 <= runs_[run].u1 + 1; ++other) {
      const std::int32_t a = root(static_cast<std::int32_t>(other)), b = root(static_cast<std::int32_t>(run));
      runs_[std::max(a, b)].parent = std::min(a, b);
    }
  }
}

template <typename T>
void CentroidFinder::collect_runs(ImageView<const T> image, const FrameLevel& level) {
  runs_.clear();
  T threshold;
  if constexpr (std::is_integral_v<T>) {
    threshold = static_cast<T>(std::clamp(std::floor(level.threshold_dn), 0.0, 65535.0));
  } else {
    threshold = static_cast<T>(level.threshold_dn);
  }
  std::size_t above_first = 0, above_last = 0;
  for (int v = 0; v < image.height(); ++v) {
    const T* row = image.row(v);
    const std::size_t first = runs_.size();
    int start = -1;
    for (int block = 0; block < image.width(); block += kBlock) {
      const int end = std::min(block + kBlock, image.width());
      if (start < 0 && end - block == kBlock && !(largest(row + block, kBlock) > threshold)) continue;
      for (int u = block; u < end; ++u) {
        const bool bright = row[u] > threshold;
        if (bright && start < 0) start = u;
        if (!bright && start >= 0) {
          add_run(image, level, v, start, u - 1);
          start = -1;
        }
      }
    }
    if (start >= 0) add_run(image, level, v, start, image.width() - 1);
    const std::size_t last = runs_.size();
    join_rows(above_first, above_last, first, last);
    above_first = first;
    above_last = last;
    if (overflowed_) return;
  }
}

void CentroidFinder::collect_regions() {
  regions_.clear();
  region_of_run_.clear();
  for (std::size_t i = 0; i < runs_.size(); ++i) {
    const Run& run = runs_[i];
    const std::int32_t parent = root(static_cast<std::int32_t>(i));
    std::int32_t index;
    if (parent == static_cast<std::int32_t>(i)) {
      if (regions_.size() == kMaxRegions) {
        overflowed_ = true;
        return;
      }
      index = static_cast<std::int32_t>(regions_.size());
      regions_.push_back({.box = kNowhere, .saturated_box = kNowhere});
    } else {
      index = region_of_run_[parent];
    }
    region_of_run_.push_back(index);
    Region& region = regions_[index];
    widen(region.box, run.u0, run.v, run.u1);
    region.pixels += run.u1 - run.u0 + 1;
    region.sum += run.sum;
    region.peak = std::max(region.peak, static_cast<double>(run.peak));
    if (run.s0 <= run.s1) {
      region.saturated = true;
      widen(region.saturated_box, run.s0, run.v, run.s1);
    }
  }
}

template <typename T>
bool CentroidFinder::by_squares(ImageView<const T> image, const FrameLevel& level, const Region& region,
                                Centroid& out) const {
  const Window window = grow(region.box, 1, image.width(), image.height());
  // The noise adds its variance to every square: taken off again, or empty pixels would pull towards the box's middle.
  const double noise2 = level.noise_dn * level.noise_dn;
  const double cu = 0.5 * (window.u0 + window.u1), cv = 0.5 * (window.v0 + window.v1);
  double w = 0.0, wu = 0.0, wv = 0.0, flux = 0.0, variance_sum = 0.0;
  for (int v = window.v0; v <= window.v1; ++v) {
    const T* row = image.row(v);
    for (int u = window.u0; u <= window.u1; ++u) {
      const double d = static_cast<double>(row[u]) - level.background_dn;
      const double weight = d * d - noise2;
      w += weight;
      wu += weight * (u - cu);
      wv += weight * (v - cv);
      flux += d;
      variance_sum += sensor_.pixel_variance_dn2(d, level.noise_dn);
    }
  }
  if (!(w > 0.0)) return false;
  const double mu = wu / w, mv = wv / w;
  double uu = 0.0, uv = 0.0, vv = 0.0;
  for (int v = window.v0; v <= window.v1; ++v) {
    const T* row = image.row(v);
    const double dv = v - cv - mv;
    for (int u = window.u0; u <= window.u1; ++u) {
      const double dn = static_cast<double>(row[u]);
      if (dn >= sensor_.saturation_dn) continue;  // clipped: no noise, and no news
      const double d = dn - level.background_dn;
      const double s2 = sensor_.pixel_variance_dn2(d, level.noise_dn);
      // Var(weight) = 4 d^2 s^2 + 2 s^4 with the true d; the square of the measured d is larger by s^2 (eq. 2).
      const double variance = 4.0 * d * d * s2 - 2.0 * s2 * s2;
      const double du = u - cu - mu;
      uu += variance * du * du;
      uv += variance * du * dv;
      vv += variance * dv * dv;
    }
  }
  const double floor2 = s_curve_rms_px_ * s_curve_rms_px_;
  const double quantum2 = 1e-8;
  out.covariance_px2 << std::max(uu / (w * w), quantum2) + floor2, uv / (w * w), uv / (w * w),
      std::max(vv / (w * w), quantum2) + floor2;
  if (out.covariance_px2.determinant() <= 0.0) out.covariance_px2(0, 1) = out.covariance_px2(1, 0) = 0.0;
  if (region.saturated) {
    // The shape of the plateau decides now: a pixel more or less at its edge.
    const double edge = std::sqrt(static_cast<double>(std::max(1, region.saturated_box.width())));
    out.covariance_px2 += Mat2::Identity() * std::pow(0.1 / edge, 2);
  }
  out.pixel = {cu + mu, cv + mv};
  out.flux_dn = flux;
  out.snr = flux / std::sqrt(variance_sum);
  return true;
}

template <typename T>
bool CentroidFinder::by_fit(ImageView<const T> image, const FrameLevel& level, const Region& region,
                            Centroid& out) const {
  Pixel guess;
  Window window;
  const int reach = static_cast<int>(std::ceil(3.0 * sensor_.psf_sigma_px));
  if (region.saturated) {
    guess = {0.5 * (region.saturated_box.u0 + region.saturated_box.u1),
             0.5 * (region.saturated_box.v0 + region.saturated_box.v1)};
    window = grow(region.saturated_box, reach + 1, image.width(), image.height());
  } else {
    if (!by_squares(image, level, region, out)) return false;
    guess = out.pixel;
    const int u = static_cast<int>(std::lround(guess.u)), v = static_cast<int>(std::lround(guess.v));
    window = grow({u, v, u, v}, reach, image.width(), image.height());
  }
  if (window.width() > kMaxFitWindow || window.height() > kMaxFitWindow) return by_squares(image, level, region, out);
  const PsfFit fit = fit_psf(image, window, guess, level.background_dn, level.noise_dn, sensor_);
  if (!fit.converged || !(fit.covariance_px2(0, 0) < 4.0)) return by_squares(image, level, region, out);
  out.pixel = fit.pixel;
  out.covariance_px2 = fit.covariance_px2;
  out.flux_dn = fit.flux_dn;
  out.snr = fit.flux_dn / fit.flux_sigma_dn;
  return true;
}

bool CentroidFinder::measure_beside(ImageView<const std::uint16_t> image, const FrameLevel& level, Pixel guess,
                                    const Companion& companion, Centroid& spot) const {
  const int u = static_cast<int>(std::lround(guess.u)), v = static_cast<int>(std::lround(guess.v));
  const int reach = static_cast<int>(std::ceil(3.0 * sensor_.psf_sigma_px));
  if (u < reach || v < reach || u >= image.width() - reach || v >= image.height() - reach) return false;
  // The saturated core around the guess: a box that grows as long as a saturated pixel touches it.
  Window core{u, v, u, v};
  bool saturated = static_cast<double>(image(u, v)) >= sensor_.saturation_dn;
  for (bool grew = saturated; grew && std::max(core.width(), core.height()) + 2 * (reach + 1) < kMaxFitWindow;) {
    grew = false;
    const Window ring = grow(core, 1, image.width(), image.height());
    for (int j = ring.v0; j <= ring.v1; ++j) {
      for (int i = ring.u0; i <= ring.u1; ++i) {
        const bool inside = i >= core.u0 && i <= core.u1 && j >= core.v0 && j <= core.v1;
        if (inside || static_cast<double>(image(i, j)) < sensor_.saturation_dn) continue;
        core = {std::min(core.u0, i), std::min(core.v0, j), std::max(core.u1, i), std::max(core.v1, j)};
        grew = true;
      }
    }
  }
  const Window window = grow(core, saturated ? reach + 1 : reach, image.width(), image.height());
  if (window.width() > kMaxFitWindow || window.height() > kMaxFitWindow) return false;
  const PsfFit fit = fit_psf_beside(image, window, guess, level.background_dn, level.noise_dn, sensor_, companion);
  if (!fit.converged || !(fit.covariance_px2(0, 0) < 4.0)) return false;
  spot.pixel = fit.pixel;
  spot.covariance_px2 = fit.covariance_px2;
  spot.flux_dn = fit.flux_dn;
  spot.snr = fit.flux_dn / fit.flux_sigma_dn;
  spot.saturated = saturated;
  spot.repeating_sigma_px = saturated ? repeating_sigma(fit.covariance_px2) : 0.0;
  return true;
}

template <typename T>
std::size_t CentroidFinder::find_in(ImageView<const T> image, const FrameLevel& level, std::span<Centroid> out) {
  overflowed_ = false;
  collect_runs(image, level);
  collect_regions();
  order_.clear();
  for (std::size_t i = 0; i < regions_.size(); ++i) {
    const Region& r = regions_[i];
    if (r.pixels < settings_.min_region_px || r.pixels > settings_.max_region_px) continue;
    if (r.box.u0 == 0 || r.box.v0 == 0 || r.box.u1 == image.width() - 1 || r.box.v1 == image.height() - 1) continue;
    if (settings_.refuse_sharp && r.pixels <= 4 && !r.saturated) {
      const int u = (r.box.u0 + r.box.u1) / 2, v = (r.box.v0 + r.box.v1) / 2;
      double sum = 0.0, peak = 0.0;
      for (int dv = -1; dv <= 1; ++dv) {
        for (int du = -1; du <= 1; ++du) {
          const double d = static_cast<double>(image(u + du, v + dv)) - level.background_dn;
          sum += d;
          peak = std::max(peak, d);
        }
      }
      const double noise = 3.0 * level.noise_dn;  // of the sum over nine pixels
      if (peak - sharpest_star_ * sum > 3.0 * std::hypot(noise * sharpest_star_, level.noise_dn)) continue;
    }
    order_.push_back(static_cast<std::uint32_t>(i));
  }
  const std::size_t wanted = std::min({out.size(), order_.size(), static_cast<std::size_t>(settings_.max_centroids)});
  std::partial_sort(order_.begin(), order_.begin() + static_cast<std::ptrdiff_t>(wanted), order_.end(),
                    [&](std::uint32_t a, std::uint32_t b) { return regions_[a].sum > regions_[b].sum; });
  std::size_t count = 0;
  for (std::size_t k = 0; k < wanted; ++k) {
    const Region& region = regions_[order_[k]];
    Centroid& centroid = out[count];
    centroid = Centroid{};
    const bool measured = settings_.method == CentroidMethod::psf_fit ? by_fit(image, level, region, centroid)
                                                                      : by_squares(image, level, region, centroid);
    if (!measured) continue;
    centroid.peak_dn = region.peak;
    centroid.pixels = region.pixels;
    centroid.saturated = region.saturated;
    if (region.saturated) centroid.repeating_sigma_px = repeating_sigma(centroid.covariance_px2);
    ++count;
  }
  std::sort(out.begin(), out.begin() + static_cast<std::ptrdiff_t>(count),
            [](const Centroid& a, const Centroid& b) { return a.flux_dn > b.flux_dn; });
  return count;
}

std::size_t CentroidFinder::find(ImageView<const std::uint16_t> image, std::span<Centroid> out, FrameLevel* level) {
  const FrameLevel measured = measure_level(image);
  if (level != nullptr) *level = measured;
  return find_in(image, measured, out);
}
std::size_t CentroidFinder::find(ImageView<const float> image, std::span<Centroid> out, FrameLevel* level) {
  const FrameLevel measured = measure_level(image);
  if (level != nullptr) *level = measured;
  return find_in(image, measured, out);
}
std::size_t CentroidFinder::find_above(ImageView<const std::uint16_t> image, const FrameLevel& level,
                                       std::span<Centroid> out) {
  return find_in(image, level, out);
}
std::size_t CentroidFinder::find_above(ImageView<const float> image, const FrameLevel& level, std::span<Centroid> out) {
  return find_in(image, level, out);
}

}  // namespace astronav::vision
