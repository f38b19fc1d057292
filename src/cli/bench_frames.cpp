// SPDX-License-Identifier: Apache-2.0
// Figures of rendering and image processing.
#include <algorithm>
#include <cmath>
#include <memory>
#include <string>
#include <thread>
#include <unordered_map>
#include <utility>

#include <fmt/format.h>
#include <malloc.h>

#include "cli/bench.h"
#include "cli/bench_timing.h"
#include "foundation/math/rotation.h"
#include "simulator/render/renderer.h"
#include "verification/loop/belief.h"

namespace astronav::cli::bench {
namespace {

constexpr int kFrames = 100;
constexpr int kWarmUpFrames = 3;  // looked at, but not timed
constexpr double kLeastSnr = 20.0;
// As in a mission's summary: an attitude is wrong where it is off by more than this and five of its own sigmas, and a
// star's spot farther from the truth than this is another star's.
constexpr double kWrongAttitudeRad = 60.0 * kArcsecond;
constexpr double kWrongAttitudeSigma = 5.0;
constexpr double kOtherSpotPx = 3.0;
// How far off a prior attitude is, 1 sigma an axis: what a gyro leaves after a slew.
constexpr double kPriorSigmaRad = 200.0 * kArcsecond;

// Takes frames of random pointings with one camera.
class Photographer {
 public:
  Photographer(const Bench& bench, const Camera& camera)
      : Photographer(bench, std::make_shared<const render::Renderer>(camera, 1), 1) {}
  // Beside others that share the renderer.
  Photographer(const Bench& bench, std::shared_ptr<const render::Renderer> renderer, std::uint64_t seed)
      : bench_(bench), renderer_(std::move(renderer)), random_({.seed = seed, .purpose = "bench pointings"}) {}

  // From the pointing to the DN: the stars of the field are looked up too.
  Result<void> shoot() {
    R_CN = R_CN_from_pointing(
        {random_.uniform(0.0, 2.0 * kPi), std::asin(random_.uniform(-1.0, 1.0)), random_.uniform(0.0, 2.0 * kPi)});
    const Camera& camera = renderer_->camera();
    const auto sky = bench_.world->sky().look(bench_.epoch, bench_.observer_O, R_CN.row(2).transpose(),
                                              camera.intrinsics.half_diagonal_rad() + 0.5 * kDegree,
                                              bench_.world->band(), bench_.world->sky_settings());
    if (!sky) return forward(sky);
    sources = render::place_sources(*sky, camera, R_CN, camera.exposure_s);
    draw();
    return {};
  }
  // The same sources once more, with noise of their own.
  void draw() {
    renderer_->frame(sources, {.duration_s = renderer_->camera().exposure_s}, {.image = ++images_, .purpose = "frame"},
                     frame);
  }

  // The last frame.
  Mat3 R_CN = Mat3::Identity();
  std::vector<render::RenderedSource> sources;
  ImageU16 frame;

 private:
  const Bench& bench_;
  std::shared_ptr<const render::Renderer> renderer_;
  RandomStream random_;
  std::uint64_t images_ = 0;
};

// The same lens before a detector of twice the pixels each way at half the pitch: a spot is twice as many pixels wide,
// and a pixel gets a quarter of the diffuse light and of the dark current.
Camera finer(Camera camera) {
  Intrinsics& k = camera.intrinsics;
  k.width_px *= 2;
  k.height_px *= 2;
  k.fx_px *= 2.0;
  k.fy_px *= 2.0;
  k.cx_px = 2.0 * (k.cx_px + 0.5) - 0.5;
  k.cy_px = 2.0 * (k.cy_px + 0.5) - 0.5;
  PointSpread& psf = camera.psf;
  for (double* px :
       {&psf.sigma_px, &psf.sigma_growth_px, &psf.halo_sigma_px, &psf.halo_offset_u_px, &psf.halo_offset_v_px})
    *px *= 2.0;
  Detector& d = camera.detector;
  d.pixel_pitch_m *= 0.5;
  d.background_e_s_px *= 0.25;
  d.dark_current_e_s *= 0.25;
  return camera;
}

// Everything that makes noise, at rates typical of a small camera in deep space.
Camera noisiest(Camera camera) {
  Detector& d = camera.detector;
  d.hot_pixel_share = 1e-4;
  d.hot_pixel_e_s = 500.0;
  d.cosmic_rays_cm2_s = 5.0;
  d.blooming = true;
  d.frame_transfer_row_us = 1.0;
  return camera;
}

Result<Figure> render_fps(const Bench& bench, const Camera& camera) {
  Photographer photographer(bench, camera);
  Result<void> ok;
  std::size_t frames = 0, sources = 0;
  const Timing timing = measure([&] {
    if (auto shot = photographer.shoot(); !shot) ok = shot;
    sources += photographer.sources.size();
    ++frames;
  });
  if (!ok) return forward(ok);
  return Figure{1.0 / timing.median_s(), "1/s",
                fmt::format("all noise, one core, {} x {}, random pointings, {:.0f} sources a frame; {}",
                            camera.intrinsics.width_px, camera.intrinsics.height_px,
                            static_cast<double>(sources) / static_cast<double>(frames), spread(timing, 1e3, "ms"))};
}

void judge_centroids(const vision::FrameResult& seen, const std::vector<render::RenderedSource>& sources,
                     Survey& survey) {
  std::unordered_map<std::int64_t, Pixel> truth;
  for (const render::RenderedSource& s : sources) {
    if (s.source.kind == sky::SourceKind::star) truth.emplace(s.source.id, s.pixel);
  }
  for (const vision::MatchedStar& star : seen.stars) {
    const vision::Centroid& spot = seen.centroids[star.centroid];
    const auto at = truth.find(star.id);
    if (at == truth.end() || spot.snr < kLeastSnr) continue;
    const Vec2 error = spot.pixel.vec() - at->second.vec();
    if (error.norm() > kOtherSpotPx) continue;
    survey.centroid_errors_px.push_back(error.x());
    survey.centroid_errors_px.push_back(error.y());
  }
}

void judge(const vision::FrameResult& seen, const Photographer& photographer, Survey& survey) {
  if (seen.source == vision::AttitudeSource::none) return;
  const Vec3 error = -rotation_log(photographer.R_CN * seen.attitude.R_CN.transpose());
  const Vec3 sigma = seen.attitude.covariance_rad2.diagonal().cwiseSqrt();
  if (error.norm() > kWrongAttitudeRad && error.cwiseQuotient(sigma).cwiseAbs().maxCoeff() > kWrongAttitudeSigma) {
    ++survey.wrong;
    return;
  }
  ++survey.solved;
  survey.attitude_errors_arcsec.push_back(error / kArcsecond);
  judge_centroids(seen, photographer.sources, survey);
}

Result<Survey> look_at_frames(const Bench& bench) {
  const auto eyes = OnboardEyes::create(bench);
  if (!eyes) return forward(eyes);
  vision::Vision& vision = *(*eyes)->vision;
  const vision::Observer observer{.epoch = bench.epoch, .p_O_N = bench.observer_O.p_m, .v_O_N = bench.observer_O.v_m_s};
  Photographer photographer(bench, bench.world->camera());
  RandomStream random({.seed = 1, .purpose = "bench prior attitudes"});
  Survey survey;
  for (int i = 0; i < kFrames; ++i) {
    if (const auto shot = photographer.shoot(); !shot) return forward(shot);
    const ImageView<const std::uint16_t> frame = std::as_const(photographer.frame).view();
    const bool timed = i >= kWarmUpFrames;
    double before = seconds_now();
    const vision::FrameResult& seen = vision.process(frame, observer);
    if (timed) survey.lost_in_space_ms.push_back((seconds_now() - before) * 1e3);
    if (timed) survey.centroid_ms.push_back(seen.time_ms.centroid);
    judge(seen, photographer, survey);
    const Vec3 off(random.normal(0.0, kPriorSigmaRad), random.normal(0.0, kPriorSigmaRad),
                   random.normal(0.0, kPriorSigmaRad));
    const Mat3 prior = rotation_exp(off) * photographer.R_CN;
    before = seconds_now();
    const vision::FrameResult& again = vision.process(frame, observer, prior);
    if (timed) survey.tracked_ms.push_back((seconds_now() - before) * 1e3);
    survey.tracked += again.source == vision::AttitudeSource::prior;
    ++survey.frames;
    if (bench.progress) bench.progress(static_cast<double>(i + 1) / kFrames, "");
  }
  return survey;
}

Result<const Survey*> survey_of(Bench& bench) {
  if (!bench.survey) {
    auto survey = look_at_frames(bench);
    if (!survey) return forward(survey);
    bench.survey = std::move(*survey);
  }
  return &*bench.survey;
}

Result<const Survey*> solved_survey_of(Bench& bench) {
  const auto survey = survey_of(bench);
  if (survey && (*survey)->solved == 0) return fail(ErrorCode::no_match, "no frame's attitude was found");
  return survey;
}

Figure time_figure(const Survey& survey, const std::vector<double>& ms, const std::string& what) {
  return {median(ms), "ms",
          fmt::format(
              "{}; median of {} frames; 10 to 90 %: {:.4g} to {:.4g} ms, largest {:.4g}; centroids alone {:.4g}", what,
              ms.size(), quantile(ms, 0.1), quantile(ms, 0.9), quantile(ms, 1.0), median(survey.centroid_ms))};
}

// Share of the axes `first` to `first + count` in each error.
std::vector<double> sizes_of(const std::vector<Vec3>& errors, int first, int count) {
  std::vector<double> sizes;
  for (const Vec3& e : errors) sizes.push_back(e.segment(first, count).norm());
  return sizes;
}

Figure attitude_figure(const std::vector<double>& sizes, const std::string& what) {
  return {median(sizes), "arcsec",
          fmt::format("{}; median of {} frames; 10 to 90 %: {:.3g} to {:.3g}", what, sizes.size(), quantile(sizes, 0.1),
                      quantile(sizes, 0.9))};
}

// Of the main arena and what was mapped for large blocks: all there is in a program of one thread.
std::size_t heap_in_use() {
  const struct mallinfo2 info = mallinfo2();
  return info.uordblks + info.hblkhd;
}

}  // namespace

Result<std::unique_ptr<OnboardEyes>> OnboardEyes::create(const Bench& bench) {
  auto eyes = std::make_unique<OnboardEyes>();
  const Intrinsics& camera = bench.believed.intrinsics;
  const double max_v = bench.scenario.onboard.vision.star_max_v_mag;
  std::size_t before = heap_in_use();
  const auto grown = [&before] { return heap_in_use() - std::exchange(before, heap_in_use()); };
  eyes->field = vision::StarField::build(bench.world->catalogue(), max_v, bench.epoch);
  eyes->field_size = grown();
  eyes->neighbours =
      vision::StarField::build(bench.world->catalogue(), loop::neighbours_max_v_mag(bench.scenario), bench.epoch);
  eyes->neighbours_size = grown();
  auto asterisms =
      vision::AsterismSettings::for_field(camera.field_of_view_horizontal_rad(), camera.field_of_view_vertical_rad());
  asterisms.max_v_mag = std::min(asterisms.max_v_mag, max_v);
  eyes->index_bytes = vision::build_pair_index(eyes->field, asterisms);
  const auto index = vision::PairIndex::open(eyes->index_bytes);
  if (!index) return forward(index);
  eyes->index = *index;
  eyes->index_size = grown();
  eyes->vision = std::make_unique<vision::Vision>(loop::vision_settings(bench.scenario), camera,
                                                  vision::SensorModel::from(bench.believed), eyes->field, eyes->index);
  eyes->vision->look_up_neighbours_in(eyes->neighbours);
  eyes->vision_size = grown();
  return eyes;
}

Result<Figure> render_fps_1024(Bench& bench) {
  return render_fps(bench, noisiest(bench.believed));
}
Result<Figure> render_fps_2048(Bench& bench) {
  return render_fps(bench, noisiest(finer(bench.believed)));
}

// With the mission's true lens, whose halo makes of every star a spot of some hundred pixels.
Result<Figure> render_fps_1024_halo(Bench& bench) {
  return render_fps(bench, noisiest(bench.world->camera()));
}

// What of the former is the drawing itself: the sources are known, and the same in every frame.
Result<Figure> render_frame_ms_1024(Bench& bench) {
  Photographer photographer(bench, noisiest(bench.believed));
  if (const auto shot = photographer.shoot(); !shot) return forward(shot);
  const Timing timing = measure([&] { photographer.draw(); });
  return Figure{timing.median_s() * 1e3, "ms",
                fmt::format("sources to DN, {} sources; {}", photographer.sources.size(), spread(timing, 1e3, "ms"))};
}

// Frames of two threads over those of one, in turns, so that what else the machine does falls on both alike.
Result<Figure> render_two_threads(Bench& bench) {
  constexpr int kRounds = 7;
  constexpr double kRoundS = 0.3;
  const auto renderer = std::make_shared<const render::Renderer>(noisiest(bench.believed), 1);
  const auto work = [&](std::uint64_t seed, double until, std::size_t& frames) {
    Photographer photographer(bench, renderer, seed);
    while (seconds_now() < until && photographer.shoot()) ++frames;
  };
  std::vector<double> ratios;
  for (int i = 0; i <= kRounds; ++i) {
    std::size_t one = 0, first = 0, second = 0;
    work(1, seconds_now() + kRoundS, one);
    const double until = seconds_now() + kRoundS;
    std::thread other([&] { work(2, until, second); });
    work(1, until, first);
    other.join();
    // The first round warms up.
    if (i > 0 && one > 0) ratios.push_back(static_cast<double>(first + second) / static_cast<double>(one));
  }
  if (ratios.empty()) return fail(ErrorCode::not_converged, "no frame was made");
  return Figure{
      median(ratios), "x",
      fmt::format("frames of two threads over those of one, median of {} turns; smallest {:.3g}, largest "
                  "{:.3g}; {} processors",
                  ratios.size(), quantile(ratios, 0.0), quantile(ratios, 1.0), std::thread::hardware_concurrency())};
}

Result<Figure> vision_ms_lost_in_space_1024(Bench& bench) {
  const auto survey = survey_of(bench);
  if (!survey) return forward(survey);
  return time_figure(**survey, (*survey)->lost_in_space_ms, "attitude from nothing");
}

Result<Figure> vision_ms_tracked_1024(Bench& bench) {
  const auto survey = survey_of(bench);
  if (!survey) return forward(survey);
  return time_figure(**survey, (*survey)->tracked_ms,
                     fmt::format("prior attitude off by {:.0f} arcsec an axis, used in {} of {}",
                                 kPriorSigmaRad / kArcsecond, (*survey)->tracked, (*survey)->frames));
}

Result<Figure> attitude_cross_arcsec(Bench& bench) {
  const auto survey = solved_survey_of(bench);
  if (!survey) return forward(survey);
  return attitude_figure(sizes_of((*survey)->attitude_errors_arcsec, 0, 2),
                         "of the boresight, camera as believed, what calibration left included");
}

// A true camera that is not centred as believed turns every attitude by the same angle; the rest is the software's.
Result<Figure> attitude_cross_scatter_arcsec(Bench& bench) {
  const auto survey = solved_survey_of(bench);
  if (!survey) return forward(survey);
  std::vector<Vec3> errors = (*survey)->attitude_errors_arcsec;
  Vec3 constant = Vec3::Zero();
  for (const Vec3& e : errors) constant += e / static_cast<double>(errors.size());
  for (Vec3& e : errors) e -= constant;
  return attitude_figure(sizes_of(errors, 0, 2), "the same without the part that all frames share");
}

Result<Figure> attitude_roll_arcsec(Bench& bench) {
  const auto survey = solved_survey_of(bench);
  if (!survey) return forward(survey);
  return attitude_figure(sizes_of((*survey)->attitude_errors_arcsec, 2, 1), "about the boresight, camera as believed");
}

Result<Figure> centroid_px(Bench& bench) {
  const auto survey = solved_survey_of(bench);
  if (!survey) return forward(survey);
  std::vector<double> sizes = (*survey)->centroid_errors_px;
  for (double& e : sizes) e = std::abs(e);
  return Figure{rms((*survey)->centroid_errors_px), "px",
                fmt::format("1 sigma an axis (rms), {} stars with S/N > {:.0f}; 68 % within {:.4g}, 95 % within {:.4g}",
                            sizes.size() / 2, kLeastSnr, quantile(sizes, 0.6827), quantile(sizes, 0.95))};
}

Result<Figure> solve_success_rate(Bench& bench) {
  const auto survey = survey_of(bench);
  if (!survey) return forward(survey);
  const Survey& s = **survey;
  return Figure{static_cast<double>(s.solved) / s.frames, "share",
                fmt::format("lost in space: {} of {} right, {} wrong, {} not found", s.solved, s.frames, s.wrong,
                            s.frames - s.solved - s.wrong)};
}

}  // namespace astronav::cli::bench
