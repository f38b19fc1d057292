// SPDX-License-Identifier: Apache-2.0
#include <cmath>
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "cli/answers.h"
#include "cli/command.h"
#include "cli/commands.h"
#include "cli/inputs.h"
#include "cli/near_stars.h"
#include "cli/picture_header.h"
#include "cli/validators.h"
#include "cli/wcs.h"
#include "foundation/math/rotation.h"
#include "foundation/raster/raster.h"
#include "models/aberration/aberration.h"
#include "models/camera_file/camera_file.h"
#include "onboard/navigation/triangulation.h"
#include "onboard/vision/centroids.h"
#include "verification/opensky/spots.h"
#include "verification/opensky/star_fix.h"

namespace astronav::cli {
namespace {

using Json = nlohmann::ordered_json;

struct Options {
  std::vector<std::string> images, sights, kernels;
  std::string epoch, targets, camera, velocity;
  std::optional<double> sigma_arcsec;
  bool json = false;
};

// What both ways to a fix have in common.
struct Answer {
  Epoch epoch;
  Vec3 p_O_N;
  Mat3 covariance_m2;
  double chi2 = 0.0;
  int degrees_of_freedom = 0;
  Json sights = Json::array(), fields = Json::array();
  std::vector<std::string> lines{};  // for people
};

Result<std::optional<Vec3>> velocity_of(const Options& options) {
  if (options.velocity.empty()) return std::optional<Vec3>();
  const auto numbers = parse_numbers(options.velocity, 3, 3, "VX,VY,VZ");
  if (!numbers) return forward(numbers, "--velocity");
  return std::optional(Vec3(Vec3((*numbers)[0], (*numbers)[1], (*numbers)[2]) * 1e3));
}

std::vector<vision::Centroid> spots_of(const Picture& picture, const std::optional<Camera>& camera) {
  if (!camera) return opensky::find_spots(picture).spots;
  vision::CentroidSettings settings;
  constexpr int kMostSpots = 2000;
  settings.max_centroids = kMostSpots;
  vision::CentroidFinder finder(settings, vision::SensorModel::from(*camera), picture.pixels.width(),
                                picture.pixels.height());
  std::vector<vision::Centroid> spots(kMostSpots);
  spots.resize(finder.find(picture.pixels.view(), spots));
  return spots;
}

Result<opensky::FixFrame> read_frame(const std::string& path, const Options& options,
                                     const std::optional<Camera>& camera) {
  const auto picture = read_picture(path);
  if (!picture) return forward(picture);
  const int width = picture->pixels.width(), height = picture->pixels.height();
  if (width < 16 || height < 16)
    return fail(ErrorCode::invalid_argument, "{0} x {1} pixels; at least 16 x 16",
                {static_cast<double>(width), static_cast<double>(height)}, path);
  opensky::FixFrame frame;
  if (!options.epoch.empty()) {
    const auto told = Epoch::parse(options.epoch);
    if (!told) return forward(told, "--epoch");
    frame.epoch = *told;
  } else if (const auto epoch = header_epoch(*picture)) {
    frame.epoch = *epoch;
  } else {
    return fail(ErrorCode::invalid_argument, "its header tells no time; say --epoch", {}, path);
  }
  if (const auto exposure = header_number(*picture, "EXPTIME")) frame.exposure_s = *exposure;
  const auto plate = plate_from_header(picture->header, width, height);
  if (!plate) return forward(plate, path);
  frame.plate = plate->camera;
  frame.R_CN = plate->R_CN;
  frame.mirrored = plate->mirrored;
  frame.spots = spots_of(*picture, camera);
  return frame;
}

Result<Answer> by_pictures(const Options& options) {
  if (options.targets.empty())
    return fail(ErrorCode::invalid_argument, "pictures need a list of near stars", {}, "--targets");
  const auto stars = read_near_stars(options.targets);
  if (!stars) return forward(stars, "--targets");
  std::vector<opensky::NearStar> near_stars;
  for (const ListedStar& star : *stars) near_stars.push_back({star.name, star.star});
  std::optional<Camera> camera;
  if (!options.camera.empty()) {
    auto read = read_camera(options.camera);
    if (!read) return forward(read, "--camera");
    camera = std::move(*read);
  }
  opensky::StarFixSettings settings;
  if (options.sigma_arcsec) settings.sight_sigma_rad = *options.sigma_arcsec * kArcsecond;
  const auto velocity = velocity_of(options);
  if (!velocity) return forward(velocity);
  settings.velocity_m_s = *velocity;
  std::vector<opensky::FixFrame> frames;
  for (const std::string& path : options.images) {
    auto frame = read_frame(path, options, camera);
    if (!frame) return forward(frame);
    frames.push_back(std::move(*frame));
  }
  const auto fix = opensky::fix_by_near_stars(frames, near_stars, settings);
  if (!fix) return forward(fix);

  Answer out{fix->epoch, fix->p_O_N, fix->covariance_m2, fix->chi2, fix->degrees_of_freedom};
  for (const opensky::FixField& field : fix->fields) {
    const std::string& name = near_stars[field.star].name;
    out.fields.push_back({{"name", name},
                          {"frames", field.frames},
                          {"field_stars", field.field_stars},
                          {"star_scatter_arcsec", field.star_scatter_rad / kArcsecond},
                          {"plate_scatter_arcsec", field.plate_scatter_rad / kArcsecond},
                          {"sigma_measured", field.measured}});
    out.lines.push_back(fmt::format(
        "  {}: {} frames, {} field stars, which scatter by {:.2f} arcsec an axis, plates by {:.2f}", name, field.frames,
        field.field_stars, field.star_scatter_rad / kArcsecond, field.plate_scatter_rad / kArcsecond));
  }
  for (const opensky::StarSight& sight : fix->sights) {
    const RaDec at = radec_from_direction(sight.direction_N);
    const Vec2 shift = sight.parallax_shift_rad / kArcsecond, residual = sight.residual_rad / kArcsecond;
    out.sights.push_back({{"name", near_stars[sight.star].name},
                          {"image", options.images[sight.frame]},
                          {"epoch_tdb", tdb(frames[sight.frame].epoch)},
                          {"u_px", rounded(sight.pixel.u, 1e4)},
                          {"v_px", rounded(sight.pixel.v, 1e4)},
                          {"ra_deg", at.ra_rad / kDegree},
                          {"dec_deg", at.dec_rad / kDegree},
                          {"sigma_arcsec", sight.sigma_rad / kArcsecond},
                          {"parallax_shift_east_arcsec", shift.x()},
                          {"parallax_shift_north_arcsec", shift.y()},
                          {"residual_east_arcsec", residual.x()},
                          {"residual_north_arcsec", residual.y()}});
    out.lines.push_back(fmt::format(
        "  {:<18} {:7.2f} {:7.2f} px, {:+8.3f} {:+8.3f} arcsec off its place; left {:+.3f} {:+.3f} +- {:.3f}",
        near_stars[sight.star].name, sight.pixel.u, sight.pixel.v, shift.x(), shift.y(), residual.x(), residual.y(),
        sight.sigma_rad / kArcsecond));
  }
  return out;
}

Result<Answer> by_sights(const Options& options) {
  if (options.epoch.empty()) return fail(ErrorCode::invalid_argument, "sights are of an --epoch", {}, "--sight");
  const auto epoch = Epoch::parse(options.epoch);
  if (!epoch) return forward(epoch, "--epoch");
  const auto velocity = velocity_of(options);
  if (!velocity) return forward(velocity);
  std::vector<navigation::BodySight> sights;
  std::vector<std::string> names;
  for (const std::string& text : options.sights) {
    const auto comma = text.find(',');
    const auto body = parse_body(text.substr(0, comma));
    if (!body) return forward(body, "--sight");
    const auto numbers =
        parse_numbers(comma == std::string::npos ? "" : text.substr(comma + 1), 3, 3, "RA,DEC,SIGMA_ARCSEC");
    if (!numbers) return forward(numbers, "--sight");
    const double sigma = (*numbers)[2] * kArcsecond;
    if (!(std::abs((*numbers)[1]) <= 90.0 && sigma > 0.0))
      return fail(ErrorCode::invalid_argument, "no such sight: DEC {0} deg, SIGMA {1} arcsec",
                  {(*numbers)[1], (*numbers)[2]}, "--sight");
    sights.push_back({*body, direction_from_radec((*numbers)[0] * kDegree, (*numbers)[1] * kDegree),
                      Mat3::Identity() * sigma * sigma, 0.0});
    names.push_back(title(*body));
  }
  const auto kernels = open_kernels(options.kernels);
  if (!kernels) return forward(kernels);
  const Vec3 v = velocity->value_or(Vec3::Zero());
  const auto fix = navigation::triangulate((*kernels)->ephemeris, *epoch, v, sights);
  if (!fix) return forward(fix);
  Answer out{*epoch, fix->p_O_N, fix->covariance_m2, fix->chi2, fix->degrees_of_freedom};
  for (std::size_t i = 0; i < sights.size(); ++i) {
    const auto seen = light_time((*kernels)->ephemeris, sights[i].body, {fix->p_O_N, v}, *epoch);
    if (!seen) return forward(seen);
    const Vec3 foretold = aberrate(seen->relative.p_m.normalized(), v);
    const EastNorth axes = east_north(foretold);
    const Vec3 off = (sights[i].direction_N - foretold) / kArcsecond;
    const double distance_km = seen->relative.p_m.norm() * 1e-3;
    out.sights.push_back({{"name", names[i]},
                          {"distance_km", distance_km},
                          {"light_time_s", seen->light_time_s},
                          {"residual_east_arcsec", axes.east.dot(off)},
                          {"residual_north_arcsec", axes.north.dot(off)}});
    out.lines.push_back(fmt::format("  {:<18} {:.0f} km away; {:+.3f} {:+.3f} arcsec left", names[i], distance_km,
                                    axes.east.dot(off), axes.north.dot(off)));
  }
  return out;
}

Json matrix(const Mat3& m, double unit) {
  Json rows = Json::array();
  for (int i = 0; i < 3; ++i) rows.push_back({m(i, 0) / unit, m(i, 1) / unit, m(i, 2) / unit});
  return rows;
}

Result<int> run(const Options& options) {
  if (options.images.empty() == options.sights.empty())
    return fail(ErrorCode::invalid_argument, "either pictures or --sight, and one of the two");
  const auto answer = options.sights.empty() ? by_pictures(options) : by_sights(options);
  if (!answer) return forward(answer);
  const Vec3 sigma = answer->covariance_m2.diagonal().cwiseSqrt();
  if (options.json) {
    Json out{{"status", "fixed"},
             {"epoch_tdb", tdb(answer->epoch)},
             {"position_km", xyz(answer->p_O_N, 1e3)},
             {"sigma_km", xyz(sigma, 1e3)},
             {"covariance_km2", matrix(answer->covariance_m2, 1e6)},
             {"chi2", answer->chi2},
             {"degrees_of_freedom", answer->degrees_of_freedom}};
    if (!answer->fields.empty()) out["fields"] = answer->fields;
    out["sights"] = answer->sights;
    fmt::print("{}\n", out.dump());
    return 0;
  }
  fmt::print("At {}, barycentric, ICRF axes:\n", answer->epoch.iso());
  for (int axis = 0; axis < 3; ++axis)
    fmt::print("  {} {:+16.6e} km +- {:.3e}   {:+13.7f} au +- {:.7f}\n", "xyz"[axis], answer -> p_O_N[axis] * 1e-3,
               sigma[axis] * 1e-3, answer -> p_O_N[axis] / kAstronomicalUnit, sigma[axis] / kAstronomicalUnit);
  fmt::print("  chi-square {:.2f} with {} degrees of freedom\n", answer->chi2, answer->degrees_of_freedom);
  for (const std::string& line : answer->lines) fmt::print("{}\n", line);
  return 0;
}

}  // namespace

void add_fix(CLI::App& app, Invocation& invocation) {
  auto options = std::make_shared<Options>();
  CLI::App* sub = app.add_subcommand("fix", "a position from lines of sight alone: planets, or near stars");
  sub->footer(
      "Example:\n  astronav fix --epoch 2027-03-01 --sight earth,250.379,-23.609,9 --sight mars,182.847,2.491,9");
  sub->add_option("images", options->images,
                  "FITS with a plate in the header, stars not aberrated; several of each near star");
  sub->add_option("--targets", options->targets, "CSV of near stars, as Gaia gives them");
  sub->add_option("--camera", options->camera, "measure spots as the flight software does (file or name)");
  sub->add_option("--sight", options->sights, "NAME,RA,DEC,SIGMA_ARCSEC of a planet, degrees; repeated")
      ->allow_extra_args(false);
  sub->add_option("--epoch", options->epoch, "ISO 8601 with scale; of pictures the header's where not given");
  sub->add_option("--velocity", options->velocity, "VX,VY,VZ, barycentric km/s; else stars and planets at rest alike");
  sub->add_option("--sigma-arcsec", options->sigma_arcsec, "of a picture's sight, where frames are too few to tell")
      ->check(number_within(1e-6, 3600));
  sub->add_option("--kernel", options->kernels, "SPK files in place of DE405; later ones take precedence");
  sub->add_flag("--json", options->json, "one JSON object");
  sub->callback([options, &invocation] { invocation.action = [options] { return run(*options); }; });
}

}  // namespace astronav::cli
