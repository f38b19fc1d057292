// SPDX-License-Identifier: Apache-2.0
// Stars of the catalogue where one observer sees them, and which spot of a picture is which.
#pragma once

#include <optional>
#include <span>
#include <vector>

#include "foundation/time/epoch.h"
#include "models/ephemeris/ephemeris.h"
#include "models/ephemeris/refraction.h"
#include "models/stars/catalogue.h"
#include "onboard/vision/types.h"

namespace astronav::opensky {

struct SkyStar {
  Vec3 direction_N;  // apparent
  double v_mag = 0.0;
  std::uint32_t index = 0;  // in the catalogue
  std::uint32_t id = 0;
};
// Of a picture that says nothing about its time: J2025.0 TDB.
Epoch assumed_epoch();
// Where a star is seen: motion, parallax, aberration, refraction. Without an observer: from the barycentre, at rest.
Vec3 apparent_direction(const Star& star, Epoch epoch, const std::optional<State>& observer,
                        const std::optional<Refraction>& refraction);
// All to a magnitude, brightest first.
std::vector<SkyStar> apparent_stars(const StarCatalogue& catalogue, double max_v_mag, Epoch epoch,
                                    const std::optional<State>& observer,
                                    const std::optional<Refraction>& refraction = {});

struct SkyPlanet {
  BodyId body;
  Vec3 direction_N;  // apparent
  double v_mag = 0.0;
};
std::vector<SkyPlanet> apparent_planets(const Ephemeris& ephemeris, Epoch epoch, const State& observer,
                                        const std::optional<Refraction>& refraction = {});

struct StarMatch {
  std::size_t star = 0;  // index into the sky
  std::size_t spot = 0;
};
struct MatchSettings {
  double radius_px = 3.0;
  double stars_per_spot = 1.3;  // as many stars of the field, brightest first, are looked for
  double blend_px = 3.0;        // a star is left out that has another beside it
  double blend_mag = 1.5;       // which is not fainter than this much
  double brightness_mag = 2.5;  // a pair is left out that is off the others' zero point by more; 0: never
};
// `closed`: spots that are known to be something else. `sky` brightest first.
std::vector<StarMatch> match_stars(std::span<const SkyStar> sky, std::span<const vision::Centroid> spots,
                                   std::span<const char> closed, const Intrinsics& camera, const Mat3& R_CN,
                                   const MatchSettings& settings);

}  // namespace astronav::opensky
