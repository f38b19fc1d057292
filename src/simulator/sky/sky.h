// SPDX-License-Identifier: Apache-2.0
// Sky: what an observer sees inside a cone: apparent directions (light time, exact aberration, proper motion, parallax,
// refraction where there is air) and band fluxes. Bodies come with what is needed to draw their lit discs, and hide
// what is behind them; moons of other planets are not here.
#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "foundation/base/error.h"
#include "foundation/time/epoch.h"
#include "models/ephemeris/ephemeris.h"
#include "models/ephemeris/refraction.h"
#include "models/photometry/photometry.h"
#include "models/photometry/small_bodies.h"
#include "models/stars/catalogue.h"

namespace astronav::sky {

enum class SourceKind : unsigned char { star, planet, small_body, sun };

struct SkySource {
  SourceKind kind = SourceKind::star;
  std::int64_t id = 0;  // Hipparcos number, or NAIF number of the planet's centre or the small body
  // Apparent unit vector: where a camera at rest with the observer sees it. Of a body: its centre of light.
  Vec3 direction_N = Vec3::Zero();
  double v_mag = 0.0;
  double b_v = 0.65;
  BandFlux flux;
  // Of bodies: what a resolved disc looks like. 0 where it has to be drawn as a point.
  double angular_radius_rad = 0.0;
  double phase_angle_rad = 0.0;
  double minnaert = 1.0;  // exponent of the law by which its surface scatters; 1: Lambert's
  Vec3 sunward_N =
      Vec3::Zero();  // unit vector across the line of sight, towards the Sun, as the moving observer sees it
};

struct SkySettings {
  double max_v_mag = 8.0;  // of stars
  bool aberration = true;
  bool light_time = true;
  // Bodies at their centre of light, with their discs; false: points at the centre of figure (the paper's way).
  bool centre_of_light = true;
  double centre_of_light_scale = 1.0;  // the truth's law over the Lambert sphere's
  // Bodies whose own law is another one: on top of that scale.
  struct OwnLaw {
    BodyId body;
    double centre_of_light_scale;
  };
  std::vector<OwnLaw> own_laws{};
  double centre_of_light_scale_of(BodyId body) const;
  // Exponent of Minnaert's law, by which discs are drawn about the centre of light that the scales give; 1: Lambert's.
  double minnaert = 1.0;
  // Share of the stars that have a companion which no catalogue knows: 0.1 to 10 arcsec away, up to 4 mag fainter, the
  // same ones at each look with the same seed (docs/theory/rendering.md section Companions).
  double companion_share = 0.0;
  std::uint64_t companion_seed = 1;
  // Of an observer on the ground, whose zenith it knows.
  std::optional<Refraction> refraction{};
  // Small bodies beside the known ones (known_small_bodies()) or, with the number of one, in its place. Those that no
  // kernel holds are not seen.
  std::vector<SmallBody> bodies{};
};

// How far (m) the photocentre of a Lambert sphere lies from its centre towards the Sun, across the line of sight.
// docs/theory/rendering.md eq. 6.
double lambert_photocentre_shift(double radius_m, double phase_angle_rad);

class Sky {
 public:
  // The ephemeris and catalogue must outlive the object.
  Sky(const Ephemeris& ephemeris, const StarCatalogue& catalogue);

  // All sources within `radius_rad` of the apparent direction `axis_N`, brightest first: stars not fainter than
  // max_v_mag; the Sun, Mercury to Pluto, Earth, Moon and small bodies as far as the kernels hold them, those too whose
  // disc alone reaches in. A body right below the observer (two radii) hides, and is not drawn; one that the
  // observer is in the middle of does neither. `observer_O` is the barycentric state. out_of_range beyond the
  // ephemeris; a small body is just not there beyond its kernel.
  Result<std::vector<SkySource>> look(Epoch epoch, const State& observer_O, const Vec3& axis_N, double radius_rad,
                                      const BandPhotometry& band, const SkySettings& settings) const;
  // From the observer to where it sees the Sun (light time, no aberration), N, metres; zero where no kernel holds it.
  Vec3 sun_N_m(Epoch epoch, const State& observer_O) const;

 private:
  const Ephemeris* ephemeris_;
  const StarCatalogue* catalogue_;
  std::vector<SmallBody> known_;  // those that the kernels hold
};

}  // namespace astronav::sky
