// SPDX-License-Identifier: Apache-2.0
#include "simulator/sky/sky.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <optional>
#include <span>
#include <utility>

#include "foundation/math/random.h"
#include "foundation/math/rotation.h"
#include "models/aberration/aberration.h"

namespace astronav::sky {
namespace {

constexpr std::array kPlanets{body::mercury, body::venus,  body::earth,  body::moon,    body::mars,
                              body::jupiter, body::saturn, body::uranus, body::neptune, body::pluto};
constexpr double kSunlikeColour = 0.65;
constexpr double kSunV = -26.76;  // at 1 au; Willmer 2018
constexpr double kSunBV = 0.653;  // Ramirez et al. 2012
constexpr double kMostRefraction = 0.25 * kDegree;
constexpr double kFastestStar = 11.0 * kArcsecond;  // a year; Barnard's star moves 10.4

bool brighter(const SkySource& a, const SkySource& b) {
  return a.v_mag != b.v_mag ? a.v_mag < b.v_mag : a.id < b.id;
}

// Indices of stars by V, then by number: sorted by bytes of V in thousandths (a catalogue's unit), which takes a tenth
// of the time of a comparing sort; the few that share a V are put in order afterwards.
std::vector<std::uint32_t> brightest_first(std::span<const Star> stars) {
  const auto count = static_cast<std::uint32_t>(stars.size());
  std::vector<std::uint32_t> keys(stars.size()), from(stars.size()), to(stars.size());
  std::array<std::array<std::uint32_t, 256>, 2> ends{};
  for (std::uint32_t i = 0; i < count; ++i) {
    keys[i] = static_cast<std::uint32_t>(std::clamp(stars[i].v_mag * 1000.0f + 32768.5f, 0.0f, 65535.0f));
    from[i] = i;
    ++ends[0][keys[i] & 255];
    ++ends[1][keys[i] >> 8];
  }
  for (int byte = 0; byte < 2; ++byte) {
    std::uint32_t first = 0;
    for (std::uint32_t& end : ends[byte]) first += std::exchange(end, first);
    for (const std::uint32_t i : from) to[ends[byte][keys[i] >> (8 * byte) & 255]++] = i;
    from.swap(to);
  }
  const auto before = [&](std::uint32_t a, std::uint32_t b) {
    return stars[a].v_mag != stars[b].v_mag ? stars[a].v_mag < stars[b].v_mag : stars[a].id < stars[b].id;
  };
  for (std::uint32_t i = 1; i < count; ++i) {
    for (std::uint32_t k = i; k > 0 && before(from[k], from[k - 1]); --k) std::swap(from[k], from[k - 1]);
  }
  return from;
}

// Stars side by side: square roots and divisions, most of the work, then take a fraction of the time.
constexpr int kLanes = 8;
using Lanes = Eigen::Array<double, kLanes, 1>;

std::array<Lanes, 3> apparent(const StarPlaces& places, const Aberration& aberration, std::span<const Star> stars,
                              std::span<const std::uint32_t> chosen) {
  Lanes x, y, z, east, north, parallax;
  for (int k = 0; k < kLanes; ++k) {
    const Star& star = stars[chosen[std::min<std::size_t>(k, chosen.size() - 1)]];
    x[k] = star.direction_N.x();
    y[k] = star.direction_N.y();
    z[k] = star.direction_N.z();
    east[k] = star.pm_ra_cosdec_rad_yr;
    north[k] = star.pm_dec_rad_yr;
    parallax[k] = std::max(star.parallax_rad, 0.0);
  }
  const auto [at_x, at_y, at_z] = places.displaced(x, y, z, east, north, parallax);
  return aberration.apparent(at_x, at_y, at_z);
}

// Nearly all red stars that are bright are giants. A dwarf of the same B-V is far redder beyond it; its parallax gives
// it away: absolute magnitude beyond 7.5, where no giant is.
bool is_red_dwarf(const Star& star) {
  if (!(star.b_v > 1.3f) || !(star.parallax_rad > 0.0)) return false;
  return static_cast<double>(star.v_mag) + 5.0 + 5.0 * std::log10(star.parallax_rad / kArcsecond) > 7.5;
}

struct Look {
  const Ephemeris& ephemeris;
  Epoch epoch;
  const State& observer_O;
  Vec3 axis_N;
  double radius_rad;
  double cos_radius;
  const BandPhotometry& band;
  const SkySettings& settings;

  Vec3 refracted(const Vec3& direction) const {
    return settings.refraction ? settings.refraction->refract(direction) : direction;
  }
  bool inside(const Vec3& direction) const { return direction.dot(axis_N) >= cos_radius; }
  // Of something that reaches out from its direction.
  bool inside(const Vec3& direction, double reach_rad) const {
    return direction.dot(axis_N) >= std::cos(std::min(radius_rad + reach_rad, kPi));
  }
};

// A body of the solar system, and how its brightness follows from its illumination.
struct Body {
  SourceKind kind;
  BodyId id;
  double radius_m;
  double b_v;
  const PhaseLaw* law;  // of a small body
};

Result<Body> planet(BodyId id) {
  const Result<BodyConstants> constants = body_constants(id);
  if (!constants) return forward(constants);
  const SourceKind kind = id == body::pluto ? SourceKind::small_body : SourceKind::planet;
  return Body{kind, id, constants->mean_radius_m, planet_b_v(id), nullptr};
}

Body small_body(const SmallBody& b) {
  return {SourceKind::small_body, b.id, b.mean_radius_m, b.b_v, &b.law};
}

// A body as something opaque: its apparent centre and radius, refraction aside.
struct Globe {
  Vec3 centre;
  double radius_rad;
  double distance_m;
};

struct Seen {
  SkySource source;
  Vec3 direction;  // apparent, refraction aside
  double distance_m;
};

bool hidden(std::span<const Globe> globes, const Vec3& direction, double distance_m) {
  return std::any_of(globes.begin(), globes.end(), [&](const Globe& globe) {
    const double chord = 2.0 * std::sin(0.5 * globe.radius_rad);
    return globe.distance_m < distance_m && (direction - globe.centre).squaredNorm() < chord * chord;
  });
}

// Whether light time, aberration and the photocentre together could bring a body into the cone that stands at p_m and
// moves at v_m_s, both from the observer. A tenth of the time of asking exactly.
bool may_be_inside(const Look& look, const Body& body, const State& there_O) {
  const Vec3 p_m = there_O.p_m - look.observer_O.p_m;
  const double distance = p_m.norm();
  const double speeds = (there_O.v_m_s.norm() + look.observer_O.v_m_s.norm()) / kSpeedOfLight;
  const double size = (1.0 + look.settings.centre_of_light_scale_of(body.id)) * body.radius_m;
  const double margin = 2.0 * speeds + size / distance + (look.settings.refraction ? kMostRefraction : 0.0);
  if (!(margin < 0.5)) return true;
  return p_m.dot(look.axis_N) >= distance * std::cos(std::min(look.radius_rad + 2.0 * margin, kPi));
}

Result<std::optional<Seen>> see(const Look& look, const Body& body, std::vector<Globe>& globes) {
  const std::optional<Seen> nothing;
  const Result<BodyId> held = look.ephemeris.resolve(body.id);
  if (!held) return nothing;
  const Result<State> now = look.ephemeris.state(*held, body::solar_system_barycenter, look.epoch);
  if (!now) return forward(now);
  if (!may_be_inside(look, body, *now)) return nothing;
  const Result<LightTime> seen =
      light_time(look.ephemeris, *held, look.observer_O, look.epoch, look.settings.light_time ? -1 : 0);
  if (!seen) return forward(seen);
  const Vec3 p_from_observer = seen->relative.p_m;
  const double distance = p_from_observer.norm();
  const double radius_rad = std::asin(std::min(1.0, body.radius_m / distance));
  // An observer deep inside of a body is at its centre by name ("earth"), and looks through it.
  if (body.radius_m > 0.0 && distance > 0.99 * body.radius_m) {
    const Vec3 centre = p_from_observer / distance;
    globes.push_back(
        {look.settings.aberration ? aberrate(centre, look.observer_O.v_m_s) : centre, radius_rad, distance});
  }
  if (!(distance > 2.0 * body.radius_m)) return nothing;

  const Epoch departure = look.settings.light_time ? look.epoch - Duration::seconds(seen->light_time_s) : look.epoch;
  const Result<State> from_sun = look.ephemeris.state(*held, body::sun, departure);
  if (!from_sun) return forward(from_sun);
  const Illumination light{from_sun->p_m, p_from_observer, departure};

  // Towards the Sun, across the line of sight; with the Sun straight before or behind the body any direction will do.
  const Vec3 sight = p_from_observer / distance;
  Vec3 across = -from_sun->p_m + sight * sight.dot(from_sun->p_m);
  across = across.norm() > 1e-12 * from_sun->p_m.norm() ? Vec3(across.normalized()) : sight.unitOrthogonal();
  const double phase = phase_angle(light);
  double shift_m = 0.0;
  if (look.settings.centre_of_light)
    shift_m = look.settings.centre_of_light_scale_of(body.id) * lambert_photocentre_shift(body.radius_m, phase);
  const Vec3 rest = (p_from_observer + shift_m * across).normalized();
  Mat3 by_direction = Mat3::Identity();
  const Vec3 direction = look.settings.aberration ? aberrate(rest, look.observer_O.v_m_s, &by_direction) : rest;
  const Vec3 seen_N = look.refracted(direction);
  if (!look.inside(seen_N, radius_rad + shift_m / distance)) return nothing;
  double v_mag = 0.0;
  if (body.law != nullptr) {
    v_mag = small_body_v_magnitude(*body.law, light);
  } else {
    const Result<double> planets = planet_v_magnitude(body.id, light);
    if (!planets) return forward(planets);
    v_mag = *planets;
  }
  // A magnitude law may know no light at all at the back of a body.
  if (!std::isfinite(v_mag)) return nothing;
  SkySource source;
  source.kind = body.kind;
  source.id = body.id.value;
  source.direction_N = seen_N;
  source.v_mag = v_mag;
  source.b_v = body.b_v;
  source.flux = look.band.flux(v_mag, body.b_v);
  // Aberration turns the direction to the Sun with the body, and stretches the disc.
  const Vec3 sunward = by_direction * (across - rest * rest.dot(across)).normalized();
  if (look.settings.centre_of_light) source.angular_radius_rad = radius_rad * sunward.norm();
  source.phase_angle_rad = phase;
  source.minnaert = look.settings.minnaert;
  source.sunward_N = (sunward - seen_N * seen_N.dot(sunward)).normalized();
  return std::optional(Seen{source, direction, distance});
}

std::optional<Seen> see_sun(const Look& look, std::vector<Globe>& globes) {
  const auto seen =
      light_time(look.ephemeris, body::sun, look.observer_O, look.epoch, look.settings.light_time ? -1 : 0);
  const auto constants = body_constants(body::sun);
  if (!seen || !constants) return {};
  const double distance = seen->relative.p_m.norm();
  if (!(distance > constants->mean_radius_m)) return {};
  const double radius_rad = std::asin(constants->mean_radius_m / distance);
  const Vec3 rest = seen->relative.p_m / distance;
  const Vec3 direction = look.settings.aberration ? aberrate(rest, look.observer_O.v_m_s) : rest;
  const Vec3 seen_N = look.refracted(direction);
  if (!look.inside(seen_N, radius_rad)) return {};
  globes.push_back({direction, radius_rad, distance});
  SkySource source;
  source.kind = SourceKind::sun;
  source.id = body::sun.value;
  source.direction_N = seen_N;
  source.v_mag = kSunV + 5.0 * std::log10(distance / kAstronomicalUnit);
  source.b_v = kSunBV;
  source.flux = look.band.flux(source.v_mag, source.b_v);
  if (look.settings.centre_of_light) source.angular_radius_rad = radius_rad;
  source.sunward_N = seen_N.unitOrthogonal();
  return Seen{source, direction, distance};
}

std::optional<SkySource> unknown_companion(const SkySource& star, const SkySettings& settings) {
  RandomStream random(
      {.seed = settings.companion_seed, .image = static_cast<std::uint64_t>(star.id), .purpose = "companion"});
  if (!(random.uniform() < settings.companion_share)) return {};
  constexpr double kNearest = 0.1 * kArcsecond, kFarthestOverNearest = 100.0, kMostFainter = 4.0;
  const double apart = kNearest * std::pow(kFarthestOverNearest, random.uniform());
  const double angle = random.uniform(0.0, 2.0 * kPi), fainter = random.uniform(0.0, kMostFainter);
  const EastNorth axes = east_north(star.direction_N);
  SkySource out = star;
  out.id = 0;
  out.direction_N =
      (star.direction_N + apart * (std::cos(angle) * axes.east + std::sin(angle) * axes.north)).normalized();
  out.v_mag += fainter;
  out.flux.electrons_per_s *= std::pow(10.0, -0.4 * fainter);
  return out;
}

}  // namespace

double SkySettings::centre_of_light_scale_of(BodyId body) const {
  for (const OwnLaw& law : own_laws)
    if (law.body == body) return centre_of_light_scale * law.centre_of_light_scale;
  return centre_of_light_scale;
}

double lambert_photocentre_shift(double radius_m, double phase_angle_rad) {
  const double a = std::clamp(phase_angle_rad, 0.0, kPi);
  const double lit = std::sin(a) + (kPi - a) * std::cos(a);
  // With e = pi - a, numerator and denominator vanish like e^3 / 2 and e^3 / 3.
  if (kPi - a < 1e-3) return radius_m * 9.0 * kPi / 32.0;
  return radius_m * (3.0 * kPi / 16.0) * std::sin(a) * (1.0 + std::cos(a)) / lit;
}

Sky::Sky(const Ephemeris& ephemeris, const StarCatalogue& catalogue) : ephemeris_(&ephemeris), catalogue_(&catalogue) {
  for (const SmallBody& body : known_small_bodies()) {
    if (ephemeris.resolve(body.id)) known_.push_back(body);
  }
}

Vec3 Sky::sun_N_m(Epoch epoch, const State& observer_O) const {
  const auto sun = light_time(*ephemeris_, body::sun, observer_O, epoch);
  return sun ? sun->relative.p_m : Vec3::Zero();
}

Result<std::vector<SkySource>> Sky::look(Epoch epoch, const State& observer_O, const Vec3& axis_N, double radius_rad,
                                         const BandPhotometry& band, const SkySettings& settings) const {
  const Look look{
      *ephemeris_, epoch,   observer_O, axis_N.normalized(), radius_rad, std::cos(std::min(radius_rad, kPi)),
      band,        settings};
  std::vector<Seen> all;
  std::vector<Globe> globes;
  if (const auto sun = see_sun(look, globes)) all.push_back(*sun);
  for (const BodyId id : kPlanets) {
    const Result<Body> body = planet(id);
    if (!body) return forward(body);
    const auto seen = see(look, *body, globes);
    if (!seen) return forward(seen);
    if (*seen) all.push_back(**seen);
  }
  const auto add_small = [&](const SmallBody& small) -> Result<void> {
    const auto seen = see(look, small_body(small), globes);
    if (!seen && seen.error().code != ErrorCode::out_of_range && seen.error().code != ErrorCode::not_found)
      return forward(seen);
    if (seen && *seen) all.push_back(**seen);
    return {};
  };
  for (const SmallBody& small : settings.bodies) {
    if (const auto added = add_small(small); !added) return forward(added);
  }
  for (const SmallBody& small : known_) {
    const bool replaced = std::any_of(settings.bodies.begin(), settings.bodies.end(), [&](const SmallBody& b) {
      return known_small_body(b.id) == known_small_body(small.id);
    });
    if (replaced) continue;
    if (const auto added = add_small(small); !added) return forward(added);
  }

  std::vector<SkySource> bodies;
  for (const Seen& seen : all) {
    if (!hidden(globes, seen.direction, seen.distance_m)) bodies.push_back(seen.source);
  }
  std::sort(bodies.begin(), bodies.end(), brighter);

  // The catalogue knows places at J2000 from the barycentre at rest: the cone is turned back by aberration and widened
  // by what aberration stretches, proper motion and parallax (below 1 arcsec times the distance in au) can bring in.
  const double beta = settings.aberration ? observer_O.v_m_s.norm() / kSpeedOfLight : 0.0;
  const Vec3 centre = settings.aberration ? unaberrate(look.axis_N, observer_O.v_m_s) : look.axis_N;
  const double widened = radius_rad * std::sqrt((1.0 + beta) / (1.0 - beta)) + beta +
                         kFastestStar * (std::abs(epoch.julian_years_since_j2000()) + 1.0) +
                         kArcsecond * observer_O.p_m.norm() / kAstronomicalUnit +
                         (settings.refraction ? kMostRefraction : 0.0);
  std::vector<Star> stars(1024);
  const auto search = [&] {
    return catalogue_->stars_in_cone(centre, std::min(widened, kPi), settings.max_v_mag, stars);
  };
  std::size_t count = search();
  if (count > stars.size()) {
    stars.resize(count);
    count = search();
  }

  // Both lists are sorted; one pass merges them.
  std::vector<SkySource> sources;
  sources.reserve(bodies.size() + count);
  auto next_body = bodies.begin();
  const StarPlaces places(epoch, observer_O.p_m);
  const Aberration aberration(settings.aberration ? observer_O.v_m_s : Vec3::Zero());
  const std::vector<std::uint32_t> order = brightest_first(std::span(stars).first(count));
  for (std::size_t first = 0; first < order.size(); first += kLanes) {
    const auto lanes = std::span(order).subspan(first, std::min<std::size_t>(kLanes, order.size() - first));
    const std::array<Lanes, 3> seen = apparent(places, aberration, stars, lanes);
    const Lanes along_axis = seen[0] * look.axis_N.x() + seen[1] * look.axis_N.y() + seen[2] * look.axis_N.z();
    for (std::size_t k = 0; k < lanes.size(); ++k) {
      const auto lane = static_cast<Eigen::Index>(k);
      Vec3 direction(seen[0][lane], seen[1][lane], seen[2][lane]);
      const bool behind = hidden(globes, direction, std::numeric_limits<double>::infinity());
      if (settings.refraction) {
        direction = look.refracted(direction);
        if (!look.inside(direction)) continue;
      } else if (along_axis[lane] < look.cos_radius) {
        continue;
      }
      if (behind) continue;
      const Star& star = stars[lanes[k]];
      const auto v_mag = static_cast<double>(star.v_mag);
      while (next_body != bodies.end() && next_body->v_mag < v_mag) sources.push_back(*next_body++);
      const double b_v = std::isnan(star.b_v) ? kSunlikeColour : static_cast<double>(star.b_v);
      SkySource& source = sources.emplace_back();
      source.id = star.id;
      source.direction_N = direction;
      source.v_mag = v_mag;
      source.b_v = b_v;
      source.flux = band.flux(v_mag, b_v, is_red_dwarf(star) ? dwarf_v_i(b_v) : kUnknownColour);
    }
  }
  sources.insert(sources.end(), next_body, bodies.end());
  if (settings.companion_share > 0.0) {
    const std::size_t known = sources.size();
    for (std::size_t i = 0; i < known; ++i) {
      if (sources[i].kind != SourceKind::star) continue;
      if (const auto companion = unknown_companion(sources[i], settings)) sources.push_back(*companion);
    }
    const auto middle = sources.begin() + static_cast<std::ptrdiff_t>(known);
    std::sort(middle, sources.end(), brighter);
    std::inplace_merge(sources.begin(), middle, sources.end(), brighter);
  }
  return sources;
}

}  // namespace astronav::sky
