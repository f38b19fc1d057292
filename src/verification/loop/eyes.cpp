// SPDX-License-Identifier: Apache-2.0
#include "verification/loop/eyes.h"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <unordered_map>
#include <utility>

#include <Eigen/Cholesky>
#include <fmt/format.h>

#include "foundation/math/rotation.h"
#include "foundation/math/statistics.h"
#include "verification/loop/belief.h"

namespace astronav::loop {
namespace {

double milliseconds_since(std::chrono::steady_clock::time_point start) {
  return std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - start).count();
}

// A planet's spot farther from the truth than this is another spot.
constexpr double kFalsePlanetPx = 3.0;
// An attitude is wrong where it is off by more than its own bounds allow, and by more than a centroid could explain.
constexpr double kWrongAttitudeRad = 60.0 * kArcsecond;
constexpr double kWrongAttitudeSigma = 5.0;

// What the attitude filter foretold of an image, and what it knows of the gyro after it, against the truth.
AttitudeRecord judge_stance(const executive::StanceReport& stance, const Pointing& pointing) {
  AttitudeRecord record;
  if (stance.foretold) {
    record.foretold = true;
    record.after_slew = pointing.after_slew();
    record.error_rad = -rotation_log(pointing.R_PN() * stance.foretold->R_CN.transpose());
    const Mat3& covariance = stance.foretold->covariance_rad2;
    record.sigma_rad = covariance.diagonal().cwiseSqrt();
    record.nees = record.error_rad.dot(covariance.llt().solve(record.error_rad));
  }
  if (stance.update) {
    record.accepted = stance.update->accepted();
    record.restarted = stance.update->verdict == attitude::AttitudeVerdict::gated;
    record.nis = stance.update->nis;
  }
  const auto bias = pointing.gyro_bias_rad_s();
  if (stance.after && bias) {
    record.knows_bias = true;
    record.bias_error_rad_s = *bias - stance.after->gyro_bias_rad_s;
    record.bias_sigma_rad_s = stance.after->gyro_bias_sigma_rad_s;
  }
  return record;
}

}  // namespace

Result<std::unique_ptr<Eyes>> Eyes::create(const scenario::Scenario& s, World& world, const Camera& believed,
                                           Epoch epoch) {
  std::unique_ptr<Eyes> eyes(new Eyes(world));
  const auto true_axes = executive::pixel_axes(world.camera().intrinsics);
  if (!true_axes) return forward(true_axes);
  eyes->true_axes_ = *true_axes;
  const scenario::OnboardVision& belief = s.onboard.vision;
  const double fov_h = believed.intrinsics.field_of_view_horizontal_rad();
  const double fov_v = believed.intrinsics.field_of_view_vertical_rad();
  eyes->field_ = vision::StarField::build(world.catalogue(), belief.star_max_v_mag, epoch);
  eyes->neighbours_ = vision::StarField::build(world.catalogue(), neighbours_max_v_mag(s), epoch);
  auto asterisms = vision::AsterismSettings::for_field(fov_h, fov_v);
  asterisms.max_v_mag = std::min(asterisms.max_v_mag, belief.star_max_v_mag);
  eyes->index_bytes_ = vision::build_pair_index(eyes->field_, asterisms);
  const auto index = vision::PairIndex::open(eyes->index_bytes_);
  if (!index) return forward(index);
  eyes->index_ = *index;
  eyes->vision_ = std::make_unique<vision::Vision>(vision_settings(s), believed.intrinsics,
                                                   vision::SensorModel::from(believed), eyes->field_, eyes->index_);
  eyes->vision_->look_up_neighbours_in(eyes->neighbours_);
  if (belief.exposure == "chosen") {
    const auto exposure = exposure_settings(s, believed);
    if (!exposure) return forward(exposure);
    eyes->exposure_ = std::make_unique<vision::ExposureControl>(*exposure, vision::SensorModel::from(believed),
                                                                believed.intrinsics, eyes->field_);
  }
  eyes->known_latency_s_ = 1e-3 * believed.detector.time_tag_latency_ms;
  eyes->frame_ = ImageU16(believed.intrinsics.width_px, believed.intrinsics.height_px);
  return eyes;
}

Result<void> Eyes::expose(Epoch epoch, const State& truth_O, const Mat3& R_CN, double exposure_s,
                          const StreamId& noise) {
  const Camera& camera = world_.camera();
  const Vec3 boresight_N = R_CN.row(2).transpose();
  const auto sky = world_.sky().look(epoch, truth_O, boresight_N, camera.intrinsics.half_diagonal_rad() + 0.5 * kDegree,
                                     world_.band(), world_.sky_settings());
  if (!sky) return forward(sky);
  render::Exposure exposure{.duration_s = exposure_s};
  exposure.sun_C_m = R_CN * world_.sky().sun_N_m(epoch, truth_O);
  sources_ = render::place_sources(*sky, camera, R_CN, exposure);
  world_.renderer(epoch).frame(sources_, exposure, noise, frame_);
  return {};
}

Epoch Eyes::tag(Epoch clock, const StreamId& noise) const {
  return clock + Duration::seconds(render::time_tag_error_s(world_.camera().detector, noise) - known_latency_s_);
}

Result<void> Eyes::survey(Event& event, Epoch clock, const State& truth_O, const Mat3& R_CN, double exposure_s,
                          const StreamId& noise, executive::ColdStart& start) {
  if (const auto ok = expose(event.epoch, truth_O, R_CN, exposure_s, noise); !ok) return ok;
  const Epoch tagged = tag(clock, noise);
  const vision::FrameResult& seen = vision_->process(std::as_const(frame_).view(), {.epoch = tagged});
  event.spots = start.see(seen, tagged);
  judge_attitude(event, seen, R_CN);
  return {};
}

Result<void> Eyes::photograph(Event& event, Epoch clock, const State& truth_O, const Pointing& pointing, BodyId beacon,
                              const StreamId& noise, executive::Navigator& navigator, Records& records, bool keep_frame,
                              executive::ColdStart* start) {
  const Mat3& R_CN = pointing.R_CN();
  auto before = std::chrono::steady_clock::now();
  if (const auto ok = expose(event.epoch, truth_O, R_CN, navigator.exposure_s(), noise); !ok) return ok;
  records.stage_ms_sum.render += milliseconds_since(before);

  const Epoch tagged = tag(clock, noise);
  before = std::chrono::steady_clock::now();
  for (const attitude::GyroSample& sample : pointing.gyro()) navigator.sense(sample);
  const Mat3& commanded = pointing.commanded_R_CN();
  const auto look = start != nullptr ? navigator.watch(std::as_const(frame_).view(), tagged, beacon, commanded)
                                     : navigator.look(std::as_const(frame_).view(), tagged, beacon, commanded);
  if (!look) return forward(look);
  event.for_start = start != nullptr;
  if (start != nullptr && look->measured) start->add(look->measurement);
  const double onboard_ms = milliseconds_since(before);
  const vision::StageTimes& stages = look->frame->time_ms;
  records.stage_ms_sum.centroid += stages.centroid;
  records.stage_ms_sum.identify += stages.identify;
  records.stage_ms_sum.planets += stages.planets;
  records.stage_ms_sum.update += std::max(0.0, onboard_ms - stages.total);
  records.image_ms.push_back(onboard_ms);
  judge(event, *look, R_CN, beacon);
  event.attitude = judge_stance(look->stance, pointing);
  if (keep_frame) records.frames.push_back(keep(event, *look));
  return {};
}

void Eyes::judge_attitude(Event& event, const vision::FrameResult& seen, const Mat3& R_CN) const {
  event.attitude_found = seen.source != vision::AttitudeSource::none;
  event.by_prior = seen.source == vision::AttitudeSource::prior;
  if (event.attitude_found) {
    // R_CN_true = exp(-[theta]x) R_CN_found, both in the axes of the believed camera: a principal point that is not
    // where it is believed turns the axes, not the picture.
    const auto believed_axes = executive::pixel_axes(seen.attitude.intrinsics);
    const Mat3 R_believed_true = believed_axes ? Mat3(*believed_axes * true_axes_.transpose()) : Mat3::Identity();
    event.attitude_error_rad = -rotation_log(R_believed_true * R_CN * seen.attitude.R_CN.transpose());
    event.attitude_sigma_rad = seen.attitude.covariance_rad2.diagonal().cwiseSqrt();
    event.attitude_repeating_rad = seen.attitude.repeating_rad2.diagonal().cwiseSqrt();
    const double worst = event.attitude_error_rad.cwiseQuotient(event.attitude_sigma_rad).cwiseAbs().maxCoeff();
    event.attitude_wrong = event.attitude_error_rad.norm() > kWrongAttitudeRad && worst > kWrongAttitudeSigma;
    event.stars_matched = static_cast<int>(seen.stars.size());
    std::unordered_map<std::int64_t, Pixel> truth;
    for (const render::RenderedSource& s : sources_) {
      if (s.source.kind == sky::SourceKind::star) truth.emplace(s.source.id, s.pixel);
    }
    for (const vision::MatchedStar& star : seen.stars) {
      const auto at = truth.find(star.id);
      if (at == truth.end()) continue;
      const Vec2 error = seen.centroids[star.centroid].pixel.vec() - at->second.vec();
      if (error.norm() > kFalsePlanetPx) continue;  // matched to another star's spot: not a centroid error
      event.centroid_error_sum2_px2 += error.squaredNorm();
      event.centroid_error_count += 2;
    }
  }
}

void Eyes::judge(Event& event, const executive::Look& look, const Mat3& R_CN, BodyId beacon) const {
  event.spots = static_cast<int>(look.frame->centroids.size());
  judge_attitude(event, *look.frame, R_CN);
  if (!look.measured) return;
  event.planet_found = true;
  event.accepted = look.update.accepted;
  event.innovation_px = look.update.innovation_px;
  event.innovation_covariance_px2 = look.update.innovation_covariance_px2;
  event.nis = look.update.nis;
  event.planet_sigma_px = look.measurement.pixel_covariance_px2.diagonal().cwiseSqrt();
  event.planet_repeating_px = look.measurement.repeating_sigma_px;
  event.planet_false = true;
  for (const render::RenderedSource& s : sources_) {
    if (s.source.kind != sky::SourceKind::planet || s.source.id != beacon.value) continue;
    event.planet_error_px = look.frame->centroids[look.frame->planets[0].centroid].pixel.vec() - s.pixel.vec();
    event.planet_false = event.planet_error_px.norm() > kFalsePlanetPx;
  }
}

KeptFrame Eyes::keep(const Event& event, const executive::Look& look) const {
  const vision::FrameResult& seen = *look.frame;
  KeptFrame kept;
  kept.epoch = event.epoch;
  kept.beacon = event.body;
  kept.pixels = frame_;
  std::vector<bool> named(seen.centroids.size(), false);
  for (const vision::MatchedStar& star : seen.stars) {
    named[star.centroid] = true;
    kept.marks.push_back({seen.centroids[star.centroid].pixel, fmt::format("HIP {}", star.id), "star", 6.0});
  }
  if (look.measured) {
    named[seen.planets[0].centroid] = true;
    kept.marks.push_back({look.measurement.pixel, std::string(body_name(event.body)), "planet", 9.0});
  }
  if (event.attitude_found) {
    if (const auto predicted = vision::predict_pixel(look.prediction, seen.attitude)) {
      // Where the planet had to be, as an ellipse's larger axis at 99.7 %.
      const double sigma = std::sqrt(predicted->covariance_px2.trace());
      kept.marks.push_back({predicted->pixel, fmt::format("{} predicted", body_name(event.body)), "predicted",
                            std::max(3.0, 3.0 * sigma)});
    }
  }
  for (std::size_t i = 0; i < seen.centroids.size(); ++i) {
    if (!named[i]) kept.marks.push_back({seen.centroids[i].pixel, "", "spot", 5.0});
  }
  return kept;
}

}  // namespace astronav::loop
