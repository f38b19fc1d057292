// SPDX-License-Identifier: Apache-2.0
#include "onboard/vision/centroids.h"

#include <algorithm>
#include <cmath>

#include <Eigen/Eigenvalues>

namespace astronav::vision {
namespace {

constexpr std::size_t kMaxOthers = 128;
constexpr std::size_t kMaxBox = 65536;  // px; a larger region is no spot, and its light is not summed
constexpr std::size_t kConsensus = 5;   // bright spots that can tell what all have in common
constexpr double kBrightNoise = 20.0;   // peak over noise: then a spot's width is its own, not the threshold's
constexpr int kLessonReach = 9;         // px about a star that shows the point-spread function beyond its core
// With a prior attitude: so many pixels tell the level, and a spot that is cut and this high may be a smeared column.
constexpr std::size_t kFewSamples = 16384;
constexpr int kLongCut = 24;

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

// A place known to 2 px, or worse, is none.
bool usable(const PsfFit& fit) {
  return fit.converged && fit.covariance_px2(0, 0) < 4.0;
}

// Of a spot that saturates what repeats is said apart; of others it is a small part of the covariance, and stays there.
void take(const PsfFit& fit, Centroid& spot) {
  spot.pixel = fit.pixel;
  spot.covariance_px2 = fit.saturated ? fit.noise_px2 : fit.covariance_px2;
  spot.repeating_sigma_px = fit.saturated ? repeating_sigma(fit) : 0.0;
  spot.flux_dn = fit.flux_dn;
  spot.snr = fit.flux_dn / fit.flux_sigma_dn;
}

bool on_border(const Window& box, int width, int height) {
  return box.u0 == 0 || box.v0 == 0 || box.u1 == width - 1 || box.v1 == height - 1;
}

// What overflowed along columns makes a saturated spot higher than wide.
bool bloomed(const Window& saturated) {
  return saturated.height() > saturated.width() + 2;
}

// Of the centre of light of a region's box and a margin.
template <typename T>
Mat2 centre_covariance(ImageView<const T> image, const Region& region, const Moments& m, const LocalLevel& level,
                       const SensorModel& sensor) {
  // What the faint rim that is left out, and a pixel's form, may move the centre by.
  constexpr double kRimPx = 0.005;
  const Window w = grown(region.box, 1, image.width(), image.height());
  Mat2 sum = Mat2::Zero();
  for (int v = w.v0; v <= w.v1; ++v) {
    for (int u = w.u0; u <= w.u1; ++u) {
      const Vec2 from = Vec2(u, v) - m.centre;
      const double light = static_cast<double>(image(u, v)) - level.under(u, v);
      sum += sensor.pixel_variance_dn2(light, level.noise_dn) * from * from.transpose();
    }
  }
  return sum / (m.flux * m.flux) + Mat2::Identity() * kRimPx * kRimPx;
}

Pixel middle_of(const Window& box) {
  return {0.5 * (box.u0 + box.u1), 0.5 * (box.v0 + box.v1)};
}

}  // namespace

CentroidFinder::CentroidFinder(const CentroidSettings& settings, const SensorModel& sensor, int max_width,
                               int max_height)
    : settings_(settings), sensor_(sensor), lessons_(sensor, max_width, max_height), background_(max_width) {
  ASTRONAV_CHECK(max_width > 2 && max_height > 2 && max_width < 32768 && max_height < 32768);
  ASTRONAV_CHECK(sensor.psf_sigma_px > 0.0 && sensor.gain_e_dn > 0.0);
  s_curve_rms_px_ = s_curve_rms(sensor.psf_sigma_px);
  order_.reserve(Regions::kMaxRegions);
  candidates_.resize(static_cast<std::size_t>(std::max(1, settings.max_centroids)));
  candidates_.clear();
  others_.reserve(kMaxOthers);
  excess_.resize(candidates_.capacity());
}

// A centre of squares, of the region's box and a margin.
template <typename T>
bool CentroidFinder::by_squares(ImageView<const T> image, const Region& region, Centroid& out) const {
  const Window window = grown(region.box, 1, image.width(), image.height());
  const LocalLevel level = background_.at(middle_of(window));
  // The noise adds its variance to every square: taken off again, or empty pixels would pull towards the box's middle.
  const double noise2 = level.noise_dn * level.noise_dn;
  const double cu = level.at.u, cv = level.at.v;
  double w = 0.0, wu = 0.0, wv = 0.0, flux = 0.0, variance_sum = 0.0;
  for (int v = window.v0; v <= window.v1; ++v) {
    const T* row = image.row(v);
    for (int u = window.u0; u <= window.u1; ++u) {
      const double d = static_cast<double>(row[u]) - level.under(u, v);
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
      const double d = dn - level.under(u, v);
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
    out.repeating_sigma_px = 0.05;  // and the same pixels, where the place repeats
  }
  out.pixel = {cu + mu, cv + mv};
  out.flux_dn = flux;
  out.snr = flux / std::sqrt(variance_sum);
  return true;
}

template <typename T>
bool CentroidFinder::by_fit(ImageView<const T> image, const Candidate& candidate, Centroid& out) {
  const Region& region = regions_.all()[candidate.region];
  Pixel guess = middle_of(candidate.core);
  if (!region.saturated) {
    // A streak is no point-spread function; its centre of squares is the camera's place at mid-exposure.
    if (moving_) return by_squares(image, region, out);
    if (candidate.moments.flux > 0.0)
      guess = {candidate.moments.centre.x(), candidate.moments.centre.y()};
    else if (by_squares(image, region, out))
      guess = out.pixel;
    else
      return false;
  }
  const LocalPsf psf = lessons_.belief().at(guess);
  const int u = static_cast<int>(std::lround(guess.u)), v = static_cast<int>(std::lround(guess.v));
  const Window core = region.saturated ? candidate.core : Window{u, v, u, v};
  const int reach = region.saturated ? reach_about_full_px(core, psf) : psf.reach_px();
  const Window window = grown(core, reach, image.width(), image.height());
  if (window.width() > kMaxFitWindow || window.height() > kMaxFitWindow) return by_squares(image, region, out);
  const LocalLevel level = background_.at(guess);
  PsfEvidence evidence;
  const PsfFit fit =
      fit_psf(image, window, guess, level, sensor_, psf, region.saturated && !moving_ ? &evidence : nullptr);
  if (!usable(fit)) return by_squares(image, region, out);
  take(fit, out);
  if (settings_.learn_psf && !moving_) consider_lesson(image, region, fit, psf, level, evidence);
  return true;
}

// Bright stars, alone, whose light is a point's.
template <typename T>
void CentroidFinder::consider_lesson(ImageView<const T> image, const Region& region, const PsfFit& fit,
                                     const LocalPsf& psf, const LocalLevel& level, const PsfEvidence& evidence) {
  if (!lessons_.wants(fit)) return;
  const int u = static_cast<int>(std::lround(fit.pixel.u)), v = static_cast<int>(std::lround(fit.pixel.v));
  const Window window =
      grown(region.saturated ? region.saturated_box : Window{u, v, u, v}, kLessonReach, image.width(), image.height());
  if (!alone(window, region)) return;
  PsfEvidence found = evidence;
  bool tells = true;
  if (region.saturated)
    found.weaken(fit.chi2_per_dof);
  else
    tells = psf_evidence(image, window, fit, level, sensor_, psf, found);
  lessons_.offer(fit.pixel, tells ? &found : nullptr, region.saturated);
}

bool CentroidFinder::alone(const Window& window, const Region& region) const {
  if (attention_ != nullptr && !attention_->covers(window)) return false;
  for (const Region& other : regions_.all()) {
    if (&other == &region) continue;
    if (other.box.u0 <= window.u1 && other.box.u1 >= window.u0 && other.box.v0 <= window.v1 &&
        other.box.v1 >= window.v0)
      return false;
  }
  return true;
}

Window CentroidFinder::core_about(ImageView<const std::uint16_t> image, Pixel place, int most_px) const {
  const int u = static_cast<int>(std::lround(place.u)), v = static_cast<int>(std::lround(place.v));
  Window core{u, v, u, v};
  // A box that grows as long as a saturated pixel touches it.
  for (bool grew = static_cast<double>(image(u, v)) >= sensor_.saturation_dn; grew;) {
    grew = false;
    const Window ring = grown(core, 1, image.width(), image.height());
    for (int j = ring.v0; j <= ring.v1; ++j) {
      for (int i = ring.u0; i <= ring.u1; ++i) {
        const bool inside = i >= core.u0 && i <= core.u1 && j >= core.v0 && j <= core.v1;
        if (inside || static_cast<double>(image(i, j)) < sensor_.saturation_dn) continue;
        core = {std::min(core.u0, i), std::min(core.v0, j), std::max(core.u1, i), std::max(core.v1, j)};
        grew = true;
      }
    }
    grew = grew && core.width() <= most_px && (sensor_.blooming || core.height() <= most_px);
  }
  return sensor_.blooming && bloomed(core) ? core_of_bloomed(image, core, sensor_.saturation_dn) : core;
}

std::optional<Window> CentroidFinder::window_about(ImageView<const std::uint16_t> image, Pixel place,
                                                   const LocalPsf& psf) const {
  const Window core = core_about(image, place, kMaxFitWindow - 2 * (psf.reach_px() + 1));
  const bool full =
      core.width() > 1 || core.height() > 1 || static_cast<double>(image(core.u0, core.v0)) >= sensor_.saturation_dn;
  const int reach = full ? reach_about_full_px(core, psf) : psf.reach_px() + 1;
  const Window window = grown(core, reach, image.width(), image.height());
  if (window.width() > kMaxFitWindow || window.height() > kMaxFitWindow) return std::nullopt;
  return window;
}

bool CentroidFinder::measure_beside(ImageView<const std::uint16_t> image, const FrameLevel& level,
                                    std::span<const Pixel> guesses, double flux_dn, const LitDisc& disc,
                                    std::span<const LightBeside> beside, Centroid& spot) {
  // A fit this good needs no other guess.
  constexpr double kGoodChi2 = 1.5;
  PsfFit best;
  for (const Pixel guess : guesses) {
    const LocalPsf psf = lessons_.before().at(guess);
    const int reach = psf.reach_px();
    if (!(guess.u >= reach && guess.v >= reach && guess.u < image.width() - reach && guess.v < image.height() - reach))
      continue;
    const auto window = window_about(image, guess, psf);
    if (!window) continue;
    const PsfFit fit =
        fit_psf_beside(image, *window, guess, level_under(guess, level), sensor_, psf, flux_dn, disc, beside);
    if (!usable(fit) || (best.converged && fit.chi2_per_dof >= best.chi2_per_dof)) continue;
    best = fit;
    if (best.chi2_per_dof < kGoodChi2) break;
  }
  if (!best.converged) return false;
  take(best, spot);
  // As a point alone, which it is not, its spot taught what is wrong.
  lessons_.replace(best.pixel, {});
  spot.saturated = best.saturated;
  if (!best.saturated) {  // the companion's light comes again
    spot.covariance_px2 = best.noise_px2;
    spot.repeating_sigma_px = best.repeating_sigma_px;
  }
  return true;
}

bool CentroidFinder::measure_disc(ImageView<const std::uint16_t> image, const FrameLevel& level, const LitDisc& disc,
                                  Centroid& spot) {
  const LocalPsf psf = lessons_.before().at(spot.pixel);
  const auto window = window_about(image, spot.pixel, psf);
  if (!window) return false;
  PsfEvidence evidence;
  const PsfFit fit =
      fit_psf_of_disc(image, *window, spot.pixel, level_under(spot.pixel, level), sensor_, psf, disc, &evidence);
  if (!usable(fit)) return false;
  evidence.weaken(fit.chi2_per_dof);
  lessons_.replace(spot.pixel, evidence);
  take(fit, spot);
  return true;
}

// The background as it was measured where it is uneven.
LocalLevel CentroidFinder::level_under(Pixel place, const FrameLevel& level) const {
  LocalLevel under = background_.at(place);
  if (background_.even()) {
    under.background_dn = level.background_dn;
    under.noise_dn = level.noise_dn;
  }
  return under;
}

// A hot pixel comes again, a proton does not.
SpotKind CentroidFinder::kind_of_sharp(Pixel peak) {
  if (sharp_count_[0] < kSharp) sharp_[0][sharp_count_[0]++] = peak;
  for (std::size_t i = 0; i < sharp_count_[1]; ++i) {
    if (sharp_[1][i].u == peak.u && sharp_[1][i].v == peak.v) return SpotKind::hot_pixel;
  }
  return SpotKind::cosmic_ray;
}

// Light that reaches all along a column: more than half of the image's height, and narrow.
bool CentroidFinder::smeared(int height) const {
  for (const Region& region : regions_.all()) {
    if (2 * region.box.height() > height && 8 * region.pixels < height * region.box.height() &&
        !bloomed(region.saturated_box))
      return true;
    if (region.saturated && 2 * region.box.height() > height && 2 * region.saturated_box.height() < region.box.height())
      return true;
  }
  return false;
}

// The middle of what bright spots have beyond the point-spread function; zero where that is nothing.
Mat2 CentroidFinder::common_motion() {
  Mat2 common = Mat2::Zero();
  moving_ = false;
  for (const auto& [row, column] : {std::pair{0, 0}, std::pair{0, 1}, std::pair{1, 1}}) {
    std::size_t n = 0;
    for (const Candidate& candidate : candidates_) {
      if (regions_.all()[candidate.region].saturated || candidate.moments.peak_over_noise < kBrightNoise) continue;
      excess_[n++] = candidate.moments.second(row, column);
    }
    if (n < kConsensus) return Mat2::Zero();
    const auto middle = excess_.begin() + static_cast<std::ptrdiff_t>(n / 2);
    std::nth_element(excess_.begin(), middle, excess_.begin() + static_cast<std::ptrdiff_t>(n));
    common(row, column) = common(column, row) = *middle;
  }
  const double one = spot_variance_px2(lessons_.belief().at({0.0, 0.0}));
  common -= one * Mat2::Identity();
  const Eigen::SelfAdjointEigenSolver<Mat2> axes(common);
  // Half a star's own variance, along one axis: 2 px of motion for a core of 0.8.
  moving_ = axes.eigenvalues()[1] > 0.5 * one && axes.eigenvalues()[0] < 0.5 * axes.eigenvalues()[1];
  if (!moving_) return Mat2::Zero();
  const Vec2 along = axes.eigenvectors().col(1);
  return axes.eigenvalues()[1] * along * along.transpose();
}

// Candidates for measurement, brightest first; what is no point goes to the others.
template <typename T>
void CentroidFinder::choose(ImageView<const T> image, std::size_t wanted) {
  others_.clear();
  std::swap(sharp_[0], sharp_[1]);
  sharp_count_ = {0, sharp_count_[0]};
  const auto regions = regions_.all();
  order_.clear();
  for (std::size_t i = 0; i < regions.size(); ++i) {
    if (regions[i].pixels >= settings_.min_region_px) order_.push_back({regions[i].sum, static_cast<std::uint32_t>(i)});
  }
  // As many again as are wanted may be no stars.
  const std::size_t looked = std::min(order_.size(), 2 * wanted);
  const auto brighter = [](const Ranked& a, const Ranked& b) { return a.light > b.light; };
  const auto last = order_.begin() + static_cast<std::ptrdiff_t>(looked);
  if (looked < order_.size()) std::nth_element(order_.begin(), last, order_.end(), brighter);
  std::sort(order_.begin(), last, brighter);
  candidates_.clear();
  const auto set_apart = [&](const Candidate& candidate, SpotKind kind) {
    if (others_.size() == kMaxOthers) return;
    const Region& region = regions[candidate.region];
    Centroid other;
    other.pixel = candidate.moments.flux > 0.0 ? Pixel{candidate.moments.centre.x(), candidate.moments.centre.y()}
                                               : middle_of(region.box);
    if (kind == SpotKind::extended && candidate.moments.flux > 0.0)
      other.covariance_px2 =
          centre_covariance(image, region, candidate.moments, background_.at(middle_of(region.box)), sensor_);
    other.flux_dn = region.sum;
    other.peak_dn = region.peak;
    other.pixels = region.pixels;
    other.saturated = region.saturated;
    other.kind = kind;
    others_.push_back(other);
  };
  for (std::size_t k = 0; k < looked && candidates_.size() < wanted; ++k) {
    const Region& region = regions[order_[k].region];
    Candidate candidate;
    candidate.region = order_[k].region;
    candidate.core = region.saturated_box;
    const bool blooming = region.saturated && bloomed(region.saturated_box);
    if (blooming) candidate.core = core_of_bloomed(image, region.saturated_box, sensor_.saturation_dn);
    if (region.cut || on_border(blooming ? candidate.core : region.box, image.width(), image.height())) continue;
    const bool vast =
        static_cast<std::size_t>(region.box.width()) * static_cast<std::size_t>(region.box.height()) > kMaxBox;
    if (!blooming && (vast || region.pixels > settings_.max_region_px)) {
      if (settings_.refuse_sharp) set_apart(candidate, SpotKind::extended);
      continue;
    }
    if (settings_.refuse_sharp && !region.saturated)
      candidate.moments = moments_of(image, region, background_.at(middle_of(region.box)), sensor_);
    candidates_.push_back(candidate);
  }
  moving_ = false;
  if (!settings_.refuse_sharp) return;
  const Mat2 motion = common_motion();
  std::size_t kept = 0, bright = 0, sharp = 0;
  for (Candidate& candidate : candidates_) {
    const Region& region = regions[candidate.region];
    candidate.kind = kind_of(region, candidate.moments, lessons_.belief().at(middle_of(region.box)), motion);
    if (candidate.moments.peak_over_noise < kBrightNoise) continue;
    ++bright;
    if (candidate.kind == SpotKind::cosmic_ray) ++sharp;
  }
  // Where most bright spots are sharper than believed, the belief is wrong and not the spots; once it was learned, it
  // is not.
  const bool sharper_optics = bright >= kConsensus && 2 * sharp > bright && !lessons_.belief().settled();
  for (const Candidate& candidate : candidates_) {
    SpotKind kind = candidate.kind;
    if (kind == SpotKind::cosmic_ray) kind = sharper_optics ? SpotKind::point : kind_of_sharp(candidate.moments.peak);
    if (kind == SpotKind::point)
      candidates_[kept++] = candidate;
    else
      set_apart(candidate, kind);
  }
  candidates_.resize(kept);
}

FrameLevel CentroidFinder::with_threshold(FrameLevel level) const {
  level.threshold_dn =
      level.background_dn +
      (settings_.threshold_dn > 0.0 ? settings_.threshold_dn : settings_.threshold_sigma * level.noise_dn);
  return level;
}

template <typename T>
void CentroidFinder::grow_regions(ImageView<const T> image, const FrameLevel& level) {
  regions_.grow(image, {.background = background_,
                        .level = level,
                        .threshold_sigma = settings_.threshold_sigma,
                        .threshold_dn = settings_.threshold_dn,
                        .saturation_dn = sensor_.saturation_dn,
                        .attention = attention_});
}

template <typename T>
std::size_t CentroidFinder::find_in(ImageView<const T> image, const FrameLevel& level, std::span<Centroid> out) {
  attention_ = nullptr;
  grow_regions(image, level);
  if (smeared(image.height())) {
    background_.measure_columns(image);
    grow_regions(image, level);
  }
  choose(image, std::min(out.size(), static_cast<std::size_t>(settings_.max_centroids)));
  return measure_chosen(image, settings_.method, out);
}

bool CentroidFinder::choose_within(ImageView<const std::uint16_t> image, const Attention& attention,
                                   const FrameLevel& level, std::size_t wanted) {
  attention_ = &attention;
  lessons_.begin_frame();
  grow_regions(image, level);
  for (const Region& region : regions_.all()) {
    if (region.cut && (region.saturated || region.box.height() >= kLongCut)) return false;
  }
  choose(image, std::min(wanted, static_cast<std::size_t>(settings_.max_centroids)));
  if (moving_) look_again();
  return !moving_;
}

std::optional<std::size_t> CentroidFinder::glance(ImageView<const std::uint16_t> image, const Attention& attention,
                                                  std::span<Centroid> out, FrameLevel& level) {
  level = with_threshold(background_.measure(image, kFewSamples));
  if (!background_.even() || !choose_within(image, attention, level, out.size())) return std::nullopt;
  const std::size_t count = measure_chosen(image, CentroidMethod::squared_intensity, out);
  look_again();
  return count;
}

std::optional<std::size_t> CentroidFinder::find_within(ImageView<const std::uint16_t> image, const Attention& attention,
                                                       const FrameLevel& level, std::span<Centroid> out) {
  if (!choose_within(image, attention, level, out.size())) return std::nullopt;
  return measure_chosen(image, settings_.method, out);
}

void CentroidFinder::look_again() {
  lessons_.take_back();
  std::swap(sharp_[0], sharp_[1]);
  std::swap(sharp_count_[0], sharp_count_[1]);
}

template <typename T>
std::size_t CentroidFinder::measure_chosen(ImageView<const T> image, CentroidMethod method, std::span<Centroid> out) {
  lessons_.begin_frame();
  std::size_t count = 0;
  for (const Candidate& candidate : candidates_) {
    const Region& region = regions_.all()[candidate.region];
    Centroid& centroid = out[count];
    centroid = Centroid{};
    const bool measured =
        method == CentroidMethod::psf_fit ? by_fit(image, candidate, centroid) : by_squares(image, region, centroid);
    if (!measured) continue;
    centroid.peak_dn = region.peak;
    centroid.pixels = region.pixels;
    centroid.saturated = region.saturated;
    ++count;
  }
  lessons_.learn();
  std::sort(out.begin(), out.begin() + static_cast<std::ptrdiff_t>(count),
            [](const Centroid& a, const Centroid& b) { return a.flux_dn > b.flux_dn; });
  return count;
}

template <typename T>
std::size_t CentroidFinder::find_whole(ImageView<const T> image, std::span<Centroid> out, FrameLevel* level) {
  const FrameLevel measured = with_threshold(background_.measure(image));
  if (level != nullptr) *level = measured;
  return find_in(image, measured, out);
}

std::size_t CentroidFinder::find(ImageView<const std::uint8_t> image, std::span<Centroid> out, FrameLevel* level) {
  return find_whole(image, out, level);
}
std::size_t CentroidFinder::find(ImageView<const std::uint16_t> image, std::span<Centroid> out, FrameLevel* level) {
  return find_whole(image, out, level);
}
std::size_t CentroidFinder::find(ImageView<const float> image, std::span<Centroid> out, FrameLevel* level) {
  return find_whole(image, out, level);
}
std::size_t CentroidFinder::find_above(ImageView<const std::uint16_t> image, const FrameLevel& level,
                                       std::span<Centroid> out) {
  background_.set(level);
  return find_in(image, level, out);
}
std::size_t CentroidFinder::find_above(ImageView<const float> image, const FrameLevel& level, std::span<Centroid> out) {
  background_.set(level);
  return find_in(image, level, out);
}

}  // namespace astronav::vision
