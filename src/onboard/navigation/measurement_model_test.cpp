// SPDX-License-Identifier: Apache-2.0
#include "onboard/navigation/measurement_model.h"

#include "onboard/navigation/arc_for_tests.h"

namespace astronav::navigation {
namespace {

using namespace testing;

Vec3 pull_of_the_earth(BodyId body, Epoch epoch) {
  if (body != body::moon) return Vec3::Zero();
  const Vec3 d = barycentric(body::earth, epoch).p_m - barycentric(body, epoch).p_m;
  return body_constants(body::earth).value().gm_m3_s2 / std::pow(d.norm(), 3) * d;
}

// The worst of 1,000 places 0.05 to 3 AU from the Sun or 1e4 to 1e7 km from the body, with up to 200 km/s in any
// direction (Parker Solar Probe's fastest is 191). Table 1 of docs/theory/navigation.md.
TEST(Sight, AgreesWithIteratedLightTimeAndExactAberrationToAMilliarcsecond) {
  const SightSettings point{.centre_of_light = false};
  RandomStream random({.seed = 21, .purpose = "sights"});
  double without_acceleration = 0.0, first_order = 0.0, without_the_earth = 0.0;
  for (const BodyId id :
       {body::mercury, body::venus, body::earth, body::moon, body::mars, body::jupiter, body::saturn, body::uranus}) {
    double largest = 0.0;
    for (int i = 0; i < 1000; ++i) {
      const Epoch epoch = departure() + Duration::days(random.uniform(0.0, 8000.0));
      const State body = barycentric(id, epoch);
      const Vec3 sun = barycentric(body::sun, epoch).p_m;
      const auto any_direction = [&random] {
        return Vec3(random.normal(), random.normal(), random.normal()).normalized();
      };
      State observer;
      observer.p_m = i % 2 == 0 ? Vec3(sun + random.uniform(0.05, 3.0) * kAstronomicalUnit * any_direction())
                                : Vec3(body.p_m + std::pow(10.0, random.uniform(7.0, 10.0)) * any_direction());
      observer.v_m_s = random.uniform(0.0, 2e5) * any_direction();
      const LightTime exact = light_time(kernel(), id, observer, epoch).value();
      const Vec3 at_rest = exact.relative.p_m.normalized();
      const Vec3 truth = aberrate(at_rest, observer.v_m_s);
      const Vec3 pull = pull_of_the_earth(id, epoch);
      const Sight sight = apparent_sight(observer, body, sun, 0.0, point, pull);
      largest = std::max(largest, angle_between(sight.direction_N, truth));
      EXPECT_NEAR(sight.light_time_s, exact.light_time_s, 1e-3);

      // Each term does something: the body's acceleration (the Sun infinitely far away), the aberration's second order,
      // the Earth's pull on the Moon.
      const Sight linear = apparent_sight(observer, body, Vec3::Constant(1e20), 0.0, point, pull);
      without_acceleration = std::max(without_acceleration, angle_between(linear.direction_N, truth));
      first_order = std::max(first_order, angle_between(aberrate_first_order(at_rest, observer.v_m_s), truth));
      if (id == body::moon)
        without_the_earth = std::max(without_the_earth,
                                     angle_between(apparent_sight(observer, body, sun, 0.0, point).direction_N, truth));
    }
    EXPECT_LT(largest, 1.0 * kMilliarcsecond) << body_name(id);
    RecordProperty(std::string(body_name(id)), std::to_string(largest / kMilliarcsecond));
  }
  EXPECT_GT(without_acceleration, 5.0 * kMilliarcsecond);
  EXPECT_GT(first_order, 10.0 * kMilliarcsecond);
  EXPECT_GT(without_the_earth, 0.5 * kMilliarcsecond);
  RecordProperty("without_acceleration", std::to_string(without_acceleration / kMilliarcsecond));
  RecordProperty("first_order", std::to_string(first_order / kMilliarcsecond));
  RecordProperty("without_the_earth", std::to_string(without_the_earth / kMilliarcsecond));
}

TEST(Sight, LeavingLightTimeOrAberrationOutCostsArcseconds) {
  const State observer = cruise_start().state;
  const Epoch epoch = cruise_start().epoch;
  const State mars = barycentric(body::mars, epoch);
  const Vec3 sun = barycentric(body::sun, epoch).p_m;
  const Vec3 truth = exact_direction(observer, body::mars, epoch);
  const Vec3 no_light_time =
      apparent_sight(observer, mars, sun, 0.0, {.light_time = false, .centre_of_light = false}).direction_N;
  const Vec3 no_aberration =
      apparent_sight(observer, mars, sun, 0.0, {.aberration = false, .centre_of_light = false}).direction_N;
  EXPECT_GT(angle_between(no_light_time, truth) / kArcsecond, 1.0);
  EXPECT_GT(angle_between(no_aberration, truth) / kArcsecond, 1.0);
}

TEST(Sight, CentreOfLightHasLambertsFigures) {
  // Shift in radii by phase: docs/theory/navigation.md eq. 7; figures from an integration over the lit disc below.
  EXPECT_NEAR(lambert_shift(90.0 * kDegree), 3.0 * kPi / 16.0, 1e-12);
  EXPECT_NEAR(lambert_shift(10.0 * kDegree), 0.066, 0.0005);
  EXPECT_NEAR(lambert_shift(120.0 * kDegree), 0.745, 0.0005);
  EXPECT_DOUBLE_EQ(lambert_shift(0.0), 0.0);
  for (const double degrees : {5.0, 30.0, 60.0, 100.0, 150.0}) {
    const double alpha = degrees * kDegree;
    const Vec3 to_sun(std::sin(alpha), 0.0, std::cos(alpha));  // observer at +z
    double light = 0.0, moment = 0.0;
    const int n = 600;
    for (int i = 0; i < n; ++i) {
      for (int j = 0; j < n; ++j) {
        const double x = -1.0 + (i + 0.5) * 2.0 / n, y = -1.0 + (j + 0.5) * 2.0 / n;
        if (x * x + y * y >= 1.0) continue;
        const double brightness = std::max(Vec3(x, y, std::sqrt(1.0 - x * x - y * y)).dot(to_sun), 0.0);
        light += brightness;
        moment += brightness * x;
      }
    }
    EXPECT_NEAR(lambert_shift(alpha), moment / light, 1e-3) << degrees;
  }
}

TEST(Sight, CentreOfLightMovesTowardsTheSun) {
  const State observer{Vec3(kAstronomicalUnit, 0, 0), Vec3::Zero()};
  const State body{Vec3(0, kAstronomicalUnit, 0), Vec3::Zero()};
  const SightSettings plain{.light_time = false, .aberration = false, .centre_of_light = false};
  SightSettings shifted = plain;
  shifted.centre_of_light = true;
  const double radius = 6000e3;
  const Vec3 sun = Vec3::Zero();
  const Sight a = apparent_sight(observer, body, sun, radius, plain);
  const Sight b = apparent_sight(observer, body, sun, radius, shifted);
  const Vec3 moved = b.direction_N - a.direction_N;
  EXPECT_GT(moved.dot(sun - body.p_m), 0.0);
  EXPECT_NEAR(moved.norm() * a.distance_m, radius * lambert_shift(45.0 * kDegree), 1.0);
  shifted.centre_of_light_scale = 0.5;
  EXPECT_NEAR((apparent_sight(observer, body, sun, radius, shifted).direction_N - a.direction_N).norm() / moved.norm(),
              0.5, 1e-6);
}

class PixelDerivatives : public ::testing::Test {
 protected:
  State observer = cruise_start().state;
  Epoch epoch = cruise_start().epoch;
  Intrinsics camera = [] {
    Intrinsics c = twenty_degree_camera();
    c.distortion.k1 = -0.03;
    return c;
  }();
  Eigen::Vector4d xi_c{2e-4, 3e-3, 0.3, -0.2};

  // theta as in measurement.h.
  PixelPrediction at(BodyId body, const State& from, const Vec3& theta, const Eigen::Vector4d& xi) const {
    const Sight sight = apparent_sight(from, barycentric(body, epoch), barycentric(body::sun, epoch).p_m, 3e6, {});
    const Mat3 R = pointed_at(exact_direction(observer, body, epoch), camera, {310.0, -220.0}, 0.7);
    return predict_pixel(sight, rotation_exp(-theta) * R, camera, xi).value();
  }
};

TEST_F(PixelDerivatives, AgreeWithCentralDifferences) {
  for (const BodyId body : {body::venus, body::earth, body::mars, body::jupiter}) {
    const PixelPrediction p = at(body, observer, Vec3::Zero(), xi_c);
    for (int axis = 0; axis < 3; ++axis) {
      const auto difference = [&](auto change, double step) -> Vec2 {
        return (change(step) - change(-step)) / (2.0 * step);
      };
      const Vec2 by_position = difference(
          [&](double h) -> Vec2 {
            State s = observer;
            s.p_m[axis] += h;
            return at(body, s, Vec3::Zero(), xi_c).pixel;
          },
          1e6);
      EXPECT_LT((by_position - p.by_position.col(axis)).norm(), 2e-3 * p.by_position.norm()) << body_name(body);
      const Vec2 by_velocity = difference(
          [&](double h) -> Vec2 {
            State s = observer;
            s.v_m_s[axis] += h;
            return at(body, s, Vec3::Zero(), xi_c).pixel;
          },
          100.0);
      EXPECT_LT((by_velocity - p.by_velocity.col(axis)).norm(), 1e-3 * p.by_velocity.norm()) << body_name(body);
      const Vec2 by_theta =
          difference([&](double h) { return at(body, observer, h * Vec3::Unit(axis), xi_c).pixel; }, 1e-5);
      EXPECT_LT((by_theta - p.by_attitude.col(axis)).norm(), 1e-6 * p.by_attitude.norm()) << body_name(body);
    }
    for (int i = 0; i < 4; ++i) {
      const double h = 1e-5;
      const Vec2 by_xi = (at(body, observer, Vec3::Zero(), xi_c + h * Eigen::Vector4d::Unit(i)).pixel -
                          at(body, observer, Vec3::Zero(), xi_c - h * Eigen::Vector4d::Unit(i)).pixel) /
                         (2.0 * h);
      EXPECT_LT((by_xi - p.by_camera.col(i)).norm(), 1e-3 * p.by_camera.col(i).norm()) << i;
    }
  }
}

// Without the centre of light, whose turning is left out on purpose, the position's derivative is exact.
TEST_F(PixelDerivatives, OfPositionIsExactForAPoint) {
  const State venus = barycentric(body::venus, epoch);
  const Vec3 sun = barycentric(body::sun, epoch).p_m;
  const SightSettings point{.centre_of_light = false};
  const Sight sight = apparent_sight(observer, venus, sun, 0.0, point);
  for (int axis = 0; axis < 3; ++axis) {
    State up = observer, down = observer;
    up.p_m[axis] += 1e6;
    down.p_m[axis] -= 1e6;
    const Vec3 numeric = (apparent_sight(up, venus, sun, 0.0, point).direction_N -
                          apparent_sight(down, venus, sun, 0.0, point).direction_N) /
                         2e6;
    EXPECT_LT((numeric - sight.by_position.col(axis)).norm(), 1e-6 * sight.by_position.norm());
  }
}

}  // namespace
}  // namespace astronav::navigation
