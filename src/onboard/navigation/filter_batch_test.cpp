// SPDX-License-Identifier: Apache-2.0
// The images of a window one after the other through the filter, and all at once through one update that stands here.
#include <Eigen/Cholesky>

#include "onboard/navigation/campaign_for_tests.h"
#include "onboard/navigation/filter.h"

namespace astronav::navigation {
namespace {

using namespace testing;

// A state known so well, and images so sharp, that no sight bends: then all is linear, and the two must agree to
// rounding. The stacked update knows nothing of factors, iterations and windows: it takes Gauss's conditional mean of
// the last state, given all pixels, from the joint covariance of a process with noise.
TEST(FilterBatch, AWindowAtOnceIsAWindowImageByImage) {
  FilterSettings settings = campaign_settings();
  settings.bias = {.sigma = 1e-6, .tau_s = 3600.0};
  settings.focal.sigma = 1e-8;
  settings.k1.sigma = 1e-5;
  settings.gate_probability = 1.0;
  const Epoch begin = cruise_start().epoch;
  const State start = cruise_start().state;
  const Mat6 P0 = diagonal_covariance(1e3, 0.1);
  Filter filter(settings, kernel());
  ASSERT_TRUE(filter.initialise({begin, start, P0}));

  const StateVector units = state_scales();
  const StateMatrix inverse = StateMatrix(units.cwiseInverse().asDiagonal());
  Process process = process_of(settings, kernel());
  StateVector x = filter.state_vector().cwiseQuotient(units);
  StateMatrix P = inverse * filter.covariance() * inverse;

  constexpr int n = kImages;
  using Rows = Eigen::Matrix<double, 2, kStates>;
  std::vector<Eigen::Matrix<double, kStates, 2>> shared;  // of the state now with the pixels so far
  Eigen::VectorXd residual(2 * n);
  Eigen::MatrixXd S = Eigen::MatrixXd::Zero(2 * n, 2 * n);
  RandomStream random({.seed = 31, .purpose = "batch"});
  State truth = start;
  truth.p_m += Vec3(800.0, -1200.0, 500.0);
  truth.v_m_s += Vec3(0.1, 0.05, -0.12);
  for (int k = 0; k < n; ++k) {
    const Duration h_k = k == 0 ? Duration() : kImagePeriod;
    const Epoch epoch = begin + kImagePeriod * k;
    if (k > 0) {
      truth = fly(truth, epoch - h_k, h_k);
      Transition t;
      ASSERT_TRUE(process.step(epoch - h_k, h_k, {}, x, t));
      const Process::Ageing ageing = process.ageing(h_k);
      StateMatrix phi = StateMatrix::Zero();
      phi.topLeftCorner<kDynamicStates, kDynamicStates>() = t.phi;
      phi.diagonal().tail<kAgeingStates>() = ageing.factor;
      P = (phi * P * phi.transpose()).eval();
      P.topLeftCorner<kDynamicStates, kDynamicStates>() += t.n * t.q.asDiagonal() * t.n.transpose();
      P.diagonal().tail<kAgeingStates>() += ageing.variance;
      for (auto& c : shared) c = (phi * c).eval();
    }
    const BeaconMeasurement m =
        photograph(truth, body::mars, epoch, settings.camera, {.pixel = 1e-5, .cross = 1e-10, .roll = 1e-9}, &random,
                   Eigen::Vector4d::Zero(), {150.0, -100.0});
    filter.update(m);

    const State here{x.segment<3>(index::position) * unit::length_m,
                     x.segment<3>(index::velocity) * unit::velocity_m_s};
    const Sight sight =
        apparent_sight(here, barycentric(body::mars, epoch), barycentric(body::sun, epoch).p_m, 0.0, settings.sight);
    const PixelPrediction p = predict_pixel(sight, m.R_CN, settings.camera, x.segment<4>(index::camera)).value();
    Rows rows = Rows::Zero();
    rows.middleCols<3>(index::position) = p.by_position * unit::length_m;
    rows.middleCols<3>(index::velocity) = p.by_velocity * unit::velocity_m_s;
    rows.middleCols<4>(index::camera) = p.by_camera;
    residual.segment<2>(2 * k) = m.pixel.vec() - p.pixel;
    for (int j = 0; j < k; ++j) {
      S.block<2, 2>(2 * k, 2 * j) = rows * shared[static_cast<std::size_t>(j)];
      S.block<2, 2>(2 * j, 2 * k) = S.block<2, 2>(2 * k, 2 * j).transpose();
    }
    shared.push_back(P * rows.transpose());
    S.block<2, 2>(2 * k, 2 * k) = rows * shared.back() + m.pixel_covariance_px2 +
                                  p.by_attitude * m.attitude_covariance_rad2 * p.by_attitude.transpose();
  }
  Eigen::MatrixXd cross(kStates, 2 * n);
  for (int k = 0; k < n; ++k) cross.middleCols<2>(2 * k) = shared[static_cast<std::size_t>(k)];
  const Eigen::LLT<Eigen::MatrixXd> llt(S);
  const StateVector change = cross * llt.solve(residual);
  const StateMatrix after = P - cross * llt.solve(cross.transpose());

  const StateVector sequential = filter.state_vector().cwiseQuotient(units);
  const StateMatrix covariance = inverse * filter.covariance() * inverse;
  double largest_state = 0.0, largest_covariance = 0.0, least_gain = 1.0;
  for (int i = 0; i < kStates; ++i) {
    if (!(after(i, i) > 0.0)) continue;
    const double sigma_i = std::sqrt(after(i, i));
    largest_state = std::max(largest_state, std::abs(sequential[i] - x[i] - change[i]) / sigma_i);
    least_gain = std::min(least_gain, after(i, i) / P(i, i));
    for (int j = 0; j < kStates; ++j)
      if (after(j, j) > 0.0)
        largest_covariance =
            std::max(largest_covariance, std::abs(covariance(i, j) - after(i, j)) / (sigma_i * std::sqrt(after(j, j))));
  }
  RecordProperty("state_sigmas", std::to_string(1e9 * largest_state) + "e-9");
  RecordProperty("covariance", std::to_string(1e9 * largest_covariance) + "e-9");
  EXPECT_LT(largest_state, 1e-5);
  EXPECT_LT(largest_covariance, 1e-5);
  EXPECT_LT(least_gain, 0.5);  // the images say something
}

}  // namespace
}  // namespace astronav::navigation
