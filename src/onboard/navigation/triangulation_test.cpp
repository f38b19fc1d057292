// SPDX-License-Identifier: Apache-2.0
#include "onboard/navigation/triangulation.h"

#include <algorithm>
#include <vector>

#include <Eigen/Eigenvalues>
#include <gtest/gtest.h>

#include "foundation/math/statistics.h"
#include "onboard/navigation/arc_for_tests.h"
#include "onboard/navigation/measurement_model.h"

namespace astronav::navigation {
namespace {

using testing::barycentric;
using testing::exact_direction;
using testing::kernel;

Epoch noon() {
  return Epoch::parse("2027-03-01T12:00:00 TDB").value();
}
// Between Earth and Mars, moving as a spacecraft does.
State observer() {
  const State earth = barycentric(body::earth, noon()), mars = barycentric(body::mars_barycenter, noon());
  return {0.6 * earth.p_m + 0.4 * mars.p_m + Vec3(2e10, -3e10, 1e9), 0.5 * (earth.v_m_s + mars.v_m_s)};
}

struct Case {
  std::vector<BodyId> bodies;
  std::vector<double> sigma_rad, ephemeris_m;
};

// Sights with errors across themselves, planets that are not quite where the ephemeris has them.
std::vector<BodySight> look(const Case& c, RandomStream& random) {
  std::vector<BodySight> sights;
  for (std::size_t i = 0; i < c.bodies.size(); ++i) {
    const auto seen = light_time(kernel(), c.bodies[i], observer(), noon()).value();
    const Vec3 off(random.normal(), random.normal(), random.normal());
    const Vec3 direction = aberrate((seen.relative.p_m + c.ephemeris_m[i] * off).normalized(), observer().v_m_s) +
                           c.sigma_rad[i] * Vec3(random.normal(), random.normal(), random.normal());
    sights.push_back(
        {c.bodies[i], direction.normalized(), Mat3::Identity() * std::pow(c.sigma_rad[i], 2), c.ephemeris_m[i]});
  }
  return sights;
}

// The Cramer-Rao bound at the truth, by the filter's measurement model.
Mat3 bound(const Case& c) {
  Mat3 information = Mat3::Zero();
  for (std::size_t i = 0; i < c.bodies.size(); ++i) {
    const Sight sight = apparent_sight(observer(), barycentric(c.bodies[i], noon()), barycentric(body::sun, noon()).p_m,
                                       0.0, {.centre_of_light = false});
    const double variance = std::pow(c.sigma_rad[i], 2) + std::pow(c.ephemeris_m[i] / sight.distance_m, 2);
    information += sight.by_position.transpose() * sight.by_position / variance;
  }
  return information.inverse();
}

const Case kCases[] = {
    {{body::earth, body::mars_barycenter}, {1.0 * kArcsecond, 1.0 * kArcsecond}, {0.0, 0.0}},
    // Unequal in every way: a near planet poorly seen, a far one well, another with a poor ephemeris.
    {{body::earth, body::jupiter_barycenter, body::venus_barycenter},
     {20.0 * kArcsecond, 0.3 * kArcsecond, 1.0 * kArcsecond},
     {1e3, 1e5, 3e6}},
    {{body::mercury_barycenter, body::venus_barycenter, body::earth, body::mars_barycenter, body::jupiter_barycenter,
      body::saturn_barycenter},
     {3e-6, 1e-6, 2e-6, 5e-6, 1e-6, 4e-6},
     {0.0, 1e4, 0.0, 1e5, 1e6, 1e6}},
};

TEST(Triangulation, ExactWithoutErrors) {
  for (const Case& c : kCases) {
    std::vector<BodySight> sights;
    for (std::size_t i = 0; i < c.bodies.size(); ++i)
      sights.push_back({c.bodies[i], exact_direction(observer(), c.bodies[i], noon()),
                        Mat3::Identity() * std::pow(c.sigma_rad[i], 2), c.ephemeris_m[i]});
    const auto found = triangulate(kernel(), noon(), observer().v_m_s, sights);
    ASSERT_TRUE(found) << describe(found.error());
    // Directions of 16 digits, over 10 au.
    EXPECT_LT((found->p_O_N - observer().p_m).norm(), 5e3);
    EXPECT_LT(found->chi2, 1e-3);
  }
}

// 4000 triangulations: NEES (3 degrees) and chi-square inside bands that a right program leaves once in 1000 times, the
// scatter within 10 % of the Cramer-Rao bound along each of its axes (a variance of 4000 scatters by 2.2 %).
TEST(Triangulation, AtTheBoundAndConsistent) {
  constexpr int kRuns = 4000;
  for (std::size_t k = 0; k < std::size(kCases); ++k) {
    const Case& c = kCases[k];
    RandomStream random(StreamId{.seed = 7, .sample = k, .purpose = "triangulation"});
    const Mat3 least = bound(c);
    const Eigen::SelfAdjointEigenSolver<Mat3> axes(least);
    double nees = 0.0, chi2 = 0.0;
    Vec3 squares = Vec3::Zero(), formal = Vec3::Zero(), mean_error = Vec3::Zero();
    int dof = 0;
    for (int run = 0; run < kRuns; ++run) {
      const auto sights = look(c, random);
      const auto found = triangulate(kernel(), noon(), observer().v_m_s, sights);
      ASSERT_TRUE(found) << describe(found.error());
      const Vec3 error = found->p_O_N - observer().p_m;
      nees += error.dot(found->covariance_m2.inverse() * error) / kRuns;
      chi2 += found->chi2 / kRuns;
      dof = found->degrees_of_freedom;
      const Vec3 along = axes.eigenvectors().transpose() * error;
      squares += along.cwiseAbs2() / kRuns;
      mean_error += along / kRuns;
      formal += (axes.eigenvectors().transpose() * found->covariance_m2 * axes.eigenvectors()).diagonal() / kRuns;
    }
    EXPECT_TRUE(chi_square_mean_band(0.999, 3, kRuns).contains(nees)) << k << ": " << nees;
    EXPECT_TRUE(chi_square_mean_band(0.999, dof, kRuns).contains(chi2)) << k << ": " << chi2;
    for (int axis = 0; axis < 3; ++axis) {
      EXPECT_NEAR(squares[axis] / axes.eigenvalues()[axis], 1.0, 0.1) << k;
      EXPECT_NEAR(formal[axis] / axes.eigenvalues()[axis], 1.0, 0.01) << k;
      EXPECT_LT(std::abs(mean_error[axis]), 4.0 * std::sqrt(axes.eigenvalues()[axis] / kRuns)) << k;
    }
  }
}

// Equal weights for sights of unequal worth cost accuracy: what the weighting is for.
TEST(Triangulation, WeightsAreWorthIt) {
  const Case& c = kCases[1];
  RandomStream random(StreamId{.seed = 8, .purpose = "weights"});
  double weighted = 0.0, plain = 0.0;
  for (int run = 0; run < 500; ++run) {
    auto sights = look(c, random);
    weighted += (triangulate(kernel(), noon(), observer().v_m_s, sights)->p_O_N - observer().p_m).squaredNorm();
    for (BodySight& sight : sights) {
      sight.covariance_rad2 = Mat3::Identity() * std::pow(60.0 * kArcsecond, 2);
      sight.ephemeris_sigma_m = 0.0;
    }
    plain += (triangulate(kernel(), noon(), observer().v_m_s, sights)->p_O_N - observer().p_m).squaredNorm();
  }
  EXPECT_LT(weighted, 0.5 * plain);
}

LineOfSight line(const Vec3& direction, const Vec3& beacon) {
  return {direction.normalized(), Mat3::Identity() * 1e-10, beacon, 0.0};
}

TEST(Triangulation, NamesWhatIsSingular) {
  const Vec3 x = Vec3::UnitX(), y = Vec3::UnitY();
  const auto reason = [](const std::vector<LineOfSight>& lines) -> std::string {
    const auto found = triangulate(lines);
    EXPECT_FALSE(found);
    if (found) return "";
    EXPECT_EQ(found.error().code, ErrorCode::no_match);
    return std::string(found.error().subject.view());
  };
  EXPECT_EQ(reason({line(x, 1e11 * x), line(x, 2e11 * x)}), "parallel");
  EXPECT_EQ(reason({line(x, 1e11 * x), line(-x, -2e11 * x)}), "parallel");
  // Parallel within the errors of 2 arcsec: 5 arcsec apart.
  EXPECT_EQ(reason({line(x, 1e11 * x), line(x + 2.4e-5 * y, 1e11 * (x + 2.4e-5 * y))}), "parallel");
  EXPECT_EQ(reason({line(-x, 1e11 * x), line(-y, 1e11 * y)}), "behind");
  EXPECT_EQ(reason({line(x, 1e11 * x), line(y, 1e11 * (y + 0.01 * Vec3::UnitZ()))}), "apart");
  // A tenth of a degree is enough for a place.
  EXPECT_TRUE(triangulate(std::vector{line(x, 1e11 * x), line(x + 1.7e-3 * y, 1e11 * (x + 1.7e-3 * y))}));
}

TEST(Triangulation, RefusesWhatMakesNoSense) {
  const LineOfSight good = line(Vec3::UnitX(), 1e11 * Vec3::UnitX());
  LineOfSight blind = line(Vec3::UnitY(), 1e11 * Vec3::UnitY()), bad = blind;
  blind.covariance_rad2.setZero();
  bad.direction_N.x() = std::nan("");
  EXPECT_EQ(triangulate(std::span(&good, 1)).error().code, ErrorCode::invalid_argument);
  EXPECT_EQ(triangulate(std::vector{good, blind}).error().code, ErrorCode::invalid_argument);
  EXPECT_EQ(triangulate(std::vector{good, bad}).error().code, ErrorCode::invalid_argument);
  const BodySight nowhere{BodyId{-98}, Vec3::UnitX(), Mat3::Identity() * 1e-10, 0.0};
  EXPECT_FALSE(triangulate(kernel(), noon(), Vec3::Zero(), std::vector{nowhere, nowhere}));
}

}  // namespace
}  // namespace astronav::navigation
