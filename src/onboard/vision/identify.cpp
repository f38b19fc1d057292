// SPDX-License-Identifier: Apache-2.0
#include "onboard/vision/identify.h"

#include <algorithm>
#include <cmath>

#include "foundation/base/check.h"
#include "models/aberration/aberration.h"
#include "onboard/vision/spot_tiles.h"
namespace astronav::vision {
namespace {

constexpr std::size_t kMaxStarsInCone = 8192;
constexpr double kConeMarginRad = 0.01;  // aberration, motion, a rough attitude
constexpr std::size_t kMaxLinks = 32768;
constexpr std::size_t kMaxCandidates = 256;  // of one triple of spots
constexpr int kConfirmSpots = 120;
constexpr double kMaxClaimedSigmaPx = 1.0;
constexpr std::size_t kMaxRays = 48;       // of a star of spots
constexpr std::int64_t kWorkOfATry = 200;  // confirming an attitude, in entries of the index
constexpr double kSpotsWithinReach = 32.0, kSpotsWithinReachOfRung = 16.0;

// Far enough that so many spots are within; or that stars of the index must be, of which few lie in one place.
enum class Reach : unsigned char { any, near, far };

struct Stage {
  Reach reach;
  bool wide;
  int neighbours;  // of a spot, in neighbours of the index
  double least_sine;
  double share, ladder_share;  // of the work
};
constexpr Stage kStages[] = {{Reach::any, false, 1, 0.3, 0.02, 0.005},
                             {Reach::near, false, 8, 0.1, 0.33, 0.50},
                             {Reach::near, true, 8, 0.1, 0.33, 0.18},
                             {Reach::far, false, 8, 0.1, 0.33, 0.15}};

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

Identifier::Identifier(const StarField& field, const PairIndex& index, const Intrinsics& camera,
                       const IdentifySettings& settings, std::size_t max_spots)
    : field_(field),
      index_(index),
      believed_(camera),
      camera_(camera),
      settings_(settings),
      pixel_rad_(camera.plate_scale_rad_px()) {
  ASTRONAV_CHECK(camera.width_px > 0 && camera.height_px > 0 && camera.fx_px > 0.0);
  grid_width_ = camera.width_px / kTilePx + 1;
  grid_height_ = camera.height_px / kTilePx + 1;
  grid_.resize(static_cast<std::size_t>(grid_width_) * grid_height_);
  star_grid_.resize(grid_.size());
  star_next_.reserve(kMaxStarsJudged);
  spot_C_.reserve(max_spots);
  turned_.reserve(settings.parity == Parity::as_seen ? 0 : max_spots);
  next_.reserve(max_spots);
  on_star_.reserve(max_spots);
  asterism_.reserve(static_cast<std::size_t>(settings.asterism_spots));
  stars_.reserve(kMaxStarsJudged);
  cone_.resize(kMaxStarsInCone);
  cone_radius_rad_ = camera.half_diagonal_rad() * (1.0 + settings.focal_uncertainty) + kConeMarginRad;
  by_brightness_.reserve(kMaxStarsInCone);
  sights_.reserve(kMaxStarsJudged);
  sight_star_.reserve(kMaxStarsJudged);
  numbers_.reserve(kMaxStarsJudged);
  head_.resize(index.star_count());
  stamp_.assign(index.star_count(), 0);
  links_.reserve(kMaxLinks);
  candidates_.reserve(kMaxCandidates);
  rays_.reserve(kMaxRays);
  corners_.reserve(kMaxRays);
}

// What is no point, or cannot be seen through this lens, is put behind the camera, where no star is looked for.
void Identifier::load_spots(std::span<const Centroid> spots) {
  ASTRONAV_CHECK_OP(spots.size(), <=, spot_C_.capacity());
  spot_C_.clear();
  next_.clear();
  std::fill(grid_.begin(), grid_.end(), -1);
  for (std::size_t i = 0; i < spots.size(); ++i) {
    if (spots[i].kind != SpotKind::point) {
      spot_C_.push_back(-Vec3::UnitZ());
      next_.push_back(-1);
      continue;
    }
    const Result<Vec3> direction = unproject(camera_, spots[i].pixel);
    spot_C_.push_back(direction ? *direction : Vec3(-Vec3::UnitZ()));
    std::int32_t& head = grid_[static_cast<std::size_t>(tile(spots[i].pixel.v, grid_height_)) * grid_width_ +
                               tile(spots[i].pixel.u, grid_width_)];
    next_.push_back(head);
    head = static_cast<std::int32_t>(i);
  }
}

// By the rule that made the index: the brightest, but few in one place.
void Identifier::choose_asterism_spots(std::span<const Centroid> spots, std::size_t count, int most_neighbours) {
  asterism_.clear();
  const double near = std::cos(index_.radius_rad());
  for (std::size_t i = 0; i < spots.size() && asterism_.size() < count; ++i) {
    if (spot_C_[i].z() <= 0.0) continue;
    int neighbours = 0;
    for (const int j : asterism_) neighbours += spot_C_[i].dot(spot_C_[j]) > near;
    if (neighbours < most_neighbours) asterism_.push_back(static_cast<int>(i));
  }
}

// Of the corners of triangles, an axis: the root of the mean square.
double Identifier::typical_sigma_px(std::span<const Centroid> spots) const {
  double sum2 = 0.0;
  for (const int i : asterism_) sum2 += 0.5 * spots[i].covariance_px2.trace();
  return asterism_.empty() ? 0.0
                           : std::min(kMaxClaimedSigmaPx, std::sqrt(sum2 / static_cast<double>(asterism_.size())));
}

// Eq. 8a.
Identifier::Side Identifier::side(std::span<const Centroid> spots, int i, int j, const Search& how) const {
  const Vec3 &p = spot_C_[i], &q = spot_C_[j];
  const double angle = std::atan2(p.cross(q).norm(), p.dot(q));
  const double sigma_px = std::sqrt(0.5 * (spots[i].covariance_px2.trace() + spots[j].covariance_px2.trace()));
  const double noise_px = 3.0 * std::min(std::sqrt(2.0) * kMaxClaimedSigmaPx, sigma_px);
  const double tolerance = (how.pair_px + noise_px) * pixel_rad_ + how.scale * angle;
  return {angle, tolerance, std::cos(angle + tolerance), std::cos(std::max(angle - tolerance, 0.0))};
}

// Eq. 8b. Every pair that fits one side, both ways round, and for each the stars of the list that lie where the third
// corner b would be: within a parallelogram between the rings of ab and bc.
double Identifier::chance_triangles(std::size_t pairs, const Side& ab, const Side& bc, double sine_b) const {
  return 2.0 * static_cast<double>(pairs) * static_cast<double>(index_.star_count()) * 4.0 * ab.tolerance *
         bc.tolerance / (4.0 * kPi * std::max(sine_b, 0.05));
}

double Identifier::triangles(std::span<const Centroid> spots, const int (&corner)[3], const Search& how) {
  candidates_.clear();
  const Vec3 &a = spot_C_[corner[0]], &b = spot_C_[corner[1]], &c = spot_C_[corner[2]];
  const Side ab = side(spots, corner[0], corner[1], how), ac = side(spots, corner[0], corner[2], how),
             bc = side(spots, corner[1], corner[2], how);
  if (std::max({ab.angle, ac.angle, bc.angle}) > index_.max_angle_rad()) return 0.0;
  if (widest_sine(a, b, c) < how.least_sine) return 0.0;
  const bool right_handed = handedness(a, b, c) > 0.0;

  // Chain up the partners of every star for side ac, then walk side ab.
  const std::span<const PairIndex::Pair> pairs_ac = index_.pairs(ac.cos_min, ac.cos_max);
  if (2 * pairs_ac.size() > kMaxLinks) return 0.0;
  links_.clear();
  ++now_;
  const auto link = [&](std::uint16_t from, std::uint16_t to) {
    if (stamp_[from] != now_) {
      stamp_[from] = now_;
      head_[from] = -1;
    }
    links_.push_back({to, 0, head_[from]});
    head_[from] = static_cast<std::int32_t>(links_.size()) - 1;
  };
  for (const PairIndex::Pair& pair : pairs_ac) {
    link(pair.a, pair.b);
    link(pair.b, pair.a);
  }
  const auto walk = [&](std::uint16_t star_a, std::uint16_t star_b) {
    if (stamp_[star_a] != now_) return;
    const Vec3 da = index_.direction(star_a), db = index_.direction(star_b);
    const double cos_ab = da.dot(db);
    if (cos_ab < ab.cos_min || cos_ab > ab.cos_max) return;
    for (std::int32_t i = head_[star_a]; i >= 0; i = links_[i].next) {
      const std::uint16_t star_c = links_[i].partner;
      const Vec3 dc = index_.direction(star_c);
      const double cos_bc = db.dot(dc), cos_ac = da.dot(dc);
      if (cos_bc < bc.cos_min || cos_bc > bc.cos_max || cos_ac < ac.cos_min || cos_ac > ac.cos_max) continue;
      if ((handedness(da, db, dc) > 0.0) != right_handed) continue;
      if (candidates_.size() < kMaxCandidates) candidates_.push_back({star_a, star_b, star_c});
    }
  };
  const std::span<const PairIndex::Pair> pairs_ab = index_.pairs(ab.cos_min, ab.cos_max);
  looked_at_ += static_cast<std::int64_t>(pairs_ab.size() + pairs_ac.size());
  for (const PairIndex::Pair& pair : pairs_ab) {
    walk(pair.a, pair.b);
    walk(pair.b, pair.a);
  }
  return chance_triangles(pairs_ac.size(), ab, bc, (a - b).normalized().cross((c - b).normalized()).norm());
}

// Do further bright spots fall on stars? Aberration is the same for near-by stars and already in the attitude.
bool Identifier::confirmed(const Mat3& R_CN, const int (&corner)[3], double radius_px) const {
  const double radius = radius_px * pixel_rad_;
  const int last = std::min<int>(kConfirmSpots, static_cast<int>(spot_C_.size()));
  const int tried = last - (corner[0] < last) - (corner[1] < last) - (corner[2] < last);
  // One in twenty, and one more: twice what chance brings where stars are dense (60 stars in 1000 nets of 4 px).
  const int needed = 1 + tried / 20;
  int hits = 0;
  for (int i = 0; i < last && hits < needed && hits + last - i >= needed; ++i) {
    if (i == corner[0] || i == corner[1] || i == corner[2] || !(spot_C_[i].z() > 0.0)) continue;
    hits += field_.nearest(R_CN.transpose() * spot_C_[i], radius) >= 0;
  }
  return hits >= needed;
}

bool Identifier::try_candidate(std::span<const Centroid> spots, const Observer& observer, const Search& how,
                               const Candidate& candidate, const int (&corner)[3], Identification& out,
                               std::span<MatchedStar> matches) {
  const Vec3 seen[3] = {spot_C_[corner[0]], spot_C_[corner[1]], spot_C_[corner[2]]};
  // Confirmed at rest, judged as seen from the moving observer.
  Vec3 known[3] = {index_.direction(candidate.a), index_.direction(candidate.b), index_.direction(candidate.c)};
  const Result<Mat3> at_rest = attitude_from_directions(seen, known);
  if (!at_rest || !confirmed(*at_rest, corner, how.first_match_px)) return false;
  if (++out.hypotheses > settings_.max_hypotheses) return false;
  for (Vec3& direction : known) direction = aberrate(direction.normalized(), observer.v_O_N);
  const Result<Mat3> first = attitude_from_directions(seen, known);
  if (!first) return false;
  const Claim claim{*first,    how.first_match_px,    3,
                    expected_, settings_.min_matched, settings_.focal_uncertainty > settings_.scale_tolerance};
  return judge(spots, observer, claim, out, matches);
}

bool Identifier::search(std::span<const Centroid> spots, const Observer& observer, const Search& how,
                        Identification& out, std::span<MatchedStar> matches) {
  const int corners = static_cast<int>(asterism_.size());
  const std::int64_t last = looked_at_ + how.pairs;
  for (int dj = 1; dj <= corners - 2; ++dj) {
    for (int dk = 1; dk <= corners - dj - 1; ++dk) {
      for (int i = 0; i < corners - dj - dk; ++i) {
        if (looked_at_ > last) return false;
        const int corner[3] = {asterism_[i], asterism_[i + dj], asterism_[i + dj + dk]};
        ++out.triples;
        expected_ += triangles(spots, corner, how);
        for (const Candidate& candidate : candidates_) {
          if (try_candidate(spots, observer, how, candidate, corner, out, matches)) return true;
          if (out.hypotheses > settings_.max_hypotheses) return false;
        }
      }
    }
  }
  return false;
}

// The pairs that fit a ray are linked up by the star that would be the middle; where a star has links of two rays, and
// the third side fits, there is a triangle. n rays cost n looks into the index, and the n (n - 1) / 2 triples nothing;
// short sides have fewer pairs than long ones. Every triple is looked at once, from its brightest spot, and counted as
// it would be alone.
bool Identifier::search_near(std::span<const Centroid> spots, const Observer& observer, const Search& how,
                             Identification& out, std::span<MatchedStar> matches) {
  const std::int64_t last = looked_at_ + how.pairs;
  for (std::size_t m = 0; m + 2 < asterism_.size(); ++m) {
    const int middle = asterism_[m];
    const Vec3& a = spot_C_[middle];
    rays_.clear();
    links_.clear();
    ++now_;
    for (std::size_t n = m + 1; n < asterism_.size() && rays_.size() < kMaxRays; ++n) {
      const int spot = asterism_[n];
      const Vec3& c = spot_C_[spot];
      if (a.dot(c) < how.reach) continue;
      if (looked_at_ > last) return false;
      Ray ray{spot, side(spots, middle, spot, how), {}};
      if (ray.side.angle > index_.max_angle_rad()) continue;
      ray.pairs = index_.pairs(ray.side.cos_min, ray.side.cos_max);
      if (links_.size() + 2 * ray.pairs.size() > kMaxLinks) continue;
      looked_at_ += static_cast<std::int64_t>(ray.pairs.size());
      corners_.clear();
      for (const Ray& other : rays_) {
        const Vec3& b = spot_C_[other.spot];
        Corner corner{side(spots, other.spot, spot, how), handedness(a, b, c) > 0.0, false};
        corner.wanted = corner.side.angle <= index_.max_angle_rad() && widest_sine(a, b, c) >= how.least_sine;
        corners_.push_back(corner);
        if (!corner.wanted) continue;
        ++out.triples;
        expected_ += chance_triangles(ray.pairs.size(), other.side, corner.side,
                                      (a - b).normalized().cross((c - b).normalized()).norm());
      }
      const auto ray_number = static_cast<std::uint16_t>(rays_.size());
      const auto link = [&](std::uint16_t from, std::uint16_t to) {
        if (stamp_[from] != now_) {
          stamp_[from] = now_;
          head_[from] = -1;
        }
        for (std::int32_t i = head_[from]; i >= 0; i = links_[i].next) {
          ++looked_at_;
          if (links_[i].ray == ray_number) continue;
          const Corner& corner = corners_[links_[i].ray];
          if (!corner.wanted) continue;
          const Vec3 db = index_.direction(links_[i].partner), dc = index_.direction(to);
          if (!corner.side.holds(db.dot(dc))) continue;
          const Vec3 da = index_.direction(from);
          if (!rays_[links_[i].ray].side.holds(da.dot(db)) || !ray.side.holds(da.dot(dc))) continue;
          if ((handedness(da, db, dc) > 0.0) != corner.right_handed) continue;
          looked_at_ += kWorkOfATry;
          const int at[3] = {middle, rays_[links_[i].ray].spot, spot};
          if (try_candidate(spots, observer, how, {from, links_[i].partner, to}, at, out, matches)) return true;
          if (out.hypotheses > settings_.max_hypotheses) return false;
        }
        links_.push_back({to, ray_number, head_[from]});
        head_[from] = static_cast<std::int32_t>(links_.size()) - 1;
        return false;
      };
      for (const PairIndex::Pair& pair : ray.pairs) {
        if (link(pair.a, pair.b) || link(pair.b, pair.a)) return true;
        if (out.hypotheses > settings_.max_hypotheses) return false;
      }
      rays_.push_back(ray);
    }
  }
  return false;
}

Result<Identification> Identifier::lost_in_space(std::span<const Centroid> spots, const Observer& observer,
                                                 std::span<MatchedStar> matches) {
  Identification out;
  attention_ = nullptr;
  expected_ = 0.0;
  looked_at_ = 0;
  turned_.clear();
  if (settings_.parity != Parity::as_seen) {
    turned_.assign(spots.begin(), spots.end());
    for (Centroid& spot : turned_) {
      spot.pixel.u = believed_.width_px - 1 - spot.pixel.u;
      spot.covariance_px2(0, 1) = spot.covariance_px2(1, 0) = -spot.covariance_px2(0, 1);
    }
  }
  // Rungs of the ladder of focal lengths overlap: the believed one, then ever farther off to both sides.
  const bool ladder = settings_.focal_uncertainty > settings_.scale_tolerance;
  const int rungs =
      ladder ? 1 + 2 * static_cast<int>(std::ceil(settings_.focal_uncertainty / (2.0 * settings_.scale_tolerance))) : 1;
  for (const Stage& stage : kStages) {
    const double work = (ladder ? stage.ladder_share : stage.share) * static_cast<double>(settings_.max_pairs);
    for (int rung = 0; rung < rungs; ++rung) {
      const double off = (rung % 2 == 0 ? 1.0 : -1.0) * ((rung + 1) / 2) * 2.0 * settings_.scale_tolerance;
      camera_ = believed_;
      camera_.fx_px *= 1.0 + off;
      camera_.fy_px *= 1.0 + off;
      pixel_rad_ = camera_.plate_scale_rad_px();
      for (const bool mirrored : {false, true}) {
        if (mirrored ? settings_.parity == Parity::as_seen : settings_.parity == Parity::mirrored) continue;
        mirrored_ = mirrored;
        const std::span<const Centroid> shown = mirrored ? std::span<const Centroid>(turned_) : spots;
        load_spots(shown);
        choose_asterism_spots(
            shown,
            static_cast<std::size_t>(stage.reach == Reach::any ? settings_.first_spots : settings_.asterism_spots),
            stage.neighbours * index_.neighbours());
        const double noise = 3.0 * std::sqrt(2.0) * typical_sigma_px(shown);
        Search how;
        how.pair_px = settings_.pair_tolerance_px * (stage.wide ? 2.0 : 0.17);
        how.scale = settings_.scale_tolerance * (stage.wide || ladder ? 1.0 : 0.12);
        how.first_match_px = settings_.first_match_px + noise;
        how.least_sine = stage.least_sine;
        how.pairs = static_cast<std::int64_t>(stage.reach == Reach::any ? work : work / rungs);
        if (stage.reach != Reach::any) {
          const double share =
              (ladder ? kSpotsWithinReachOfRung : kSpotsWithinReach) / static_cast<double>(asterism_.size() + 1);
          const double field = camera_.field_of_view_horizontal_rad() * camera_.field_of_view_vertical_rad();
          const double near = std::sqrt(share * field / kPi), far = std::max(2.0 * index_.radius_rad(), 1.5 * near);
          how.reach = std::cos(std::min(index_.max_angle_rad(), stage.reach == Reach::far ? far : near));
        }
        if (stage.reach == Reach::any ? search(shown, observer, how, out, matches)
                                      : search_near(shown, observer, how, out, matches)) {
          out.attitude.mirrored = mirrored;
          return out;
        }
        if (out.hypotheses > settings_.max_hypotheses)
          return fail(ErrorCode::no_match, "{0} hypotheses, none of which all stars agree with",
                      {static_cast<double>(settings_.max_hypotheses)});
      }
    }
  }
  return fail(ErrorCode::no_match, "{0} spots: no triangle of them is in the catalogue",
              {static_cast<double>(spots.size())});
}

Result<Identification> Identifier::track(std::span<const Centroid> spots, const Observer& observer,
                                         const Mat3& prior_R_CN, double radius_px, std::span<MatchedStar> matches) {
  attention_ = nullptr;
  return follow(spots, observer, {prior_R_CN, radius_px, 2, 1.0, settings_.min_tracked, false, false}, matches);
}

Result<Identification> Identifier::track_within(std::span<const Centroid> spots, const Attention& attention,
                                                const Mat3& prior_R_CN, double radius_px,
                                                std::span<MatchedStar> matches) {
  attention_ = &attention;
  return follow(spots, {}, {prior_R_CN, radius_px, 2, 1.0, settings_.min_tracked, false, true}, matches);
}

Result<Identification> Identifier::follow(std::span<const Centroid> spots, const Observer& observer, const Claim& claim,
                                          std::span<MatchedStar> matches) {
  Identification out;
  camera_ = believed_;
  pixel_rad_ = camera_.plate_scale_rad_px();
  mirrored_ = false;
  load_spots(spots);
  out.hypotheses = 1;
  if (judge(spots, observer, claim, out, matches)) return out;
  return fail(ErrorCode::no_match, "the stars are not where the prior attitude puts them");
}

void Identifier::gather(const Observer& observer, const Mat3& prior_R_CN, std::size_t most) {
  // More than half of the cone about the frame is the frame.
  gather_stars(prior_R_CN, observer, 2 * most, cone_radius_rad_ * believed_.fx_px);
}

std::size_t Identifier::place(const Mat3& R_CN, std::span<Pixel> out) const {
  std::size_t count = 0;
  for (const Star& star : stars_) {
    if (count == out.size()) break;
    const Result<Pixel> pixel = project(believed_, R_CN * star.direction_N);
    if (pixel && believed_.contains(*pixel)) out[count++] = *pixel;
  }
  return count;
}

}  // namespace astronav::vision
