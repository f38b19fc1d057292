// SPDX-License-Identifier: Apache-2.0
#include "verification/loop/pointing.h"

#include <algorithm>
#include <cmath>

#include "foundation/math/random.h"
#include "foundation/math/rotation.h"
#include "onboard/executive/stance.h"
#include "simulator/motion/turn.h"

namespace astronav::loop {
namespace {

constexpr double kDegreePerHour = kDegree / 3600.0;
constexpr double kRootHour = 60.0;  // sqrt(s)

motion::GyroErrors errors_of(const scenario::TruthGyro& gyro) {
  return {.angle_random_walk_rad_sqrt_s = gyro.angle_random_walk_deg_sqrt_h * kDegree / kRootHour,
          .bias_random_walk_rad_s_sqrt_s = gyro.bias_random_walk_deg_h_sqrt_h * kDegreePerHour / kRootHour,
          .bias_sigma_rad_s = gyro.bias_deg_h * kDegreePerHour};
}

}  // namespace

Result<Pointing> Pointing::create(const scenario::Scenario& scenario, const FlyOptions& options, const World& world,
                                  const Camera& believed) {
  const auto axes = executive::pixel_axes(world.camera().intrinsics);
  if (!axes) return forward(axes);
  return Pointing(scenario, options, world, believed.intrinsics.plate_scale_rad_px(), *axes);
}

StreamId Pointing::stream(std::string_view purpose, int number) const {
  return {.seed = options_.seed,
          .sample = options_.sample,
          .image = static_cast<std::uint64_t>(number),
          .purpose = purpose};
}

void Pointing::begin_window(int cycle, int window) {
  RandomStream random(stream("roll of a window", 2 * cycle + window));
  roll_rad_ = options_.level == Level::cov ? 0.0 : random.uniform(0.0, 2.0 * kPi);
  if (cycle != cycle_) {
    last_picture_.reset();
    gyro_.reset();
    if (scenario_.truth.gyro.on && options_.level == Level::sil)
      gyro_.emplace(errors_of(scenario_.truth.gyro), stream("gyro", cycle));
  }
  cycle_ = cycle;
  window_ = window;
}

void Pointing::point(const Vec3& aim_N, Epoch mid_exposure, int image) {
  const Mat3 R_PN_before = R_PN();
  RandomStream dither(stream("pointing", image));
  const double sigma = scenario_.conops.dither_px * plate_scale_rad_px_;
  const Vec3 offset(dither.normal(0.0, sigma), dither.normal(0.0, sigma), 0.0);
  const RaDec at = radec_from_direction(aim_N);
  commanded_R_CN_ = rotation_exp(offset) * R_CN_from_pointing({at.ra_rad, at.dec_rad, roll_rad_});

  RandomStream shaking(stream("jitter", image));
  const double jitter = scenario_.truth.pointing.jitter_arcsec * kArcsecond;
  R_CN_ = rotation_exp({shaking.normal(0.0, jitter), shaking.normal(0.0, jitter), shaking.normal(0.0, jitter)}) *
          commanded_R_CN_;

  samples_.clear();
  after_slew_ = last_picture_ && last_window_ != window_;
  if (gyro_ && after_slew_ && scenario_.truth.gyro.jump_deg_h > 0.0)
    gyro_->jump(scenario_.truth.gyro.jump_deg_h * kDegreePerHour);
  if (gyro_ && last_picture_) turn(R_PN_before, *last_picture_, mid_exposure);
  last_picture_ = mid_exposure;
  last_window_ = window_;
}

// The gyro is read out with each picture, so that the samples between two of them may be a little shorter than usual.
void Pointing::turn(const Mat3& R_PN_before, Epoch before, Epoch now) {
  const motion::Turn turn(before, R_PN_before, now, R_PN());
  const double seconds = (now - before).seconds();
  const int count = std::max(1, static_cast<int>(std::ceil(seconds / scenario_.truth.gyro.sample_period_s - 1e-9)));
  const auto at = [&](int k) { return k == count ? now : before + Duration::seconds(seconds * k / count); };
  for (int k = 0; k < count; ++k) {
    const Vec3 rate = turn.mean_rate_rad_s(at(k), at(k + 1));
    samples_.push_back({world_.onboard_clock(at(k)), world_.onboard_clock(at(k + 1)),
                        gyro_->measure(rate, (at(k + 1) - at(k)).seconds())});
  }
}

std::optional<Vec3> Pointing::gyro_bias_rad_s() const {
  return gyro_ ? std::optional(gyro_->bias_rad_s()) : std::nullopt;
}

}  // namespace astronav::loop
