// SPDX-License-Identifier: Apache-2.0
#include "onboard/navigation/process.h"

#include "onboard/navigation/arc_for_tests.h"

namespace astronav::navigation {
namespace {

using namespace testing;

class Flight : public ::testing::Test {
 protected:
  using Dynamic = Eigen::Matrix<double, kDynamicStates, kDynamicStates>;
  ProcessSettings settings;

  static StateVector scaled(const State& s, double mass) {
    StateVector x = StateVector::Zero();
    x.head<3>() = s.p_m / unit::length_m;
    x.segment<3>(3) = s.v_m_s / unit::velocity_m_s;
    x[index::mass] = mass;
    return x;
  }
  static State unscaled(const StateVector& x) {
    return {x.head<3>() * unit::length_m, x.segment<3>(3) * unit::velocity_m_s};
  }

  StateVector propagate(StateVector x, Epoch from, Duration span, const Thrust& thrust = {}, Dynamic* phi = nullptr,
                        Dynamic* q = nullptr, int* steps = nullptr) const {
    Process process(settings, kernel());
    const Epoch end = from + span;
    Transition step;
    if (phi) phi->setIdentity();
    if (q) q->setZero();
    while (from < end) {
      const Duration h = std::min(process.step_length(from, x).value(), end - from);
      EXPECT_TRUE(process.step(from, h, thrust, x, step));
      if (phi) *phi = (step.phi * *phi).eval();
      if (q) *q = (step.phi * *q * step.phi.transpose() + step.n * step.q.asDiagonal() * step.n.transpose()).eval();
      if (steps) ++*steps;
      from = from + h;
    }
    return x;
  }
};

TEST_F(Flight, TenDaysOfCoastAreWithinAMetreOfAnotherIntegrator) {
  const double mass = 25.0;
  const double pressure = 4.56e-6 * settings.reflectivity_area_m2 / mass;
  State truth = cruise_start().state;
  Epoch epoch = cruise_start().epoch;
  for (int leg = 0; leg < 6; ++leg) {
    const Duration span = Duration::days(10.0);
    int steps = 0;
    const State mine = unscaled(propagate(scaled(truth, mass), epoch, span, {}, nullptr, nullptr, &steps));
    truth = fly(truth, epoch, span, pressure);
    EXPECT_LT((mine.p_m - truth.p_m).norm(), 1.0) << "leg " << leg << ", " << steps << " steps";
    EXPECT_LT((mine.v_m_s - truth.v_m_s).norm(), 1e-5);
    EXPECT_LT(steps, 100);
    truth = fly(truth, epoch + span, Duration::days(40.0), pressure);
    epoch = epoch + span + Duration::days(40.0);
  }
}

TEST_F(Flight, AttractionsAddUpInBarycentricAxesAndNeptuneMayNotBeLeftOut) {
  ProcessSettings few = settings;
  settings.attractors[8] = settings.attractors[9] = BodyId{};
  const Start& s = cruise_start();
  const State without = unscaled(propagate(scaled(s.state, 25.0), s.epoch, Duration::days(10.0)));
  settings = few;
  const State with = unscaled(propagate(scaled(s.state, 25.0), s.epoch, Duration::days(10.0)));
  EXPECT_GT((with.p_m - without.p_m).norm(), 50.0);
}

TEST_F(Flight, TransitionMatrixAgreesWithCentralDifferences) {
  const Start& s = cruise_start();
  Thrust thrust{.force_n = 1e-3, .specific_impulse_s = 3000.0, .direction_N = Vec3(0.6, -0.64, 0.48)};
  StateVector x = scaled(s.state, 25.0);
  x.segment<3>(index::acceleration) = Vec3(2e-8, -1e-8, 3e-8) / unit::acceleration_m_s2;
  x.segment<3>(index::thrust) = Vec3(0.01, -0.02, 0.015);
  for (const bool on : {false, true}) {
    const Thrust now = on ? thrust : Thrust{};
    const Duration span = Duration::days(3.0);
    Dynamic phi;
    propagate(x, s.epoch, span, now, &phi);
    Eigen::Matrix<double, kDynamicStates, 1> steps;
    steps << Vec3::Constant(1e-6), Vec3::Constant(1e-6), 1e-2, Vec3::Constant(1e-4), Vec3::Constant(1e-3), 1e-3;
    for (int j = 0; j < kDynamicStates; ++j) {
      StateVector up = x, down = x;
      up[j] += steps[j];
      down[j] -= steps[j];
      const StateVector numeric =
          (propagate(up, s.epoch, span, now) - propagate(down, s.epoch, span, now)) / (2.0 * steps[j]);
      for (int i = 0; i < kDynamicStates; ++i) {
        // Six digits of the largest entry in the same triple of rows.
        const double scale = phi.col(j).segment(i - (i < 6 ? i % 3 : 0), i < 6 ? 3 : 1).cwiseAbs().maxCoeff();
        EXPECT_NEAR(phi(i, j), numeric[i], 1e-5 * scale + 1e-8) << i << ' ' << j << " thrust " << on;
      }
    }
  }
}

TEST_F(Flight, ThrustAndItsErrorsAreFlownAsAnotherIntegratorFliesThem) {
  const Start& s = cruise_start();
  const Thrust thrust{.force_n = 1.5e-3, .specific_impulse_s = 3000.0, .direction_N = Vec3(0.0, 0.6, 0.8)};
  settings.thrust_magnitude.tau_s = settings.thrust_pointing.tau_s = 1e12;  // constant errors
  StateVector x = scaled(s.state, 25.0);
  x[index::thrust] = 0.02;
  const double flow = thrust.force_n / (3000.0 * 9.80665);
  const State truth = fly(s.state, s.epoch, Duration::days(5.0), 0.0, [&](double t) -> Vec3 {
    return thrust.force_n / (25.0 - flow * t) * 1.02 * thrust.direction_N;
  });
  settings.reflectivity_area_m2 = 0.0;
  const StateVector end = propagate(x, s.epoch, Duration::days(5.0), thrust);
  EXPECT_LT((unscaled(end).p_m - truth.p_m).norm(), 1.0);
  EXPECT_NEAR(end[index::mass], 25.0 - flow * 5.0 * 86400.0, 1e-9);
}

// Q against a Monte Carlo that drives the acceleration with small exact steps and integrates it twice, no gravity
// needed: the closed form of a double integral of a Gauss-Markov process.
TEST_F(Flight, ProcessNoiseIsThatOfTheContinuousLaw) {
  const Start& s = cruise_start();
  const double days = 10.0, T = days * 86400.0, tau = settings.acceleration.tau_s, sigma = settings.acceleration.sigma;
  Dynamic q;
  propagate(scaled(s.state, 25.0), s.epoch, Duration::days(days), {}, nullptr, &q);
  const double e = std::exp(-T / tau);
  // Variance of velocity by noise alone (initial xi zero): Gelb 1974, problem 3-8, and numerically below.
  const double velocity2 = sigma * sigma * tau * tau * (2.0 * T / tau - 3.0 + 4.0 * e - e * e);
  double position2 = 0.0;
  const int n = 200000;
  for (int i = 0; i < n; ++i) {
    const double u = (i + 0.5) * T / n;
    const double g = tau * (u - tau * (1.0 - std::exp(-u / tau)));
    position2 += 2.0 * sigma * sigma / tau * g * g * T / n;
  }
  for (int axis = 0; axis < 3; ++axis) {
    EXPECT_NEAR(std::sqrt(q(7 + axis, 7 + axis)) * unit::acceleration_m_s2, sigma * std::sqrt(1.0 - e * e),
                1e-6 * sigma);
    EXPECT_NEAR(std::sqrt(q(3 + axis, 3 + axis)) * unit::velocity_m_s / std::sqrt(velocity2), 1.0, 0.02);
    EXPECT_NEAR(std::sqrt(q(axis, axis)) * unit::length_m / std::sqrt(position2), 1.0, 0.02);
  }
}

TEST(Process, StatesOfTheCameraAgeByTheirLaws) {
  AgeingLaws laws;
  laws[index::bias - kDynamicStates] = {.sigma = 1e-3, .tau_s = 1e5};
  laws[index::ephemeris - kDynamicStates] = {.sigma = 1e5, .tau_s = 1e8};
  const Process process({}, kernel(), laws);
  const double T = 864000.0;
  const Process::Ageing ageing = process.ageing(Duration::seconds(T));
  const int bias = index::bias - kDynamicStates, place = index::ephemeris - kDynamicStates;
  EXPECT_NEAR(ageing.factor[bias], std::exp(-T / 1e5), 1e-15);
  EXPECT_NEAR(ageing.variance[bias], 1e-6 * (1.0 - std::exp(-2.0 * T / 1e5)), 1e-18);
  EXPECT_NEAR(std::sqrt(ageing.variance[place]) * unit::length_m, 1e5 * std::sqrt(1.0 - std::exp(-2.0 * T / 1e8)),
              1e-3);
  EXPECT_EQ(ageing.factor[bias + 1], 1.0);
  EXPECT_EQ(ageing.variance[bias + 1], 0.0);
}

TEST(Process, SaysWhatIsWrongWithItsSettings) {
  ProcessSettings settings;
  EXPECT_TRUE(Process(settings, kernel()).check(departure()));
  EXPECT_EQ(Process(settings, kernel()).check(Epoch::parse("2199-01-01 TDB").value()).error().code,
            ErrorCode::out_of_range);
  AgeingLaws laws;
  laws[0] = {.sigma = 1.0, .tau_s = 0.0};
  EXPECT_EQ(Process(settings, kernel(), laws).check(departure()).error().code, ErrorCode::invalid_argument);
  settings.attractors[0] = body::venus_barycenter;
  EXPECT_EQ(Process(settings, kernel()).check(departure()).error().code, ErrorCode::invalid_argument);
}

}  // namespace
}  // namespace astronav::navigation
