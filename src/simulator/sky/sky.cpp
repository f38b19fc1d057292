// SPDX-License-Identifier: Apache-2.0
#include "simulator/sky/sky.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <optional>

#include "foundation/math/rotation.h"
#include "models/aberration/aberration.h"

namespace astronav::sky {
namespace {

constexpr std::array kBodies{body::mercury, body::venus,  body::earth,  body::moon,   body::mars,
                             body::jupiter, body::saturn, body::uranus, body::neptune};
constexpr double kSunlikeColour = 0.65;
constexpr double kFastestStar = 11.0 * kArcsecond;  // a year; Barnard's star moves 10.4

// Where a planet's light comes from: centre of figure, or photocentre.
Vec3 centre_of_light(const Vec3& p_body_from_observer, const Vec3& p_body_from_sun, double shift_m) {
  const Vec3 sight = p_body_from_observer.normalized();
  const Vec3 to_sun = -p_body_from_sun;
  const Vec3 across = to_sun - sight * sight.dot(to_sun);
  const double length = across.norm();
  return length > 0.0 ? Vec3(p_body_from_observer + across * (shift_m / length)) : p_body_from_observer;
}

struct Look {
  const Ephemeris& ephemeris;
  Epoch epoch;
  const State& observer_O;
  Vec3 axis_N;
  double cos_radius;
  const BandPhotometry& band;
  const SkySettings& settings;

  Vec3 apparent(const Vec3& direction) const {
    return settings.aberration ? aberrate(direction, observer_O.v_m_s) : direction;
  }
  bool inside(const Vec3& direction) const { return direction.dot(axis_N) >= cos_radius; }

  SkySource source(SourceKind kind, std::int64_t id, const Vec3& direction, double v_mag, double b_v) const {
    return {kind, id, direction, v_mag, b_v, band.flux(v_mag, b_v)};
  }
};

Result<std::optional<SkySource>> planet(const Look& look, BodyId id) {
  const std::optional<SkySource> nothing;
  const Result<BodyId> held = look.ephemeris.resolve(id);
  if (!held) return nothing;
  const Result<LightTime> seen =
      light_time(look.ephemeris, *held, look.observer_O, look.epoch, look.settings.light_time ? -1 : 0);
  if (!seen) return forward(seen);
  const Result<BodyConstants> constants = body_constants(id);
  if (!constants) return forward(constants);
  const Vec3 p_from_observer = seen->relative.p_m;
  if (!(p_from_observer.norm() > 2.0 * constants->mean_radius_m)) return nothing;

  const Epoch departure = look.settings.light_time ? look.epoch - Duration::seconds(seen->light_time_s) : look.epoch;
  const Result<State> from_sun = look.ephemeris.state(*held, body::sun, departure);
  if (!from_sun) return forward(from_sun);
  const Illumination light{from_sun->p_m, p_from_observer, departure};
  Vec3 origin = p_from_observer;
  if (look.settings.centre_of_light) {
    const double shift =
        look.settings.centre_of_light_scale * lambert_photocentre_shift(constants->mean_radius_m, phase_angle(light));
    origin = centre_of_light(p_from_observer, from_sun->p_m, shift);
  }
  const Vec3 direction = look.apparent(origin.normalized());
  if (!look.inside(direction)) return nothing;
  const Result<double> v_mag = planet_v_magnitude(id, light);
  if (!v_mag) return forward(v_mag);
  // A magnitude law may know no light at all at the back of a body.
  if (!std::isfinite(*v_mag)) return nothing;
  return std::optional(look.source(SourceKind::planet, id.value, direction, *v_mag, planet_b_v(id)));
}

}  // namespace

double lambert_photocentre_shift(double radius_m, double phase_angle_rad) {
  const double a = std::clamp(phase_angle_rad, 0.0, kPi);
  const double lit = std::sin(a) + (kPi - a) * std::cos(a);
  // With e = pi - a, numerator and denominator vanish like e^3 / 2 and e^3 / 3.
  if (kPi - a < 1e-3) return radius_m * 9.0 * kPi / 32.0;
  return radius_m * (3.0 * kPi / 16.0) * std::sin(a) * (1.0 + std::cos(a)) / lit;
}

Result<std::vector<SkySource>> Sky::look(Epoch epoch, const State& observer_O, const Vec3& axis_N, double radius_rad,
                                         const BandPhotometry& band, const SkySettings& settings) const {
  const Look look{*ephemeris_, epoch,   observer_O, axis_N.normalized(), std::cos(std::min(radius_rad, kPi)),
                  band,        settings};
  std::vector<SkySource> sources;
  for (const BodyId id : kBodies) {
    const auto seen = planet(look, id);
    if (!seen) return forward(seen);
    if (*seen) sources.push_back(**seen);
  }

  // The catalogue knows places at J2000 from the barycentre at rest: the cone is turned back by aberration and widened
  // by what aberration stretches, proper motion and parallax (below 1 arcsec times the distance in au) can bring in.
  const double beta = settings.aberration ? observer_O.v_m_s.norm() / kSpeedOfLight : 0.0;
  const Vec3 centre = settings.aberration ? unaberrate(look.axis_N, observer_O.v_m_s) : look.axis_N;
  const double widened = radius_rad * std::sqrt((1.0 + beta) / (1.0 - beta)) + beta +
                         kFastestStar * (std::abs(epoch.julian_years_since_j2000()) + 1.0) +
                         kArcsecond * observer_O.p_m.norm() / kAstronomicalUnit;
  std::vector<std::uint32_t> found(4096);
  const auto search = [&] { return catalogue_->cone(centre, std::min(widened, kPi), settings.max_v_mag, found); };
  std::size_t count = search();
  if (count > found.size()) {
    found.resize(count);
    count = search();
  }
  sources.reserve(sources.size() + count);
  for (std::size_t i = 0; i < count; ++i) {
    const Star star = catalogue_->star(found[i]);
    const Vec3 direction = look.apparent(star_direction(star, epoch, observer_O.p_m));
    if (!look.inside(direction)) continue;
    const double b_v = std::isfinite(star.b_v) ? static_cast<double>(star.b_v) : kSunlikeColour;
    sources.push_back(look.source(SourceKind::star, star.id, direction, static_cast<double>(star.v_mag), b_v));
  }
  std::stable_sort(sources.begin(), sources.end(), [](const SkySource& a, const SkySource& b) {
    return a.v_mag != b.v_mag ? a.v_mag < b.v_mag : a.id < b.id;
  });
  return sources;
}

}  // namespace astronav::sky
