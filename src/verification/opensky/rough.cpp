// SPDX-License-Identifier: Apache-2.0
#include "verification/opensky/rough.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <optional>

#include "foundation/math/rotation.h"
#include "verification/opensky/spots.h"

namespace astronav::opensky {
namespace {

// Lists that are tried: so many of the surest spots against all that is brighter than this.
struct List {
  std::size_t spots;
  double v_mag;
};
constexpr std::array<List, 6> kLists{{{8, 4.5}, {16, 4.5}, {8, 5.5}, {16, 5.5}, {8, 6.5}, {16, 6.5}}};
constexpr double kLeastPairPx = 60.0;  // closer ones do not fix the roll
constexpr double kBrightnessMag = 1.5;

struct Target {
  Vec3 direction_N;
  double v_mag;
  std::optional<std::size_t> star;  // into the sky; a planet has none
};
struct Hit {
  std::size_t target, spot;
};

// P(at least `hits` of n), each with probability p.
double binomial_tail(int n, int hits, double p) {
  double tail = 0.0;
  for (int k = hits; k <= n; ++k)
    tail += std::exp(std::lgamma(n + 1.0) - std::lgamma(k + 1.0) - std::lgamma(n - k + 1.0) + k * std::log(p) +
                     (n - k) * std::log1p(-p));
  return std::min(tail, 1.0);
}

// What a full well cannot hold makes a spot too faint, never too bright.
bool brightness_agrees(const Target& a, const vision::Centroid& x, const Target& b, const vision::Centroid& y) {
  const double too_bright = -2.5 * std::log10(x.flux_dn / y.flux_dn) - (a.v_mag - b.v_mag);  // x, against y: negative
  return (too_bright > -kBrightnessMag || y.saturated) && (too_bright < kBrightnessMag || x.saturated);
}

class Search {
 public:
  Search(std::span<const vision::Centroid> spots, const Intrinsics& camera, const RoughSettings& settings)
      : spots_(spots), camera_(camera), settings_(settings) {
    for (const vision::Centroid& spot : spots.first(std::min(spots.size(), kMostSpots))) {
      const auto seen = unproject(camera, spot.pixel);
      seen_.push_back(seen ? *seen : Vec3(0.0, 0.0, -1.0));
    }
  }

  struct Pair {
    double angle_rad;
    std::size_t a, b;
  };
  // Targets brightest first. The best of all pairs, and its chance, pairs and lists counted.
  double run(std::span<const Target> all, const Near& near, Mat3& R_CN) {
    double best = 1.0;
    std::vector<Pair> pairs;
    for (std::size_t a = 0; a < all.size(); ++a)
      for (std::size_t b = a + 1; b < all.size(); ++b)
        pairs.push_back({angle_between(all[a].direction_N, all[b].direction_N), a, b});
    std::sort(pairs.begin(), pairs.end(), [](const Pair& x, const Pair& y) { return x.angle_rad < y.angle_rad; });
    const double tolerance = 1.5 * settings_.net_px * camera_.plate_scale_rad_px();
    for (const List& list : kLists) {
      const auto end = std::find_if(all.begin(), all.end(), [&](const Target& t) { return t.v_mag > list.v_mag; });
      const std::span<const Target> targets(all.begin(), end);
      const std::size_t spots = std::min(list.spots, seen_.size());
      double tried = 0.0, least = 1.0;
      Mat3 found = Mat3::Identity();
      for (std::size_t i = 0; i < spots; ++i) {
        for (std::size_t j = 0; j < spots; ++j) {
          if (i == j || (spots_[i].pixel.vec() - spots_[j].pixel.vec()).norm() < kLeastPairPx) continue;
          const double angle = angle_between(seen_[i], seen_[j]);
          auto pair = std::lower_bound(pairs.begin(), pairs.end(), angle - tolerance,
                                       [](const Pair& p, double x) { return p.angle_rad < x; });
          for (; pair != pairs.end() && pair->angle_rad < angle + tolerance; ++pair) {
            const auto [ignored, a, b] = *pair;
            if (a >= targets.size() || b >= targets.size()) continue;
            if (!brightness_agrees(targets[a], spots_[i], targets[b], spots_[j])) continue;
            const Mat3 R =
                pair_axes(seen_[i], seen_[j]) * pair_axes(targets[a].direction_N, targets[b].direction_N).transpose();
            if (R.row(2).dot(near.direction_N) < std::cos(std::min(kPi, near.radius_rad))) continue;
            ++tried;
            int visible = 0;
            const int hits = static_cast<int>(hits_of(targets, spots, R, visible).size()) - 2;
            if (hits < 1) continue;
            const double area = static_cast<double>(camera_.width_px) * camera_.height_px;
            const double p = std::min(0.9, visible * kPi * settings_.net_px * settings_.net_px / area);
            const double chance = binomial_tail(static_cast<int>(spots) - 2, hits, p);
            if (chance < least) {
              least = chance;
              found = R;
            }
          }
        }
      }
      const double chance = static_cast<double>(kLists.size()) * tried * least;
      if (chance < best) {
        best = chance;
        R_CN = found;
      }
    }
    return best;
  }

  // Every target at its nearest spot.
  std::vector<Hit> hits_of(std::span<const Target> targets, std::size_t spots, const Mat3& R_CN, int& visible) const {
    std::vector<Hit> hits;
    visible = 0;
    for (std::size_t t = 0; t < targets.size(); ++t) {
      const auto pixel = project(camera_, R_CN * targets[t].direction_N);
      if (!pixel || !camera_.contains(*pixel)) continue;
      ++visible;
      // A saturated spot's centre is no better than a part of its width.
      std::size_t nearest = spots;
      double least = 1.0;
      for (std::size_t s = 0; s < spots; ++s) {
        const double net = settings_.net_px + (spots_[s].saturated ? 0.1 * std::sqrt(1.0 * spots_[s].pixels) : 0.0);
        const double off = (spots_[s].pixel.vec() - pixel->vec()).norm() / net;
        if (off < least) {
          least = off;
          nearest = s;
        }
      }
      const bool taken = std::any_of(hits.begin(), hits.end(), [&](const Hit& h) { return h.spot == nearest; });
      if (nearest < spots && !taken) hits.push_back({t, nearest});
    }
    return hits;
  }

  static constexpr std::size_t kMostSpots = 40;

 private:
  std::span<const vision::Centroid> spots_;
  const Intrinsics& camera_;
  const RoughSettings& settings_;
  std::vector<Vec3> seen_;
};

}  // namespace

Result<RoughLook> look_near(std::span<const vision::Centroid> spots, const Intrinsics& camera,
                            std::span<const SkyStar> sky, std::span<const SkyPlanet> planets, const Near& near,
                            const RoughSettings& settings) {
  const double reach = std::cos(std::min(kPi, near.radius_rad + camera.half_diagonal_rad()));
  std::vector<Target> targets;
  for (const SkyPlanet& planet : planets) {
    if (planet.direction_N.dot(near.direction_N) > reach) targets.push_back({planet.direction_N, planet.v_mag, {}});
  }
  for (std::size_t i = 0; i < sky.size() && sky[i].v_mag <= kLists.back().v_mag; ++i) {
    if (sky[i].direction_N.dot(near.direction_N) > reach) targets.push_back({sky[i].direction_N, sky[i].v_mag, i});
  }
  std::sort(targets.begin(), targets.end(), [](const Target& a, const Target& b) { return a.v_mag < b.v_mag; });

  RoughLook best;
  for (const bool mirrored : {false, true}) {
    std::vector<vision::Centroid> turned(spots.begin(), spots.end());
    if (mirrored) turn_round(turned, camera.width_px);
    Search search(turned, camera, settings);
    Mat3 R_CN;
    const double chance = 2.0 * search.run(targets, near, R_CN);  // two parities
    if (chance >= best.chance_probability) continue;
    best = {R_CN, mirrored, {}, chance};
    int visible = 0;
    for (const Hit& hit : search.hits_of(targets, std::min(spots.size(), Search::kMostSpots), R_CN, visible)) {
      if (targets[hit.target].star) best.stars.push_back({*targets[hit.target].star, hit.spot});
    }
  }
  if (best.chance_probability > settings.max_chance || best.stars.size() < 3)
    return fail(ErrorCode::no_match, "{0} spots, and no part of the sky near the pointing that they fit",
                {static_cast<double>(spots.size())});
  return best;
}

}  // namespace astronav::opensky
