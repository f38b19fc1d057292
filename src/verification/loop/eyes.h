// SPDX-License-Identifier: Apache-2.0
// Eyes: software in the loop. Renders what the true camera sees, lets the onboard software look, and notes how right it
// was.
#pragma once

#include <cstddef>
#include <memory>
#include <vector>

#include "foundation/base/error.h"
#include "foundation/math/random.h"
#include "onboard/executive/cold_start.h"
#include "onboard/executive/navigator.h"
#include "onboard/vision/exposure.h"
#include "onboard/vision/vision.h"
#include "verification/loop/pointing.h"
#include "verification/loop/records.h"
#include "verification/loop/world.h"
#include "verification/scenario/scenario.h"

namespace astronav::loop {

class Eyes {
 public:
  // Star list and pair index for the believed camera, stars at their places of `epoch`.
  static Result<std::unique_ptr<Eyes>> create(const scenario::Scenario& scenario, World& world, const Camera& believed,
                                              Epoch epoch);
  Eyes(const Eyes&) = delete;
  Eyes& operator=(const Eyes&) = delete;

  vision::Vision& vision() { return *vision_; }
  const vision::StarField& field() const { return field_; }
  // nullptr: the exposure is fixed.
  const vision::ExposureControl* exposure_control() const { return exposure_.get(); }

  // Takes the image of `event` (epoch and number are set), feeds it to the navigator and fills in what came of it.
  // `clock`: what the onboard clock shows at mid-exposure. `start`: gets what is measured instead of the filter; or
  // nullptr.
  Result<void> photograph(Event& event, Epoch clock, const State& truth_O, const Pointing& pointing, BodyId beacon,
                          const StreamId& noise, executive::Navigator& navigator, Records& records, bool keep_frame,
                          executive::ColdStart* start = nullptr);
  // A picture of a survey: no place is known, and no planet is predicted.
  Result<void> survey(Event& event, Epoch clock, const State& truth_O, const Mat3& R_CN, double exposure_s,
                      const StreamId& noise, executive::ColdStart& start);

 private:
  explicit Eyes(World& world) : world_(world) {}
  Result<void> expose(Epoch epoch, const State& truth_O, const Mat3& R_CN, double exposure_s, const StreamId& noise);
  // What the onboard software believes the time of a frame to be: its tag, less the latency that it knows of.
  Epoch tag(Epoch clock, const StreamId& noise) const;
  void judge_attitude(Event& event, const vision::FrameResult& seen, const Mat3& R_CN) const;
  void judge(Event& event, const executive::Look& look, const Mat3& R_CN, BodyId beacon) const;
  KeptFrame keep(const Event& event, const executive::Look& look) const;

  World& world_;
  Mat3 true_axes_ = Mat3::Identity();  // axes that hang on pixels, in the true camera's
  vision::StarField field_, neighbours_;
  std::vector<std::byte> index_bytes_;
  vision::PairIndex index_;
  std::unique_ptr<vision::Vision> vision_;
  std::unique_ptr<vision::ExposureControl> exposure_;
  std::vector<render::RenderedSource> sources_;
  ImageU16 frame_;
  double known_latency_s_ = 0.0;  // of the frames' time tags
};

}  // namespace astronav::loop
