// SPDX-License-Identifier: Apache-2.0
#include "verification/opensky/blind.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>

#include <Eigen/Geometry>

#include "foundation/base/clock.h"
#include "verification/opensky/spots.h"

namespace astronav::opensky {
namespace {

// Lists of stars are served in steps of the field of view: one that suits a field suits its neighbours.
constexpr double kListStep = 1.25;
// Of the shorter side of the field: how densely stars and spots are taken for shapes, and how large those are.
constexpr double kSpread = 0.3;
constexpr int kInSpread = 4;
constexpr double kReach = 0.5;
constexpr int kNeighbours = 7;
constexpr double kLeastSize = 0.1, kLargestSize = 0.8;

constexpr double kRung = 1.45;  // widest field of a step over the narrowest
constexpr double kWideField = 14.0 * kDegree;
constexpr std::size_t kConfirmSpots = 16;
constexpr double kConfirmChance = 0.02;

// Most cameras first, then outwards.
std::vector<FieldRange> ladder(const FieldRange& range) {
  const double middle = std::clamp(10.8 * kDegree, range.min_rad, range.max_rad);
  const int steps =
      std::max(1, static_cast<int>(std::ceil(std::log(range.max_rad / range.min_rad) / std::log(kRung) - 1e-9)));
  const double ratio = std::pow(range.max_rad / range.min_rad, 1.0 / steps);
  std::vector<FieldRange> rungs;
  for (int k = 0; k < steps; ++k)
    rungs.push_back({range.min_rad * std::pow(ratio, k), range.min_rad * std::pow(ratio, k + 1)});
  const auto away = [&](const FieldRange& r) { return std::abs(std::log(std::sqrt(r.min_rad * r.max_rad) / middle)); };
  std::sort(rungs.begin(), rungs.end(), [&](const auto& a, const auto& b) { return away(a) < away(b); });
  return rungs;
}

std::vector<std::size_t> spread_spots(std::span<const vision::Centroid> spots, double radius_px, std::size_t most) {
  std::vector<std::size_t> chosen;
  for (std::size_t i = 0; i < spots.size() && chosen.size() < most; ++i) {
    int neighbours = 0;
    for (const std::size_t j : chosen) neighbours += (spots[i].pixel.vec() - spots[j].pixel.vec()).norm() < radius_px;
    if (neighbours < kInSpread) chosen.push_back(i);
  }
  return chosen;
}

}  // namespace

Mat3 pair_axes(const Vec3& p, const Vec3& q) {
  Mat3 axes;
  axes.col(0) = (p + q).normalized();
  axes.col(2) = (p - q).normalized();
  axes.col(1) = axes.col(0).cross(axes.col(2));
  return axes;
}

// One picture and all that is tried on it.
class BlindSearch::Attempt {
 public:
  Attempt(const vision::StarField& field, std::span<const vision::Centroid> spots, int width, int height,
          const vision::Observer& observer, const BlindSettings& settings, std::size_t shape_spots, double tried)
      : field_(field), observer_(observer), settings_(settings), shorter_px_(std::min(width, height)), tried_(tried) {
    for (std::vector<vision::Centroid>& side : spots_) side.assign(spots.begin(), spots.end());
    turn_round(spots_[1], width);
    chosen_ = spread_spots(spots, kSpread * shorter_px_, shape_spots);

    // A blurred spot's centre is no better than a part of its width.
    std::vector<int> sizes;
    for (const std::size_t k : chosen_) sizes.push_back(spots[k].pixels);
    const auto middle = sizes.begin() + static_cast<std::ptrdiff_t>(sizes.size() / 2);
    std::nth_element(sizes.begin(), middle, sizes.end());
    const double blur_px = std::sqrt(static_cast<double>(*middle));

    identify_.match_px = std::max(settings.match_px, 0.2 * blur_px);
    identify_.rough_stars = 25;
    identify_.brightness_gate_mag = 3.0;  // film curves, compression, colour
    identify_.psf_sigma_px = 1.0;
    identify_.attitude.extra_sigma_px = std::max(0.25, 0.05 * blur_px);
    identify_.attitude.gate_sigma = 6.0;
    if (settings.camera) {
      camera_ = *settings.camera;
      identify_.attitude.freedom.focal_length = !settings.focal_is_known;
    } else {
      camera_.width_px = width;
      camera_.height_px = height;
      camera_.cx_px = 0.5 * (width - 1);
      camera_.cy_px = 0.5 * (height - 1);
      identify_.attitude.freedom = {.focal_length = true, .k1 = true, .tangential = false};
    }
    plain_ = camera_.model == ProjectionModel::pinhole && camera_.distortion.k1 == 0.0 &&
             camera_.distortion.p1 == 0.0 && camera_.distortion.p2 == 0.0;
  }

  double tried() const { return tried_; }

  // One step of the ladder.
  bool climb(const FieldRange& range, const Shapes& shapes, BlindSolution& out) {
    shapes_ = &shapes;
    const double half_width = 0.5 * camera_.width_px;
    focal_min_ = half_width / std::tan(0.5 * range.max_rad);
    focal_max_ = half_width / std::tan(0.5 * range.min_rad);
    range_ = range;
    // A wrong focal length and a lens that bends lines change shapes by about this share of the squared field angle.
    const double corner = camera_.half_diagonal_px() / focal_min_;
    const double corner2 = corner * corner;
    tolerance_ = std::min(0.004 + (settings_.camera ? 0.0 : 0.12 * corner2), 0.025);
    net_px_ = camera_.width_px * std::clamp(0.005 + 0.1 * corner2, 0.005, 0.015);
    needed_ = hits_needed();
    const double spread = std::log(focal_max_ / focal_min_);
    const int focals = std::max(1, static_cast<int>(std::ceil(0.5 * spread * corner2 / 0.01)));
    for (int k = 0; k < focals; ++k) {
      if (look(focal_min_ * std::exp(spread * (k + 0.5) / focals), out)) return true;
    }
    return false;
  }

 private:
  // Direction of a spot (C) under a focal length, in the picture as it is or turned round.
  Vec3 direction(std::size_t spot, bool mirrored, double focal_px) const {
    const Pixel& p = spots_[mirrored][spot].pixel;
    if (plain_) return Vec3((p.u - camera_.cx_px) / focal_px, (p.v - camera_.cy_px) / focal_px, 1.0).normalized();
    const auto seen = unproject(with_focal(focal_px), p);
    return seen ? *seen : Vec3(0.0, 0.0, -1.0);
  }

  Intrinsics with_focal(double focal_px) const {
    Intrinsics camera = camera_;
    camera.fx_px = focal_px;
    camera.fy_px = settings_.camera ? focal_px * camera_.fy_px / camera_.fx_px : focal_px;
    return camera;
  }

  // So many other spots must fall on stars that chance would do it in one of fifty hypotheses.
  int hits_needed() const {
    const double per_field =
        kInSpread / (kPi * kSpread * kSpread);  // stars of the list, in the square of the shorter side
    const double p = per_field * kPi * net_px_ * net_px_ / (shorter_px_ * shorter_px_);
    const int others = static_cast<int>(std::min(kConfirmSpots, chosen_.size() - 4));
    int hits = 1;
    while (hits < others && vision::chance_of_matches(others, hits, p) > kConfirmChance) ++hits;
    return hits;
  }

  bool look(double focal_px, BlindSolution& out) {
    const std::size_t n = chosen_.size();
    std::vector<Vec3> seen;
    for (const std::size_t spot : chosen_) seen.push_back(direction(spot, false, focal_px));
    const double least = std::pow(kLeastSize * shorter_px_ / focal_px, 2);
    const double largest = std::pow(kLargestSize * shorter_px_ / focal_px, 2);
    // What a pair brings to every shape whose longest side it is.
    std::vector<double> d2(n * n);
    std::vector<QuadAxes> axes(n * n);
    for (std::size_t i = 0; i < n; ++i) {
      for (std::size_t j = 0; j < n; ++j) {
        d2[i * n + j] = (seen[i] - seen[j]).squaredNorm();
        if (j < i) axes[i * n + j] = QuadAxes(seen[j], seen[i]);
      }
    }
    // In the order of the least certain of the four.
    for (std::size_t l = 3; l < n; ++l) {
      for (std::size_t k = 2; k < l; ++k) {
        if (d2[l * n + k] > largest) continue;
        for (std::size_t j = 1; j < k; ++j) {
          if (d2[l * n + j] > largest || d2[k * n + j] > largest) continue;
          for (std::size_t i = 0; i < j; ++i) {
            const std::array<std::size_t, 4> of{i, j, k, l};
            std::size_t split = 0;
            double longest = -1.0;
            for (std::size_t s = 0; s < kQuadSplits.size(); ++s) {
              const double length = d2[of[kQuadSplits[s][1]] * n + of[kQuadSplits[s][0]]];
              if (length <= longest) continue;
              longest = length;
              split = s;
            }
            if (longest > largest || longest < least) continue;
            const auto& corners = kQuadSplits[split];
            const QuadShape shape = quad_shape(axes[of[corners[1]] * n + of[corners[0]]], corners, seen[of[corners[2]]],
                                               seen[of[corners[3]]]);
            const auto tolerance = static_cast<float>(tolerance_ + 1.0 / (shape.size_rad * focal_px));
            bool found = false;
            for (const bool mirrored : {false, true}) {
              shapes_->quads.look_up(mirrored ? shape.mirrored() : shape, tolerance, [&](const QuadIndex::Quad& quad) {
                found = found || try_quad(of, shape, quad, mirrored, focal_px, out);
              });
              if (found) return true;
            }
          }
        }
      }
    }
    return false;
  }

  bool try_quad(const std::array<std::size_t, 4>& of, const QuadShape& shape, const QuadIndex::Quad& quad,
                bool mirrored, double focal_px, BlindSolution& out) {
    const auto star = [&](std::size_t corner) -> const Vec3& {
      return shapes_->stars.stars()[quad.stars[corner]].direction_N;
    };
    const double focal = focal_px * shape.size_rad / (star(0) - star(1)).norm();
    if (focal < 0.97 * focal_min_ || focal > 1.03 * focal_max_) return false;
    const Mat3 axes_N = pair_axes(star(0), star(1));
    const Mat3 axes_C = pair_axes(direction(chosen_[of[shape.corners[0]]], mirrored, focal),
                                  direction(chosen_[of[shape.corners[1]]], mirrored, focal));
    const Mat3 R_CN = axes_C * axes_N.transpose();
    if (settings_.near && R_CN.row(2).dot(settings_.near->direction_N) <
                              std::cos(std::min(kPi, settings_.near->radius_rad + range_.max_rad)))
      return false;
    ++tried_;
    int hits = 0, left = static_cast<int>(std::min(kConfirmSpots, chosen_.size() - 4));
    for (std::size_t m = 0; m < chosen_.size() && left > 0; ++m) {
      if (std::find(of.begin(), of.end(), m) != of.end()) continue;
      --left;
      const Vec3 there_N = R_CN.transpose() * direction(chosen_[m], mirrored, focal);
      hits += shapes_->stars.nearest(there_N, net_px_ / focal) >= 0;
      if (hits >= needed_) return judge(R_CN, focal, mirrored, out);
      if (hits + left < needed_) return false;
    }
    return false;
  }

  // That so many spots fall on stars by chance in any of the hypotheses tried (docs/theory/vision.md eq. 9). The four
  // that made the hypothesis prove nothing. Four lengths of the list of spots and three nets are tried, and paid for.
  double chance(const vision::Identification& known, std::span<const vision::MatchedStar> stars, std::size_t spots,
                double match_px) const {
    const Intrinsics& camera = known.attitude.intrinsics;
    std::vector<std::uint32_t> near(field_.stars().size());
    near.resize(field_.cone(known.attitude.R_CN.row(2).transpose(), camera.half_diagonal_rad(), near));
    // As many as the Identifier looks at.
    const auto brightest = near.begin() + static_cast<std::ptrdiff_t>(std::min(near.size(), spots + spots / 2 + 30));
    std::partial_sort(near.begin(), brightest, near.end(), [&](std::uint32_t a, std::uint32_t b) {
      return field_.stars()[a].v_mag < field_.stars()[b].v_mag;
    });
    const auto visible = std::count_if(near.begin(), brightest, [&](std::uint32_t i) {
      const auto p = project(camera, known.attitude.R_CN * field_.stars()[i].direction_N);
      return p && camera.contains(*p);
    });
    const double area = static_cast<double>(camera.width_px) * camera.height_px;
    // The fit has drawn the matches nearer to their stars, by as many degrees of freedom as it has spent.
    const double used = static_cast<double>(known.matched);
    const double drawn = 2.0 * used / std::max(1.0, 2.0 * used - 5.0);
    double least = 1.0;
    int tried = 0;
    for (const std::size_t first : {std::size_t{15}, std::size_t{30}, std::size_t{60}, spots}) {
      for (const double share : {1.0, 0.5, 0.25}) {
        ++tried;
        const double radius = share * match_px;
        const auto hits = std::count_if(
            stars.begin(), stars.begin() + static_cast<std::ptrdiff_t>(known.matched),
            [&](const vision::MatchedStar& m) { return m.centroid < first && m.residual_px.norm() < radius; });
        const double p = std::min(0.9, static_cast<double>(visible) * kPi * radius * radius * drawn / area);
        const auto looked_at = static_cast<int>(std::min(first, spots));
        least = std::min(least, vision::chance_of_matches(looked_at - 4, static_cast<int>(hits) - 4, p));
      }
    }
    return std::min(1.0, tried * tried_ * least);
  }

  // By all stars.
  bool judge(const Mat3& R_CN, double focal_px, bool mirrored, BlindSolution& out) {
    const std::span<const vision::Centroid> spots(spots_[mirrored]);
    const auto judged = spots.first(std::min(spots.size(), settings_.judged_spots));
    Intrinsics camera = camera_;
    if (!settings_.camera || !settings_.focal_is_known) camera = with_focal(focal_px);
    vision::IdentifySettings identify = identify_;
    identify.first_match_px = net_px_ * 1.2;
    identify.max_chance = settings_.max_chance;
    out.stars.resize(spots.size());
    vision::Identifier identifier(field_, no_pairs_, camera, identify, spots.size());
    auto known = identifier.track(judged, observer_, R_CN, identify.first_match_px, out.stars);
    if (!known) return false;
    const double fov = known->attitude.intrinsics.field_of_view_horizontal_rad();
    if (fov < 0.97 * range_.min_rad || fov > 1.03 * range_.max_rad) return false;
    const Vec3 boresight = known->attitude.R_CN.row(2).transpose();
    if (settings_.near && boresight.dot(settings_.near->direction_N) < std::cos(settings_.near->radius_rad))
      return false;
    const double by_chance = chance(*known, out.stars, judged.size(), identify.match_px);
    if (by_chance > settings_.max_chance) return false;
    refine(spots, judged, identify, *known, out);
    out.extra_sigma_px = identify.attitude.extra_sigma_px;
    known->attitude.chance_probability = by_chance;
    out.identification = *known;
    out.mirrored = mirrored;
    out.stars.resize(known->matched);
    return true;
  }

  // Wider nets, cast from the camera that the first stars have shown, bring in the corners and the faint.
  void refine(std::span<const vision::Centroid> spots, std::span<const vision::Centroid> judged,
              const vision::IdentifySettings& identify, vision::Identification& known, BlindSolution& out) {
    // A narrow field has no corners that a lens could have bent away.
    const std::initializer_list<double> wide{1.5, 4.0, 8.0, 4.0, 2.0}, narrow{1.0, 2.0, 1.0};
    for (const double net : range_.max_rad > kWideField ? wide : narrow) {
      vision::IdentifySettings finer = identify;
      finer.attitude.freedom.tangential = !settings_.camera;
      vision::Identifier again(field_, no_pairs_, known.attitude.intrinsics, finer, spots.size());
      std::vector<vision::MatchedStar> more(spots.size());
      const auto better =
          again.track(net > 2.0 ? judged : spots, observer_, known.attitude.R_CN, net * identify.match_px, more);
      if (!better || better->matched <= known.matched) continue;
      known = *better;
      out.stars = std::move(more);
    }
  }

  const vision::StarField& field_;
  const vision::Observer& observer_;
  const BlindSettings& settings_;
  const double shorter_px_;
  std::array<std::vector<vision::Centroid>, 2> spots_;  // as in the picture, and turned round
  std::vector<std::size_t> chosen_;
  vision::PairIndex no_pairs_;
  vision::IdentifySettings identify_;
  Intrinsics camera_;
  bool plain_ = true;  // no distortion

  const Shapes* shapes_ = nullptr;
  FieldRange range_;
  double focal_min_ = 0.0, focal_max_ = 0.0;
  double tolerance_ = 0.0;  // of shapes
  double net_px_ = 0.0;     // star to spot, for a fresh hypothesis
  int needed_ = 0;
  double tried_;  // hypotheses, those of attempts before among them
};

BlindSearch::BlindSearch(const vision::StarField& field) : field_(field), by_brightness_(field.stars().size()) {
  std::iota(by_brightness_.begin(), by_brightness_.end(), 0u);
  std::sort(by_brightness_.begin(), by_brightness_.end(), [&](std::uint32_t a, std::uint32_t b) {
    const float x = field.stars()[a].v_mag, y = field.stars()[b].v_mag;
    return x != y ? x < y : a < b;
  });
}

const BlindSearch::Shapes& BlindSearch::shapes(double shorter_fov_rad) {
  const int key = static_cast<int>(std::lround(std::log(shorter_fov_rad / kDegree) / std::log(kListStep)));
  std::unique_ptr<Shapes>& slot = made_[key];
  if (slot) return *slot;
  const double begin = now_ms();
  const double fov = std::pow(kListStep, key) * kDegree;
  // Where stars are sparse the list goes deeper; six times as many as it will hold are deep enough.
  const double wanted = 4.0 * kPi * kInSpread / (kPi * kSpread * kSpread * fov * fov);
  slot = std::make_unique<Shapes>();
  slot->stars = field_.subset(
      even_stars(field_, by_brightness_, kSpread * fov, kInSpread, static_cast<std::size_t>(6.0 * wanted)));
  slot->quads = QuadIndex(slot->stars, {.radius_rad = kReach * fov, .neighbours = kNeighbours});
  lists_ms_ += now_ms() - begin;
  return *slot;
}

Result<BlindSolution> BlindSearch::search(std::span<const vision::Centroid> spots, int width, int height,
                                          const FieldRange& range, const vision::Observer& observer,
                                          const BlindSettings& settings) {
  if (spots.size() < 5)
    return fail(ErrorCode::no_match, "{0} spots of light are too few", {static_cast<double>(spots.size())});
  BlindSolution out;
  lists_ms_ = 0.0;
  // Few spots first; many where most of those are no stars.
  double tried = 0.0;
  // Where stars are missing another list than that of the field has the four that are left: a ladder passes by those of
  // its neighbours, and a field that is known does not.
  const std::vector<FieldRange> rungs = ladder(range);
  const std::initializer_list<double> one{1.0}, some{1.0, 0.8, 1.25, 0.64};
  for (const std::size_t shape_spots : {settings.spots, settings.spots * 3 / 2}) {
    Attempt attempt(field_, spots, width, height, observer, settings, shape_spots, tried);
    for (const double other : rungs.size() > 2 ? one : some) {
      for (const FieldRange& rung : rungs) {
        const double middle = std::sqrt(rung.min_rad * rung.max_rad);
        const double shorter_fov = 2.0 * std::atan(std::tan(0.5 * middle) * std::min(width, height) / width);
        const bool found = attempt.climb(rung, shapes(other * shorter_fov), out);
        out.lists_ms = lists_ms_;
        if (found) return out;
      }
    }
    if (spots.size() <= settings.spots) break;
    tried = attempt.tried();
  }
  return fail(ErrorCode::no_match, "{0} spots, and no part of the sky that they fit",
              {static_cast<double>(spots.size())});
}

}  // namespace astronav::opensky
