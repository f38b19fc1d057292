// SPDX-License-Identifier: Apache-2.0
#include <chrono>
#include <cmath>
#include <cstdio>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "cli/answers.h"
#include "cli/command.h"
#include "cli/commands.h"
#include "cli/inputs.h"
#include "cli/outputs.h"
#include "cli/wcs.h"
#include "foundation/files/mapped_file.h"
#include "foundation/raster/raster.h"
#include "models/camera_file/camera_file.h"
#include "verification/opensky/solver.h"
#include "verification/opensky/solver_picture.h"

namespace astronav::cli {
namespace {

using Json = nlohmann::ordered_json;

struct Options {
  std::vector<std::string> images;
  std::string camera, fov, epoch, observer, near, wcs, picture, raw, catalogue;
  std::vector<std::string> kernels;
  bool json = false;
};

// What is asked of every picture, and what must live as long.
struct Request {
  opensky::SolveRequest solve;
  std::shared_ptr<const Kernels> kernels;
  std::optional<RawLayout> raw;
};

Result<opensky::FieldRange> parse_field(const std::string& text) {
  std::string commas = text;
  for (char& c : commas)
    if (c == ':') c = ',';
  const auto numbers = parse_numbers(commas, 1, 2, "MIN:MAX");
  if (!numbers) return forward(numbers);
  const opensky::FieldRange range{numbers->front() * kDegree, numbers->back() * kDegree};
  if (!(range.min_rad > 0.0 && range.min_rad <= range.max_rad && range.max_rad < 120.0 * kDegree))
    return fail(ErrorCode::invalid_argument, "'{s}' is no field of view: MIN:MAX in degrees, 0 < MIN <= MAX < 120", {},
                {}, text);
  return range;
}

Result<Request> read_request(const Options& options) {
  Request request;
  if (!options.fov.empty()) {
    const auto field = parse_field(options.fov);
    if (!field) return forward(field, "--fov");
    request.solve.field = *field;
  }
  if (!options.camera.empty()) {
    const auto camera = read_camera(options.camera);
    if (!camera) return forward(camera, "--camera");
    request.solve.camera = camera->intrinsics;
  }
  if (!options.near.empty()) {
    const auto near = parse_numbers(options.near, 3, 3, "RA,DEC,RADIUS");
    if (!near) return forward(near, "--near");
    if (!((*near)[2] > 0.0 && std::abs((*near)[1]) <= 90.0 && std::abs((*near)[0]) <= 360.0))
      return fail(ErrorCode::invalid_argument,
                  "'{s}': a right ascension within 360 degrees, a declination within 90 degrees and a radius above 0",
                  {}, "--near", options.near);
    request.solve.near =
        opensky::Near{direction_from_radec((*near)[0] * kDegree, (*near)[1] * kDegree), (*near)[2] * kDegree};
  }
  if (!options.raw.empty()) {
    const auto raw = parse_raw_layout(options.raw);
    if (!raw) return forward(raw, "--raw");
    request.raw = *raw;
  }
  if (!options.epoch.empty()) {
    const auto epoch = Epoch::parse(options.epoch);
    if (!epoch) return forward(epoch, "--epoch");
    request.solve.epoch = *epoch;
  }
  if (options.observer.empty() && !options.kernels.empty())
    return fail(ErrorCode::invalid_argument, "kernels say where an --observer is, and none is given", {}, "--kernel");
  if (!options.observer.empty()) {
    if (!request.solve.epoch)
      return fail(ErrorCode::invalid_argument, "an observer is somewhere only at an --epoch", {}, "--observer");
    auto kernels = open_kernels(options.kernels);
    if (!kernels) return forward(kernels);
    request.kernels = *kernels;
    const auto observer = parse_observer(options.observer, request.kernels);
    if (!observer) return forward(observer, "--observer");
    const auto state = (*observer)(*request.solve.epoch);
    if (!state) return forward(state, "--observer");
    request.solve.observer = *state;
    request.solve.ephemeris = &request.kernels->ephemeris;
    const auto warning = daylight_warning(options.observer, *request.solve.epoch, request.kernels->ephemeris);
    if (!warning) return forward(warning);
    if (*warning) fmt::print(stderr, "astronav: {}\n", **warning);
    const auto air = parse_air(options.observer, *request.solve.epoch);
    if (!air) return forward(air);
    if (*air) {
      request.solve.refraction = (*air)->refraction;
      // An all-sky camera looks up.
      if (!request.solve.near && request.solve.camera && request.solve.camera->model == ProjectionModel::fisheye)
        request.solve.near = opensky::Near{(*air)->zenith_N, 30.0 * kDegree};
    }
  }
  return request;
}

Json to_json(const std::string& image, const opensky::Solution& s, double read_ms) {
  const vision::AttitudeSolution& a = s.attitude;
  const Pointing center = opensky::center_pointing(s);
  const Quaternion q = to_quaternion(a.R_CN.transpose());
  const Vec3 sigma = a.covariance_rad2.diagonal().cwiseSqrt() / kArcsecond;
  Json out;
  out["image"] = image;
  out["status"] = "solved";
  out["message"] = fmt::format("{} of {} spots are stars", s.stars.size(), s.detected);
  out["ra_deg"] = center.ra_rad / kDegree;
  out["dec_deg"] = center.dec_rad / kDegree;
  out["roll_deg"] = center.roll_rad / kDegree;
  out["fov_h_deg"] = a.intrinsics.field_of_view_horizontal_rad() / kDegree;
  out["fov_v_deg"] = a.intrinsics.field_of_view_vertical_rad() / kDegree;
  out["plate_scale_arcsec"] = a.intrinsics.plate_scale_rad_px() / kArcsecond;
  out["q_NC"] = {{"w", q.w}, {"x", q.x}, {"y", q.y}, {"z", q.z}};
  out["attitude_sigma_arcsec"] = {{"x", sigma.x()}, {"y", sigma.y()}, {"z", sigma.z()}};
  const Vec3 at_center = s.center_covariance_rad2.diagonal().cwiseSqrt() / kArcsecond;
  out["center_sigma_arcsec"] = {{"right", at_center.y()}, {"down", at_center.x()}, {"roll", at_center.z()}};
  out["parity"] = s.mirrored ? "mirrored" : "direct";
  out["chance_probability"] = a.chance_probability;
  out["focal_px"] = a.intrinsics.fx_px;
  out["aspect"] = a.intrinsics.fy_px / a.intrinsics.fx_px;
  const Distortion& d = a.intrinsics.distortion;
  out["principal_point_px"] = {{"u", a.intrinsics.cx_px}, {"v", a.intrinsics.cy_px}};
  out["distortion"] = {{"k1", d.k1}, {"k2", d.k2}, {"k3", d.k3}, {"p1", d.p1}, {"p2", d.p2}};
  out["epoch_tdb"] = tdb(s.epoch);
  out["epoch_assumed"] = s.epoch_assumed;
  out["aberration_corrected"] = s.aberration_corrected;
  out["refraction_corrected"] = s.refraction_corrected;
  out["stars_detected"] = s.detected;
  out["stars_matched"] = s.stars.size();
  out["residual_rms_px"] = a.residual_rms_px;
  out["stars"] = Json::array();
  for (const opensky::SolvedStar& star : s.stars)
    out["stars"].push_back({{"id", star.match.id},
                            {"u_px", rounded(star.spot.pixel.u, 1e4)},
                            {"v_px", rounded(star.spot.pixel.v, 1e4)},
                            {"residual_px", rounded(star.match.residual_px.norm(), 1e4)},
                            {"flux_dn", rounded(star.spot.flux_dn, 1e2)},
                            {"mag", rounded(star.v_mag, 1e3)}});
  out["planets"] = Json::array();
  for (const opensky::SolvedPlanet& planet : s.planets)
    out["planets"].push_back({{"name", std::string(body_name(planet.body))},
                              {"u_px", planet.spot.pixel.u},
                              {"v_px", planet.spot.pixel.v},
                              {"predicted_u_px", planet.predicted.u},
                              {"predicted_v_px", planet.predicted.v},
                              {"mahalanobis", planet.mahalanobis},
                              {"mag_predicted", planet.v_mag_predicted},
                              {"mag_measured", planet.v_mag_measured}});
  out["spots"] = Json::array();
  for (const vision::Centroid& spot : s.unknown)
    out["spots"].push_back({{"u_px", rounded(spot.pixel.u, 1e4)},
                            {"v_px", rounded(spot.pixel.v, 1e4)},
                            {"flux_dn", rounded(spot.flux_dn, 1e2)},
                            {"sigma_px", std::sqrt(0.5 * spot.covariance_px2.trace())}});
  out["time_ms"] = {{"read", read_ms},
                    {"centroid", s.time_ms.centroid},
                    {"lists", s.time_ms.lists},
                    {"identify", s.time_ms.identify},
                    {"attitude", s.time_ms.attitude},
                    {"planets", s.time_ms.planets},
                    {"total", read_ms + s.time_ms.total}};
  return out;
}

void tell(const std::string& image, const opensky::Solution& s) {
  const Pointing center = opensky::center_pointing(s);
  const Vec3 sigma = s.center_covariance_rad2.diagonal().cwiseSqrt() / kArcsecond;
  fmt::print("{}: RA {:.4f} Dec {:+.4f} roll {:.3f} deg, field {:.3f} x {:.3f} deg{}\n", image, center.ra_rad / kDegree,
             center.dec_rad / kDegree, center.roll_rad / kDegree,
             s.attitude.intrinsics.field_of_view_horizontal_rad() / kDegree,
             s.attitude.intrinsics.field_of_view_vertical_rad() / kDegree, s.mirrored ? ", mirrored" : "");
  fmt::print(
      "  {} of {} spots are stars, rms {:.2f} px; sigma of the middle {:.2f} {:.2f}, of roll {:.1f} arcsec{}; by "
      "chance "
      "{:.0e}; {:.2f} s\n",
      s.stars.size(), s.detected, s.attitude.residual_rms_px, sigma.y(), sigma.x(), sigma.z(),
      s.aberration_corrected ? "" : " beside aberration (up to 21 on the Earth: --epoch and --observer remove it)",
      s.attitude.chance_probability, s.time_ms.total / 1e3);
  for (const opensky::SolvedPlanet& p : s.planets)
    fmt::print("  {} at ({:.2f}, {:.2f}) px, predicted ({:.2f}, {:.2f}), magnitude {:.1f} (predicted {:.1f})\n",
               body_name(p.body), p.spot.pixel.u, p.spot.pixel.v, p.predicted.u, p.predicted.v, p.v_mag_measured,
               p.v_mag_predicted);
}

Result<void> write_files(const Options& options, const Picture& picture, const opensky::Solution& solution) {
  if (!options.wcs.empty()) {
    const vision::AttitudeSolution& a = solution.attitude;
    const auto stored = write_fits(options.wcs, picture.pixels.view(),
                                   wcs_cards(a.intrinsics, a.R_CN, solution.mirrored), picture.header_cards);
    if (!stored) return forward(stored, options.wcs);
  }
  if (!options.picture.empty()) {
    const auto png = encode_png_rgb(opensky::annotated(picture, solution).view());
    if (!png) return forward(png, options.picture);
    const auto stored = write_file(options.picture, *png);
    if (!stored) return forward(stored, options.picture);
  }
  return {};
}

Result<int> run(const Options& options) {
  const auto request = read_request(options);
  if (!request) return forward(request);
  if (options.images.size() != 1 && !(options.wcs.empty() && options.picture.empty()))
    return fail(ErrorCode::invalid_argument, "one image for one file", {}, options.wcs.empty() ? "--picture" : "--wcs");
  if (const auto ending = check_ending(options.wcs, {".fits", ".fit"}, "--wcs"); !ending) return forward(ending);
  if (const auto ending = check_ending(options.picture, {".png"}, "--picture"); !ending) return forward(ending);
  for (const std::string& image : options.images) {
    if (const auto apart = check_apart(options.wcs, image, "--wcs"); !apart) return forward(apart);
    if (const auto apart = check_apart(options.picture, image, "--picture"); !apart) return forward(apart);
  }
  if (const auto writable = check_writable({options.wcs, options.picture}); !writable) return forward(writable);
  const auto catalogue = open_catalogue(options.catalogue);
  if (!catalogue) return forward(catalogue);
  opensky::Solver solver(catalogue->stars);

  bool unreadable = false, unmatched = false;
  for (const std::string& image : options.images) {
    const auto begin = std::chrono::steady_clock::now();
    const auto picture = read_picture(image, request->raw);
    const double read_ms = std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - begin).count();
    const auto solution =
        picture ? solver.solve(*picture, request->solve) : Result<opensky::Solution>(forward(picture));
    if (!solution) {
      // What the arguments and the picture's size disagree about is the caller's mistake, not the sky's.
      const bool no_match = solution.error().code == ErrorCode::no_match;
      (no_match ? unmatched : unreadable) = true;
      std::string message = describe(solution.error());
      if (no_match && !(options.fov.empty() && options.near.empty() && options.camera.empty()))
        message += fmt::format(" (looked for within{}{}{} only)", options.fov.empty() ? "" : " --fov",
                               options.near.empty() ? "" : " --near", options.camera.empty() ? "" : " --camera");
      if (options.json) {
        Json out;
        out["image"] = image;
        out["status"] = no_match ? "no_match" : "unreadable";
        out["message"] = message;
        fmt::print("{}\n", out.dump());
      }
      fmt::print(stderr, "astronav: {}{}\n", picture ? image + ": " : "", message);
      continue;
    }
    // The files first: an answer that is told is an answer that stands.
    if (const auto stored = write_files(options, *picture, *solution); !stored) return forward(stored);
    if (options.json)
      fmt::print("{}\n", to_json(image, *solution, read_ms).dump());
    else
      tell(image, *solution);
    std::fflush(stdout);
  }
  return unreadable ? 2 : unmatched ? 3 : 0;
}

}  // namespace

void add_solve(CLI::App& app, Invocation& invocation) {
  auto options = std::make_shared<Options>();
  CLI::App* sub = app.add_subcommand("solve", "attitude and planets from pictures of the sky");
  sub->footer("Example:\n  astronav solve night.jpg --fov 8:13 --json");
  sub->add_option("images", options->images, "PNG, TIFF, JPEG, FITS or raw frames")->required();
  sub->add_option("--camera", options->camera, "camera file, or the name of one in scenarios/cameras: lens and all");
  sub->add_option("--fov", options->fov, "MIN:MAX, horizontal field of view in degrees, give or take 3 %");
  sub->add_option("--epoch", options->epoch, "middle of the exposure, ISO 8601 with scale (UTC if none)");
  sub->add_option("--observer", options->observer,
                  "ground:LAT,LON,HEIGHT_M, ssb:X,Y,Z[,VX,VY,VZ], spk:ID@FILE, oem:FILE\n"
                  "or a body: for aberration, refraction, planets");
  sub->add_option("--near", options->near, "RA,DEC,RADIUS in degrees: the centre lies there");
  sub->add_option("--wcs", options->wcs, "FILE.fits: the picture with its world coordinates");
  sub->add_option("--picture", options->picture, "FILE.png: the picture with its stars and planets marked");
  sub->add_option("--raw", options->raw, "WIDTHxHEIGHT,u16le,OFFSET");
  sub->add_option("--kernel", options->kernels, "SPK files in place of DE405; later ones take precedence")
      ->allow_extra_args(false);
  sub->add_option("--catalog", options->catalogue, "star catalogue in place of Hipparcos");
  sub->add_flag("--json", options->json, "one JSON object an image");
  sub->callback([options, &invocation] { invocation.action = [options] { return run(*options); }; });
}

}  // namespace astronav::cli
