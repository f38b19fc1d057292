// SPDX-License-Identifier: Apache-2.0
// The second half of the Identifier: a hypothesis is judged by all catalogue stars in the field.
#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>

#include "onboard/vision/identify.h"
#include "onboard/vision/spot_tiles.h"

namespace astronav::vision {
namespace {

// A net of this many sigma misses one star in ten thousand.
constexpr double kNetSigma = 4.3;
// A spot on a star is that star if its light differs by less than this, which colours and blends explain.
constexpr double kSameStarMag = 1.0;
// While the net is wide: enough to see which stars belong to each other.
constexpr int kRoughIterations = 3;
// Median of chi-square with two degrees of freedom.
constexpr double kMedianOfChi2 = 1.386;
// By how much chi-square must fall before a lens is believed to bend lines (two parameters bring 2 by chance, and 30
// once in three million).
constexpr double kDistortionGain = 30.0;
// Up to so many matches their probability is summed, and not bounded alone.
constexpr int kFewMatches = 8;
// Stars are gathered as far beyond the edge as a rough attitude may be off there, of the frame's width.
constexpr double kEdgeOfFrame = 0.06;
constexpr double kFullNet = 0.38;  // root mean square of what is left, an axis, over the radius
// A lens that bends lines by 8 px at 700 px from the middle takes a part of that for another focal length.
constexpr double kFocalStray = 0.012;
constexpr std::size_t kFewSpots = 40;

}  // namespace

double chance_of_matches(int spots, int matched, double p) {
  if (matched <= 0 || spots <= 0) return 1.0;
  if (matched > spots) return 0.0;
  p = std::clamp(p, 1e-300, 1.0);
  const double x = static_cast<double>(matched) / spots;
  if (x <= p) return 1.0;
  const double divergence = x * std::log(x / p) + (x < 1.0 ? (1.0 - x) * std::log((1.0 - x) / (1.0 - p)) : 0.0);
  const double chernoff = std::exp(-spots * divergence);
  if (matched > kFewMatches) return chernoff;
  // Of few the first term, and what a geometric series brings for the others, is the smaller bound.
  double term = std::pow(1.0 - p, spots - matched);
  for (int i = 0; i < matched; ++i) term *= p * (spots - i) / (i + 1.0);
  const double ratio = (spots - matched) * p / ((matched + 1.0) * (1.0 - p));
  return ratio < 1.0 ? std::min(chernoff, term / (1.0 - ratio)) : chernoff;
}

// The brightest stars of the field: some more than there are spots. Where spots are few, a cluster beside the frame
// would take their stars' places, so the frame's are picked.
void Identifier::gather_stars(const Mat3& R_CN, const Observer& observer, std::size_t spots, double margin_px) {
  const Vec3 boresight = R_CN.row(2).transpose();
  const std::size_t found = field_.cone(boresight, cone_radius_rad_, cone_);
  const bool few = spots < kFewSpots;
  const std::size_t wanted = std::min({found, kMaxStarsJudged, spots + spots / 2 + (few ? 60 : 30)});
  const std::size_t wanted_in_frame = few ? std::min(9 * spots / 10 + 15, 2 * spots + 6) : wanted;
  const std::span<const FieldStar> all = field_.stars();
  by_brightness_.clear();
  for (std::size_t i = 0; i < found; ++i) by_brightness_.push_back({all[cone_[i]].v_mag, cone_[i]});
  const auto brighter = [](const Bright& a, const Bright& b) { return a.v_mag < b.v_mag; };
  const auto end = by_brightness_.begin() + static_cast<std::ptrdiff_t>(wanted);
  if (wanted < found) std::nth_element(by_brightness_.begin(), end, by_brightness_.end(), brighter);
  std::sort(by_brightness_.begin(), end, brighter);
  stars_.clear();
  const ApparentPlaces places(field_, observer);
  std::size_t in_frame = 0;
  for (auto star = by_brightness_.begin(); star != end && in_frame < wanted_in_frame; ++star) {
    const Vec3 direction_N = places.of(all[star->star]);
    if (few) {
      const Result<Pixel> pixel = project(camera_, R_CN * direction_N);
      if (!pixel || std::abs(pixel->u - 0.5 * camera_.width_px) > 0.5 * camera_.width_px + margin_px ||
          std::abs(pixel->v - 0.5 * camera_.height_px) > 0.5 * camera_.height_px + margin_px)
        continue;
      in_frame += camera_.contains(*pixel);
    }
    stars_.push_back({.direction_N = direction_N, .field = star->star, .pixel = {}});
  }
}

void Identifier::attend(const Mat3& R_CN) {
  for (Star& star : stars_) {
    const Result<Pixel> pixel = project(camera_, R_CN * star.direction_N);
    star.attended = false;
    if (!pixel || !camera_.contains(*pixel)) continue;
    const int u = static_cast<int>(std::lround(pixel->u)), v = static_cast<int>(std::lround(pixel->v));
    star.attended = attention_->covers({u, v, u, v});
  }
}

// Pairs every star, bright ones first, with the nearest spot, until there are `enough`. Fills sights_; returns their
// number.
int Identifier::match(std::span<const Centroid> spots, const Mat3& R_CN, const Intrinsics& camera, double radius_px,
                      std::size_t enough) {
  sights_.clear();
  sight_star_.clear();
  const std::span<const FieldStar> all = field_.stars();
  for (Star& star : stars_) {
    star.spot = -1;
    star.visible = false;
  }
  for (std::size_t k = 0; k < stars_.size() && sights_.size() < enough; ++k) {
    Star& star = stars_[k];
    if (!star.attended) continue;
    const Result<Pixel> pixel = project(camera, R_CN * star.direction_N);
    star.visible = pixel.has_value() && camera_.contains(*pixel);
    if (!star.visible) continue;
    star.pixel = *pixel;
    const int x0 = tile(star.pixel.u - radius_px, grid_width_), x1 = tile(star.pixel.u + radius_px, grid_width_);
    const int y0 = tile(star.pixel.v - radius_px, grid_height_), y1 = tile(star.pixel.v + radius_px, grid_height_);
    double best = radius_px * radius_px;
    for (int y = y0; y <= y1; ++y) {
      for (int x = x0; x <= x1; ++x) {
        for (std::int32_t i = grid_[static_cast<std::size_t>(y) * grid_width_ + x]; i >= 0; i = next_[i]) {
          const double d2 = (spots[i].pixel.vec() - star.pixel.vec()).squaredNorm();
          if (d2 >= best) continue;
          best = d2;
          star.spot = i;
        }
      }
    }
    if (star.spot < 0) continue;
    StarSight sight;
    sight.pixel = spots[star.spot].pixel;
    sight.covariance_px2 = spots[star.spot].whole_covariance_px2();
    sight.direction_N = star.direction_N;
    sights_.push_back(sight);
    sight_star_.push_back(static_cast<std::uint32_t>(k));
  }
  return static_cast<int>(sights_.size());
}

// Stars whose light is mixed with a neighbour's make biased sights. A neighbour with the share q of the common light,
// at the distance d, pulls by q d exp(-d^2 / 8 sigma^2). Two that make one round spot are taken for what they are, one
// spot at their common centre; others are left out, both where they claim the same spot.
void Identifier::drop_mixed(std::span<const Centroid> spots) {
  const std::span<const FieldStar> all = field_.stars();
  const double reach = 8.0 * settings_.psf_sigma_px;
  const double width2 = 8.0 * settings_.psf_sigma_px * settings_.psf_sigma_px;
  std::fill(star_grid_.begin(), star_grid_.end(), -1);
  star_next_.assign(stars_.size(), -1);
  for (std::size_t k = 0; k < stars_.size(); ++k) {
    if (!stars_[k].visible) continue;
    std::int32_t& head = star_grid_[static_cast<std::size_t>(tile(stars_[k].pixel.v, grid_height_)) * grid_width_ +
                                    tile(stars_[k].pixel.u, grid_width_)];
    star_next_[k] = head;
    head = static_cast<std::int32_t>(k);
  }
  const double one_spot2 = 1.5 * 1.5 * settings_.psf_sigma_px * settings_.psf_sigma_px;
  const auto mixed = [&](std::uint32_t k, StarSight& sight) {
    const Star& star = stars_[k];
    Vec2 common = Vec2::Zero();
    const double sigma =
        std::hypot(std::sqrt(0.5 * spots[star.spot].covariance_px2.trace()), settings_.attitude.extra_sigma_px);
    for (int y = tile(star.pixel.v - reach, grid_height_); y <= tile(star.pixel.v + reach, grid_height_); ++y) {
      for (int x = tile(star.pixel.u - reach, grid_width_); x <= tile(star.pixel.u + reach, grid_width_); ++x) {
        for (std::int32_t j = star_grid_[static_cast<std::size_t>(y) * grid_width_ + x]; j >= 0; j = star_next_[j]) {
          if (j == static_cast<std::int32_t>(k)) continue;
          const Star& other = stars_[j];
          const Vec2 apart = other.pixel.vec() - star.pixel.vec();
          const double d2 = apart.squaredNorm();
          if (d2 > reach * reach) continue;
          const double ratio = std::pow(10.0, 0.4 * (all[star.field].v_mag - all[other.field].v_mag));
          const Vec2 pull = ratio / (1.0 + ratio) * std::exp(-d2 / width2) * apart;
          if (d2 < one_spot2 && ratio < 1.0) {
            common += pull;
          } else if (other.spot == star.spot || pull.norm() > 0.3 * sigma) {
            return true;
          }
        }
      }
    }
    // Magnitudes in the camera's own colours are known to 0.3 mag.
    sight.pixel = {sight.pixel.u - common.x(), sight.pixel.v - common.y()};
    sight.covariance_px2 += Mat2::Identity() * 0.09 * common.squaredNorm();
    return false;
  };
  std::size_t kept = 0;
  for (std::size_t i = 0; i < sights_.size(); ++i) {
    if (mixed(sight_star_[i], sights_[i])) continue;
    sights_[kept] = sights_[i];
    sight_star_[kept++] = sight_star_[i];
  }
  sights_.resize(kept);
  sight_star_.resize(kept);
}

// V + 2.5 log10 of the light: the same for all stars, but for their colours.
double Identifier::zero_point(const Star& star, std::span<const Centroid> spots) const {
  return field_.stars()[star.field].v_mag + 2.5 * std::log10(std::max(spots[star.spot].flux_dn, 1e-6));
}

// A star much fainter or brighter than the spot it was paired with is another one; a planet in front of it, say.
void Identifier::drop_wrong_brightness(std::span<const Centroid> spots) {
  zero_point_ = std::numeric_limits<double>::quiet_NaN();
  if (!(settings_.brightness_gate_mag > 0.0) || sights_.size() < 5) return;
  numbers_.clear();
  for (const std::uint32_t k : sight_star_) numbers_.push_back(zero_point(stars_[k], spots));
  const auto middle = numbers_.begin() + static_cast<std::ptrdiff_t>(numbers_.size() / 2);
  std::nth_element(numbers_.begin(), middle, numbers_.end());
  zero_point_ = *middle;
  std::size_t kept = 0;
  for (std::size_t i = 0; i < sights_.size(); ++i) {
    if (std::abs(zero_point(stars_[sight_star_[i]], spots) - zero_point_) > settings_.brightness_gate_mag) continue;
    sights_[kept] = sights_[i];
    sight_star_[kept++] = sight_star_[i];
  }
  sights_.resize(kept);
  sight_star_.resize(kept);
}

// Doubles that were left out of the fit are stars all the same. All stars of the field count that may be as bright as
// the faintest spot, and each has the spot nearest to it.
void Identifier::mark_stars(std::span<const Centroid> spots, double radius_px) {
  on_star_.assign(spots.size(), 0);
  for (std::size_t i = 0; i < sights_.size(); ++i)
    if (sights_[i].used) on_star_[stars_[sight_star_[i]].spot] = 1;
  for (const Star& star : stars_) {
    if (!star.visible || star.spot < 0) continue;
    if ((spots[star.spot].pixel.vec() - star.pixel.vec()).norm() > radius_px) continue;
    if (std::abs(zero_point(star, spots) - zero_point_) > kSameStarMag) continue;
    on_star_[star.spot] = 1;
  }
}

// Noise an axis beyond what the covariances tell, from the median of what is left; 0 where it may be chance. A camera
// or catalogue worse than believed then shows in the covariance of the attitude.
double Identifier::unexplained_sigma_px() {
  const auto median_d2 = [&](double extra2) {
    numbers_.clear();
    for (const StarSight& sight : sights_)
      numbers_.push_back(sight.residual_px.squaredNorm() / (0.5 * sight.covariance_px2.trace() + extra2));
    const auto middle = numbers_.begin() + static_cast<std::ptrdiff_t>(numbers_.size() / 2);
    std::nth_element(numbers_.begin(), middle, numbers_.end());
    return *middle;
  };
  const double told2 = settings_.attitude.extra_sigma_px * settings_.attitude.extra_sigma_px;
  const auto n = static_cast<double>(sights_.size());
  if (sights_.empty() || median_d2(told2) < kMedianOfChi2 * (1.0 + 3.0 / std::sqrt(n))) return 0.0;
  double lo = 0.0, hi = 0.0;
  for (const StarSight& sight : sights_) hi = std::max(hi, sight.residual_px.norm());
  for (int i = 0; i < 12; ++i) {
    const double mid = 0.5 * (lo + hi);
    (median_d2(told2 + mid * mid) > kMedianOfChi2 ? lo : hi) = mid;
  }
  return hi;
}

Result<AttitudeFit> Identifier::fit(const AttitudeFit& start, AttitudeOptions options) {
  options.freedom.focal_length &= sights_.size() >= 4;
  options.freedom.k1 &= sights_.size() >= 8;
  options.freedom.tangential &= sights_.size() >= 20;
  return fit_attitude(sights_, start.R_CN, start.camera, options);
}

// The same with distortion, where that explains the places far better.
std::optional<AttitudeFit> Identifier::fit_bent(const AttitudeFit& start, const AttitudeFit& straight,
                                                AttitudeOptions& options) {
  AttitudeOptions bent = options;
  bent.freedom = {.focal_length = true,
                  .k1 = true,
                  .tangential = sights_.size() >= 2 * static_cast<std::size_t>(settings_.distortion_from_stars)};
  // On equal terms: the nets and the gates let through what fits.
  bent.extra_sigma_px = std::max(bent.extra_sigma_px, straight.residual_rms_px);
  const Result<AttitudeFit> tried = fit(start, bent);
  if (!tried) return std::nullopt;
  const double gain = 2.0 * straight.used - tried->chi2_per_dof * (2.0 * tried->used - 3.0 - bent.freedom.count());
  if (tried->used < straight.used || gain < kDistortionGain) return std::nullopt;
  bent.extra_sigma_px = options.extra_sigma_px;
  options = bent;
  const Result<AttitudeFit> again = fit(*tried, bent);
  if (!again) return std::nullopt;
  return *again;
}

// Eq. 9. The first spots are the surest, and the nearest matches: several lengths of the list and several radii are
// tried, and paid for.
double Identifier::chance(std::span<const Centroid> spots, const Claim& claim, double radius_px, int parameters) const {
  int visible = 0, used = 0;
  for (const Star& star : stars_) visible += star.visible;
  for (const StarSight& sight : sights_) used += sight.used;
  const double area =
      attention_ != nullptr ? attention_->area_px() : static_cast<double>(camera_.width_px) * camera_.height_px;
  // What was fitted to all matches, and not to the three alone, brings them nearer to their stars: of what they may be
  // off by, each parameter leaves the share that the three have in telling it.
  const double spent = std::pow(std::max(1.0, used / 3.0), parameters);
  const int all = static_cast<int>(spots.size());
  const int lengths[] = {15, 30, 60};
  constexpr int kNets = 5;  // each half as wide as the one before
  int tried = 0;
  double least = 1.0;
  const auto try_length = [&](int length) {
    int hits[kNets] = {};
    for (std::size_t i = 0; i < sights_.size(); ++i) {
      if (!sights_[i].used || stars_[sight_star_[i]].spot >= length) continue;
      const double d2 = sights_[i].residual_px.squaredNorm();
      for (int net = 0; net < kNets; ++net) hits[net] += d2 * (1 << 2 * net) < radius_px * radius_px;
    }
    for (int net = 0; net < kNets; ++net) {
      ++tried;
      const double p = std::min(0.9, visible * kPi * radius_px * radius_px / ((1 << 2 * net) * area));
      least = std::min(least, chance_of_matches(length - claim.given, hits[net] - claim.given, p));
    }
  };
  for (const int length : lengths)
    if (length < all) try_length(length);
  try_length(all);
  return tried * claim.expected * spent * least;
}

bool Identifier::judge(std::span<const Centroid> spots, const Observer& observer, const Claim& claim,
                       Identification& out, std::span<MatchedStar> matches) {
  if (!claim.gathered)
    gather_stars(claim.R_CN, observer, spots.size(), claim.radius_px + kEdgeOfFrame * camera_.width_px);
  if (attention_ != nullptr) attend(claim.R_CN);
  AttitudeFit fitted;
  fitted.R_CN = claim.R_CN;
  fitted.camera = camera_;
  const std::size_t distortion_from = static_cast<std::size_t>(settings_.distortion_from_stars);
  double radius = claim.radius_px, unexplained = 0.0, told = 0.0;
  int parameters = 3;
  for (int pass = 0;; ++pass) {
    const double last_radius = std::max(settings_.match_px, kNetSigma * std::hypot(told, unexplained));
    const bool final_pass = pass > 0 && radius <= last_radius;
    if (match(spots, fitted.R_CN, fitted.camera, radius, final_pass ? kMaxStarsJudged : settings_.rough_stars) <
        std::max(3, claim.min_matched - 1))
      return false;
    AttitudeOptions options = settings_.attitude;
    options.freedom.focal_length |= claim.free_focal;
    const bool may_bend = distortion_from > 0 && sights_.size() >= distortion_from;
    if (!final_pass) {
      // A wide net also holds chance pairs: equal weights and a gate that fits the net.
      options.extra_sigma_px = std::max(options.extra_sigma_px, 0.3 * radius);
      options.gate_sigma = 2.5;
      options.max_iterations = kRoughIterations;
      options.freedom.k1 |= may_bend;
      options.freedom.focal_length |= may_bend;
    } else {
      drop_mixed(spots);
      drop_wrong_brightness(spots);
    }
    Result<AttitudeFit> next = fit(fitted, options);
    // Noise that nobody told, or a companion that nobody listed, may leave too little within the gates. What was left
    // in the pass before then stands for the noise. A prior that fits no better is wrong: the sky will be searched.
    const bool of_triangle = claim.given > 2;
    const bool blurred = final_pass && of_triangle && fitted.used >= claim.min_matched &&
                         (!next || next->used < std::max<int>(claim.min_matched, static_cast<int>(sights_.size()) / 2));
    if (blurred) {
      const double freedom = 2.0 * fitted.used - 3.0 - options.freedom.count();
      options.extra_sigma_px =
          std::hypot(options.extra_sigma_px, fitted.residual_rms_px * std::sqrt(2.0 * fitted.used / freedom));
      next = fit(fitted, options);
    }
    if (!next) return false;
    if (final_pass && may_bend) {
      if (const auto bent = fit_bent(fitted, *next, options)) next = *bent;
    }
    told = 0.0;
    for (const StarSight& sight : sights_) told += 0.5 * sight.covariance_px2.trace();
    told = std::sqrt(told / static_cast<double>(std::max<std::size_t>(1, sights_.size())));
    unexplained = unexplained_sigma_px();
    if (final_pass) {
      parameters += options.freedom.count();
      if (unexplained > 0.0) {
        options.extra_sigma_px =
            std::max(options.extra_sigma_px, std::hypot(settings_.attitude.extra_sigma_px, unexplained));
        next = fit(fitted, options);
        if (!next) return false;
      }
      fitted = *next;
      break;
    }
    fitted = *next;
    radius = std::max(std::min(radius, std::max(settings_.match_px, kNetSigma * std::hypot(told, unexplained))),
                      0.4 * radius);
  }
  if (fitted.used < claim.min_matched) return false;
  // Matches by chance fill their net (half its radius an axis), stars do not (a quarter): near the truth it may be
  // both.
  if (radius > settings_.match_px && fitted.residual_rms_px > kFullNet * radius) return false;
  // What ran beyond the ladder looks at the field as a part of another, or at another as a part of it.
  if (claim.free_focal && std::abs(fitted.camera.fx_px / believed_.fx_px - 1.0) >
                              std::max(settings_.focal_uncertainty, settings_.scale_tolerance) + kFocalStray)
    return false;
  const double by_chance = chance(spots, claim, radius, parameters);
  if (!(by_chance < settings_.max_chance)) return false;

  mark_stars(spots, radius);

  AttitudeSolution& attitude = out.attitude;
  attitude.R_CN = fitted.R_CN;
  attitude.covariance_rad2 = fitted.covariance_rad2;
  attitude.repeating_rad2 = fitted.repeating_rad2;
  attitude.intrinsics = fitted.camera;
  attitude.residual_rms_px = fitted.residual_rms_px;
  attitude.chance_probability = by_chance;
  attitude.matched = fitted.used;
  out.matched = 0;
  for (std::size_t i = 0; i < sights_.size() && out.matched < matches.size(); ++i) {
    if (!sights_[i].used) continue;
    const Star& star = stars_[sight_star_[i]];
    const FieldStar& entry = field_.stars()[star.field];
    matches[out.matched++] = {entry.catalogue_index, entry.id, static_cast<std::uint32_t>(star.field),
                              static_cast<std::uint32_t>(star.spot), sights_[i].residual_px};
  }
  return true;
}

}  // namespace astronav::vision
