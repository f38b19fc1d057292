// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cmath>

#include "foundation/math/rotation.h"
#include "models/ephemeris/ecliptic.h"
#include "models/photometry/photometry.h"

namespace astronav {
namespace {

constexpr double kDaysPerCentury = 36525.0;

// The planet's own number for a planet or its barycentre. The Earth-Moon barycentre is not a planet.
constexpr BodyId planet_of(BodyId id) {
  const bool barycentre = id.value >= 1 && id.value <= 9 && id != body::earth_moon_barycenter;
  return barycentre ? BodyId{id.value * 100 + 99} : id;
}

// Pole (ICRF) and angle of the prime meridian from the node of the equator on the ICRF equator, degrees.
struct Orientation {
  double pole_ra_deg = 0.0;
  double pole_dec_deg = 0.0;
  double meridian_deg = 0.0;
};

// Archinal et al. 2018 ("Report of the IAU Working Group on Cartographic Coordinates and Rotational Elements: 2015") as
// in NAIF's pck00011.tpc. Of the periodic terms of Mars those below 0.0003 degrees are left out.
Result<Orientation> orientation(BodyId planet, Epoch epoch) {
  const double days = epoch.tdb_seconds() / 86400.0;
  const double centuries = days / kDaysPerCentury;
  if (planet == body::mars) {
    const double slow = 0.5042615 * centuries;
    return Orientation{
        .pole_ra_deg = 317.269202 - 0.10927547 * centuries + 0.419057 * std::sin((79.398797 + slow) * kDegree),
        .pole_dec_deg = 54.432516 - 0.05827105 * centuries + 1.591274 * std::cos((166.325722 + slow) * kDegree),
        .meridian_deg = 176.049863 + 350.891982443297 * days + 0.584542 * std::sin((95.391654 + slow) * kDegree)};
  }
  if (planet == body::saturn) {
    return Orientation{40.589 - 0.036 * centuries, 83.537 - 0.004 * centuries, 38.90 + 810.7939024 * days};
  }
  if (planet == body::uranus) return Orientation{257.311, -15.175, 203.81 - 501.1600928 * days};
  return fail(ErrorCode::not_found, "no orientation for body {0}", {static_cast<double>(planet.value)});
}

struct LatitudeLongitude {
  double latitude_deg = 0.0;
  double west_longitude_deg = 0.0;
};

LatitudeLongitude below(const Orientation& o, const Vec3& direction_N) {
  const Vec3 pole = direction_from_radec(o.pole_ra_deg * kDegree, o.pole_dec_deg * kDegree);
  const Vec3 node = direction_from_radec((o.pole_ra_deg + 90.0) * kDegree, 0.0);
  const Vec3 d = direction_N.normalized();
  const double from_node_deg = std::atan2(d.dot(pole.cross(node)), d.dot(node)) / kDegree;
  const double west = o.meridian_deg - from_node_deg;
  return {std::asin(std::clamp(d.dot(pole), -1.0, 1.0)) / kDegree, west - 360.0 * std::floor(west / 360.0)};
}

double ecliptic_longitude_deg(const Vec3& p_N) {
  const double y = std::cos(kObliquityJ2000) * p_N.y() + std::sin(kObliquityJ2000) * p_N.z();
  return std::atan2(y, p_N.x()) / kDegree;
}

}  // namespace

double phase_angle(const Illumination& geometry) {
  return angle_between(geometry.p_body_from_sun_N, geometry.p_body_from_observer_N);
}

PhaseGeometry phase_geometry(const Illumination& geometry) {
  return {.r_au = geometry.p_body_from_sun_N.norm() / kAstronomicalUnit,
          .delta_au = geometry.p_body_from_observer_N.norm() / kAstronomicalUnit,
          .phase_deg = phase_angle(geometry) / kDegree};
}

Result<SubPoints> sub_points(BodyId body, const Illumination& geometry) {
  const Result<Orientation> o = orientation(planet_of(body), geometry.epoch);
  if (!o) return forward(o);
  const auto observer = below(*o, -geometry.p_body_from_observer_N);
  const auto sun = below(*o, -geometry.p_body_from_sun_N);
  return SubPoints{.observer_latitude_deg = observer.latitude_deg,
                   .observer_longitude_deg = observer.west_longitude_deg,
                   .sun_latitude_deg = sun.latitude_deg,
                   .sun_longitude_deg = sun.west_longitude_deg};
}

Result<double> planet_v_magnitude(BodyId id, const Illumination& geometry) {
  const PhaseGeometry g = phase_geometry(geometry);
  if (!(g.r_au > 0.0 && g.delta_au > 0.0)) {
    return fail(ErrorCode::invalid_argument, "body {0} has no magnitude at distance 0",
                {static_cast<double>(id.value)});
  }
  const BodyId planet = planet_of(id);
  if (planet == body::mercury) return mercury_v_magnitude(g);
  if (planet == body::venus) return venus_v_magnitude(g);
  if (planet == body::earth) return earth_v_magnitude(g);
  if (planet == body::moon) return moon_v_magnitude(g);
  if (planet == body::jupiter) return jupiter_v_magnitude(g);
  if (planet == body::pluto) return pluto_v_magnitude(g);
  if (planet == body::neptune) return neptune_v_magnitude(g, 2000.0 + geometry.epoch.julian_years_since_j2000());

  const Result<SubPoints> points = sub_points(planet, geometry);
  if (!points) {
    return fail(ErrorCode::not_found, "no magnitude law for body {0}", {static_cast<double>(id.value)});
  }
  if (planet == body::mars) {
    return mars_v_magnitude(g, mars_effective_longitude_deg(points->observer_longitude_deg, points->sun_longitude_deg),
                            ecliptic_longitude_deg(geometry.p_body_from_sun_N) - 85.0);
  }
  if (planet == body::saturn) {
    return saturn_v_magnitude(g, saturn_ring_latitude_deg(points->observer_latitude_deg, points->sun_latitude_deg));
  }
  const auto graphic = [](double centric) {
    return planetographic_latitude_deg(centric, kUranusEquatorialOverPolarRadius);
  };
  return uranus_v_magnitude(
      g, uranus_effective_latitude_deg(graphic(points->observer_latitude_deg), graphic(points->sun_latitude_deg)));
}

double asteroid_v_magnitude(double h, double g, const Illumination& geometry) {
  const double tan_half = std::tan(0.5 * phase_angle(geometry));
  const double phi1 = std::exp(-3.33 * std::pow(tan_half, 0.63));
  const double phi2 = std::exp(-1.87 * std::pow(tan_half, 1.22));
  const PhaseGeometry p = phase_geometry(geometry);
  return h + 5.0 * std::log10(p.r_au * p.delta_au) - 2.5 * std::log10((1.0 - g) * phi1 + g * phi2);
}

double planet_b_v(BodyId id) {
  switch (planet_of(id).value) {
    case body::mercury.value:
      return 0.93;
    case body::venus.value:
      return 0.82;
    case body::earth.value:
      return 0.20;
    case body::moon.value:
      return 0.92;
    case body::mars.value:
      return 1.36;
    case body::jupiter.value:
      return 0.83;
    case body::saturn.value:
      return 1.04;
    case body::uranus.value:
      return 0.56;
    case body::neptune.value:
      return 0.41;
    case body::pluto.value:
      return 0.85;
    default:
      return 0.65;
  }
}

}  // namespace astronav
