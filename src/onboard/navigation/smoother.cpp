// SPDX-License-Identifier: Apache-2.0
#include "onboard/navigation/smoother.h"

#include <cmath>

#include <Eigen/Eigenvalues>

#include "foundation/base/check.h"

namespace astronav::navigation {
namespace {

// Eigenvalues of the predicted correlation matrix that count as zero. Its elements come with errors of some 1e-15, so
// that below this nothing is known; what is dropped are combinations known to 1e-6 of the sigmas of their members.
constexpr double kLeastEigenvalue = 1e-12;

// Standard deviations as units; 1 where there is nothing to scale.
StateVector units_of(const StateMatrix& P) {
  return P.diagonal().unaryExpr([](double variance) { return variance > 0.0 ? std::sqrt(variance) : 1.0; });
}

// M with rows in units of `rows`, columns in units of `columns`.
StateMatrix scaled(const StateMatrix& M, const StateVector& rows, const StateVector& columns) {
  return rows.cwiseInverse().asDiagonal() * M * columns.asDiagonal();
}
StateMatrix scaled(const StateMatrix& covariance, const StateVector& units) {
  return scaled(covariance, units, units.cwiseInverse());
}

StateMatrix pseudo_inverse(const StateMatrix& correlation) {
  const Eigen::SelfAdjointEigenSolver<StateMatrix> eigen(correlation);
  const StateVector inverse =
      eigen.eigenvalues().unaryExpr([](double value) { return value > kLeastEigenvalue ? 1.0 / value : 0.0; });
  return eigen.eigenvectors() * inverse.asDiagonal() * eigen.eigenvectors().transpose();
}

SmoothedState step_back(const FilterRecord& from, const SmoothedState& next) {
  const StateMatrix predicted_covariance = from.phi * from.covariance * from.phi.transpose() + from.q;
  const StateVector units = units_of(from.covariance), next_units = units_of(predicted_covariance);
  const StateMatrix P = scaled(from.covariance, units);
  const StateMatrix phi = scaled(from.phi, next_units, units);
  StateMatrix C = P * phi.transpose() * pseudo_inverse(scaled(predicted_covariance, next_units));
  // Exactly nothing from states that start anew, whatever rounding left of them.
  for (int i = 0; i < kStates; ++i)
    if (!(predicted_covariance(i, i) > 0.0)) C.col(i).setZero();

  SmoothedState out;
  out.epoch = from.epoch;
  out.x = from.x + units.cwiseProduct(C * (next.x - from.predicted).cwiseQuotient(next_units));
  // P + C (P_next - P_predicted) C' written without a difference, as Joseph did for the update: never negative, and an
  // error of the gain counts only by its square.
  const StateMatrix rest = StateMatrix::Identity() - C * phi;
  const StateMatrix arriving = scaled(from.q + next.covariance, next_units);
  const StateMatrix smoothed = rest * P * rest.transpose() + C * arriving * C.transpose();
  out.covariance = units.asDiagonal() * (0.5 * (smoothed + smoothed.transpose())) * units.asDiagonal();
  return out;
}

}  // namespace

Result<std::vector<SmoothedState>> smooth(const std::vector<FilterRecord>& records) {
  for (std::size_t i = 0; i < records.size(); ++i) {
    const FilterRecord& r = records[i];
    if (!r.x.allFinite() || !r.covariance.allFinite() || !r.predicted.allFinite() || !r.phi.allFinite() ||
        !r.q.allFinite())
      return fail(ErrorCode::invalid_argument, "record {0} is not finite", {static_cast<double>(i)});
    if (!(r.covariance.diagonal().array() >= 0.0).all() || !(r.q.diagonal().array() >= 0.0).all())
      return fail(ErrorCode::invalid_argument, "record {0} has a variance below zero", {static_cast<double>(i)});
    if (i > 0 && r.epoch < records[i - 1].epoch)
      return fail(ErrorCode::invalid_argument, "record {0} is earlier than the one before", {static_cast<double>(i)});
  }
  std::vector<SmoothedState> out(records.size());
  if (records.empty()) return out;
  out.back() = {records.back().epoch, records.back().x, records.back().covariance};
  for (std::size_t i = records.size() - 1; i-- > 0;) out[i] = step_back(records[i], out[i + 1]);
  return out;
}

RecordedFilter::RecordedFilter(const FilterSettings& settings, const Ephemeris& ephemeris)
    : filter_(settings, ephemeris), process_(process_of(settings, ephemeris)) {}

RecordedFilter::RecordedFilter(const Filter& begin, const Ephemeris& ephemeris)
    : filter_(begin), process_(process_of(begin.settings(), ephemeris)) {
  records_ = {now()};
}

FilterRecord RecordedFilter::now() const {
  FilterRecord record;
  record.epoch = filter_.epoch();
  record.x = filter_.state_vector();
  record.covariance = filter_.covariance();
  return record;
}

Result<void> RecordedFilter::initialise(const InitialState& initial) {
  if (const Result<void> done = filter_.initialise(initial); !done) return done;
  records_ = {now()};
  return {};
}

void RecordedFilter::set_thrust(const Thrust& thrust) {
  thrust_ = thrust;
  filter_.set_thrust(thrust);
}

// Step by step as the filter does it, so that each transition matrix is that of its own step.
Result<void> RecordedFilter::propagate_to(Epoch epoch) {
  ASTRONAV_CHECK(!records_.empty());
  if (epoch <= filter_.epoch()) return filter_.propagate_to(epoch);
  const StateVector units = state_scales();
  using Dynamic = Eigen::Matrix<double, kDynamicStates, kDynamicStates>;
  Dynamic phi = Dynamic::Identity();
  Dynamic q = Dynamic::Zero();
  Result<void> result;
  Transition step;
  while (result && filter_.epoch() < epoch) {
    StateVector x = filter_.state_vector().cwiseQuotient(units);
    const Result<Duration> h = process_.step_towards(filter_.epoch(), epoch, x);
    if (!h) {
      result = forward(h);
      break;
    }
    result = process_.step(filter_.epoch(), *h, thrust_, x, step);
    if (result) result = filter_.propagate_to(filter_.epoch() + *h);
    if (!result) break;
    phi = (step.phi * phi).eval();
    q = (step.phi * q * step.phi.transpose() + step.n * step.q.asDiagonal() * step.n.transpose()).eval();
  }
  const FilterRecord arrived = now();
  if (arrived.epoch > records_.back().epoch) {
    FilterRecord& last = records_.back();
    const Process::Ageing ageing = process_.ageing(arrived.epoch - last.epoch);
    last.predicted = arrived.x;
    last.phi.setZero();
    last.phi.topLeftCorner<kDynamicStates, kDynamicStates>() = phi;
    last.phi.diagonal().tail<kAgeingStates>() = ageing.factor;
    last.phi = scaled(last.phi, units.cwiseInverse(), units.cwiseInverse());
    last.q.setZero();
    last.q.topLeftCorner<kDynamicStates, kDynamicStates>() = q;
    last.q.diagonal().tail<kAgeingStates>() = ageing.variance;
    last.q = scaled(last.q, units.cwiseInverse());
    records_.push_back(arrived);
  }
  return result;
}

UpdateResult RecordedFilter::update(const BeaconMeasurement& measurement) {
  ASTRONAV_CHECK(!records_.empty());
  // Errors of the way there are the update's to report.
  if (measurement.mid_exposure > filter_.epoch()) (void)propagate_to(measurement.mid_exposure);
  const UpdateResult result = filter_.update(measurement);
  if (!result.accepted && !result.window_started && !result.recovered) return result;
  const FilterRecord updated = now();
  if (!result.window_started && !result.recovered) {
    records_.back() = updated;
    return result;
  }
  FilterRecord& last = records_.back();
  last.predicted = last.x;
  if (result.recovered) {
    last.phi.setZero();
  } else {
    last.predicted.segment<2>(index::bias).setZero();
    last.phi.block<2, 2>(index::bias, index::bias).setZero();
  }
  records_.push_back(updated);
  return result;
}

Result<void> RecordedFilter::kick(const Vec3& delta_v_N_m_s, double sigma_m_s) {
  ASTRONAV_CHECK(!records_.empty());
  if (const Result<void> done = filter_.kick(delta_v_N_m_s, sigma_m_s); !done) return done;
  FilterRecord& last = records_.back();
  last.q.block<3, 3>(index::velocity, index::velocity).diagonal().setConstant(sigma_m_s * sigma_m_s);
  const FilterRecord kicked = now();
  last.predicted = kicked.x;
  records_.push_back(kicked);
  return {};
}

}  // namespace astronav::navigation
