// SPDX-License-Identifier: Apache-2.0
#include "onboard/navigation/batch.h"

#include <algorithm>
#include <array>
#include <bitset>
#include <cmath>

#include <Eigen/Cholesky>

#include "foundation/math/statistics.h"
#include "onboard/navigation/measurement_model.h"

namespace astronav::navigation {
namespace {

// Position, velocity, mass, acceleration: the head of the filter's state.
constexpr int kGlobal = 10;
// Bias (2) and drift across the window (2).
constexpr int kLocal = 4;
using Global = Eigen::Matrix<double, kGlobal, 1>;
using GlobalMatrix = Eigen::Matrix<double, kGlobal, kGlobal>;
using Local = Eigen::Matrix<double, kLocal, 1>;
using LocalMatrix = Eigen::Matrix<double, kLocal, kLocal>;
using Cross = Eigen::Matrix<double, kGlobal, kLocal>;

constexpr double kHuber = 2.5;       // sigma, from which on a sight pulls no harder
constexpr int kGatedFrom = 4;        // the iteration from which on what is beyond the gate takes no part
constexpr double kConverged = 0.01;  // sigma, of the step

struct WindowSpan {
  std::size_t begin = 0, end = 0;  // of sights
};

class Batch {
 public:
  Batch(const Ephemeris& ephemeris, std::span<const BatchSight> sights, const BatchSettings& settings)
      : ephemeris_(ephemeris),
        sights_(sights),
        settings_(settings),
        process_(settings.process, ephemeris),
        gate_(chi_square_quantile(settings.gate_probability, 2.0)) {}

  Result<void> check() const;
  Result<void> split();
  Result<BatchSolution> solve(const BatchStart& start);

 private:
  struct Normal {
    GlobalMatrix n = GlobalMatrix::Zero();
    Global g = Global::Zero();
    double chi2 = 0.0;
  };
  struct LocalFit {  // nuisances of a window as they follow from the step of the rest: z - m step
    Local z = Local::Zero();
    Eigen::Matrix<double, kLocal, kGlobal> m = Eigen::Matrix<double, kLocal, kGlobal>::Zero();
  };
  // State and sensitivities, carried along.
  struct Flow {
    Epoch epoch;
    StateVector x;
    GlobalMatrix phi = GlobalMatrix::Identity();
  };

  Result<void> carry(Flow& flow, Epoch to);
  Result<Normal> pass(const BatchStart& start, const StateVector& x0, int iteration);
  Result<void> add_window(std::size_t window, Flow& flow, int iteration, Normal& normal);

  const Ephemeris& ephemeris_;
  std::span<const BatchSight> sights_;
  const BatchSettings& settings_;
  Process process_;
  double gate_;
  std::array<WindowSpan, kMaxBatchWindows> windows_{};
  std::size_t window_count_ = 0;
  std::array<LocalFit, kMaxBatchWindows> local_{};
  Global step_ = Global::Zero();  // of the iteration before
  std::bitset<kMaxBatchSights> rejected_;
  Flow end_;
};

Result<void> Batch::check() const {
  if (sights_.size() < 3 || sights_.size() > kMaxBatchSights)
    return fail(ErrorCode::invalid_argument, "{0} sights; 3 to {1} make a batch",
                {static_cast<double>(sights_.size()), static_cast<double>(kMaxBatchSights)});
  for (std::size_t i = 0; i < sights_.size(); ++i) {
    const BodySight& s = sights_[i].sight;
    if (!(std::abs(s.direction_N.norm() - 1.0) < 1e-6) || !(s.covariance_rad2.trace() > 0.0) ||
        !s.covariance_rad2.allFinite() || (i > 0 && sights_[i].epoch < sights_[i - 1].epoch))
      return fail(ErrorCode::invalid_argument, "sight {0} is no unit vector, has no variance or comes out of turn",
                  {static_cast<double>(i)});
  }
  const GaussMarkov& acceleration = settings_.process.acceleration;
  const double arc_s = (sights_.back().epoch - sights_.front().epoch).seconds();
  if (acceleration.sigma > 0.0 && arc_s > acceleration.tau_s)
    return fail(ErrorCode::invalid_argument, "an arc of {0} days; the unmodelled acceleration forgets itself in {1}",
                {arc_s / 86400.0, acceleration.tau_s / 86400.0});
  return process_.check(sights_.front().epoch);
}

Result<void> Batch::split() {
  for (std::size_t i = 0; i < sights_.size(); ++i) {
    const bool first = i == 0 || sights_[i].sight.body != sights_[i - 1].sight.body ||
                       sights_[i].epoch - sights_[i - 1].epoch > settings_.window_gap;
    if (first) {
      if (window_count_ == kMaxBatchWindows)
        return fail(ErrorCode::invalid_argument, "more than {0} windows", {static_cast<double>(kMaxBatchWindows)});
      windows_[window_count_++].begin = i;
    }
    windows_[window_count_ - 1].end = i + 1;
  }
  return {};
}

Result<void> Batch::carry(Flow& flow, Epoch to) {
  // 1e5 steps of the shortest kind are more than any arc has.
  constexpr int kMostSteps = 100000;
  for (int i = 0; flow.epoch < to; ++i) {
    if (i == kMostSteps) return fail(ErrorCode::not_converged, "the arc takes more than {0} steps", {kMostSteps});
    const auto length = process_.step_length(flow.epoch, flow.x);
    if (!length) return forward(length);
    const Duration h = std::min(*length, to - flow.epoch);
    Transition step;
    if (const auto stepped = process_.step(flow.epoch, h, {}, flow.x, step); !stepped) return stepped;
    flow.phi = step.phi.topLeftCorner<kGlobal, kGlobal>() * flow.phi;
    flow.epoch = flow.epoch + h;
  }
  return {};
}

// Fix page eq. 8 and 9: residuals y = H x + A z + noise of one window; z, with its prior, is eliminated.
Result<void> Batch::add_window(std::size_t window, Flow& flow, int iteration, Normal& normal) {
  const WindowSpan span = windows_[window];
  const Epoch begin = sights_[span.begin].epoch;
  const double length_s = std::max((sights_[span.end - 1].epoch - begin).seconds(), 1e-3);
  // One pair of axes for all of the window, so that its bias keeps its meaning.
  const Axes2 axes = axes_across(sights_[span.begin].sight.direction_N);

  GlobalMatrix n = GlobalMatrix::Zero();
  Cross cross = Cross::Zero();
  LocalMatrix local = LocalMatrix::Zero();
  Global g = Global::Zero();
  Local h = Local::Zero();
  double chi2 = 0.0, distance = 1.0;
  for (std::size_t i = span.begin; i < span.end; ++i) {
    const BatchSight& sight = sights_[i];
    if (const auto carried = carry(flow, sight.epoch); !carried) return carried;
    const State observer{flow.x.segment<3>(index::position) * unit::length_m,
                         flow.x.segment<3>(index::velocity) * unit::velocity_m_s};
    const auto body = ephemeris_.state(sight.sight.body, body::solar_system_barycenter, sight.epoch);
    if (!body) return forward(body);
    const auto sun = ephemeris_.state(body::sun, body::solar_system_barycenter, sight.epoch);
    if (!sun) return forward(sun);
    const auto constants = body_constants(sight.sight.body);
    const Sight seen =
        apparent_sight(observer, *body, sun->p_m, constants ? constants->mean_radius_m : 0.0, settings_.sight);
    distance = seen.distance_m;
    // The stars took the turn b x (v - v_stars)/c with them.
    const Vec3 s = seen.direction_N, b = sight.boresight_N;
    const Vec3 delta = (observer.v_m_s - sight.v_stars_m_s) / kSpeedOfLight;
    const Vec3 foretold = s - (delta * b.dot(s) - b * delta.dot(s));
    const Mat3 by_velocity = seen.by_velocity - (b.dot(s) * Mat3::Identity() - b * s.transpose()) / kSpeedOfLight;

    Eigen::Matrix<double, 2, kGlobal> H;
    H = axes.transpose() * (seen.by_position * unit::length_m * flow.phi.topRows<3>() +
                            by_velocity * unit::velocity_m_s * flow.phi.middleRows<3>(index::velocity));
    Eigen::Matrix<double, 2, kLocal> A;
    const double t = (sight.epoch - begin).seconds() / length_s - 0.5;
    A << Mat2::Identity(), t * Mat2::Identity();
    const Vec2 y = axes.transpose() * (sight.sight.direction_N - foretold);
    const Mat2 weight_full = Mat2(axes.transpose() * sight.sight.covariance_rad2 * axes).inverse();
    // What the step of the last iteration and the window's bias leave.
    double weight = 1.0;
    if (iteration > 0) {
      const Vec2 left = y - A * (local_[window].z - local_[window].m * step_);
      const double d2 = left.dot(weight_full * left);
      if (iteration >= kGatedFrom) rejected_[i] = d2 > gate_;
      weight = rejected_[i] ? 0.0 : std::min(1.0, kHuber / std::sqrt(std::max(d2, 1e-12)));
    }
    const Mat2 W = weight * weight_full;
    n += H.transpose() * W * H;
    cross += H.transpose() * W * A;
    local += A.transpose() * W * A;
    g += H.transpose() * W * y;
    h += A.transpose() * W * y;
    chi2 += y.dot(W * y);
  }
  const double e = sights_[span.begin].sight.ephemeris_sigma_m / distance;
  const double bias2 = settings_.bias.sigma * settings_.bias.sigma;
  // A Gauss-Markov bias differs from one end of the window to the other by this.
  const double drift2 = -2.0 * bias2 * std::expm1(-length_s / settings_.bias.tau_s);
  constexpr double kTiny = 1e-22;  // rad2: a bias of zero is a bias of 2 microarcseconds
  local.diagonal().head<2>().array() += 1.0 / (bias2 + e * e + kTiny);
  local.diagonal().tail<2>().array() += 1.0 / (drift2 + kTiny);
  const Eigen::LLT<LocalMatrix> llt(local);
  local_[window].z = llt.solve(h);
  local_[window].m = llt.solve(cross.transpose());
  normal.n += n - cross * local_[window].m;
  normal.g += g - cross * local_[window].z;
  normal.chi2 += chi2 - h.dot(local_[window].z);
  return {};
}

Result<Batch::Normal> Batch::pass(const BatchStart& start, const StateVector& x0, int iteration) {
  Normal normal;
  end_ = {start.epoch, x0};
  for (std::size_t k = 0; k < window_count_; ++k)
    if (const auto added = add_window(k, end_, iteration, normal); !added) return forward(added);
  return normal;
}

Result<BatchSolution> Batch::solve(const BatchStart& start) {
  if (const auto made = split(); !made) return forward(made);
  if (!start.state.p_m.allFinite() || !start.state.v_m_s.allFinite() || start.epoch > sights_.front().epoch)
    return fail(ErrorCode::invalid_argument, "a batch starts from a finite state, and not after its first sight");
  const StateVector scales = state_scales();
  // What is known before any sight.
  GlobalMatrix prior = GlobalMatrix::Zero();
  if (start.covariance.trace() > 0.0) {
    const Mat6 scaled =
        scales.head<6>().cwiseInverse().asDiagonal() * start.covariance * scales.head<6>().cwiseInverse().asDiagonal();
    const Eigen::LLT<Mat6> llt(scaled);
    if (llt.info() != Eigen::Success)
      return fail(ErrorCode::invalid_argument, "the prior's covariance is not positive");
    prior.topLeftCorner<6, 6>() = llt.solve(Mat6::Identity());
  }
  const double mass_sigma = std::max(settings_.mass_sigma_kg, 1e-6 * settings_.mass_kg);
  prior(index::mass, index::mass) = 1.0 / (mass_sigma * mass_sigma);
  const double acceleration_sigma = std::max(settings_.process.acceleration.sigma, 1e-15) / unit::acceleration_m_s2;
  prior.diagonal().segment<3>(index::acceleration).setConstant(1.0 / (acceleration_sigma * acceleration_sigma));

  StateVector mean = StateVector::Zero();
  mean.segment<3>(index::position) = start.state.p_m / unit::length_m;
  mean.segment<3>(index::velocity) = start.state.v_m_s / unit::velocity_m_s;
  mean[index::mass] = settings_.mass_kg;
  StateVector x0 = mean;
  for (int iteration = 0; iteration < settings_.max_iterations; ++iteration) {
    auto normal = pass(start, x0, iteration);
    if (!normal) return forward(normal);
    const Global off = x0.head<kGlobal>() - mean.head<kGlobal>();
    normal->n += prior;
    normal->g -= prior * off;
    // Scaled to a unit diagonal: the units of the states differ by eight orders of magnitude.
    const Global scale = normal->n.diagonal().cwiseSqrt().cwiseInverse();
    const GlobalMatrix scaled = scale.asDiagonal() * normal->n * scale.asDiagonal();
    const Eigen::LLT<GlobalMatrix> llt(scaled);
    if (llt.info() != Eigen::Success || !(llt.rcond() > 1e-13))
      return fail(ErrorCode::no_match, "position and velocity are {s} by these sights", {}, {}, "unobservable");
    step_ = scale.cwiseProduct(llt.solve(scale.cwiseProduct(normal->g)));
    // A step of more than a tenth of the way to the Sun is a leap out of what is linear.
    const double reach = step_.head<3>().norm() / (0.1 * x0.head<3>().norm());
    if (reach > 1.0) step_ /= reach;
    x0.head<kGlobal>() += step_;
    const double sigmas = std::sqrt(step_.dot(normal->n * step_));
    if (!std::isfinite(sigmas)) break;
    if (sigmas > kConverged || iteration <= kGatedFrom) continue;

    // One more pass, for the residuals and the sensitivities at the solution.
    step_.setZero();
    const auto last = pass(start, x0, iteration + 1);
    if (!last) return forward(last);
    BatchSolution out;
    out.epoch = end_.epoch;
    out.state.p_m = end_.x.segment<3>(index::position) * unit::length_m;
    out.state.v_m_s = end_.x.segment<3>(index::velocity) * unit::velocity_m_s;
    const GlobalMatrix covariance = scale.asDiagonal() * llt.solve(GlobalMatrix::Identity()) * scale.asDiagonal();
    const Eigen::Matrix<double, 6, kGlobal> map = scales.head<6>().asDiagonal() * end_.phi.topRows<6>();
    out.covariance = map * covariance * map.transpose();
    out.covariance = 0.5 * (out.covariance + out.covariance.transpose()).eval();
    const Global left = x0.head<kGlobal>() - mean.head<kGlobal>();
    out.chi2 = last->chi2 + left.dot(prior * left);
    out.rejected = static_cast<int>(rejected_.count());
    out.used = static_cast<int>(sights_.size()) - out.rejected;
    out.degrees_of_freedom = 2 * out.used - (start.covariance.trace() > 0.0 ? 0 : 6);
    out.iterations = iteration + 1;
    // More than a quarter thrown away: what is left is not the sky that was meant.
    if (4 * out.rejected > static_cast<int>(sights_.size()))
      return fail(ErrorCode::no_match, "{0} of {1} sights do not agree with the rest",
                  {static_cast<double>(out.rejected), static_cast<double>(sights_.size())}, {}, "apart");
    return out;
  }
  return fail(ErrorCode::not_converged, "the batch did not settle in {0} iterations",
              {static_cast<double>(settings_.max_iterations)});
}

Result<Vec3> velocity_of_circle(const Ephemeris& ephemeris, const Vec3& p_O_N, Epoch epoch) {
  const auto sun = ephemeris.state(body::sun, body::solar_system_barycenter, epoch);
  if (!sun) return forward(sun);
  const auto constants = body_constants(body::sun);
  if (!constants) return forward(constants);
  return circular_velocity(p_O_N - sun->p_m, constants->gm_m3_s2);
}

}  // namespace

Result<BatchSolution> solve_batch(const Ephemeris& ephemeris, std::span<const BatchSight> sights,
                                  const BatchStart& start, const BatchSettings& settings) {
  Batch batch(ephemeris, sights, settings);
  if (const auto checked = batch.check(); !checked) return forward(checked);
  return batch.solve(start);
}

Result<BatchStart> start_from_survey(const Ephemeris& ephemeris, const SurveySolution& survey) {
  const auto velocity = velocity_of_circle(ephemeris, survey.p_O_N, survey.epoch);
  if (!velocity) return forward(velocity);
  constexpr double kSigma = 8e3;  // m/s an axis: as the survey itself believes
  BatchStart start{survey.epoch, {survey.p_O_N, *velocity}};
  start.covariance.topLeftCorner<3, 3>() = survey.covariance_m2;
  start.covariance.bottomRightCorner<3, 3>() = Mat3::Identity() * kSigma * kSigma;
  return start;
}

Result<BatchStart> start_from_sights(const Ephemeris& ephemeris, std::span<const BatchSight> sights) {
  if (sights.empty()) return fail(ErrorCode::invalid_argument, "no sights to start from");
  // The planet's way between the two is small beside the spacecraft's, and that is left to the batch.
  std::array<BodySight, 2> two{sights[0].sight, sights[0].sight};
  std::size_t last = 0;
  while (last < sights.size() && sights[last].sight.body == sights[0].sight.body) ++last;
  if (last == sights.size()) return fail(ErrorCode::no_match, "sights of one body are {s}", {}, {}, "unobservable");
  two[1] = sights[last].sight;
  // One moment, as if: the way of an hour and a half at 30 km/s, seen from half an au.
  for (BodySight& sight : two) sight.covariance_rad2 += Mat3::Identity() * 4e-6;
  const Epoch epoch = sights[0].epoch;
  const auto crossing =
      triangulate(ephemeris, epoch, Vec3::Zero(), two, {.most_sigma_share = 1.0, .least_probability = 0.0});
  if (!crossing) return forward(crossing);
  const auto velocity = velocity_of_circle(ephemeris, crossing->p_O_N, epoch);
  if (!velocity) return forward(velocity);
  return BatchStart{epoch, {crossing->p_O_N, *velocity}};
}

InitialState initial_state(const BatchSolution& solution, const BatchSettings& settings) {
  return {.epoch = solution.epoch,
          .state = solution.state,
          .covariance = solution.covariance,
          .mass_kg = settings.mass_kg,
          .mass_sigma_kg = settings.mass_sigma_kg};
}

}  // namespace astronav::navigation
