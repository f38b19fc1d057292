// SPDX-License-Identifier: Apache-2.0
#include "onboard/navigation/triangulation.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>

#include "foundation/math/statistics.h"
#include "models/aberration/aberration.h"

namespace astronav::navigation {
namespace {

bool makes_sense(const LineOfSight& sight) {
  return std::abs(sight.direction_N.norm() - 1.0) < 1e-6 && sight.p_beacon_O_N.allFinite() &&
         sight.covariance_rad2.allFinite() && sight.covariance_rad2.trace() > 0.0 && sight.beacon_sigma_m >= 0.0;
}

Mat2 variance_across(const LineOfSight& sight, const Axes2& across, double distance) {
  return distance * distance * across.transpose() * sight.covariance_rad2 * across +
         sight.beacon_sigma_m * sight.beacon_sigma_m * Mat2::Identity();
}

}  // namespace

Axes2 axes_across(const Vec3& direction) {
  Axes2 axes;
  axes.col(0) = direction.unitOrthogonal();
  axes.col(1) = direction.cross(axes.col(0));
  return axes;
}

Result<Triangulation> triangulate(std::span<const LineOfSight> sights, const TriangulationSettings& settings) {
  if (sights.size() < 2)
    return fail(ErrorCode::invalid_argument, "{0} lines of sight; a place needs two",
                {static_cast<double>(sights.size())});
  for (const LineOfSight& sight : sights)
    if (!makes_sense(sight))
      return fail(ErrorCode::invalid_argument,
                  "a line of sight that is not finite, not of length 1 or without variance");

  // About the first beacon, so that light years do not swallow the digits of a place between planets.
  const Vec3 origin = sights[0].p_beacon_O_N;
  Vec3 place = Vec3::Zero();
  Mat3 information;
  // Each round shrinks the error of the distances by the size of a sight's error; the first has them equal.
  constexpr int kRounds = 5;
  for (int round = 0; round < kRounds; ++round) {
    information.setZero();
    Vec3 sum = Vec3::Zero();
    for (const LineOfSight& sight : sights) {
      const Vec3 beacon = sight.p_beacon_O_N - origin;
      const auto across = axes_across(sight.direction_N);
      Mat2 weight = Mat2::Identity();
      if (round > 0) weight = variance_across(sight, across, (beacon - place).norm()).inverse();
      const Mat3 share = across * weight * across.transpose();
      information += share;
      sum += share * beacon;
    }
    const Eigen::LDLT<Mat3> ldlt(information);
    if (ldlt.info() != Eigen::Success || !(ldlt.rcond() > std::numeric_limits<double>::epsilon()))
      return fail(ErrorCode::no_match, "the sights are {s}", {}, {}, "parallel");
    place = ldlt.solve(sum);
  }

  Triangulation out;
  out.p_O_N = origin + place;
  out.covariance_m2 = information.inverse();
  out.degrees_of_freedom = 2 * static_cast<int>(sights.size()) - 3;
  double nearest = std::numeric_limits<double>::infinity();
  for (const LineOfSight& sight : sights) nearest = std::min(nearest, (sight.p_beacon_O_N - origin - place).norm());
  const double worst = std::sqrt(Eigen::SelfAdjointEigenSolver<Mat3>(out.covariance_m2).eigenvalues().maxCoeff());
  if (!(worst < settings.most_sigma_share * nearest))
    return fail(ErrorCode::no_match, "the sights are {s}: the place is known to {0} of the way to the nearest beacon",
                {worst / nearest}, {}, "parallel");
  for (const LineOfSight& sight : sights) {
    const Vec3 to = sight.p_beacon_O_N - origin - place;
    if (to.dot(sight.direction_N) <= 0.0)
      return fail(ErrorCode::no_match, "where the sights meet, a beacon is {s}", {}, {}, "behind");
    const auto across = axes_across(sight.direction_N);
    const Vec2 off = across.transpose() * to;
    out.chi2 += off.dot(variance_across(sight, across, to.norm()).inverse() * off);
  }
  if (chi_square_exceedance(out.chi2, out.degrees_of_freedom) < settings.least_probability)
    return fail(ErrorCode::no_match, "the sights pass {s}: chi-square {0} with {1} degrees of freedom",
                {out.chi2, static_cast<double>(out.degrees_of_freedom)}, {}, "apart");
  return out;
}

Result<Triangulation> triangulate(const Ephemeris& ephemeris, Epoch epoch, const Vec3& v_observer_O_N,
                                  std::span<const BodySight> sights, const TriangulationSettings& settings) {
  if (sights.size() > kMaxBodySights)
    return fail(ErrorCode::invalid_argument, "{0} lines of sight; {1} at most",
                {static_cast<double>(sights.size()), static_cast<double>(kMaxBodySights)});
  std::array<LineOfSight, kMaxBodySights> lines;
  for (std::size_t i = 0; i < sights.size(); ++i) {
    const Result<State> body = ephemeris.state(sights[i].body, body::solar_system_barycenter, epoch);
    if (!body) return forward(body);
    lines[i] = {unaberrate(sights[i].direction_N, v_observer_O_N), sights[i].covariance_rad2, body->p_m,
                sights[i].ephemeris_sigma_m};
  }
  const std::span<const LineOfSight> used(lines.data(), sights.size());
  // Without light time the place is wrong by the planets' way of minutes: 1e-4 of the distance, and less by that factor
  // with each round. Only the last must satisfy the chi-square.
  TriangulationSettings lenient = settings;
  lenient.least_probability = 0.0;
  constexpr int kRounds = 3;
  for (int round = 0; round < kRounds; ++round) {
    const auto place = triangulate(used, lenient);
    if (!place) return place;
    const State observer{place->p_O_N, v_observer_O_N};
    for (std::size_t i = 0; i < sights.size(); ++i) {
      const Result<LightTime> seen = light_time(ephemeris, sights[i].body, observer, epoch);
      if (!seen) return forward(seen);
      lines[i].p_beacon_O_N = observer.p_m + seen->relative.p_m;
    }
  }
  return triangulate(used, settings);
}

}  // namespace astronav::navigation
