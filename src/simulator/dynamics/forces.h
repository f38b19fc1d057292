// SPDX-License-Identifier: Apache-2.0
// The true forces on the spacecraft, in barycentric ICRF (origin O, axes N), in m/s^2.
//
//   Sun, planets and Moon     point masses at their ephemeris places (docs/theory/dynamics.md eq. 1)
//   relativity                Schwarzschild term of the Sun, first post-Newtonian order (eq. 2)
//   solar radiation pressure  a cannonball, (AU/r)^2 (eq. 3)
//   unmodelled acceleration   one realisation of an Ornstein-Uhlenbeck process per axis (eq. 4)
#pragma once

#include <span>
#include <vector>

#include "foundation/base/error.h"
#include "foundation/math/linear.h"
#include "foundation/math/random.h"
#include "foundation/time/epoch.h"
#include "models/ephemeris/ephemeris.h"

namespace astronav::dynamics {

// Radiation pressure at 1 AU, N/m^2 (solar constant over the speed of light, for a surface that absorbs).
inline constexpr double kSolarPressureAtOneAu = 4.56e-6;

struct UnmodelledSettings {
  double sigma_m_s2 = 0.0;             // steady one sigma per axis; 0 = off
  Duration tau = Duration::days(5.0);  // correlation time
  // Spacing of the drawn values; between them the acceleration is linear, so that its variance half-way is lower by
  // (1 - exp(-grid/tau))/2: 2.4 % with the defaults.
  Duration grid = Duration::days(0.25);
};

// One realisation over [begin, end], the same for the same stream; a longer span begins with the same values. Zero
// outside the span.
class UnmodelledAcceleration {
 public:
  UnmodelledAcceleration() = default;  // none
  // invalid_argument: a negative or non-finite sigma, tau or grid not above zero, end before begin.
  static Result<UnmodelledAcceleration> draw(const UnmodelledSettings& settings, Epoch begin, Epoch end,
                                             RandomStream& stream);

  Vec3 at(Epoch epoch) const;
  bool active() const { return !values_.empty(); }
  // The next epoch after (forward) or before (backward) `epoch` at which the slope jumps; steps of integration end
  // there. `limit` where there is none before it.
  Epoch next_knot(Epoch epoch, Epoch limit) const;

 private:
  Epoch begin_;
  Duration grid_;
  std::vector<Vec3> values_;
};

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
  double srp_cr_area_over_mass_m2_kg = 0.026;  // CR A/m; 0 = off
  double srp_scale = 1.0;                      // of this run: truth differs from what the onboard software believes
};

class ForceModel {
 public:
  // The ephemeris' bytes must outlive the model. not_found where a body has no ephemeris or no constants.
  static Result<ForceModel> create(const Ephemeris& ephemeris, ForceSettings settings = {},
                                   UnmodelledAcceleration unmodelled = {});

  // Of the barycentric state at the epoch. out_of_range outside the ephemeris.
  Result<Vec3> acceleration(Epoch epoch, const State& state) const;
  const ForceSettings& settings() const { return settings_; }
  const UnmodelledAcceleration& unmodelled() const { return unmodelled_; }

 private:
  struct PointMass {
    BodyId id;
    double gm_m3_s2 = 0.0;
  };
  Ephemeris ephemeris_;
  ForceSettings settings_;
  std::vector<PointMass> masses_;
  double sun_gm_m3_s2_ = 0.0;
  UnmodelledAcceleration unmodelled_;
};

}  // namespace astronav::dynamics
