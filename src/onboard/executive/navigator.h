// SPDX-License-Identifier: Apache-2.0
// Navigator: the onboard software as a whole: chooses beacons, says where to point, turns frames into updates.
//
//   Navigator navigator(settings, ephemeris, &vision);
//   navigator.start(initial);
//   navigator.coast_to(window_begin);
//   const auto beacons = navigator.select();          // which two planets to track
//   navigator.aim(body, epoch);                       // where the camera must look
//   navigator.sense(sample);                          // each of the gyro, where there is one
//   navigator.look(frame, mid_exposure, body);        // image -> attitude -> planet -> filter
//
// Where no state is known to start with, ColdStart (cold_start.h) finds one.
//
// No heap, no exceptions, no files.
#pragma once

#include <array>
#include <cstdint>
#include <optional>

#include "foundation/base/error.h"
#include "foundation/image/image.h"
#include "foundation/time/epoch.h"
#include "models/ephemeris/ephemeris.h"
#include "models/photometry/photometry.h"
#include "onboard/executive/maneuvers.h"
#include "onboard/executive/stance.h"
#include "onboard/navigation/beacons.h"
#include "onboard/navigation/filter.h"
#include "onboard/vision/exposure.h"
#include "onboard/vision/vision.h"

namespace astronav::executive {

// From a magnitude to what the camera shows of it.
struct BrightnessSettings {
  BandPhotometry band;
  double exposure_s = 0.4;
  double gain_e_dn = 1.0;
};

// Hears of every sight before the filter does: telemetry, for who looks back later.
class SightListener {
 public:
  virtual ~SightListener() = default;
  virtual void saw(const navigation::BeaconMeasurement& measurement) = 0;
};

struct NavigatorSettings {
  navigation::FilterSettings filter;
  navigation::BeaconSettings beacons;
  std::optional<BrightnessSettings> brightness;  // without it planets are told from stars by place alone
  // Asked before each window; nullptr: always the exposure of `brightness`. Must outlive the navigator.
  const vision::ExposureControl* exposure = nullptr;
  Maneuvers maneuvers;
  StanceSettings stance;
  SightListener* listener = nullptr;  // must outlive the navigator
};

// What became of one frame.
struct Look {
  const vision::FrameResult* frame = nullptr;  // valid until the next frame
  vision::PlanetPrediction prediction;         // what the image processing was told
  bool measured = false;                       // attitude and planet were found
  navigation::BeaconMeasurement measurement;
  navigation::UpdateResult update;  // where measured
  StanceReport stance;
};

class Navigator {
 public:
  // The ephemeris (and the eyes, where there are any) must outlive it. Without eyes only use() feeds the filter.
  Navigator(const NavigatorSettings& settings, const Ephemeris& ephemeris, vision::Vision* eyes);

  Result<void> start(const navigation::InitialState& initial);
  Result<void> coast_to(Epoch epoch);

  // The beacons for a cycle, from where the spacecraft believes it is at the filter's epoch.
  Result<navigation::BeaconSelection> select() const;
  // Before the first image of a window: how long to expose (exposure_s), from what the beacon and the stars around it
  // will look like.
  Result<void> prepare_window(BodyId beacon, Epoch epoch);
  double exposure_s() const { return settings_.brightness ? settings_.brightness->exposure_s : 0.0; }
  // Apparent direction (N) to point the camera at; the filter is taken to the epoch.
  Result<Vec3> aim(BodyId body, Epoch epoch);

  // One frame, its mid-exposure epoch, and the beacon that is being tracked. not-found attitude or planet is no error.
  // Where there is no gyro, `commanded_R_CN` (how the camera was told to stand) helps: what was found of the last
  // image, turned by what was commanded since, is where the stars are looked for.
  Result<Look> look(ImageView<const std::uint16_t> frame, Epoch mid_exposure, BodyId beacon,
                    const std::optional<Mat3>& commanded_R_CN = {});
  // The same, but the filter does not use what is measured: for a start that is too rough to be updated.
  Result<Look> watch(ImageView<const std::uint16_t> frame, Epoch mid_exposure, BodyId beacon,
                     const std::optional<Mat3>& commanded_R_CN = {});
  // A sample of the gyro, in order, up to the one with the mid-exposure before the frame itself. Ignored where the
  // settings know of no gyro.
  void sense(const attitude::GyroSample& sample) { stance_.sense(sample); }
  // A measurement that somebody else made.
  navigation::UpdateResult use(const navigation::BeaconMeasurement& measurement);

  // A flight that began with little known is linear along the wrong way. Where its first sight found less known than
  // 30,000 km, flies all since the last call (or start()) once more, with its thrust, kicks and sights, along the way
  // that its end shows (navigation.md, a coast flown anew); what comes after is the next flight. To be called when both
  // beacons of a cycle have been seen. True: it was flown anew.
  Result<bool> end_flight();

  const navigation::Filter& filter() const { return filter_; }

 private:
  // From where the filter is, or the end of the last flight.
  void begin_flight();
  navigation::UpdateResult update(const navigation::BeaconMeasurement& measurement);
  // The filter to an epoch, thrust and kicks on the way.
  Result<void> advance(Epoch epoch);
  // Where a beacon should be and how bright, as the image processing is told.
  Result<vision::PlanetPrediction> predict(BodyId beacon, Epoch epoch) const;
  void add_moon(vision::PlanetPrediction& prediction, Epoch emitted) const;
  double flux_dn(double v_mag, BodyId body) const;

  NavigatorSettings settings_;
  const Ephemeris* ephemeris_;
  vision::Vision* eyes_;
  navigation::Filter filter_;
  std::size_t thrust_ = 0, kick_ = 0;  // the next of each
  struct Flight {
    navigation::Filter begin;
    std::size_t thrust = 0, kick = 0;
    bool badly_known = false;
    std::size_t accepted = 0, sights = 0;  // more than are kept: it is not flown anew
    std::array<navigation::BeaconMeasurement, 1024> kept{};
  };
  Flight flight_;
  struct Flown {
    navigation::Filter filter;
    std::size_t accepted = 0;
  };
  Result<Flown> fly_anew() const;
  Stance stance_;
};

}  // namespace astronav::executive
