// SPDX-License-Identifier: Apache-2.0
#include "onboard/vision/identify.h"

#include <algorithm>
#include <cmath>

#include "foundation/base/check.h"
#include "models/aberration/aberration.h"

namespace astronav::vision {
namespace {

constexpr int kTile = 32;  // px
constexpr std::size_t kMaxStarsInCone = 8192;
constexpr std::size_t kMaxStarsJudged = 1024;
constexpr std::size_t kMaxLinks = 16384;
constexpr std::size_t kMaxCandidates = 256;  // of one triple of spots
constexpr int kConfirmSpots = 24;
constexpr double kLeastSine = 0.3;  // of a triangle's widest corner

// Sine of the largest angle's corner, or 0 where all three lie in a line: how well two sides fix the third star.
double widest_sine(const Vec3& a, const Vec3& b, const Vec3& c) {
  const Vec3 ab = b - a, ac = c - a, bc = c - b;
  const double area2 = ab.cross(ac).norm();
  const double l0 = ab.norm(), l1 = ac.norm(), l2 = bc.norm();
  return area2 * std::max({l0, l1, l2}) / (l0 * l1 * l2);
}

double handedness(const Vec3& a, const Vec3& b, const Vec3& c) {
  return a.dot(b.cross(c));
}

}  // namespace

double chance_of_matches(int spots, int matched, double p) {
  if (matched <= 0 || spots <= 0) return 1.0;
  if (matched > spots) return 0.0;
  p = std::clamp(p, 1e-300, 1.0);
  const double x = static_cast<double>(matched) / spots;
  if (x <= p) return 1.0;
  const double divergence = x * std::log(x / p) + (x < 1.0 ? (1.0 - x) * std::log((1.0 - x) / (1.0 - p)) : 0.0);
  return std::exp(-spots * divergence);
}

Identifier::Identifier(const StarField& field, const PairIndex& index, const Intrinsics& camera,
                       const IdentifySettings& settings, std::size_t max_spots)
    : field_(field), index_(index), camera_(camera), settings_(settings), pixel_rad_(camera.plate_scale_rad_px()) {
  ASTRONAV_CHECK(camera.width_px > 0 && camera.height_px > 0 && camera.fx_px > 0.0);
  grid_width_ = camera.width_px / kTile + 1;
  grid_height_ = camera.height_px / kTile + 1;
  grid_.resize(static_cast<std::size_t>(grid_width_) * grid_height_);
  star_grid_.resize(grid_.size());
  star_next_.reserve(kMaxStarsJudged);
  spot_C_.reserve(max_spots);
  next_.reserve(max_spots);
  asterism_.reserve(static_cast<std::size_t>(settings.asterism_spots));
  stars_.reserve(kMaxStarsJudged);
  cone_.resize(kMaxStarsInCone);
  sights_.reserve(kMaxStarsJudged);
  sight_star_.reserve(kMaxStarsJudged);
  zero_points_.reserve(kMaxStarsJudged);
  head_.resize(index.star_count());
  stamp_.assign(index.star_count(), 0);
  links_.reserve(kMaxLinks);
  candidates_.reserve(kMaxCandidates);
}

void Identifier::load_spots(std::span<const Centroid> spots) {
  ASTRONAV_CHECK_OP(spots.size(), <=, spot_C_.capacity());
  spot_C_.clear();
  next_.clear();
  std::fill(grid_.begin(), grid_.end(), -1);
  for (std::size_t i = 0; i < spots.size(); ++i) {
    const Result<Vec3> direction = unproject(camera_, spots[i].pixel);
    spot_C_.push_back(direction ? *direction : Vec3(0.0, 0.0, -1.0));
    const int x = std::clamp(static_cast<int>(spots[i].pixel.u) / kTile, 0, grid_width_ - 1);
    const int y = std::clamp(static_cast<int>(spots[i].pixel.v) / kTile, 0, grid_height_ - 1);
    std::int32_t& head = grid_[static_cast<std::size_t>(y) * grid_width_ + x];
    next_.push_back(head);
    head = static_cast<std::int32_t>(i);
  }
}

// By the rule that made the index: the brightest, but few in one place.
void Identifier::choose_asterism_spots(std::span<const Centroid> spots) {
  asterism_.clear();
  const double near = std::cos(index_.radius_rad());
  for (std::size_t i = 0; i < spots.size() && asterism_.size() < asterism_.capacity(); ++i) {
    if (spot_C_[i].z() <= 0.0) continue;
    int neighbours = 0;
    for (const int j : asterism_) neighbours += spot_C_[i].dot(spot_C_[j]) > near;
    if (neighbours < index_.neighbours()) asterism_.push_back(static_cast<int>(i));
  }
}

// The brightest stars of the field: some more than there are spots.
void Identifier::gather_stars(const Mat3& R_CN, const Observer& observer, std::size_t spots) {
  const Vec3 boresight = R_CN.row(2).transpose();
  const std::size_t found = field_.cone(boresight, camera_.half_diagonal_rad() + 0.01, cone_);
  const std::size_t wanted = std::min({found, kMaxStarsJudged, spots + spots / 2 + 30});
  const std::span<const FieldStar> all = field_.stars();
  std::partial_sort(cone_.begin(), cone_.begin() + static_cast<std::ptrdiff_t>(wanted),
                    cone_.begin() + static_cast<std::ptrdiff_t>(found),
                    [&](std::uint32_t a, std::uint32_t b) { return all[a].v_mag < all[b].v_mag; });
  stars_.clear();
  for (std::size_t i = 0; i < wanted; ++i)
    stars_.push_back({.direction_N = field_.apparent(all[cone_[i]], observer), .field = cone_[i], .pixel = {}});
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
    const Result<Pixel> pixel = project(camera, R_CN * star.direction_N);
    star.visible = pixel.has_value() && pixel->u > -0.5 && pixel->v > -0.5 && pixel->u < camera.width_px - 0.5 &&
                   pixel->v < camera.height_px - 0.5;
    if (!star.visible) continue;
    star.pixel = *pixel;
    const int x0 = std::max(0, static_cast<int>(star.pixel.u - radius_px) / kTile);
    const int x1 = std::min(grid_width_ - 1, static_cast<int>(star.pixel.u + radius_px) / kTile);
    const int y0 = std::max(0, static_cast<int>(star.pixel.v - radius_px) / kTile);
    const int y1 = std::min(grid_height_ - 1, static_cast<int>(star.pixel.v + radius_px) / kTile);
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
    sight.covariance_px2 = spots[star.spot].covariance_px2;
    sight.direction_N = star.direction_N;
    sights_.push_back(sight);
    sight_star_.push_back(static_cast<std::uint32_t>(k));
  }
  return static_cast<int>(sights_.size());
}

// Stars whose light is mixed with a neighbour's make biased sights: out with them. The pull of a neighbour of relative
// flux r at distance d is about r d exp(-d^2 / 8 sigma^2); two stars that claim one spot go both.
void Identifier::drop_mixed(std::span<const Centroid> spots) {
  const std::span<const FieldStar> all = field_.stars();
  const double reach = 8.0 * settings_.psf_sigma_px;
  const double width2 = 8.0 * settings_.psf_sigma_px * settings_.psf_sigma_px;
  const auto tile = [&](double x, int tiles) { return std::clamp(static_cast<int>(x) / kTile, 0, tiles - 1); };
  std::fill(star_grid_.begin(), star_grid_.end(), -1);
  star_next_.assign(stars_.size(), -1);
  for (std::size_t k = 0; k < stars_.size(); ++k) {
    if (!stars_[k].visible) continue;
    std::int32_t& head = star_grid_[static_cast<std::size_t>(tile(stars_[k].pixel.v, grid_height_)) * grid_width_ +
                                    tile(stars_[k].pixel.u, grid_width_)];
    star_next_[k] = head;
    head = static_cast<std::int32_t>(k);
  }
  const auto mixed = [&](std::uint32_t k) {
    const Star& star = stars_[k];
    const double sigma =
        std::hypot(std::sqrt(0.5 * spots[star.spot].covariance_px2.trace()), settings_.attitude.extra_sigma_px);
    for (int y = tile(star.pixel.v - reach, grid_height_); y <= tile(star.pixel.v + reach, grid_height_); ++y) {
      for (int x = tile(star.pixel.u - reach, grid_width_); x <= tile(star.pixel.u + reach, grid_width_); ++x) {
        for (std::int32_t j = star_grid_[static_cast<std::size_t>(y) * grid_width_ + x]; j >= 0; j = star_next_[j]) {
          if (j == static_cast<std::int32_t>(k)) continue;
          const Star& other = stars_[j];
          const double d2 = (other.pixel.vec() - star.pixel.vec()).squaredNorm();
          if (d2 > reach * reach) continue;
          if (other.spot == star.spot) return true;
          const double ratio = std::pow(10.0, 0.4 * (all[star.field].v_mag - all[other.field].v_mag));
          if (ratio * std::sqrt(d2) * std::exp(-d2 / width2) > 0.3 * sigma) return true;
        }
      }
    }
    return false;
  };
  std::size_t kept = 0;
  for (std::size_t i = 0; i < sights_.size(); ++i) {
    if (mixed(sight_star_[i])) continue;
    sights_[kept] = sights_[i];
    sight_star_[kept++] = sight_star_[i];
  }
  sights_.resize(kept);
  sight_star_.resize(kept);
}

// A star much fainter or brighter than the spot it was paired with is another one; a planet in front of it, say.
void Identifier::drop_wrong_brightness(std::span<const Centroid> spots) {
  if (!(settings_.brightness_gate_mag > 0.0) || sights_.size() < 5) return;
  const auto zero_point = [&](std::size_t i) {
    const Star& star = stars_[sight_star_[i]];
    return field_.stars()[star.field].v_mag + 2.5 * std::log10(std::max(spots[star.spot].flux_dn, 1e-6));
  };
  zero_points_.clear();
  for (std::size_t i = 0; i < sights_.size(); ++i) zero_points_.push_back(zero_point(i));
  const auto middle = zero_points_.begin() + static_cast<std::ptrdiff_t>(zero_points_.size() / 2);
  std::nth_element(zero_points_.begin(), middle, zero_points_.end());
  const double median = *middle;
  std::size_t kept = 0;
  for (std::size_t i = 0; i < sights_.size(); ++i) {
    if (std::abs(zero_point(i) - median) > settings_.brightness_gate_mag) continue;
    sights_[kept] = sights_[i];
    sight_star_[kept++] = sight_star_[i];
  }
  sights_.resize(kept);
  sight_star_.resize(kept);
}

// All triples of index stars that look like (a, b, c), into candidates_.
std::size_t Identifier::triangles(const Vec3& a, const Vec3& b, const Vec3& c) {
  candidates_.clear();
  const auto range = [&](const Vec3& p, const Vec3& q, double& cos_min, double& cos_max) {
    const double angle = std::atan2(p.cross(q).norm(), p.dot(q));
    const double tolerance = settings_.pair_tolerance_px * pixel_rad_ + settings_.scale_tolerance * angle;
    cos_max = std::cos(std::max(angle - tolerance, 0.0));
    cos_min = std::cos(angle + tolerance);
    return angle;
  };
  double ab_min, ab_max, ac_min, ac_max, bc_min, bc_max;
  const double longest =
      std::max({range(a, b, ab_min, ab_max), range(a, c, ac_min, ac_max), range(b, c, bc_min, bc_max)});
  if (longest > index_.max_angle_rad()) return 0;
  if (widest_sine(a, b, c) < kLeastSine) return 0;
  const bool right_handed = handedness(a, b, c) > 0.0;

  // Chain up the partners of every star for side ac, then walk side ab.
  const std::span<const PairIndex::Pair> ac = index_.pairs(ac_min, ac_max);
  if (2 * ac.size() > kMaxLinks) return 0;
  links_.clear();
  ++now_;
  const auto link = [&](std::uint16_t from, std::uint16_t to) {
    if (stamp_[from] != now_) {
      stamp_[from] = now_;
      head_[from] = -1;
    }
    links_.push_back({to, head_[from]});
    head_[from] = static_cast<std::int32_t>(links_.size()) - 1;
  };
  for (const PairIndex::Pair& pair : ac) {
    link(pair.a, pair.b);
    link(pair.b, pair.a);
  }
  const auto walk = [&](std::uint16_t star_a, std::uint16_t star_b) {
    if (stamp_[star_a] != now_) return;
    const Vec3 da = index_.direction(star_a), db = index_.direction(star_b);
    const double cos_ab = da.dot(db);
    if (cos_ab < ab_min || cos_ab > ab_max) return;
    for (std::int32_t i = head_[star_a]; i >= 0; i = links_[i].next) {
      const std::uint16_t star_c = links_[i].partner;
      const Vec3 dc = index_.direction(star_c);
      const double cos_bc = db.dot(dc), cos_ac = da.dot(dc);
      if (cos_bc < bc_min || cos_bc > bc_max || cos_ac < ac_min || cos_ac > ac_max) continue;
      if ((handedness(da, db, dc) > 0.0) != right_handed) continue;
      if (candidates_.size() < kMaxCandidates) candidates_.push_back({star_a, star_b, star_c});
    }
  };
  for (const PairIndex::Pair& pair : index_.pairs(ab_min, ab_max)) {
    walk(pair.a, pair.b);
    walk(pair.b, pair.a);
  }
  return candidates_.size();
}

// Does any further bright spot fall on a star? Aberration is the same for near-by stars and already in the attitude.
bool Identifier::confirmed(std::span<const Centroid> spots, const Mat3& R_CN, const int (&corner)[3]) const {
  const double radius = settings_.first_match_px * pixel_rad_;
  const int last = std::min<int>(kConfirmSpots, static_cast<int>(spots.size()));
  int tried = 0, hits = 0;
  for (int i = 0; i < last; ++i) {
    if (i == corner[0] || i == corner[1] || i == corner[2]) continue;
    ++tried;
    hits += field_.nearest(R_CN.transpose() * spot_C_[i], radius) >= 0;
  }
  return tried > 0 && hits >= 1 && 4 * hits >= tried;
}

// `given`: matches that made the hypothesis and so prove nothing; `tried`: hypotheses so far.
bool Identifier::judge(std::span<const Centroid> spots, const Observer& observer, const Mat3& R_CN, double radius_px,
                       int given, double tried, Identification& out, std::span<MatchedStar> matches) {
  gather_stars(R_CN, observer, spots.size());
  AttitudeFit fit;
  fit.R_CN = R_CN;
  fit.camera = camera_;
  double radius = radius_px;
  for (int pass = 0;; ++pass) {
    const bool final_pass = radius <= settings_.match_px;
    if (match(spots, fit.R_CN, fit.camera, radius, final_pass ? kMaxStarsJudged : settings_.rough_stars) <
        std::max(3, settings_.min_matched - 1))
      return false;
    AttitudeOptions options = settings_.attitude;
    if (!final_pass) {
      // A wide net also holds chance pairs: equal weights and a gate that fits the net.
      options.extra_sigma_px = std::max(options.extra_sigma_px, 0.3 * radius);
      options.gate_sigma = 2.5;
    }
    if (final_pass) {
      drop_mixed(spots);
      drop_wrong_brightness(spots);
    }
    options.freedom.focal_length &= sights_.size() >= 4;
    options.freedom.k1 &= sights_.size() >= 8;
    options.freedom.tangential &= sights_.size() >= 20;
    const Result<AttitudeFit> next = fit_attitude(sights_, fit.R_CN, fit.camera, options);
    if (!next) return false;
    fit = *next;
    if (final_pass && pass > 0) break;
    radius = std::max(settings_.match_px, 0.4 * radius);
  }
  if (fit.used < settings_.min_matched) return false;
  int visible = 0;
  for (const Star& star : stars_) visible += star.visible;
  const double area = static_cast<double>(camera_.width_px) * camera_.height_px;
  const double p = visible * kPi * settings_.match_px * settings_.match_px / area;
  // The first spots are the surest: four lengths of the list are tried, and paid for.
  double chance = 1.0;
  for (const int first : {15, 30, 60, static_cast<int>(spots.size())}) {
    int hits = 0;
    for (std::size_t i = 0; i < sights_.size(); ++i) hits += sights_[i].used && stars_[sight_star_[i]].spot < first;
    const int looked_at = std::min(first, static_cast<int>(spots.size()));
    chance = std::min(chance, 4.0 * tried * chance_of_matches(looked_at - given, hits - given, std::min(p, 0.9)));
  }
  if (!(chance < settings_.max_chance)) return false;

  AttitudeSolution& attitude = out.attitude;
  attitude.R_CN = fit.R_CN;
  attitude.covariance_rad2 = fit.covariance_rad2;
  attitude.intrinsics = fit.camera;
  attitude.residual_rms_px = fit.residual_rms_px;
  attitude.chance_probability = chance;
  attitude.matched = fit.used;
  out.matched = 0;
  for (std::size_t i = 0; i < sights_.size() && out.matched < matches.size(); ++i) {
    if (!sights_[i].used) continue;
    const Star& star = stars_[sight_star_[i]];
    const FieldStar& entry = field_.stars()[star.field];
    matches[out.matched++] = {entry.catalogue_index, entry.id, static_cast<std::uint32_t>(star.spot),
                              sights_[i].residual_px};
  }
  return true;
}

Result<Identification> Identifier::lost_in_space(std::span<const Centroid> spots, const Observer& observer,
                                                 std::span<MatchedStar> matches) {
  Identification out;
  load_spots(spots);
  choose_asterism_spots(spots);
  const int n = static_cast<int>(asterism_.size());
  for (int dj = 1; dj <= n - 2; ++dj) {
    for (int dk = 1; dk <= n - dj - 1; ++dk) {
      for (int i = 0; i < n - dj - dk; ++i) {
        const int corner[3] = {asterism_[i], asterism_[i + dj], asterism_[i + dj + dk]};
        const Vec3 seen[3] = {spot_C_[corner[0]], spot_C_[corner[1]], spot_C_[corner[2]]};
        ++out.triples;
        triangles(seen[0], seen[1], seen[2]);
        for (const Candidate& candidate : candidates_) {
          if (++out.hypotheses > settings_.max_hypotheses)
            return fail(ErrorCode::no_match, "{0} hypotheses, none of which all stars agree with",
                        {static_cast<double>(settings_.max_hypotheses)});
          // Confirmed at rest, judged as seen from the moving observer.
          Vec3 known[3] = {index_.direction(candidate.a), index_.direction(candidate.b), index_.direction(candidate.c)};
          const Result<Mat3> at_rest = attitude_from_directions(seen, known);
          if (!at_rest || !confirmed(spots, *at_rest, corner)) continue;
          for (Vec3& direction : known) direction = aberrate(direction.normalized(), observer.v_O_N);
          const Result<Mat3> first = attitude_from_directions(seen, known);
          if (first && judge(spots, observer, *first, settings_.first_match_px, 3, out.hypotheses, out, matches))
            return out;
        }
      }
    }
  }
  return fail(ErrorCode::no_match, "{0} spots: no triangle of them is in the catalogue",
              {static_cast<double>(spots.size())});
}

Result<Identification> Identifier::track(std::span<const Centroid> spots, const Observer& observer,
                                         const Mat3& prior_R_CN, double radius_px, std::span<MatchedStar> matches) {
  Identification out;
  load_spots(spots);
  out.hypotheses = 1;
  if (judge(spots, observer, prior_R_CN, radius_px, 2, 1.0, out, matches)) return out;
  return fail(ErrorCode::no_match, "the stars are not where the prior attitude puts them");
}

}  // namespace astronav::vision
