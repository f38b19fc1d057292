// SPDX-License-Identifier: Apache-2.0
#include "verification/opensky/calibrate_stars.h"

#include <algorithm>
#include <cmath>

#include "foundation/math/statistics.h"
#include "models/aberration/aberration.h"
#include "models/photometry/photometry.h"

namespace astronav::opensky {
namespace {

struct Projected {
  std::size_t star;
  Pixel pixel;
};

double squared_distance(Pixel a, Pixel b) {
  return (a.u - b.u) * (a.u - b.u) + (a.v - b.v) * (a.v - b.v);
}

}  // namespace

Epoch assumed_epoch() {
  return Epoch::tdb_seconds(25.0 * 365.25 * 86400.0);
}

Vec3 apparent_direction(const Star& star, Epoch epoch, const std::optional<State>& observer,
                        const std::optional<Refraction>& refraction) {
  const State where = observer.value_or(State{Vec3::Zero(), Vec3::Zero()});
  const Vec3 arriving = aberrate(star_direction(star, epoch, where.p_m), where.v_m_s);
  return refraction ? refraction->refract(arriving) : arriving;
}

std::vector<SkyStar> apparent_stars(const StarCatalogue& catalogue, double max_v_mag, Epoch epoch,
                                    const std::optional<State>& observer, const std::optional<Refraction>& refraction) {
  std::vector<SkyStar> sky;
  for (std::size_t i = 0; i < catalogue.size(); ++i) {
    const Star star = catalogue.star(i);
    if (!(static_cast<double>(star.v_mag) <= max_v_mag)) continue;
    sky.push_back({apparent_direction(star, epoch, observer, refraction), static_cast<double>(star.v_mag),
                   static_cast<std::uint32_t>(i), star.id});
  }
  std::stable_sort(sky.begin(), sky.end(), [](const SkyStar& a, const SkyStar& b) { return a.v_mag < b.v_mag; });
  return sky;
}

std::vector<SkyPlanet> apparent_planets(const Ephemeris& ephemeris, Epoch epoch, const State& observer,
                                        const std::optional<Refraction>& refraction) {
  std::vector<SkyPlanet> planets;
  for (const BodyId body : {body::mercury, body::venus, body::earth, body::moon, body::mars, body::jupiter,
                            body::saturn, body::uranus, body::neptune}) {
    const auto held = ephemeris.resolve(body);
    if (!held) continue;
    const auto seen = light_time(ephemeris, *held, observer, epoch);
    if (!seen || seen->relative.p_m.norm() < 1e7) continue;
    const Epoch departure = epoch - Duration::seconds(seen->light_time_s);
    const auto from_sun = ephemeris.state(*held, body::sun, departure);
    if (!from_sun) continue;
    const auto v_mag = planet_v_magnitude(body, {from_sun->p_m, seen->relative.p_m, departure});
    if (!v_mag || !std::isfinite(*v_mag)) continue;
    const Vec3 arriving = aberrate(seen->relative.p_m.normalized(), observer.v_m_s);
    planets.push_back({body, refraction ? refraction->refract(arriving) : arriving, *v_mag});
  }
  return planets;
}

std::vector<StarMatch> match_stars(std::span<const SkyStar> sky, std::span<const vision::Centroid> spots,
                                   std::span<const char> closed, const Intrinsics& camera, const Mat3& R_CN,
                                   const MatchSettings& settings) {
  const double margin_rad = 4.0 * camera.plate_scale_rad_px();
  const double least_z = std::cos(std::min(kPi, camera.half_diagonal_rad() + margin_rad));
  const auto wanted = static_cast<std::size_t>(settings.stars_per_spot * static_cast<double>(spots.size())) + 5;
  const Vec3 boresight_N = R_CN.row(2).transpose();
  std::vector<Projected> seen;
  double faintest = 99.0;
  for (std::size_t i = 0; i < sky.size() && sky[i].v_mag <= faintest; ++i) {
    if (boresight_N.dot(sky[i].direction_N) < least_z) continue;
    const auto pixel = project(camera, R_CN * sky[i].direction_N);
    if (!pixel || !camera.contains(*pixel)) continue;
    seen.push_back({i, *pixel});
    if (seen.size() == wanted) faintest = sky[i].v_mag + settings.blend_mag;
  }

  std::vector<StarMatch> matches;
  std::vector<int> claims(spots.size(), 0);
  for (std::size_t k = 0; k < std::min(wanted, seen.size()); ++k) {
    std::size_t nearest = spots.size();
    double least = settings.radius_px * settings.radius_px;
    for (std::size_t s = 0; s < spots.size(); ++s) {
      if (!closed.empty() && closed[s]) continue;
      const double d = squared_distance(spots[s].pixel, seen[k].pixel);
      if (d < least) {
        least = d;
        nearest = s;
      }
    }
    if (nearest == spots.size()) continue;
    ++claims[nearest];
    const double limit = sky[seen[k].star].v_mag + settings.blend_mag;
    const bool blended = std::any_of(seen.begin(), seen.end(), [&](const Projected& other) {
      return other.star != seen[k].star && sky[other.star].v_mag < limit &&
             squared_distance(other.pixel, seen[k].pixel) < settings.blend_px * settings.blend_px;
    });
    if (!blended) matches.push_back({seen[k].star, nearest});
  }
  // Of two stars at one spot the brighter has it only where the fainter does not count.
  std::vector<char> taken(spots.size(), 0);
  std::erase_if(matches, [&](const StarMatch& m) { return std::exchange(taken[m.spot], 1) != 0; });

  if (settings.brightness_mag > 0.0) {
    std::vector<double> zero_points;
    const auto zero_point = [&](const StarMatch& m) {
      return sky[m.star].v_mag + 2.5 * std::log10(std::max(spots[m.spot].flux_dn, 1e-3));
    };
    for (const StarMatch& m : matches) {
      if (!spots[m.spot].saturated) zero_points.push_back(zero_point(m));
    }
    if (zero_points.size() >= 8) {
      const double middle = median(zero_points);
      std::erase_if(matches, [&](const StarMatch& m) {
        return !spots[m.spot].saturated && std::abs(zero_point(m) - middle) > settings.brightness_mag;
      });
    }
  }
  return matches;
}

}  // namespace astronav::opensky
