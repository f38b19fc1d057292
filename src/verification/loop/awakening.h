// SPDX-License-Identifier: Apache-2.0
// Awakening: a start from nothing as it is flown: the truth turns the camera along the ecliptic and shows the sky
// there, the onboard software (executive::ColdStart) makes a first state of it and of the two windows that follow.
#pragma once

#include <memory>
#include <optional>

#include "foundation/base/error.h"
#include "onboard/executive/cold_start.h"
#include "onboard/executive/navigator.h"
#include "onboard/executive/timeline.h"
#include "verification/loop/eyes.h"
#include "verification/loop/mission.h"
#include "verification/loop/records.h"
#include "verification/loop/world.h"
#include "verification/scenario/scenario.h"

namespace astronav::loop {

class Awakening {
 public:
  // `eyes`: nullptr flies sights without pictures. invalid_argument where the timeline has no room for surveys,
  // limit_exceeded where the camera's field is too narrow for them.
  static Result<std::unique_ptr<Awakening>> create(const scenario::Scenario& scenario, const FlyOptions& options,
                                                   World& world, const Camera& believed, Eyes* eyes,
                                                   const executive::Timeline& timeline,
                                                   const executive::ColdStartSettings& settings);

  // Looks around before the first window of a cycle. True: the navigator knows its place well enough to track planets.
  // False: it does not; why() says more.
  Result<bool> survey(int cycle, executive::Navigator& navigator, Records& records);
  // An image of a window, for the batch.
  void add(Event& image, const navigation::BeaconMeasurement& measurement);
  executive::ColdStart& cold_start() { return *start_; }
  // After both windows. True: the navigator has a state.
  Result<bool> finish(executive::Navigator& navigator, Records& records);
  const Error& why() const { return why_; }

 private:
  Awakening(const scenario::Scenario& scenario, const FlyOptions& options, World& world, const Camera& believed,
            Eyes* eyes, const executive::Timeline& timeline)
      : scenario_(scenario), options_(options), world_(world), believed_(believed), eyes_(eyes), timeline_(timeline) {}
  Result<void> look_around(Epoch begin, int cycle, int attempt, Records& records);
  Result<void> take_picture(Epoch epoch, int cycle, int number, int picture, Records& records);
  // What a camera would see of the planets, at rest as the onboard software has to believe.
  Result<void> sight(Event& event, Epoch clock, const State& truth, const Mat3& R_CN, const StreamId& noise);

  const scenario::Scenario& scenario_;
  const FlyOptions& options_;
  World& world_;
  const Camera& believed_;
  Eyes* eyes_;
  const executive::Timeline& timeline_;
  std::unique_ptr<executive::ColdStart> start_;
  Error why_;
};

// A perfect attitude, but of stars that somebody took to be aberrated by another velocity than the true one.
Mat3 attitude_among_stars(const Mat3& R_CN, const Vec3& v_true_m_s, const Vec3& v_believed_m_s);

}  // namespace astronav::loop
