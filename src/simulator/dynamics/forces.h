// SPDX-License-Identifier: Apache-2.0
// The true forces on the spacecraft, in barycentric ICRF (origin O, axes N), in m/s^2.
//
//   Sun, planets and Moon     point masses at their ephemeris places (docs/theory/dynamics.md eq. 1)
//   relativity                Schwarzschild term of the Sun, first post-Newtonian order (eq. 2)
//   solar radiation pressure  on a sphere (eq. 3), or on plates with an attitude (eq. 3a), (AU/r)^2
//   unmodelled acceleration   one realisation of an Ornstein-Uhlenbeck process per axis (eq. 4)
//   thrust                    a plan with errors of execution, and the mass that is left (eq. 4a)
//   momentum unloading        kicks at random times
#pragma once

#include <vector>

#include "foundation/base/error.h"
#include "foundation/math/linear.h"
#include "foundation/time/epoch.h"
#include "models/ephemeris/ephemeris.h"
#include "simulator/dynamics/kicks.h"
#include "simulator/dynamics/solar_pressure.h"
#include "simulator/dynamics/thrust.h"
#include "simulator/dynamics/unmodelled.h"

namespace astronav::dynamics {

struct ForceSettings {
  // Point masses. Systems (Mars and the outer planets with their moons) go by their barycentres.
  std::vector<BodyId> bodies = {body::sun,
                                body::mercury_barycenter,
                                body::venus_barycenter,
                                body::earth,
                                body::moon,
                                body::mars_barycenter,
                                body::jupiter_barycenter,
                                body::saturn_barycenter,
                                body::uranus_barycenter,
                                body::neptune_barycenter};
  bool relativity = true;
  double srp_cr_area_over_mass_m2_kg = 0.026;  // of a sphere, CR A/m at the mass before any thrust; 0 = off
  double srp_scale = 1.0;                      // of this run: truth differs from what the onboard software believes
  // Where there are plates, they take the place of the sphere, with this attitude.
  std::vector<Plate> plates = {};
  Attitude attitude = {};
  double mass_kg = 22.0;  // what the plates push on, unless a thrust plan says what it is
};

// What happens to the spacecraft beside the forces of nature, drawn for one run. Any of it may be none.
struct Events {
  UnmodelledAcceleration unmodelled;
  ThrustHistory thrust;
  Kicks kicks;
};

class ForceModel {
 public:
  // The ephemeris' bytes must outlive the model. not_found where a body has no ephemeris or no constants,
  // invalid_argument for plates without an attitude and numbers without sense.
  static Result<ForceModel> create(const Ephemeris& ephemeris, ForceSettings settings, Events events);
  static Result<ForceModel> create(const Ephemeris& ephemeris, ForceSettings settings = {},
                                   UnmodelledAcceleration unmodelled = {});

  // Of the barycentric state at the epoch. out_of_range outside the ephemeris.
  Result<Vec3> acceleration(Epoch epoch, const State& state) const;
  double mass_kg(Epoch epoch) const;
  // The next epoch on the way from `epoch` to `limit` (in either direction of time) at which a force is not smooth;
  // `limit` where there is none. At a knot a force may jump: acceleration() gives it as it is afterwards.
  Epoch next_knot(Epoch epoch, Epoch limit) const;
  const ForceSettings& settings() const { return settings_; }
  const Events& events() const { return events_; }

 private:
  struct PointMass {
    BodyId id;
    double gm_m3_s2 = 0.0;
  };
  Vec3 solar_pressure(Epoch epoch, const Vec3& from_sun_m) const;

  Ephemeris ephemeris_;
  ForceSettings settings_;
  std::vector<PointMass> masses_;
  double sun_gm_m3_s2_ = 0.0;
  Events events_;
};

}  // namespace astronav::dynamics
