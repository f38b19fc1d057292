// SPDX-License-Identifier: Apache-2.0
// Filter: where the spacecraft is, from pixels of planets. An extended Kalman filter (states: state.h) in factorised
// form.
//
//   Filter filter(settings, ephemeris);                       // the ephemeris must outlive it
//   filter.initialise({epoch, state, covariance, mass, mass_sigma});
//   filter.propagate_to(epoch);                               // coast, slew
//   const UpdateResult r = filter.update(measurement);        // moves on to mid-exposure by itself
//
// Covariance: P = U D U' in non-dimensional units; Thornton's modified weighted Gram-Schmidt in time, Bierman's update
// (Bierman 1977, chapters V and VI), so that P stays symmetric and positive. No heap, no exceptions, bounded loops.
// docs/theory/navigation.md.
#pragma once

#include <array>
#include <optional>

#include "foundation/base/error.h"
#include "foundation/time/epoch.h"
#include "models/camera/camera.h"
#include "models/ephemeris/ephemeris.h"
#include "onboard/navigation/measurement.h"
#include "onboard/navigation/measurement_model.h"
#include "onboard/navigation/process.h"
#include "onboard/navigation/state.h"

namespace astronav::navigation {

// What the filter believes about errors of one body (1 sigma).
struct BeaconErrors {
  BodyId body;
  double ephemeris_m = 0.0;           // per axis; the same while the body is tracked, new in the next window
  double photocentre_fraction = 0.0;  // of the centre-of-light shift; a state of its own, the same in all windows
  // Along its orbit and across the orbit's plane, each; states of their own, the same in all windows. (Towards the Sun
  // planets are known far better, and from afar it is not seen.) The Moon has the Earth's.
  double lasting_ephemeris_m = 0.0;
};

struct FilterSettings {
  ProcessSettings process;
  SightSettings sight;
  Intrinsics camera;  // as believed on board; xi_c corrects its focal length and k1

  GaussMarkov focal{.sigma = 1e-5, .tau_s = 30.0 * 86400.0};  // relative
  GaussMarkov k1{.sigma = 1e-4, .tau_s = 30.0 * 86400.0};
  // Line-of-sight bias of a window, px per axis; 0.3 arcsec at 71 arcsec/px. Starts anew when the beacon changes or no
  // image has come for `window_gap`; with a `window_memory` the same beacon's goes on after a pause of up to its tau.
  GaussMarkov bias{.sigma = 0.004, .tau_s = 12.0 * 3600.0};
  Duration window_gap = Duration::seconds(900.0);
  // For how long a window resembles the last one of the same beacon, which stands before the same stars (eq. 3a); 0:
  // not at all.
  Duration window_memory = Duration::seconds(0.0);
  double photocentre_tau_s = 1000.0 * 86400.0;
  double ephemeris_tau_s = 1000.0 * 86400.0;                   // of the lasting error
  GaussMarkov clock{.sigma = 0.0, .tau_s = 1000.0 * 86400.0};  // onboard less true, s; 0: it is right

  double gate_probability = 0.9999;  // measurement editing: chi-square of 2 degrees; 1 takes everything
  // After this many rejections in a row that agree with each other, the filter doubts itself: its covariance grows
  // until they are ordinary. 0: never.
  int recovery_rejections = 8;
  double recovery_max_position_m = 3e8;
  int max_iterations = 4;  // of the iterated update; more than one only where the sight bends within the prior

  // Scale of R per beacon, learnt from past residuals (expectation-maximisation with an inverse-gamma prior of
  // `adaptive_prior_count` measurements at scale 1 and forgetting over `adaptive_memory_count`).
  bool adaptive_noise = false;
  double adaptive_prior_count = 20.0;
  double adaptive_memory_count = 300.0;

  std::array<BeaconErrors, kBeaconBodies> beacon_errors{};  // unused entries have body 0
  BeaconErrors errors_of(BodyId body) const;                // none where the body is not among them
};

// The process that such a filter runs on.
Process process_of(const FilterSettings& settings, const Ephemeris& ephemeris);

struct InitialState {
  Epoch epoch;
  State state;                     // barycentric
  Mat6 covariance = Mat6::Zero();  // of position and velocity: m, m/s
  double mass_kg = 25.0;
  double mass_sigma_kg = 0.0;
};

enum class UpdateReason : unsigned char {
  accepted,
  gated,            // innovation beyond the gate
  out_of_view,      // the prediction does not fall into the camera's half-space
  no_ephemeris,     // body or epoch not covered
  before_filter,    // mid-exposure earlier than the filter's epoch
  bad_measurement,  // not finite, or a covariance that is none
};
const char* name(UpdateReason reason);

struct UpdateResult {
  bool accepted = false;
  UpdateReason reason = UpdateReason::bad_measurement;
  Pixel predicted;
  Vec2 innovation_px = Vec2::Zero();              // measured minus predicted, before the update
  Mat2 innovation_covariance_px2 = Mat2::Zero();  // S
  Mat2 noise_covariance_px2 = Mat2::Zero();       // R: centroid, attitude and their correlation
  double nis = 0.0;                               // innovation' S^-1 innovation, 2 degrees of freedom
  int iterations = 0;
  bool window_started = false;  // the line-of-sight bias was started anew
  bool recovered = false;       // the recovery rule enlarged the covariance before this update
};

// Apparent direction of a body as the filter expects it, for the image processing.
struct DirectionPrediction {
  Vec3 direction_N;  // light time, aberration, centre of light as in the settings; unit
  Mat3 covariance;   // of the unit vector, N: position, velocity, ephemeris (rank 2)
  double distance_m = 0.0;
  double light_time_s = 0.0;
};

class Filter {
 public:
  Filter(const FilterSettings& settings, const Ephemeris& ephemeris);

  // invalid_argument: a covariance that is not positive, values that are not finite, settings that make no sense.
  Result<void> initialise(const InitialState& initial);
  // To an epoch not before the filter's own. out_of_range (ephemeris), invalid_argument (backwards). On an error the
  // filter stands at the last epoch it could reach.
  Result<void> propagate_to(Epoch epoch);
  UpdateResult update(const BeaconMeasurement& measurement);

  // At the filter's epoch.
  Result<DirectionPrediction> predict_direction(BodyId body) const;

  // For a flight that is known afterwards to have begun elsewhere than was believed: from here on everything is linear
  // along the way from that place and velocity (barycentric), and the mean is carried beside it, until join() puts the
  // two together again (eq. 9a). state() is the way's until then.
  void fly_beside(const State& begin);
  void join();
  // Sensitivity of position and velocity to those at initialise() or fly_beside(), SI.
  Mat6 sensitivity() const;

  // A push at the filter's epoch that is known to `sigma_m_s` per component (N): velocity and its covariance change.
  // invalid_argument for what is not finite, and a sigma below zero.
  Result<void> kick(const Vec3& delta_v_N_m_s, double sigma_m_s);

  // Thrust from now on, until the next call; force 0 (the default) is the ballistic mode.
  void set_thrust(const Thrust& thrust);

  Epoch epoch() const { return epoch_; }
  State state() const;  // barycentric, SI
  double mass_kg() const;
  StateVector state_vector() const;       // SI, order of state.h
  StateMatrix covariance() const;         // SI
  Mat6 covariance_pv() const;             // position and velocity, SI
  double noise_scale(BodyId body) const;  // adaptive R, 1 where nothing was learnt
  const FilterSettings& settings() const { return settings_; }

 private:
  struct NoiseScale {
    BodyId body;
    double sum = 0.0;    // forgotten sum of expected squared normalised noise
    double count = 0.0;  // ... and of its degrees of freedom
  };
  struct Rejections {
    int count = 0;
    Vec2 sum = Vec2::Zero();
    double sum2 = 0.0, noise = 0.0;  // traces, px2
  };

  struct Seen {  // a beacon, and when last
    BodyId body;
    Epoch last;
  };

  // A body as the ephemeris has it, and which of the states say how it is wrong (-1: none).
  struct Beacon {
    State state, sun;               // barycentric
    Vec3 pull_m_s2 = Vec3::Zero();  // acceleration beside what the Sun pulls: the Moon's, by the Earth
    double radius_m = 0.0;
    Eigen::Matrix<double, 3, 2> along_and_across;  // of its orbit and the orbit's plane: the directions of xi_e
    int light = -1, place = -1;
  };
  struct SightPrediction {
    Sight sight;
    Eigen::Matrix<double, 3, kStates> by_state;  // of the direction by the non-dimensional state
  };
  using Dynamic = Eigen::Matrix<double, kDynamicStates, kDynamicStates>;
  using MeasurementMatrix = Eigen::Matrix<double, 2, kStates>;
  struct Prediction {
    PixelPrediction pixel;
    MeasurementMatrix by_state;
  };
  Result<Beacon> find(BodyId body, Epoch epoch) const;
  SightPrediction predict(const StateVector& x, const Beacon& beacon) const;
  Result<Prediction> predict(const StateVector& x, const Beacon& beacon, const BeaconMeasurement& measurement) const;
  // A coast since the last accepted sight, to be flown anew from where that sight shows that it began.
  struct Coast {
    Epoch begin;
    StateVector x;
    FactorisedCovariance covariance;
    Dynamic phi = Dynamic::Identity();
  };
  struct Correction {
    Prediction prediction;  // at the updated state
    StateVector pull;       // H' S^-1 innovation: what the measurement says to the prior, before its covariance
    int iterations = 0;
  };
  Result<Correction> correct(const StateVector& prior, const Prediction& at_x, const Beacon& beacon,
                             const BeaconMeasurement& measurement, const Mat2& R);
  Correction correct_beside(const Prediction& at_x, const UpdateResult& foretold);
  Result<void> fly_to(Epoch epoch, Dynamic& phi);
  bool bends(const StateVector& change) const;
  Result<StateVector> fly_anew(const StateVector& pull);
  StateVector ageing_factors(Duration span) const;
  void age(Duration span);
  Duration longest_pause() const;
  void start_window(const BeaconMeasurement& measurement, const PixelPrediction& prediction);
  bool recover(const MeasurementMatrix& by_state);
  bool undo(const MeasurementMatrix& by_state, const Vec2& mean);
  bool allow_push(const MeasurementMatrix& by_state, const Vec2& mean);
  bool allow_displacement(const MeasurementMatrix& by_state, const Vec2& mean);
  int beacon_of(BodyId body) const;          // index into the beacon errors, or -1
  BeaconErrors errors_of(int beacon) const;  // none where there is no such beacon
  NoiseScale* scale_of(BodyId body);
  Seen* seen_of(BodyId body);
  double excess_of_window(BodyId body, Epoch epoch);

  FilterSettings settings_;
  const Ephemeris* ephemeris_;
  Process process_;
  Thrust thrust_;
  double gate_ = 0.0;
  Epoch epoch_;
  StateVector x_ = StateVector::Zero();       // non-dimensional
  bool along_ = false;                        // between fly_beside() and join()
  StateVector beside_ = StateVector::Zero();  // then the mean less x_
  Dynamic way_ = Dynamic::Identity();         // sensitivities since then
  FactorisedCovariance covariance_;           // non-dimensional
  BodyId last_body_;
  std::optional<Epoch> last_image_, last_accepted_;
  std::optional<Coast> coast_;
  Rejections rejections_;
  int accepted_in_window_ = 0;
  double window_excess_ = 1.0;         // eq. 3a, of this window
  double window_repeating_px2_ = 0.0;  // what the planet's spot was told to repeat when the window began, an axis
  std::array<NoiseScale, 8> noise_scales_{};
  std::array<Seen, 8> seen_{};
};

}  // namespace astronav::navigation
