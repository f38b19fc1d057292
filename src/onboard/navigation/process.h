// SPDX-License-Identifier: Apache-2.0
// The filter's dynamics and its factorised covariance in time. Written apart from the simulator's dynamics on purpose.
//
// Forces: point masses in barycentric coordinates, solar radiation pressure on a sphere, thrust (none in ballistic
// mode), a Gauss-Markov acceleration. The frame's origin is inertial, so the attractions simply add up; but then no
// planet may be left out because its tide is small: Uranus pulls the Sun and the spacecraft alike, and only the Sun's
// share is in the ephemeris (7e-10 m/s2, 260 m after 10 days). docs/theory/navigation.md section 1.
#pragma once

#include <array>

#include "foundation/base/error.h"
#include "foundation/time/epoch.h"
#include "models/ephemeris/ephemeris.h"
#include "onboard/navigation/factorised_covariance.h"
#include "onboard/navigation/state.h"

namespace astronav::navigation {

inline constexpr int kMaxAttractors = 11;

struct ProcessSettings {
  // 0 ends the list; the Sun must be there.
  std::array<BodyId, kMaxAttractors> attractors{body::sun,
                                                body::mercury_barycenter,
                                                body::venus_barycenter,
                                                body::earth,
                                                body::moon,
                                                body::mars_barycenter,
                                                body::jupiter_barycenter,
                                                body::saturn_barycenter,
                                                body::uranus_barycenter,
                                                body::neptune_barycenter,
                                                BodyId{}};
  double reflectivity_area_m2 = 0.65;                                     // CR * A
  GaussMarkov solar_pressure{.sigma = 0.0, .tau_s = 3000.0 * 86400.0};    // relative
  GaussMarkov acceleration{.sigma = 1e-8, .tau_s = 5.0 * 86400.0};        // m/s2 per axis
  GaussMarkov thrust_magnitude{.sigma = 0.005, .tau_s = 86400.0};         // relative
  GaussMarkov thrust_pointing{.sigma = 0.3 * kDegree, .tau_s = 86400.0};  // rad per axis
  // Steps are this share of sqrt(d^3/GM) of the Sun, or 0.4 of it of a planet, whichever is shortest.
  double step_share = 0.006;
  Duration max_step = Duration::seconds(43200.0);
};

// Constant in N until changed. Force 0 is the ballistic mode.
struct Thrust {
  double force_n = 0.0;
  double specific_impulse_s = 3000.0;
  Vec3 direction_N = Vec3::UnitX();
};

// Laws of the states that the camera sees and the orbit does not feel: xi_c, xi_p, xi_e. Sigma 0: they stay as they
// are.
using AgeingLaws = std::array<GaussMarkov, kAgeingStates>;

class Process {
 public:
  Process(const ProcessSettings& settings, const Ephemeris& ephemeris, const AgeingLaws& ageing = {});

  // not_found, out_of_range: what the settings ask for is not in the ephemeris or the table of constants.
  Result<void> check(Epoch epoch) const;

  // Step length that keeps RK4's error below 1 m in ten days.
  Result<Duration> step_length(Epoch epoch, const StateVector& x);
  // The first of equal steps to an epoch that lies ahead, so that none is a splinter.
  Result<Duration> step_towards(Epoch epoch, Epoch to, const StateVector& x);
  // One RK4 step of the dynamic states (non-dimensional), with transition matrix and process noise.
  Result<void> step(Epoch epoch, Duration h, const Thrust& thrust, StateVector& x, Transition& out);

  // What time does to each of the other states: its factor and the variance that comes in, non-dimensional. One call
  // for any number of steps.
  struct Ageing {
    Eigen::Matrix<double, kAgeingStates, 1> factor, variance;
  };
  Ageing ageing(Duration span) const;

 private:
  struct Places {
    bool valid = false;
    Epoch epoch;
    std::array<Vec3, kMaxAttractors> p;  // barycentric, non-dimensional
  };
  Result<void> places(Epoch epoch, Places& out) const;

  ProcessSettings settings_;
  const Ephemeris* ephemeris_;
  int attractors_ = 0;
  int sun_ = -1;
  bool constants_known_ = true;
  std::array<double, kMaxAttractors> gm_{};  // non-dimensional
  AgeingLaws ageing_;                        // SI
  Places start_, middle_, end_;
};

}  // namespace astronav::navigation
