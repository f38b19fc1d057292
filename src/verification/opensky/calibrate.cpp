// SPDX-License-Identifier: Apache-2.0
#include "verification/opensky/calibrate.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "foundation/math/statistics.h"
#include "verification/opensky/calibrate_fisheye.h"
#include "verification/opensky/calibrate_stars.h"
#include "verification/opensky/spots.h"

namespace astronav::opensky {
namespace {

constexpr double kZenithRadius = 30.0 * kDegree;
constexpr FieldRange kAllSky{140.0 * kDegree, 230.0 * kDegree};  // across the shorter side
constexpr double kPlanetMag = 6.5;                               // brighter ones are kept out of the stars
constexpr double kPlanetRadiusPx = 10.0;
constexpr double kSeenRadiusPx = 5.0;
constexpr std::size_t kMaxSpots = 1500;
constexpr double kSameField = 1.03;
constexpr std::size_t kMostTried = 12;   // pictures, of which each is left out in turn
constexpr std::size_t kStarsAlone = 25;  // that say how well a picture fits a camera of its own
constexpr int kLeastStars = 6;           // of a picture, that agree with the others' camera

// In order of their number of parameters.
constexpr std::array<LensFreedom, 13> kModels{{{},
                                               {.radial = 1},
                                               {.radial = 2},
                                               {.radial = 1, .aspect = true},
                                               {.centre = true, .radial = 1},
                                               {.radial = 1, .tangential = true},
                                               {.centre = true, .radial = 2},
                                               {.centre = true, .radial = 1, .aspect = true},
                                               {.centre = true, .radial = 1, .tangential = true},
                                               {.centre = true, .radial = 2, .tangential = true},
                                               {.centre = true, .radial = 3, .tangential = true},
                                               {.centre = true, .radial = 2, .tangential = true, .aspect = true},
                                               {.centre = true, .radial = 3, .tangential = true, .aspect = true}}};

struct View {
  std::size_t frame = 0;  // of the request
  Epoch epoch;
  std::optional<State> observer;
  std::vector<vision::Centroid> spots;  // as a camera that is not mirrored sees them
  double background_dn = 0.0, noise_dn = 0.0;
  std::vector<SkyStar> sky;
  std::vector<SkyPlanet> planets;
  Mat3 R_CN = Mat3::Identity();
  std::vector<StarMatch> named;  // as recognised
};

// Which star and spot an observation is.
struct Tag {
  std::size_t view, star, spot;
};
struct Sightings {
  std::vector<StarObservation> observations;
  std::vector<Tag> tags;
};

class Calibrator {
 public:
  Calibrator(const StarCatalogue& catalogue, std::span<const CalibrationFrame> frames,
             const CalibrationRequest& request)
      : catalogue_(catalogue), frames_(frames), request_(request) {}

  Result<Calibration> run() {
    if (const auto checked = check(); !checked) return forward(checked);
    const auto recognised = request_.model == ProjectionModel::fisheye ? recognise_all_sky() : recognise();
    if (!recognised) return forward(recognised);
    Result<Sightings> sightings = gather();
    if (!sightings) return forward(sightings);
    const Result<Adjustment> best = choose_model(*sightings);
    if (!best) return forward(best);
    report(*sightings, *best);
    return std::move(out_);
  }

 private:
  Result<void> check() {
    if (frames_.empty()) return fail(ErrorCode::invalid_argument, "no pictures to calibrate from");
    width_ = frames_[0].picture->pixels.width();
    height_ = frames_[0].picture->pixels.height();
    for (const CalibrationFrame& frame : frames_) {
      if (frame.picture->pixels.width() != width_ || frame.picture->pixels.height() != height_) {
        return fail(
            ErrorCode::invalid_argument, "one camera has one size of picture: {0} x {1} here, {2} x {3} before",
            {static_cast<double>(frame.picture->pixels.width()), static_cast<double>(frame.picture->pixels.height()),
             static_cast<double>(width_), static_cast<double>(height_)});
      }
    }
    out_.frames.resize(frames_.size());
    return {};
  }

  View view_of(std::size_t k, double max_v_mag) const {
    const CalibrationFrame& frame = frames_[k];
    View view;
    view.frame = k;
    view.epoch = frame.epoch.value_or(assumed_epoch());
    view.observer = frame.observer;
    SpotSettings settings = request_.model == ProjectionModel::fisheye ? SpotSettings::all_sky() : SpotSettings{};
    settings.max_spots = kMaxSpots;
    Spots found = find_spots(*frame.picture, settings);
    view.spots = std::move(found.spots);
    view.background_dn = found.background_dn;
    view.noise_dn = found.noise_dn;
    view.sky = apparent_stars(catalogue_, max_v_mag, view.epoch, view.observer, frame.refraction);
    if (request_.ephemeris && frame.epoch && frame.observer)
      view.planets = apparent_planets(*request_.ephemeris, view.epoch, *frame.observer, frame.refraction);
    return view;
  }

  // Each by itself, of which nothing is known; most of them say which way round the pictures are and how wide. Those
  // that were not recognised are tried once more with the others' field.
  Result<void> recognise() {
    Solver solver(catalogue_);
    std::vector<std::optional<Solution>> solutions(frames_.size());
    const auto solve = [&](std::size_t k, const std::optional<FieldRange>& field) {
      const SolveRequest ask{.field = field,
                             .camera = {},
                             .epoch = frames_[k].epoch,
                             .observer = frames_[k].observer,
                             .refraction = frames_[k].refraction,
                             .near = request_.near,
                             .ephemeris = nullptr};
      auto solution = solver.solve(*frames_[k].picture, ask);
      out_.frames[k].error.reset();
      if (solution)
        solutions[k] = std::move(*solution);
      else
        out_.frames[k].error = solution.error();
    };
    std::vector<double> focal;
    int mirrored = 0;
    for (std::size_t k = 0; k < frames_.size(); ++k) {
      solve(k, request_.field);
      if (!solutions[k]) continue;
      focal.push_back(solutions[k]->attitude.intrinsics.fx_px);
      mirrored += solutions[k]->mirrored;
    }
    if (focal.empty()) return tl::make_unexpected(*out_.frames.back().error);
    out_.mirrored = 2 * mirrored > static_cast<int>(focal.size());
    const double middle = median(focal), fov = 2.0 * std::atan(0.5 * width_ / middle);
    for (std::size_t k = 0; k < frames_.size(); ++k) {
      if (!solutions[k]) solve(k, FieldRange{fov / kSameField, fov * kSameField});
      if (!solutions[k]) continue;
      const Intrinsics& camera = solutions[k]->attitude.intrinsics;
      const bool other_field = std::abs(std::log(camera.fx_px / middle)) > std::log(kSameField);
      if (other_field || solutions[k]->mirrored != out_.mirrored) {
        const double own = camera.field_of_view_horizontal_rad();
        out_.frames[k].error =
            (other_field
                 ? fail(ErrorCode::invalid_argument, "recognised, but {0} degrees wide where most pictures are {1}",
                        {std::round(100.0 * own / kDegree) / 100.0, std::round(100.0 * fov / kDegree) / 100.0})
                 : fail(ErrorCode::invalid_argument,
                        "recognised, but the other way round than most pictures (mirrored)"))
                .value();
        continue;
      }
      View view = view_of(k, request_.max_v_mag);
      view.named = names_of(*solutions[k], view);
      if (out_.mirrored) turn_round(view.spots, width_);
      view.R_CN = solutions[k]->attitude.R_CN;
      if (views_.empty() || solutions[k]->stars.size() > most_stars_) {
        most_stars_ = solutions[k]->stars.size();
        camera_ = camera;
      }
      views_.push_back(std::move(view));
    }
    return {};
  }

  // The solver's spots and the calibration's are found with other settings: the same place is the same spot.
  static std::vector<StarMatch> names_of(const Solution& solution, const View& view) {
    constexpr double kSamePx = 0.01;
    std::vector<StarMatch> named;
    for (const SolvedStar& star : solution.stars) {
      const auto in_sky = std::find_if(view.sky.begin(), view.sky.end(),
                                       [&](const SkyStar& s) { return s.index == star.match.catalogue_index; });
      const auto spot = std::find_if(view.spots.begin(), view.spots.end(), [&](const vision::Centroid& s) {
        return (s.pixel.vec() - star.spot.pixel.vec()).norm() < kSamePx;
      });
      if (in_sky == view.sky.end() || spot == view.spots.end()) continue;
      named.push_back(
          {static_cast<std::size_t>(in_sky - view.sky.begin()), static_cast<std::size_t>(spot - view.spots.begin())});
    }
    return named;
  }

  Result<void> recognise_all_sky() {
    const double shorter = std::min(width_, height_);
    double focal_min = shorter / kAllSky.max_rad, focal_max = shorter / kAllSky.min_rad;
    if (request_.field) {
      focal_min = width_ / request_.field->max_rad;
      focal_max = width_ / request_.field->min_rad;
    }
    Result<void> last;
    for (std::size_t k = 0; k < frames_.size(); ++k) {
      std::optional<Near> near = request_.near;
      if (!near && frames_[k].zenith_N) near = Near{*frames_[k].zenith_N, kZenithRadius};
      View view = view_of(k, std::min(request_.max_v_mag, 7.0));
      const auto look = find_fisheye(view.spots, view.sky, width_, height_, focal_min, focal_max, near);
      if (!look || (!views_.empty() && look->mirrored != out_.mirrored)) {
        out_.frames[k].error = look
                                   ? Error{.code = ErrorCode::invalid_argument,
                                           .text = "this picture is mirrored, the first is not, or the other way round"}
                                   : look.error();
        last = tl::make_unexpected(*out_.frames[k].error);
        continue;
      }
      out_.mirrored = look->mirrored;
      if (out_.mirrored) turn_round(view.spots, width_);
      view.R_CN = look->R_CN;
      if (views_.empty()) camera_ = look->camera;
      views_.push_back(std::move(view));
      focal_min = 0.97 * camera_.fx_px;
      focal_max = 1.03 * camera_.fx_px;
    }
    if (views_.empty()) return last;
    return {};
  }

  void take(std::size_t v, std::span<const StarMatch> matches, Sightings& out) const {
    const View& view = views_[v];
    for (const StarMatch& m : matches) {
      const vision::Centroid& spot = view.spots[m.spot];
      out.observations.push_back({static_cast<int>(v), spot.pixel, spot.covariance_px2, view.sky[m.star].direction_N});
      out.tags.push_back({v, m.star, m.spot});
    }
  }

  Sightings sight(double radius_px) const {
    Sightings out;
    for (std::size_t v = 0; v < views_.size(); ++v) {
      const View& view = views_[v];
      std::vector<char> closed(view.spots.size(), 0);
      for (const SkyPlanet& planet : view.planets) {
        const auto pixel = project(camera_, view.R_CN * planet.direction_N);
        if (!pixel || planet.v_mag > kPlanetMag) continue;
        for (std::size_t s = 0; s < view.spots.size(); ++s) {
          if ((view.spots[s].pixel.vec() - pixel->vec()).norm() < kPlanetRadiusPx) closed[s] = 1;
        }
      }
      MatchSettings settings{.radius_px = radius_px, .blend_px = std::max(3.0, radius_px)};
      take(v, match_stars(view.sky, view.spots, closed, camera_, view.R_CN, settings), out);
    }
    return out;
  }

  std::vector<Mat3> attitudes() const {
    std::vector<Mat3> R_CN;
    for (const View& view : views_) R_CN.push_back(view.R_CN);
    return R_CN;
  }
  void take(const Adjustment& a) {
    camera_ = a.camera;
    for (std::size_t v = 0; v < views_.size(); ++v) views_[v].R_CN = a.R_CN[v];
  }

  // The richest model that the stars determine.
  Result<Adjustment> adjust_freely(const Sightings& s, int most_parameters) const {
    Result<Adjustment> fitted =
        fail(ErrorCode::not_converged, "{0} stars are too few", {static_cast<double>(s.observations.size())});
    for (auto model = kModels.rbegin(); model != kModels.rend(); ++model) {
      const int stars_for = 2 * (model->count() + 3 * static_cast<int>(views_.size()));
      if (model->aspect || model->count() > most_parameters || static_cast<int>(s.observations.size()) < stars_for)
        continue;
      fitted = adjust(s.observations, attitudes(), camera_, *model);
      if (fitted) return fitted;
    }
    return fitted;
  }

  // Of pictures that do not agree on one camera that one goes without which the others agree best; where none is
  // enough, the one with the fewest stars, and so on.
  Result<Sightings> gather() {
    const Intrinsics first = camera_;
    std::vector<View> recognised = views_;
    const auto leave_out = [&](std::size_t odd) {
      views_ = recognised;
      views_.erase(views_.begin() + static_cast<std::ptrdiff_t>(odd));
      camera_ = first;
      return gather_from_all();
    };
    for (;;) {
      auto gathered = gather_from_all();
      if (gathered || recognised.size() < 2) return gathered;
      std::size_t odd = odd_one_;
      double most = -1.0;
      for (std::size_t k = 0; k < recognised.size() && recognised.size() <= kMostTried; ++k) {
        const auto without = leave_out(k);
        if (!without || static_cast<double>(without->tags.size()) <= most) continue;
        most = static_cast<double>(without->tags.size());
        odd = k;
      }
      out_.frames[recognised[odd].frame].error =
          Error{.code = ErrorCode::no_match,
                .text = "recognised, but its stars are not where the other pictures' camera puts them"};
      recognised.erase(recognised.begin() + static_cast<std::ptrdiff_t>(odd));
      views_ = recognised;
      camera_ = first;
    }
  }

  // Stars and camera in turns, with narrowing nets and richer models; the stars that end up within the gate. Each
  // picture was recognised with a lens of its own: what they share is the stars' names, so the first turn is theirs.
  Result<Sightings> gather_from_all() {
    Sightings s;
    if (request_.model == ProjectionModel::fisheye) return narrow(4.0, std::array{2, 4, 6, 7, 7, 7});
    for (std::size_t v = 0; v < views_.size(); ++v) take(v, views_[v].named, s);
    constexpr int kFirst = 6;
    if (const auto fitted = fit_and_keep(s, kFirst); !fitted) return forward(fitted);
    return narrow(std::max(3.0, 0.004 * width_), std::array{kFirst, kFirst, 7, 7, 7});
  }

  Result<Sightings> narrow(double radius_px, std::span<const int> most_parameters) {
    Sightings s;
    for (const int most : most_parameters) {
      s = sight(radius_px);
      const auto rms_px = fit_and_keep(s, most);
      if (!rms_px) return forward(rms_px);
      radius_px = std::clamp(3.5 * *rms_px, 1.0, radius_px);
    }
    return s;
  }

  // Keeps what lies within the gate; the rms of that.
  Result<double> fit_and_keep(Sightings& s, int most_parameters) {
    std::vector<int> of_view(views_.size(), 0);
    const auto count = [&] {
      std::fill(of_view.begin(), of_view.end(), 0);
      for (const Tag& tag : s.tags) ++of_view[tag.view];
      odd_one_ = static_cast<std::size_t>(std::min_element(of_view.begin(), of_view.end()) - of_view.begin());
      return of_view[odd_one_];
    };
    count();
    const auto fitted = adjust_freely(s, most_parameters);
    if (!fitted) return forward(fitted);
    take(*fitted);
    Sightings kept;
    for (std::size_t i = 0; i < s.tags.size(); ++i) {
      if (!fitted->used[i]) continue;
      kept.observations.push_back(s.observations[i]);
      kept.tags.push_back(s.tags[i]);
    }
    s = std::move(kept);
    if (count() < kLeastStars && views_.size() > 1)
      return fail(ErrorCode::not_converged, "the pictures do not agree on one camera");
    return fitted->rms_px;
  }

  Result<Adjustment> choose_model(const Sightings& s) {
    // One measure for all: the scatter that the richest model leaves.
    const auto rich = adjust_freely(s, 99);
    if (!rich) return forward(rich);
    for (const LensFreedom& model : kModels) {
      auto tried = cross_validate(s.observations, attitudes(), start_of(model), model, rich->scatter, request_.folds);
      if (tried) out_.models.push_back(std::move(*tried));
    }
    if (out_.models.empty()) {
      return fail(ErrorCode::not_converged, "{0} stars do not determine a focal length",
                  {static_cast<double>(s.observations.size())});
    }
    const auto best = std::min_element(out_.models.begin(), out_.models.end(),
                                       [](const auto& a, const auto& b) { return a.mean_surprise < b.mean_surprise; });
    const auto as_good = std::find_if(out_.models.begin(), out_.models.end(), [&](const CrossValidation& m) {
      std::vector<double> more;
      for (std::size_t i = 0; i < m.surprise.size(); ++i) more.push_back(m.surprise[i] - best->surprise[i]);
      return &m == &*best || mean(more) <= standard_deviation(more) / std::sqrt(static_cast<double>(more.size()));
    });
    out_.freedom = as_good->freedom;
    out_.held_out_rms_px = as_good->held_out_rms_px;
    AdjustOptions options;
    options.gate_sigma = 1e3;  // they have been gated
    return adjust(s.observations, attitudes(), start_of(as_good->freedom), as_good->freedom, options);
  }

  // What is held stays at what is usual: the centre in the middle, no distortion, square pixels.
  Intrinsics start_of(const LensFreedom& model) const {
    Intrinsics start = camera_;
    if (!model.aspect) start.fy_px = start.fx_px;
    if (!model.centre) {
      start.cx_px = 0.5 * (width_ - 1);
      start.cy_px = 0.5 * (height_ - 1);
    }
    Distortion& d = start.distortion;
    if (model.radial < 1) d.k1 = 0.0;
    if (model.radial < 2) d.k2 = 0.0;
    if (model.radial < 3) d.k3 = 0.0;
    if (!model.tangential) d.p1 = d.p2 = 0.0;
    return start;
  }

  Pixel as_in_picture(Pixel p) const {
    if (out_.mirrored) p.u = width_ - 1 - p.u;
    return p;
  }

  void report(const Sightings& s, const Adjustment& best) {
    take(best);
    out_.camera = best.camera;
    out_.covariance = best.covariance;
    out_.scatter = best.scatter;
    out_.rms_px = best.rms_px;
    out_.stars = s.tags.size();
    std::vector<double> backgrounds, noises, widths;
    for (std::size_t v = 0; v < views_.size(); ++v) {
      const View& view = views_[v];
      CalibratedFrame& frame = out_.frames[view.frame];
      frame.R_CN = view.R_CN;
      frame.covariance_rad2 = best.attitude_covariance_rad2[v];
      frame.spots = view.spots.size();
      frame.aberration_corrected = view.observer.has_value();
      frame.refraction_corrected = frames_[view.frame].refraction.has_value();
      backgrounds.push_back(view.background_dn);
      noises.push_back(view.noise_dn);
      for (const SkyPlanet& planet : view.planets) foretell(view, planet, frame);
      if (views_.size() > 1) frame.rms_alone_px = rms_alone(s, best, v);
    }
    for (std::size_t i = 0; i < s.tags.size(); ++i) {
      const Tag& tag = s.tags[i];
      const View& view = views_[tag.view];
      CalibratedFrame& frame = out_.frames[view.frame];
      const vision::Centroid& spot = view.spots[tag.spot];
      Vec2 residual = best.residuals_px[i];
      frame.rms_px += residual.squaredNorm();
      if (out_.mirrored) residual.x() = -residual.x();
      frame.stars.push_back({view.sky[tag.star].id, view.sky[tag.star].v_mag, as_in_picture(spot.pixel),
                             std::sqrt(0.5 * spot.covariance_px2.trace()), residual});
      // A Gaussian's peak over its light.
      if (!spot.saturated && spot.snr > 30.0) widths.push_back(std::sqrt(spot.flux_dn / (2.0 * kPi * spot.peak_dn)));
    }
    for (CalibratedFrame& frame : out_.frames)
      frame.rms_px = std::sqrt(frame.rms_px / static_cast<double>(std::max<std::size_t>(1, frame.stars.size())));
    out_.background_dn = median(backgrounds);
    out_.noise_dn = median(noises);
    if (!widths.empty()) out_.psf_sigma_px = std::clamp(median(widths), 0.4, 10.0);
  }

  // What the stars of one picture leave to a camera of its own, with the same parameters; NaN where they are too few.
  double rms_alone(const Sightings& s, const Adjustment& best, std::size_t v) const {
    std::vector<StarObservation> own;
    for (std::size_t i = 0; i < s.tags.size(); ++i) {
      if (s.tags[i].view != v) continue;
      own.push_back(s.observations[i]);
      own.back().frame = 0;
    }
    if (own.size() < kStarsAlone) return std::nan("");
    AdjustOptions options;
    options.gate_sigma = 1e3;
    options.scatter = best.scatter;
    const auto alone = adjust(own, {&best.R_CN[v], 1}, best.camera, out_.freedom, options);
    return alone ? alone->rms_px : std::nan("");
  }

  void foretell(const View& view, const SkyPlanet& planet, CalibratedFrame& frame) const {
    const auto pixel = project(camera_, view.R_CN * planet.direction_N);
    if (!pixel || !camera_.contains(*pixel)) return;
    const vision::Centroid* brightest = nullptr;
    for (const vision::Centroid& spot : view.spots) {
      if ((spot.pixel.vec() - pixel->vec()).norm() > kSeenRadiusPx) continue;
      if (brightest == nullptr || spot.flux_dn > brightest->flux_dn) brightest = &spot;
    }
    ForetoldPlanet told{planet.body, as_in_picture(*pixel), planet.v_mag, {}};
    if (brightest != nullptr) told.measured = as_in_picture(brightest->pixel);
    frame.planets.push_back(told);
  }

  const StarCatalogue& catalogue_;
  std::span<const CalibrationFrame> frames_;
  const CalibrationRequest& request_;
  int width_ = 0, height_ = 0;
  std::vector<View> views_;  // of the pictures that were recognised
  std::size_t odd_one_ = 0;  // the view with the fewest stars
  std::size_t most_stars_ = 0;
  Intrinsics camera_;
  Calibration out_;
};

}  // namespace

Result<Calibration> calibrate_camera(const StarCatalogue& catalogue, std::span<const CalibrationFrame> frames,
                                     const CalibrationRequest& request) {
  return Calibrator(catalogue, frames, request).run();
}

}  // namespace astronav::opensky
