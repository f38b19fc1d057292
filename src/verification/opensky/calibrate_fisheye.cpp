// SPDX-License-Identifier: Apache-2.0
#include "verification/opensky/calibrate_fisheye.h"

#include <algorithm>
#include <array>
#include <cmath>

#include <Eigen/Geometry>

#include "foundation/math/rotation.h"
#include "onboard/vision/identify.h"
#include "verification/opensky/calibrate_adjust.h"
#include "verification/opensky/spots.h"

namespace astronav::opensky {
namespace {

constexpr double kFocalStep = 1.025;
// From the equidistant lens to one that squeezes the rim as r = sin(a) nearly does.
constexpr std::array<double, 3> kLenses{0.0, -0.05, -0.1};  // k1
constexpr double kNet = 2.5 * kDegree;                      // how far between those a lens may put stars at first
constexpr double kPairTolerance = 2.5 * kDegree;
constexpr std::size_t kPairSpots = 12;
constexpr std::size_t kCheckSpots = 30;
constexpr double kPairMag = 2.6;   // of the stars that make pairs
constexpr double kCheckMag = 3.6;  // of those that confirm
constexpr std::size_t kRefined = 24;
constexpr double kMaxChance = 1e-9;

struct StarPair {
  double angle_rad;
  std::size_t a, b;
};

struct Guess {
  Mat3 R_CN;
  Intrinsics camera;
  bool mirrored;
  int hits;
};

// Which cells of a cube around the sphere lie within the net of a star.
class Net {
 public:
  Net(std::span<const SkyStar> stars, double radius_rad) : marked_(6 * kCells * kCells, 0) {
    const double cos_radius = std::cos(radius_rad);
    for (int face = 0; face < 6; ++face) {
      for (int i = 0; i < kCells; ++i) {
        for (int j = 0; j < kCells; ++j) {
          const double s = (i + 0.5) * 2.0 / kCells - 1.0, t = (j + 0.5) * 2.0 / kCells - 1.0;
          const double sign = face % 2 == 0 ? 1.0 : -1.0;
          const Vec3 d = (face < 2 ? Vec3(sign, s, t) : face < 4 ? Vec3(s, sign, t) : Vec3(s, t, sign)).normalized();
          for (const SkyStar& star : stars) {
            if (star.direction_N.dot(d) < cos_radius) continue;
            marked_[index(face, i, j)] = 1;
            break;
          }
        }
      }
    }
  }
  bool holds(const Vec3& d) const {
    const double ax = std::abs(d.x()), ay = std::abs(d.y()), az = std::abs(d.z());
    const int axis = ax >= ay && ax >= az ? 0 : ay >= az ? 1 : 2;
    const double major = axis == 0 ? ax : axis == 1 ? ay : az;
    const double s = axis == 0 ? d.y() : d.x(), t = axis == 2 ? d.y() : d.z();
    return marked_[index(2 * axis + (d[axis] < 0.0), cell(s / major), cell(t / major))] != 0;
  }

 private:
  static constexpr int kCells = 120;
  static int cell(double x) { return std::clamp(static_cast<int>((x + 1.0) * 0.5 * kCells), 0, kCells - 1); }
  static std::size_t index(int face, int i, int j) {
    return (static_cast<std::size_t>(face) * kCells + static_cast<std::size_t>(i)) * kCells +
           static_cast<std::size_t>(j);
  }
  std::vector<char> marked_;
};

// The lens with this k1 that puts 90 degrees where an equidistant one of this focal length does.
Intrinsics first_camera(int width, int height, double focal_px, double k1) {
  Intrinsics camera;
  camera.width_px = width;
  camera.height_px = height;
  camera.fx_px = camera.fy_px = focal_px / (1.0 + k1 * 0.25 * kPi * kPi);
  camera.cx_px = 0.5 * (width - 1);
  camera.cy_px = 0.5 * (height - 1);
  camera.model = ProjectionModel::fisheye;
  camera.distortion.k1 = k1;
  return camera;
}

// A guess, fitted with growing lists of stars within shrinking nets.
Result<FisheyeLook> refine(const Guess& guess, std::span<const vision::Centroid> spots, std::span<const SkyStar> sky) {
  struct Step {
    std::size_t spots;
    double max_v_mag, net_rad;
    LensFreedom freedom;
  };
  const std::array<Step, 5> steps{{{40, 3.6, 2.5 * kDegree, {}},
                                   {60, 4.0, 2.0 * kDegree, {.radial = 1}},
                                   {100, 4.3, 1.3 * kDegree, {.centre = true, .radial = 1}},
                                   {150, 4.6, 0.9 * kDegree, {.centre = true, .radial = 1}},
                                   {200, 4.8, 0.7 * kDegree, {.centre = true, .radial = 2}}}};
  FisheyeLook look;
  look.mirrored = guess.mirrored;
  look.R_CN = guess.R_CN;
  Intrinsics& camera = look.camera;
  camera = guess.camera;
  for (const Step& step : steps) {
    const auto judged = spots.first(std::min(spots.size(), step.spots));
    const auto fainter =
        std::find_if(sky.begin(), sky.end(), [&](const SkyStar& s) { return s.v_mag > step.max_v_mag; });
    const auto stars = sky.first(static_cast<std::size_t>(fainter - sky.begin()));
    MatchSettings settings{.radius_px = step.net_rad * camera.fx_px, .stars_per_spot = 1e3, .brightness_mag = 0.0};
    const auto matches = match_stars(stars, judged, {}, camera, look.R_CN, settings);
    std::vector<StarObservation> observations;
    for (const StarMatch& m : matches)
      observations.push_back({0, judged[m.spot].pixel, Mat2::Identity() * 0.01, stars[m.star].direction_N});
    const auto fitted = adjust(observations, {&look.R_CN, 1}, camera, step.freedom);
    if (!fitted) return forward(fitted);
    camera = fitted->camera;
    look.R_CN = fitted->R_CN[0];
    // How surprising the hits are: spots within a net of three sigma, which the fit has drawn together.
    const double net_px = std::clamp(2.0 * fitted->scatter.extra_sigma_px, 1.0, settings.radius_px);
    settings.radius_px = net_px;
    const auto close = match_stars(stars, judged, {}, camera, look.R_CN, settings);
    look.matched = static_cast<int>(close.size());
    std::size_t in_view = 0;
    for (const SkyStar& s : stars)
      in_view += project(camera, look.R_CN * s.direction_N).has_value() && (look.R_CN * s.direction_N).z() > 0.0;
    const double area_px2 = 2.0 * kPi * camera.fx_px * camera.fx_px;  // of the half sphere, about
    const double p = std::min(1.0, static_cast<double>(in_view) * kPi * net_px * net_px / area_px2);
    look.chance_probability =
        vision::chance_of_matches(static_cast<int>(judged.size()) - 4, std::max(0, look.matched - 4), p);
  }
  return look;
}

}  // namespace

Result<FisheyeLook> find_fisheye(std::span<const vision::Centroid> spots, std::span<const SkyStar> sky, int width,
                                 int height, double focal_min_px, double focal_max_px,
                                 const std::optional<Near>& near) {
  std::vector<SkyStar> pair_stars, check_stars;
  for (const SkyStar& star : sky) {
    if (near && star.direction_N.dot(near->direction_N) < std::cos(std::min(kPi, near->radius_rad + 100.0 * kDegree)))
      continue;
    if (star.v_mag <= kPairMag) pair_stars.push_back(star);
    if (star.v_mag <= kCheckMag) check_stars.push_back(star);
  }
  std::vector<StarPair> pairs;
  for (std::size_t a = 0; a < pair_stars.size(); ++a) {
    for (std::size_t b = 0; b < pair_stars.size(); ++b) {
      if (a != b) pairs.push_back({angle_between(pair_stars[a].direction_N, pair_stars[b].direction_N), a, b});
    }
  }
  std::sort(pairs.begin(), pairs.end(), [](const StarPair& x, const StarPair& y) { return x.angle_rad < y.angle_rad; });
  const Net net(check_stars, kNet);
  const double near_cos = near ? std::cos(std::min(kPi, near->radius_rad)) : -2.0;

  std::vector<Guess> best;
  double tried = 0.0;
  for (const bool mirrored : {false, true}) {
    std::vector<vision::Centroid> seen(spots.begin(), spots.begin() + std::min(spots.size(), kCheckSpots));
    if (mirrored) turn_round(seen, width);
    std::vector<Intrinsics> cameras;
    for (const double k1 : kLenses) {
      for (double focal = focal_min_px; focal <= focal_max_px * std::sqrt(kFocalStep); focal *= kFocalStep)
        cameras.push_back(first_camera(width, height, focal, k1));
    }
    for (const Intrinsics& camera : cameras) {
      std::vector<Vec3> directions;
      for (const vision::Centroid& spot : seen) {
        if (const auto direction = unproject(camera, spot.pixel)) directions.push_back(*direction);
      }
      const std::size_t corners = std::min(kPairSpots, directions.size());
      for (std::size_t i = 0; i < corners; ++i) {
        for (std::size_t j = i + 1; j < corners; ++j) {
          const double angle = angle_between(directions[i], directions[j]);
          if (angle < 15.0 * kDegree || angle > 140.0 * kDegree) continue;
          const Mat3 axes_C = pair_axes(directions[i], directions[j]);
          auto pair = std::lower_bound(pairs.begin(), pairs.end(), angle - kPairTolerance,
                                       [](const StarPair& p, double x) { return p.angle_rad < x; });
          for (; pair != pairs.end() && pair->angle_rad < angle + kPairTolerance; ++pair) {
            const Mat3 R_CN =
                axes_C * pair_axes(pair_stars[pair->a].direction_N, pair_stars[pair->b].direction_N).transpose();
            if (near && R_CN.row(2).dot(near->direction_N.transpose()) < near_cos) continue;
            ++tried;
            int hits = 0;
            for (std::size_t k = 0; k < directions.size(); ++k) {
              if (k != i && k != j) hits += net.holds(R_CN.transpose() * directions[k]);
              if (k == 9 && hits < 3) break;
            }
            if (best.size() == kRefined && hits <= best.back().hits) continue;
            const auto place = std::find_if(best.begin(), best.end(), [&](const Guess& g) { return g.hits < hits; });
            best.insert(place, {R_CN, camera, mirrored, hits});
            if (best.size() > kRefined) best.pop_back();
          }
        }
      }
    }
  }

  Result<FisheyeLook> found = fail(ErrorCode::no_match, "{0} spots of light, and no part of the sky that they fit",
                                   {static_cast<double>(spots.size())});
  for (const Guess& guess : best) {
    std::vector<vision::Centroid> seen(spots.begin(), spots.end());
    if (guess.mirrored) turn_round(seen, width);
    auto look = refine(guess, seen, sky);
    if (!look || look->chance_probability * tried > kMaxChance) continue;
    look->chance_probability *= tried;
    if (!found || look->chance_probability < found->chance_probability) found = *look;
  }
  return found;
}

}  // namespace astronav::opensky
