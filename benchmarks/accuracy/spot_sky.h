// SPDX-License-Identifier: Apache-2.0
// Fields of spots as a camera's image processing would list them: stars of the whole catalogue (deeper than the onboard
// list), a fifth of them double without the catalogue knowing, blends, centroid noise, spots that are no stars, stars
// that are missing. For statistics over thousands of fields, for which rendering takes too long.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <span>
#include <string>
#include <vector>

#include "foundation/files/mapped_file.h"
#include "foundation/math/random.h"
#include "foundation/math/rotation.h"
#include "models/aberration/aberration.h"
#include "models/camera/camera.h"
#include "models/stars/catalogue.h"
#include "onboard/vision/identify.h"

namespace astronav::accuracy {

// A camera, and how deep it sees.
struct SpotCamera {
  Intrinsics intrinsics;
  double limit_v_mag = 8.5;         // half of the stars of this magnitude are detected
  double faintest_sigma_px = 0.12;  // centroid noise there, 1 sigma an axis: 0.8 px at S/N 8
  double floor_px = 0.015;          // what no light removes: non-uniformity, PSF
};

struct SpotDefects {
  int false_spots = 0;
  double false_share = 0.0;    // of all spots; beside `false_spots`
  bool false_bright = false;   // magnitudes of false spots uniform from 2 to the limit; else like those of the stars
  double missing_share = 0.0;  // of the stars
  double noise_px = 0.0;       // in place of the camera's, 1 sigma an axis; the covariances say so
  bool noise_told = true;
  int brightest = 0;  // only so many stars are detected; 0: all
  bool mirrored = false;
};

struct SpotField {
  Mat3 R_CN;
  std::vector<vision::Centroid> spots;  // brightest first
  std::vector<std::uint32_t> star;      // catalogue number of each spot, 0: none
};

class SpotSky {
 public:
  static constexpr std::size_t kMaxSpots = 200;

  SpotSky(const StarCatalogue& catalogue, const vision::Observer& observer)
      : catalogue_(catalogue), observer_(observer) {
    found_.resize(catalogue.size());
  }

  SpotField draw(const SpotCamera& camera, const SpotDefects& defects, RandomStream& random) const {
    SpotField field;
    field.R_CN = R_CN_from_pointing(
        {random.uniform(0.0, 2.0 * kPi), std::asin(random.uniform(-1.0, 1.0)), random.uniform(0.0, 2.0 * kPi)});
    std::vector<Light> lights = stars(camera, field.R_CN, random);
    std::erase_if(lights, [&](const Light&) { return random.uniform() < defects.missing_share; });
    sort(lights);
    const std::size_t most = defects.brightest > 0 ? static_cast<std::size_t>(defects.brightest) : kMaxSpots;
    if (lights.size() > most) lights.resize(most);
    const double share = defects.false_share / (1.0 - defects.false_share);
    std::size_t clutter = static_cast<std::size_t>(std::lround(share * static_cast<double>(lights.size())));
    if (clutter + lights.size() > kMaxSpots) {
      clutter = static_cast<std::size_t>(defects.false_share * kMaxSpots);
      lights.resize(kMaxSpots - clutter);
    }
    const std::size_t real = lights.size();
    const double faint = defects.brightest > 0 && !lights.empty() ? lights.back().v_mag : camera.limit_v_mag;
    for (std::size_t i = 0; i < clutter + static_cast<std::size_t>(defects.false_spots); ++i) {
      const double like =
          real > 0 ? lights[static_cast<std::size_t>(random.uniform() * static_cast<double>(real))].v_mag : faint;
      lights.push_back({{random.uniform(1.0, camera.intrinsics.width_px - 2.0),
                         random.uniform(1.0, camera.intrinsics.height_px - 2.0)},
                        defects.false_share > 0.0 && !defects.false_bright
                            ? like
                            : random.uniform(std::min(2.0, faint - 1.0), faint),
                        0});
    }
    sort(lights);
    for (const Light& light : lights) {
      vision::Centroid spot;
      const double light_ratio = std::pow(10.0, -0.4 * (camera.limit_v_mag - light.v_mag));
      const double sigma = defects.noise_px > 0.0
                               ? defects.noise_px
                               : std::hypot(camera.floor_px, camera.faintest_sigma_px * std::sqrt(light_ratio));
      spot.pixel = {light.pixel.u + random.normal(0.0, sigma), light.pixel.v + random.normal(0.0, sigma)};
      if (defects.mirrored) spot.pixel.u = camera.intrinsics.width_px - 1 - spot.pixel.u;
      const double told = defects.noise_told ? sigma : 0.05;
      spot.covariance_px2 = Mat2::Identity() * told * told;
      spot.flux_dn = 100.0 / light_ratio * std::pow(10.0, 0.4 * random.normal(0.0, 0.15));
      spot.snr = 8.0 / std::sqrt(light_ratio);
      field.spots.push_back(spot);
      field.star.push_back(light.id);
    }
    // By measured light, as the image processing lists them.
    std::vector<std::size_t> order(field.spots.size());
    for (std::size_t i = 0; i < order.size(); ++i) order[i] = i;
    std::sort(order.begin(), order.end(),
              [&](std::size_t a, std::size_t b) { return field.spots[a].flux_dn > field.spots[b].flux_dn; });
    SpotField sorted{field.R_CN, {}, {}};
    for (const std::size_t i : order) {
      sorted.spots.push_back(field.spots[i]);
      sorted.star.push_back(field.star[i]);
    }
    return sorted;
  }

 private:
  struct Light {
    Pixel pixel;
    double v_mag = 0.0;
    std::uint32_t id = 0;
  };
  static void sort(std::vector<Light>& lights) {
    std::sort(lights.begin(), lights.end(), [](const Light& a, const Light& b) { return a.v_mag < b.v_mag; });
  }

  std::vector<Light> stars(const SpotCamera& camera, const Mat3& R_CN, RandomStream& random) const {
    const Intrinsics& k = camera.intrinsics;
    const StarPlaces places(observer_.epoch, observer_.p_O_N);
    const std::size_t n = catalogue_.cone(R_CN.row(2).transpose(), k.half_diagonal_rad() + 0.5 * kDegree,
                                          camera.limit_v_mag + 1.0, found_);
    std::vector<Light> lights;
    for (std::size_t i = 0; i < n; ++i) {
      const Star star = catalogue_.star(found_[i]);
      Vec3 direction = places.direction(star);
      double v_mag = star.v_mag;
      // A fifth has a companion that the catalogue's place does not count: 0.1 to 10 arcsec, up to 4 mag fainter.
      if (random.uniform() < 0.2) {
        const double ratio = std::pow(10.0, -0.4 * random.uniform(0.0, 4.0));
        const double apart = 0.1 * kArcsecond * std::pow(100.0, random.uniform());
        const double angle = random.uniform(0.0, 2.0 * kPi);
        const EastNorth axes = east_north(direction);
        direction += (std::cos(angle) * axes.east + std::sin(angle) * axes.north) * apart * ratio / (1.0 + ratio);
        v_mag -= 2.5 * std::log10(1.0 + ratio);
      }
      if (v_mag + random.normal(0.0, 0.15) > camera.limit_v_mag) continue;
      const Result<Pixel> pixel = project(k, R_CN * aberrate(direction.normalized(), observer_.v_O_N));
      if (!pixel || pixel->u < 1 || pixel->v < 1 || pixel->u > k.width_px - 2 || pixel->v > k.height_px - 2) continue;
      lights.push_back({*pixel, v_mag, star.id});
    }
    // Lights nearer than 2.5 px make one spot, at their common centre.
    sort(lights);
    std::vector<Light> spots;
    for (const Light& light : lights) {
      Light* near = nullptr;
      for (Light& spot : spots)
        if ((spot.pixel.vec() - light.pixel.vec()).squaredNorm() < 2.5 * 2.5) near = &spot;
      if (near == nullptr) {
        spots.push_back(light);
        continue;
      }
      const double a = std::pow(10.0, -0.4 * near->v_mag), b = std::pow(10.0, -0.4 * light.v_mag);
      const Vec2 middle = (a * near->pixel.vec() + b * light.pixel.vec()) / (a + b);
      near->pixel = {middle.x(), middle.y()};
      near->v_mag = -2.5 * std::log10(a + b);
    }
    return spots;
  }

  const StarCatalogue& catalogue_;
  vision::Observer observer_;
  mutable std::vector<std::uint32_t> found_;
};

// What flies: star list and pair index of a camera.
struct Onboard {
  vision::StarField field;
  std::vector<std::byte> bytes;
  vision::PairIndex index;

  Onboard(const StarCatalogue& catalogue, const Intrinsics& camera, double max_v_mag, Epoch epoch)
      : field(vision::StarField::build(catalogue, max_v_mag, epoch)) {
    vision::AsterismSettings settings =
        vision::AsterismSettings::for_field(camera.field_of_view_horizontal_rad(), camera.field_of_view_vertical_rad());
    settings.max_v_mag = std::min(settings.max_v_mag, max_v_mag);
    bytes = vision::build_pair_index(field, settings);
    index = vision::PairIndex::open(bytes).value();
  }
  double megabytes() const {
    return (static_cast<double>(field.stars().size_bytes()) + static_cast<double>(bytes.size())) / 1e6;
  }
};

// Between Earth and Mars, at about the speed of a transfer.
inline vision::Observer cruising() {
  vision::Observer observer;
  observer.epoch = Epoch::tdb_seconds(27.2 * 365.25 * 86400.0);
  observer.p_O_N = Vec3(1.2, 0.6, 0.2) * 1.5e11;
  observer.v_O_N = Vec3(-14e3, 21e3, 9e3);
  return observer;
}

}  // namespace astronav::accuracy
