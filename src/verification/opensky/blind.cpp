// SPDX-License-Identifier: Apache-2.0
#include "verification/opensky/blind.h"

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>

#include <Eigen/Geometry>

#include "foundation/base/check.h"

namespace astronav::opensky {
namespace {

// Fields are served in steps of 1.25: a list of stars that suits one suits its neighbours.
constexpr double kStep = 1.25;

constexpr int kNodes = 160;  // of the focal length: 0.3 % apart over a range of +-20 %
constexpr std::size_t kMaxConfirm = 12;

struct PairOfSpots {
  int i, j;
  double rank;
};

// What a pair of spots sees under one focal length.
struct Node {
  double focal_px = 0.0;
  Mat3 axes_C;                          // of the pair
  std::array<Vec3, kMaxConfirm> other;  // other spots, in those axes
};

// Axes that two directions define: columns middle, normal, from the second to the first.
Mat3 pair_axes(const Vec3& p, const Vec3& q) {
  Mat3 axes;
  axes.col(0) = (p + q).normalized();
  axes.col(2) = (p - q).normalized();
  axes.col(1) = axes.col(0).cross(axes.col(2));
  return axes;
}

}  // namespace

SkyMask::SkyMask(const vision::StarField& stars, double radius_rad)
    : cells_(std::clamp(static_cast<int>(2.0 / radius_rad), 64, 4096)) {
  const auto n = static_cast<std::size_t>(cells_);
  bits_.assign((6 * n * n + 63) / 64, 0);
  // A cell is at most 2/n wide, and never narrower than a third of that: dots at a third of it miss none.
  const double step = 0.6 / cells_;
  const int reach = static_cast<int>(std::ceil(radius_rad / step)) + 1;
  for (const vision::FieldStar& star : stars.stars()) {
    const Vec3& d = star.direction_N;
    const Vec3 east = d.unitOrthogonal(), north = d.cross(east);
    for (int y = -reach; y <= reach; ++y) {
      for (int x = -reach; x <= reach; ++x) {
        if (x * x + y * y > reach * reach) continue;
        const std::size_t at = cell(d + (east * x + north * y) * step);
        bits_[at >> 6] |= std::uint64_t{1} << (at & 63);
      }
    }
  }
}

std::size_t SkyMask::cell(const Vec3& d) const {
  const double ax = std::abs(d.x()), ay = std::abs(d.y()), az = std::abs(d.z());
  double s, t, major;
  int face;
  if (ax >= ay && ax >= az) {
    major = ax, s = d.y(), t = d.z(), face = d.x() > 0.0 ? 0 : 1;
  } else if (ay >= az) {
    major = ay, s = d.x(), t = d.z(), face = d.y() > 0.0 ? 2 : 3;
  } else {
    major = az, s = d.x(), t = d.y(), face = d.z() > 0.0 ? 4 : 5;
  }
  const double scale = 0.5 * cells_ / major, middle = 0.5 * cells_;
  const int i = std::clamp(static_cast<int>(s * scale + middle), 0, cells_ - 1);
  const int j = std::clamp(static_cast<int>(t * scale + middle), 0, cells_ - 1);
  return (static_cast<std::size_t>(face) * cells_ + j) * cells_ + i;
}

bool SkyMask::near_star(const Vec3& direction_N) const {
  const std::size_t at = cell(direction_N);
  return (bits_[at >> 6] >> (at & 63)) & 1;
}

const BlindSearch::Asterisms& BlindSearch::asterisms(double shorter_fov_rad, double longest_rad,
                                                     double mask_radius_rad) {
  const int key = static_cast<int>(std::lround(std::log(shorter_fov_rad / kDegree) / std::log(kStep)));
  std::unique_ptr<Asterisms>& slot = made_[key];
  if (!slot || slot->index.max_angle_rad() < longest_rad) {
    const double fov = std::pow(kStep, key) * kDegree;
    vision::AsterismSettings settings;
    settings.radius_rad = 0.25 * fov;
    settings.neighbours = fov < 5.0 * kDegree ? 3 : 4;
    settings.max_angle_rad = std::min(1.1 * longest_rad, 60.0 * kDegree);
    settings.max_v_mag = 10.0;
    auto made = std::make_unique<Asterisms>();
    made->bytes = vision::build_pair_index(field_, settings);
    const auto index = vision::PairIndex::open(made->bytes);
    ASTRONAV_CHECK(index.has_value());
    made->index = *index;
    made->bright = field_.subset(vision::choose_asterism_stars(field_, settings));
    slot = std::move(made);
  }
  if (!slot->mask || slot->mask_radius_rad < mask_radius_rad || slot->mask_radius_rad > 1.5 * mask_radius_rad) {
    slot->mask = std::make_unique<SkyMask>(slot->bright, mask_radius_rad);
    slot->mask_radius_rad = mask_radius_rad;
  }
  return *slot;
}

Result<BlindSolution> BlindSearch::search(std::span<const vision::Centroid> spots, int width, int height,
                                          double fov_min_rad, double fov_max_rad, const vision::Observer& observer,
                                          const BlindSettings& settings) {
  if (spots.size() < 5)
    return fail(ErrorCode::no_match, "{0} spots of light are too few", {static_cast<double>(spots.size())});
  const double half_width = 0.5 * width;
  const double f_max = half_width / std::tan(0.5 * fov_min_rad), f_min = half_width / std::tan(0.5 * fov_max_rad);
  const double f_middle = std::sqrt(f_min * f_max);
  const double cu = 0.5 * (width - 1), cv = 0.5 * (height - 1);

  // Bright spots, evenly spread by the rule that made the list of stars.
  const double shorter_px = std::min(width, height);
  const double shorter_fov = 2.0 * std::atan(0.5 * shorter_px / f_middle);
  std::vector<int> chosen;
  for (std::size_t i = 0; i < spots.size() && chosen.size() < static_cast<std::size_t>(settings.spots); ++i) {
    int neighbours = 0;
    for (const int j : chosen) neighbours += (spots[i].pixel.vec() - spots[j].pixel.vec()).norm() < 0.25 * shorter_px;
    if (neighbours < 4) chosen.push_back(static_cast<int>(i));
  }

  std::vector<PairOfSpots> pairs;
  for (std::size_t a = 0; a < chosen.size(); ++a) {
    for (std::size_t b = a + 1; b < chosen.size(); ++b) {
      const double d = (spots[chosen[a]].pixel.vec() - spots[chosen[b]].pixel.vec()).norm();
      if (d < 0.15 * shorter_px || d > 0.75 * shorter_px) continue;
      pairs.push_back({chosen[a], chosen[b], static_cast<double>(a + b)});
    }
  }
  std::stable_sort(pairs.begin(), pairs.end(),
                   [](const PairOfSpots& a, const PairOfSpots& b) { return a.rank < b.rank; });
  const double longest = 2.0 * std::atan(0.5 * 0.75 * shorter_px / f_min);
  const Asterisms& sky = asterisms(shorter_fov, longest, settings.tolerance * width / f_min);

  // A blurred spot's centre is no better than a part of its width.
  std::vector<int> sizes;
  for (const int k : chosen) sizes.push_back(spots[k].pixels);
  std::nth_element(sizes.begin(), sizes.begin() + static_cast<std::ptrdiff_t>(sizes.size() / 2), sizes.end());
  const double blur_px = std::sqrt(static_cast<double>(sizes[sizes.size() / 2]));
  const double match_px = std::max(settings.match_px, 0.2 * blur_px);

  vision::IdentifySettings identify;
  identify.first_match_px = settings.tolerance * width * 1.2;
  identify.match_px = match_px;
  identify.rough_stars = 25;
  identify.brightness_gate_mag = 3.0;  // film curves, compression, colour
  identify.max_chance = settings.max_chance;
  identify.psf_sigma_px = 1.0;
  identify.attitude.freedom = {.focal_length = true, .k1 = true, .tangential = false};
  identify.attitude.extra_sigma_px = std::max(0.25, 0.05 * blur_px);
  identify.attitude.gate_sigma = 6.0;
  Intrinsics camera;
  camera.width_px = width;
  camera.height_px = height;
  camera.cx_px = cu;
  camera.cy_px = cv;
  const double near_cos = settings.near ? std::cos(std::min(kPi, settings.near->radius_rad + fov_max_rad)) : -2.0;

  BlindSolution out;
  std::vector<Node> nodes(kNodes + 1);
  double tried = 0.0;
  for (const PairOfSpots& pair : pairs) {
    std::vector<int> others;  // the best others must confirm
    for (const int k : chosen)
      if (k != pair.i && k != pair.j && others.size() < kMaxConfirm) others.push_back(k);
    const int count = static_cast<int>(others.size());
    if (count < 3) break;
    const int needed = std::min(settings.confirm_hits, count);

    // Nodes of the focal length, evenly in the cosine of the angle between the two spots.
    const auto direction = [&](int spot, double f) {
      return Vec3((spots[spot].pixel.u - cu) / f, (spots[spot].pixel.v - cv) / f, 1.0).normalized();
    };
    const auto angle_at = [&](double f) {
      const Vec3 a = direction(pair.i, f), b = direction(pair.j, f);
      return std::atan2(a.cross(b).norm(), a.dot(b));
    };
    const double cos_min = std::cos(angle_at(f_min)), cos_max = std::cos(angle_at(f_max));
    const double nodes_per_cos = kNodes / std::max(cos_max - cos_min, 1e-12);
    double f = f_min;
    for (int k = 0; k <= kNodes; ++k) {
      const double angle = std::acos(std::min(1.0, cos_min + k / nodes_per_cos));
      for (int step = 0; step < 5 && angle > 0.0; ++step) f *= angle_at(f) / angle;
      Node& node = nodes[k];
      node.focal_px = f;
      const Mat3 axes = pair_axes(direction(pair.i, f), direction(pair.j, f));
      node.axes_C = axes;
      for (int m = 0; m < count; ++m) node.other[m] = axes.transpose() * direction(others[m], f);
    }

    for (const vision::PairIndex::Pair& stars : sky.index.pairs(cos_min, cos_max)) {
      const Vec3 s = sky.index.direction(stars.a), t = sky.index.direction(stars.b);
      if (s.dot(settings.near ? settings.near->direction_N : s) < near_cos) continue;
      const double at_node = (s.dot(t) - cos_min) * nodes_per_cos + 0.5;
      if (!(at_node >= 0.0 && at_node < kNodes + 1)) continue;
      const Node& node = nodes[static_cast<std::size_t>(at_node)];
      Mat3 axes_N = pair_axes(s, t);
      for (int order = 0; order < 2; ++order) {
        if (order == 1) axes_N.rightCols<2>() *= -1.0;  // the same two stars the other way round
        ++tried;
        int hits = 0;
        for (int k = 0; k < count; ++k) {
          hits += sky.mask->near_star(axes_N * node.other[k]);
          if (hits + count - k - 1 < needed || (k == 3 && hits == 0) || (k == 6 && hits < 2)) break;
        }
        if (hits < needed) continue;
        const double radius = settings.tolerance * width / node.focal_px;
        hits = 0;
        for (int k = 0; k < count; ++k) hits += sky.bright.nearest(axes_N * node.other[k], radius) >= 0;
        if (hits < needed) continue;

        camera.fx_px = camera.fy_px = node.focal_px;
        const Mat3 R_CN = node.axes_C * axes_N.transpose();
        identify.max_chance = settings.max_chance / tried;
        const auto judged = spots.first(std::min(spots.size(), settings.judged_spots));
        out.stars.resize(spots.size());
        vision::Identifier identifier(field_, sky.index, camera, identify, spots.size());
        auto known = identifier.track(judged, observer, R_CN, identify.first_match_px, out.stars);
        if (!known) continue;
        const double fov = known->attitude.intrinsics.field_of_view_horizontal_rad();
        if (fov < 0.97 * fov_min_rad || fov > 1.03 * fov_max_rad) continue;
        const Vec3 boresight = known->attitude.R_CN.row(2).transpose();
        if (settings.near && boresight.dot(settings.near->direction_N) < std::cos(settings.near->radius_rad)) continue;
        const auto refine_begin = std::chrono::steady_clock::now();
        // Wider nets, cast from the camera that the first stars have shown, bring in the corners and the faint.
        for (const double net : {1.5, 4.0, 8.0, 4.0, 2.0}) {
          vision::IdentifySettings finer = identify;
          finer.attitude.freedom.tangential = true;
          vision::Identifier again(field_, sky.index, known->attitude.intrinsics, finer, spots.size());
          std::vector<vision::MatchedStar> more(spots.size());
          const auto better =
              again.track(net > 2.0 ? judged : spots, observer, known->attitude.R_CN, net * match_px, more);
          if (!better || better->matched <= known->matched) continue;
          known = better;
          out.stars = std::move(more);
        }
        out.refine_ms =
            std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - refine_begin).count();
        known->attitude.chance_probability *= tried;
        out.identification = *known;
        out.stars.resize(known->matched);
        return out;
      }
    }
  }
  return fail(ErrorCode::no_match, "{0} spots, and no part of the sky that they fit",
              {static_cast<double>(spots.size())});
}

}  // namespace astronav::opensky
