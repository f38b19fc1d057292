// SPDX-License-Identifier: Apache-2.0
#include "onboard/navigation/beacons.h"

#include <algorithm>
#include <cmath>

#include "foundation/math/rotation.h"
#include "models/photometry/photometry.h"
#include "onboard/navigation/measurement_model.h"
#include "onboard/navigation/triangulation.h"

namespace astronav::navigation {
namespace {

struct Neighbour {
  BodyId body;
  Vec3 direction_N;
  double v_magnitude;
};

// Direction, brightness and size of a body; false where ephemeris or magnitude law lack it.
bool observe(const Ephemeris& ephemeris, const State& observer, const State& sun, Epoch epoch, BodyId body,
             BeaconCandidate& out) {
  out.body = body;
  const Result<State> place = ephemeris.state(body, body::solar_system_barycenter, epoch);
  const Result<BodyConstants> constants = body_constants(body);
  if (!place || !constants) return false;
  const Sight sight = apparent_sight(observer, *place, sun.p_m, 0.0, {.centre_of_light = false});
  const Illumination light{
      .p_body_from_sun_N = observer.p_m + sight.p_body_from_observer_N - sun.p_m,
      .p_body_from_observer_N = sight.p_body_from_observer_N,
      .epoch = epoch - Duration::seconds(sight.light_time_s),
  };
  const Result<double> magnitude = planet_v_magnitude(body, light);
  if (!magnitude) return false;
  out.direction_N = sight.direction_N;
  out.v_magnitude = *magnitude;
  out.sun_elongation_rad = angle_between(sight.direction_N, sun.p_m - observer.p_m);
  out.distance_m = sight.distance_m;
  out.phase_angle_rad = phase_angle(light);
  out.angular_diameter_rad = 2.0 * constants->mean_radius_m / sight.distance_m;
  return true;
}

// One sight of a beacon: what stands across it is measured.
Mat6 after_sight(const Mat6& P, const BeaconCandidate& beacon) {
  Eigen::Matrix<double, 2, 6> H = Eigen::Matrix<double, 2, 6>::Zero();
  H.leftCols<3>() = axes_across(beacon.direction_N).transpose();
  const Mat2 R = Mat2::Identity() * beacon.sigma_across_m * beacon.sigma_across_m;
  const Eigen::Matrix<double, 6, 2> gain = P * H.transpose() * Mat2(H * P * H.transpose() + R).inverse();
  Mat6 keep = Mat6::Identity();
  keep -= gain * H;
  return keep * P * keep.transpose() + gain * R * gain.transpose();
}

}  // namespace

double slew_time_s(const Agility& agility, double angle_rad) {
  const double rate = agility.max_rate_rad_s, acceleration = agility.max_acceleration_rad_s2;
  const bool reaches_rate = angle_rad > rate * rate / acceleration;
  return agility.settle_s +
         (reaches_rate ? angle_rad / rate + rate / acceleration : 2.0 * std::sqrt(angle_rad / acceleration));
}

double filter_merit_m(const Mat6& covariance, const BeaconCandidate& first, const BeaconCandidate& second,
                      double gap_s) {
  Mat6 phi = Mat6::Identity();
  phi.topRightCorner<3, 3>() = gap_s * Mat3::Identity();
  const Mat6 P = after_sight(phi * after_sight(covariance, first) * phi.transpose(), second);
  return std::sqrt(P.diagonal().head<3>().sum());
}

const char* name(BeaconVerdict verdict) {
  switch (verdict) {
    case BeaconVerdict::usable:
      return "usable";
    case BeaconVerdict::sun_exclusion:
      return "Sun exclusion";
    case BeaconVerdict::too_faint:
      return "too faint";
    case BeaconVerdict::too_large:
      return "too large";
    case BeaconVerdict::blended:
      return "close to another body";
    case BeaconVerdict::no_ephemeris:
      return "not in the ephemeris";
  }
  return "";
}

const BeaconCandidate* BeaconSelection::best_single() const& {
  const BeaconCandidate* best = nullptr;
  for (const BeaconCandidate& candidate : candidates())
    if (candidate.usable() && (!best || candidate.sigma_across_m < best->sigma_across_m)) best = &candidate;
  return best;
}

Result<BeaconSelection> select_beacons(const Ephemeris& ephemeris, const State& observer, Epoch epoch,
                                       const BeaconSettings& settings, const Mat6* covariance) {
  if (settings.mode == BeaconMode::filter_merit && covariance == nullptr)
    return fail(ErrorCode::invalid_argument, "beacons by the filter's merit need its covariance");
  const Result<State> sun = ephemeris.state(body::sun, body::solar_system_barycenter, epoch);
  if (!sun) return forward(sun);

  // What could stand beside a beacon: all planets and the Moon, whether candidates or not.
  constexpr BodyId kBright[] = {body::mercury, body::venus,   body::earth, body::moon,
                                body::mars,    body::jupiter, body::saturn};
  std::array<Neighbour, std::size(kBright)> neighbours;
  int neighbour_count = 0;
  for (const BodyId body : kBright) {
    BeaconCandidate seen;
    if (observe(ephemeris, observer, *sun, epoch, body, seen))
      neighbours[neighbour_count++] = {body, seen.direction_N, seen.v_magnitude};
  }

  BeaconSelection selection;
  for (int i = 0; i < kMaxBeacons && settings.candidates[i] != BodyId{}; ++i) {
    BeaconCandidate& candidate = selection.all[selection.candidate_count++];
    if (!observe(ephemeris, observer, *sun, epoch, settings.candidates[i], candidate)) continue;
    candidate.sigma_across_m =
        std::hypot(candidate.distance_m * settings.sight_sigma_rad, settings.ephemeris_sigma_m[i]);
    candidate.nearest_rad = kPi;
    for (int k = 0; k < neighbour_count; ++k) {
      const Neighbour& other = neighbours[k];
      if (other.body == candidate.body || other.v_magnitude > candidate.v_magnitude + settings.blend_magnitudes)
        continue;
      const double separation = angle_between(candidate.direction_N, other.direction_N);
      if (separation >= candidate.nearest_rad) continue;
      candidate.nearest_rad = separation;
      candidate.nearest = other.body;
    }
    if (candidate.sun_elongation_rad < settings.sun_exclusion_rad) {
      candidate.verdict = BeaconVerdict::sun_exclusion;
    } else if (candidate.v_magnitude > settings.v_magnitude_limit) {
      candidate.verdict = BeaconVerdict::too_faint;
    } else if (candidate.angular_diameter_rad > settings.max_angular_diameter_rad) {
      candidate.verdict = BeaconVerdict::too_large;
    } else if (candidate.nearest_rad < settings.min_separation_rad) {
      candidate.verdict = BeaconVerdict::blended;
    } else {
      candidate.verdict = BeaconVerdict::usable;
    }
  }

  for (int i = 0; i < selection.candidate_count; ++i) {
    for (int j = i + 1; j < selection.candidate_count; ++j) {
      const BeaconCandidate* a = &selection.all[i];
      const BeaconCandidate* b = &selection.all[j];
      if (!a->usable() || !b->usable()) continue;
      if (b->sigma_across_m < a->sigma_across_m) std::swap(a, b);
      const double w1 = 1.0 / (a->sigma_across_m * a->sigma_across_m);
      const double w2 = 1.0 / (b->sigma_across_m * b->sigma_across_m);
      const double sine2 = a->direction_N.cross(b->direction_N).squaredNorm();
      if (!(sine2 > 1e-12)) continue;
      BeaconPair pair{a->body, b->body, angle_between(a->direction_N, b->direction_N),
                      std::sqrt(1.0 / (w1 + w2) + (w1 + w2) / (w1 * w2 * sine2))};
      pair.slew_s = slew_time_s(settings.agility, pair.separation_rad);
      if (pair.slew_s > settings.slew_s) continue;
      if (covariance != nullptr)
        pair.filter_merit_m = filter_merit_m(*covariance, *a, *b, settings.window_s + settings.slew_s);
      selection.ranked[selection.pair_count++] = pair;
    }
  }
  const auto merit = [&](const BeaconPair& pair) {
    return settings.mode == BeaconMode::filter_merit ? pair.filter_merit_m : pair.figure_of_merit_m;
  };
  std::sort(selection.ranked.begin(), selection.ranked.begin() + selection.pair_count,
            [&](const BeaconPair& a, const BeaconPair& b) { return merit(a) < merit(b); });
  return selection;
}

}  // namespace astronav::navigation
