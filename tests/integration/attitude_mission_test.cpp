// SPDX-License-Identifier: Apache-2.0
// Missions of a spacecraft with a gyro: the attitude between frames and through slews, and what becomes of it where
// frames are lost or the gyro goes wrong.
#include <cstdio>
#include <memory>
#include <vector>

#include <gtest/gtest.h>

#include "foundation/math/statistics.h"
#include "verification/loop/belief.h"
#include "verification/loop/briefing.h"
#include "verification/loop/eyes.h"
#include "verification/loop/mission.h"
#include "verification/loop/pointing.h"
#include "verification/loop/summary.h"
#include "verification/loop/world.h"
#include "verification/scenario/scenario.h"

namespace astronav {
namespace {

scenario::Scenario scenario_with(std::initializer_list<const char*> set) {
  scenario::Draft draft = scenario::Draft::read("earth-mars-ballistic").value();
  EXPECT_TRUE(draft.set("truth.gyro.on=true"));
  for (const char* assignment : set) EXPECT_TRUE(draft.set(assignment)) << assignment;
  return draft.resolve(1).value();
}

Result<loop::Records> fly(const scenario::Scenario& scenario, int cycles) {
  loop::FlyOptions options;
  options.keep_frames = 0;
  options.most_cycles = cycles;
  return loop::fly(scenario, options);
}

std::vector<loop::Event> images_of(const loop::Records& records) {
  std::vector<loop::Event> out;
  for (const loop::Event& e : records.events)
    if (e.kind == loop::EventKind::image) out.push_back(e);
  return out;
}

// The bands of all tests here are left once in 1000 times by a filter that is right.
TEST(AttitudeMission, TheFilterKnowsHowWellItKnows) {
  constexpr int kCycles = 10;
  const auto records = fly(scenario_with({}), kCycles);
  ASSERT_TRUE(records) << describe(records.error());
  const loop::Summary summary = loop::summarize(*records);
  std::puts(loop::to_text(summary).c_str());
  const loop::AttitudeFilterSummary& s = summary.attitude_filter;
  EXPECT_EQ(s.foretold, kCycles * 71);  // all but the first of each cycle
  EXPECT_EQ(s.slews, kCycles);
  EXPECT_TRUE(chi_square_mean_band(0.999, 3.0, s.foretold).contains(s.nees_mean)) << s.nees_mean;
  EXPECT_TRUE(chi_square_mean_band(0.999, 3.0, s.accepted).contains(s.nis_mean)) << s.nis_mean;
  EXPECT_LE(s.restarts, 1);  // 1 in 10,000 good ones
  EXPECT_GT(s.by_prior_rate, 0.96);
  EXPECT_EQ(summary.vision.attitude_success_rate, 1.0);
  double slew = 0.0, bias = 0.0;
  int by_prior = 0;
  const auto images = images_of(*records);
  for (std::size_t i = 0; i < images.size(); ++i) {
    const loop::AttitudeRecord& a = images[i].attitude;
    if (a.after_slew) {
      slew += a.nees / kCycles;
      by_prior += images[i].by_prior;
    }
    if (i % 72 == 71) bias += a.bias_error_rad_s.cwiseQuotient(a.bias_sigma_rad_s).squaredNorm() / kCycles;
  }
  EXPECT_TRUE(chi_square_mean_band(0.999, 3.0, kCycles).contains(slew)) << slew;
  EXPECT_TRUE(chi_square_mean_band(0.999, 3.0, kCycles).contains(bias)) << bias;
  // Two of three at least are found through the slew; 500 arcsec an axis put nine of ten inside the 15 px looked at.
  EXPECT_GE(by_prior, 6);
}

// The gyro's bias jumps when the slew begins, so that half an hour later the attitude is off by 44 degrees: the stars
// are found without it, the frame is the filter's new start, and from the third image on all is as before.
TEST(AttitudeMission, AGyroThatJumpsHarmsNobody) {
  constexpr int kCycles = 6;
  const auto records = fly(scenario_with({"truth.gyro.jump_deg_h=100"}), kCycles);
  ASSERT_TRUE(records) << describe(records.error());
  const loop::Summary summary = loop::summarize(*records);
  EXPECT_EQ(summary.vision.attitude_success_rate, 1.0);
  EXPECT_EQ(summary.attitude_filter.restarts, kCycles);
  double nees = 0.0;
  int settled = 0;
  for (const loop::Event& e : images_of(*records)) {
    const int in_window = e.image % 36;
    if (e.window == 0) continue;
    if (in_window == 0) {
      EXPECT_FALSE(e.by_prior);
      EXPECT_TRUE(e.attitude.restarted);
      EXPECT_GT(e.attitude.error_rad.norm(), 20.0 * kDegree);
    } else if (in_window >= 2) {
      EXPECT_TRUE(e.by_prior && e.attitude.accepted) << in_window;
      nees += e.attitude.nees;
      ++settled;
    }
    if (in_window == 35) {
      EXPECT_LT(e.attitude.bias_error_rad_s.norm(), 1.0 * kDegree / 3600.0);
    }
  }
  EXPECT_TRUE(chi_square_mean_band(0.999, 3.0, settled).contains(nees / settled)) << nees / settled;
}

// The first window of the mission, image by image.
class Window : public ::testing::Test {
 protected:
  void SetUp() override {
    options_.level = loop::Level::sil;
    world_ = loop::World::create(scenario_, options_.seed, options_.sample).value();
    begin_ = world_->trajectory().begin();
    pointing_.emplace(loop::Pointing::create(scenario_, options_, *world_, camera_).value());
    pointing_->begin_window(0, 0);
    eyes_ = loop::Eyes::create(scenario_, *world_, camera_, begin_).value();
    executive::NavigatorSettings settings;
    settings.filter = loop::filter_settings(scenario_, camera_, options_.level).value();
    settings.brightness =
        executive::BrightnessSettings{BandPhotometry(camera_), camera_.exposure_s, camera_.detector.gain_e_dn};
    settings.stance = loop::stance_settings(scenario_);
    navigator_ = std::make_unique<executive::Navigator>(settings, world_->onboard_ephemeris(), &eyes_->vision());
    auto known = loop::Briefing(scenario_, options_, *world_).first_state(begin_).value();
    known.state = world_->trajectory().state(begin_).value();
    ASSERT_TRUE(navigator_->start(known));
  }

  // `lost`: the shutter stays closed.
  loop::Event image(int number, bool lost = false) {
    loop::Event event;
    event.epoch = begin_ + Duration::seconds(100.0 * (number + 1));
    event.body = body::mars;
    event.image = number;
    pointing_->point(navigator_->aim(body::mars, event.epoch).value(), event.epoch, number);
    const State truth = world_->trajectory().state(event.epoch).value();
    if (lost) {
      for (const auto& sample : pointing_->gyro()) navigator_->sense(sample);
      const ImageU16 dark(camera_.intrinsics.width_px, camera_.intrinsics.height_px);
      const auto look = navigator_->look(dark.view(), event.epoch, body::mars);
      EXPECT_TRUE(look && !look->measured && !look->stance.update);
      return event;
    }
    loop::Records records;
    EXPECT_TRUE(eyes_->photograph(event, event.epoch, truth, *pointing_, body::mars,
                                  {.image = static_cast<std::uint64_t>(number), .purpose = "frame"}, *navigator_,
                                  records, false));
    return event;
  }

  scenario::Scenario scenario_ = scenario_with({});
  loop::FlyOptions options_;
  Camera camera_ = scenario::onboard_camera(scenario_).value();
  std::unique_ptr<loop::World> world_;
  Epoch begin_;
  std::optional<loop::Pointing> pointing_;
  std::unique_ptr<loop::Eyes> eyes_;
  std::unique_ptr<executive::Navigator> navigator_;
};

TEST_F(Window, LostFramesOnlyMakeTheWayLonger) {
  for (int number = 0; number < 10; ++number) EXPECT_TRUE(image(number).attitude_found) << number;
  const loop::Event before = image(10);
  EXPECT_TRUE(before.by_prior);
  image(11, true);
  image(12, true);
  const loop::Event after = image(13);
  EXPECT_TRUE(after.by_prior);
  EXPECT_TRUE(after.attitude.accepted);
  // 300 s instead of 100 s: noise of the angle by the root of three, what is unknown of the bias by three.
  EXPECT_GT(after.attitude.sigma_rad.x(), 1.6 * before.attitude.sigma_rad.x());
  EXPECT_LT(after.attitude.sigma_rad.x(), 3.0 * before.attitude.sigma_rad.x());
  EXPECT_LT(after.attitude.nees, chi_square_quantile(0.999, 3.0));
  EXPECT_TRUE(image(14).by_prior);
}

}  // namespace
}  // namespace astronav
