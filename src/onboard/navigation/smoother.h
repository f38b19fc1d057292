// SPDX-License-Identifier: Apache-2.0
// Where the spacecraft was, as the ground knows it afterwards: every past state from all images, also the later ones.
//
//   RecordedFilter flight(settings, ephemeris);          // a Filter that takes notes; used as one
//   flight.initialise(..); flight.propagate_to(..); flight.update(..);
//   const auto past = smooth(flight.records());          // one for each record, in order of time
//
// Rauch, Tung & Striebel (1965) backwards over what the filter believed, its gain by a pseudo-inverse and its
// covariance as a sum of squares. For the ground: a record takes 45 kB, and it allocates. docs/theory/navigation.md
// section 6.
#pragma once

#include <vector>

#include "foundation/base/error.h"
#include "onboard/navigation/filter.h"

namespace astronav::navigation {

// What the filter believed with all measurements up to `epoch`, and how it went on from there. All in SI, in the order
// of state.h.
struct FilterRecord {
  Epoch epoch;
  StateVector x = StateVector::Zero();
  StateMatrix covariance = StateMatrix::Zero();
  // To the next record, before its measurements: predicted = f(x), its error phi e + w with E[w w'] = q. A state with a
  // row of zeros in phi and q starts anew there and says nothing about the past. Unused in the last record.
  StateVector predicted = StateVector::Zero();
  StateMatrix phi = StateMatrix::Identity();
  StateMatrix q = StateMatrix::Zero();
};

struct SmoothedState {
  Epoch epoch;
  StateVector x = StateVector::Zero();           // SI
  StateMatrix covariance = StateMatrix::Zero();  // SI
  State state() const { return {x.segment<3>(index::position), x.segment<3>(index::velocity)}; }
  Mat6 covariance_pv() const { return covariance.topLeftCorner<6, 6>(); }
};

// invalid_argument: values that are not finite, records that go back in time, a variance below zero.
Result<std::vector<SmoothedState>> smooth(const std::vector<FilterRecord>& records);

// Errors and results are the filter's. There is a record at each epoch to which it was moved, so `propagate_to` where a
// smoothed state is wanted; two at the epoch of a window's first image, because the line-of-sight bias changes there,
// and at that of a push.
class RecordedFilter {
 public:
  RecordedFilter(const FilterSettings& settings, const Ephemeris& ephemeris);
  // From where another filter stands.
  RecordedFilter(const Filter& begin, const Ephemeris& ephemeris);

  Result<void> initialise(const InitialState& initial);  // forgets earlier records
  Result<void> propagate_to(Epoch epoch);
  // A recovery cuts the arc: what comes later says nothing about the state before it, which was wrong in a way that no
  // covariance described.
  UpdateResult update(const BeaconMeasurement& measurement);
  Result<void> kick(const Vec3& delta_v_N_m_s, double sigma_m_s);
  void set_thrust(const Thrust& thrust);

  Epoch epoch() const { return filter_.epoch(); }
  const Filter& filter() const { return filter_; }
  const std::vector<FilterRecord>& records() const { return records_; }

 private:
  FilterRecord now() const;

  Filter filter_;
  Process process_;  // the filter's once more, for its transition matrices
  Thrust thrust_;
  std::vector<FilterRecord> records_;
};

}  // namespace astronav::navigation
