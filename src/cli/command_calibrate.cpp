// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <memory>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "cli/command.h"
#include "cli/commands.h"
#include "cli/inputs.h"
#include "cli/outputs.h"
#include "foundation/files/mapped_file.h"
#include "foundation/math/rotation.h"
#include "foundation/raster/raster.h"
#include "models/camera_file/camera_file.h"
#include "verification/opensky/calibrate.h"

namespace astronav::cli {
namespace {

using Json = nlohmann::ordered_json;

struct Options {
  std::vector<std::string> images;
  std::string camera, out, fov, near, observer, raw, catalogue;
  std::vector<std::string> epochs, kernels;
  bool fisheye = false;
  bool json = false;
};

// What is asked, and what must live as long.
struct Inputs {
  std::optional<Camera> base;
  std::shared_ptr<const Kernels> kernels;
  std::vector<Picture> pictures;
  std::vector<opensky::CalibrationFrame> frames;
  opensky::CalibrationRequest request;
};

Result<opensky::FieldRange> parse_field(const std::string& text, bool fisheye) {
  std::string commas = text;
  std::replace(commas.begin(), commas.end(), ':', ',');
  const auto numbers = parse_numbers(commas, 1, 2, "MIN:MAX");
  if (!numbers) return forward(numbers, "--fov");
  const double largest = fisheye ? 360.0 : 120.0;
  const double min = numbers->front(), max = numbers->back();
  if (!(min > 0.0 && min <= max && max < largest)) {
    return fail(ErrorCode::invalid_argument, "'{s}' is no field of view: MIN:MAX in degrees, 0 < MIN <= MAX < {0}",
                {largest}, "--fov", text);
  }
  return opensky::FieldRange{min * kDegree, max * kDegree};
}

Result<opensky::Near> parse_near(const std::string& text) {
  const auto near = parse_numbers(text, 3, 3, "RA,DEC,RADIUS");
  if (!near) return forward(near, "--near");
  if (!((*near)[2] > 0.0 && std::abs((*near)[1]) <= 90.0 && std::abs((*near)[0]) <= 360.0)) {
    return fail(ErrorCode::invalid_argument,
                "'{s}': a right ascension within 360 degrees, a declination within 90 degrees and a radius above 0", {},
                "--near", text);
  }
  return opensky::Near{direction_from_radec((*near)[0] * kDegree, (*near)[1] * kDegree), (*near)[2] * kDegree};
}

Result<void> read_camera_and_field(const Options& options, Inputs& in) {
  if (!options.camera.empty()) {
    const auto base = read_camera(options.camera);
    if (!base) return forward(base, "--camera");
    in.base = *base;
  }
  const bool fisheye = options.fisheye || (in.base && in.base->intrinsics.model == ProjectionModel::fisheye);
  in.request.model = fisheye ? ProjectionModel::fisheye : ProjectionModel::pinhole;
  if (!options.fov.empty()) {
    const auto field = parse_field(options.fov, fisheye);
    if (!field) return forward(field);
    in.request.field = *field;
  } else if (in.base && in.base->intrinsics.model == in.request.model) {
    const double believed = in.base->intrinsics.field_of_view_horizontal_rad();
    in.request.field = opensky::FieldRange{0.9 * believed, 1.1 * believed};
  }
  if (!options.near.empty()) {
    const auto near = parse_near(options.near);
    if (!near) return forward(near);
    in.request.near = *near;
  }
  return {};
}

Result<void> check_each_is_another(const Options& options) {
  std::set<std::filesystem::path> seen;
  for (const std::string& image : options.images) {
    std::error_code ignored;
    if (!seen.insert(std::filesystem::weakly_canonical(image, ignored)).second) {
      return fail(ErrorCode::invalid_argument, "the same picture twice would count its stars twice", {}, image);
    }
  }
  return {};
}

Result<void> read_epochs_and_observer(const Options& options, Inputs& in) {
  if (options.epochs.size() > 1 && options.epochs.size() != options.images.size()) {
    return fail(ErrorCode::invalid_argument, "one epoch for all {1} images or one for each, not {0}",
                {static_cast<double>(options.epochs.size()), static_cast<double>(options.images.size())}, "--epoch");
  }
  for (std::size_t k = 0; k < in.frames.size() && !options.epochs.empty(); ++k) {
    const auto epoch = Epoch::parse(options.epochs[options.epochs.size() == 1 ? 0 : k]);
    if (!epoch) return forward(epoch, "--epoch");
    in.frames[k].epoch = *epoch;
  }
  if (options.observer.empty() && !options.kernels.empty())
    return fail(ErrorCode::invalid_argument, "kernels say where an --observer is, and none is given", {}, "--kernel");
  if (options.observer.empty()) return {};
  if (options.epochs.empty())
    return fail(ErrorCode::invalid_argument, "an observer is somewhere only at an --epoch", {}, "--observer");
  const auto kernels = open_kernels(options.kernels);
  if (!kernels) return forward(kernels);
  in.kernels = *kernels;
  in.request.ephemeris = &in.kernels->ephemeris;
  const auto observer = parse_observer(options.observer, in.kernels);
  if (!observer) return forward(observer, "--observer");
  for (opensky::CalibrationFrame& frame : in.frames) {
    const auto warning = daylight_warning(options.observer, *frame.epoch, in.kernels->ephemeris);
    if (!warning) return forward(warning);
    if (*warning) fmt::print(stderr, "astronav: {}\n", **warning);
    const auto state = (*observer)(*frame.epoch);
    if (!state) return forward(state, "--observer");
    frame.observer = *state;
    const auto air = parse_air(options.observer, *frame.epoch);
    if (!air) return forward(air);
    if (!*air) continue;
    frame.zenith_N = (*air)->zenith_N;
    frame.refraction = (*air)->refraction;
  }
  return {};
}

Result<void> read_pictures(const Options& options, Inputs& in) {
  std::optional<RawLayout> layout;
  if (!options.raw.empty()) {
    const auto raw = parse_raw_layout(options.raw);
    if (!raw) return forward(raw, "--raw");
    layout = *raw;
  }
  for (const std::string& image : options.images) {
    auto picture = read_picture(image, layout);
    if (!picture && Epoch::parse(image))
      return fail(ErrorCode::invalid_argument, "an epoch where a picture is expected: --epoch takes EPOCH,EPOCH,...",
                  {}, image);
    if (!picture) return forward(picture, image);
    in.pictures.push_back(std::move(*picture));
    const ImageF& pixels = in.pictures.back().pixels;
    if (in.base &&
        (in.base->intrinsics.width_px != pixels.width() || in.base->intrinsics.height_px != pixels.height())) {
      return fail(
          ErrorCode::invalid_argument, "the picture has {0} x {1} pixels, the camera {2} x {3}",
          {static_cast<double>(pixels.width()), static_cast<double>(pixels.height()),
           static_cast<double>(in.base->intrinsics.width_px), static_cast<double>(in.base->intrinsics.height_px)},
          image);
    }
  }
  for (std::size_t k = 0; k < in.frames.size(); ++k) in.frames[k].picture = &in.pictures[k];
  return {};
}

// What sky frames do not tell comes from the base, or is what docs/formats.md calls a stand-in.
Camera camera_of(const opensky::Calibration& found, const Inputs& in, const std::string& out) {
  Camera camera;
  if (in.base) {
    camera = *in.base;
  } else {
    const Picture& picture = in.pictures.front();
    camera.name = std::filesystem::path(out).stem().string();
    camera.exposure_s = 1.0;
    camera.detector.pixel_pitch_m = 5e-6;
    camera.optics.pupil_diameter_m = 0.5 * found.camera.fx_px * camera.detector.pixel_pitch_m;  // F/2
    camera.optics.transmission = {{400e-9, 0.8}, {900e-9, 0.8}};
    camera.detector.quantum_efficiency = {{400e-9, 0.5}, {900e-9, 0.5}};
    camera.psf.sigma_px = found.psf_sigma_px;
    camera.detector.bits = std::clamp(picture.bits, 8, 16);
    camera.detector.gain_e_dn = 1.0;
    camera.detector.full_well_e = std::exp2(camera.detector.bits);
    camera.detector.bias_dn = std::clamp(found.background_dn, 0.0, 65535.0);
    camera.detector.read_noise_e = found.noise_dn;
  }
  camera.intrinsics = found.camera;
  camera.optics.focal_length_m = found.camera.fx_px * camera.detector.pixel_pitch_m;
  return camera;
}

std::string file_text(const Camera& camera, const opensky::Calibration& found, const Options& options) {
  std::string text = fmt::format(
      "# Calibrated by astronav from {} stars on {} picture{}{}: {:.3f} px rms, {:.3f} px rms of stars held out.\n",
      found.stars, options.images.size(), options.images.size() == 1 ? "" : "s", found.mirrored ? ", mirrored" : "",
      found.rms_px, found.held_out_rms_px);
  text += "# One sigma:";
  for (std::size_t i = 0; i < opensky::kIntrinsicsNames.size(); ++i) {
    const auto at = static_cast<Eigen::Index>(i);
    if (found.covariance(at, at) > 0.0)
      text += fmt::format(" {} {:.2g}", opensky::kIntrinsicsNames[i], std::sqrt(found.covariance(at, at)));
  }
  if (options.camera.empty())
    text += "\n# Exposure, optics, detector and noise are stand-ins: pictures of the sky do not tell them.";
  return text + "\n" + to_toml(camera);
}

Json to_json(const opensky::Calibration& c, const Options& options) {
  Json out;
  out["status"] = "calibrated";
  out["model"] = c.camera.model == ProjectionModel::fisheye ? "fisheye" : "pinhole";
  out["parity"] = c.mirrored ? "mirrored" : "direct";
  out["width_px"] = c.camera.width_px;
  out["height_px"] = c.camera.height_px;
  out["fov_h_deg"] = c.camera.field_of_view_horizontal_rad() / kDegree;
  out["fov_v_deg"] = c.camera.field_of_view_vertical_rad() / kDegree;
  const auto values = opensky::intrinsics_values(c.camera);
  Json names = Json::array(), rows = Json::array();
  for (std::size_t i = 0; i < values.size(); ++i) {
    const std::string name(opensky::kIntrinsicsNames[i]);
    const double variance = c.covariance(static_cast<Eigen::Index>(i), static_cast<Eigen::Index>(i));
    out["intrinsics"][name] = values[i];
    out["sigma"][name] = variance > 0.0 ? Json(std::sqrt(variance)) : Json(nullptr);  // null: held
    names.push_back(name);
    Json row = Json::array();
    for (std::size_t k = 0; k < values.size(); ++k)
      row.push_back(c.covariance(static_cast<Eigen::Index>(i), static_cast<Eigen::Index>(k)));
    rows.push_back(std::move(row));
  }
  out["covariance"] = {{"order", std::move(names)}, {"rows", std::move(rows)}};
  out["stars"] = c.stars;
  out["residual_rms_px"] = c.rms_px;
  out["held_out_rms_px"] = c.held_out_rms_px;
  out["scatter"] = {{"scale", c.scatter.scale}, {"extra_sigma_px", c.scatter.extra_sigma_px}};
  out["models"] = Json::array();
  for (const opensky::CrossValidation& m : c.models) {
    out["models"].push_back({{"centre", m.freedom.centre},
                             {"radial", m.freedom.radial},
                             {"tangential", m.freedom.tangential},
                             {"aspect", m.freedom.aspect},
                             {"held_out_rms_px", m.held_out_rms_px},
                             {"held_out_chi2", m.mean_surprise}});
  }
  out["frames"] = Json::array();
  for (std::size_t k = 0; k < c.frames.size(); ++k) {
    const opensky::CalibratedFrame& f = c.frames[k];
    Json frame;
    frame["image"] = options.images[k];
    frame["status"] = f.error ? "no_match" : "solved";
    frame["message"] = f.error ? describe(*f.error) : fmt::format("{} stars", f.stars.size());
    if (!f.error) {
      const Pointing boresight = pointing_from_R_CN(f.R_CN);
      const Quaternion q = to_quaternion(f.R_CN.transpose());
      const Vec3 sigma = f.covariance_rad2.diagonal().cwiseSqrt() / kArcsecond;
      frame["boresight"] = {{"ra_deg", boresight.ra_rad / kDegree},
                            {"dec_deg", boresight.dec_rad / kDegree},
                            {"roll_deg", boresight.roll_rad / kDegree}};
      frame["q_NC"] = {{"w", q.w}, {"x", q.x}, {"y", q.y}, {"z", q.z}};
      frame["attitude_sigma_arcsec"] = {{"x", sigma.x()}, {"y", sigma.y()}, {"z", sigma.z()}};
      frame["aberration_corrected"] = f.aberration_corrected;
      frame["refraction_corrected"] = f.refraction_corrected;
      frame["stars_detected"] = f.spots;
      frame["stars_matched"] = f.stars.size();
      frame["residual_rms_px"] = f.rms_px;
      frame["residual_rms_alone_px"] = std::isnan(f.rms_alone_px) ? Json(nullptr) : Json(f.rms_alone_px);
      frame["stars"] = Json::array();
      for (const opensky::CalibrationStar& s : f.stars) {
        frame["stars"].push_back({{"id", s.id},
                                  {"u_px", s.pixel.u},
                                  {"v_px", s.pixel.v},
                                  {"residual_u_px", s.residual_px.x()},
                                  {"residual_v_px", s.residual_px.y()},
                                  {"mag", std::round(s.v_mag * 1e3) / 1e3}});
      }
      frame["planets"] = Json::array();
      for (const opensky::ForetoldPlanet& p : f.planets) {
        Json planet = {{"name", std::string(body_name(p.body))},
                       {"mag_predicted", p.v_mag},
                       {"predicted_u_px", p.predicted.u},
                       {"predicted_v_px", p.predicted.v}};
        planet["u_px"] = p.measured ? Json(p.measured->u) : Json(nullptr);
        planet["v_px"] = p.measured ? Json(p.measured->v) : Json(nullptr);
        planet["distance_px"] = p.measured ? Json((p.measured->vec() - p.predicted.vec()).norm()) : Json(nullptr);
        frame["planets"].push_back(std::move(planet));
      }
    }
    out["frames"].push_back(std::move(frame));
  }
  out["out"] = options.out.empty() ? Json(nullptr) : Json(options.out);
  return out;
}

void tell(const opensky::Calibration& c, const Options& options) {
  const auto frames = std::count_if(c.frames.begin(), c.frames.end(), [](const auto& f) { return !f.error; });
  fmt::print("{} stars on {} of {} picture{}, {}, {}: {:.3f} px rms, {:.3f} px rms of stars held out\n", c.stars,
             frames, c.frames.size(), c.frames.size() == 1 ? "" : "s",
             c.camera.model == ProjectionModel::fisheye ? "fisheye" : "pinhole", c.mirrored ? "mirrored" : "direct",
             c.rms_px, c.held_out_rms_px);
  const auto values = opensky::intrinsics_values(c.camera);
  for (std::size_t i = 0; i < values.size(); ++i) {
    const double variance = c.covariance(static_cast<Eigen::Index>(i), static_cast<Eigen::Index>(i));
    if (variance > 0.0) {
      fmt::print("  {:5} {:12.6g} +- {:.2g}\n", opensky::kIntrinsicsNames[i], values[i], std::sqrt(variance));
    } else {
      fmt::print("  {:5} {:12.6g} held: the pictures do not ask for it\n", opensky::kIntrinsicsNames[i], values[i]);
    }
  }
  for (std::size_t k = 0; k < c.frames.size(); ++k) {
    const opensky::CalibratedFrame& f = c.frames[k];
    if (f.error) {
      fmt::print("{}: {}\n", options.images[k], describe(*f.error));
      continue;
    }
    const Pointing p = pointing_from_R_CN(f.R_CN);
    fmt::print("{}: boresight RA {:.4f} Dec {:+.4f} roll {:.3f} deg, {} stars, {:.3f} px rms{}\n", options.images[k],
               p.ra_rad / kDegree, p.dec_rad / kDegree, p.roll_rad / kDegree, f.stars.size(), f.rms_px,
               f.stands_apart()
                   ? fmt::format(", alone {:.3f}: is it of this camera, and of the same focus?", f.rms_alone_px)
                   : "");
    for (const opensky::ForetoldPlanet& planet : f.planets) {
      if (!planet.measured) continue;
      fmt::print("  {}, not used, foretold at ({:.2f}, {:.2f}) px, seen at ({:.2f}, {:.2f}): {:.2f} px off\n",
                 body_name(planet.body), planet.predicted.u, planet.predicted.v, planet.measured->u, planet.measured->v,
                 (planet.measured->vec() - planet.predicted.vec()).norm());
    }
  }
}

Result<int> run(const Options& options) {
  if (const auto all = check_each_is_another(options); !all) return forward(all);
  Inputs in;
  in.frames.resize(options.images.size());
  if (const auto read = read_camera_and_field(options, in); !read) return forward(read);
  if (const auto read = read_epochs_and_observer(options, in); !read) return forward(read);
  if (const auto ending = check_ending(options.out, {".toml"}, "--out"); !ending) return forward(ending);
  if (const auto writable = check_writable({options.out}); !writable) return forward(writable);
  const auto catalogue = open_catalogue(options.catalogue);
  if (!catalogue) return forward(catalogue);
  if (const auto read = read_pictures(options, in); !read) return forward(read);
  const auto found = opensky::calibrate_camera(catalogue->stars, in.frames, in.request);
  if (!found) {
    if (options.json && exit_status(found.error().code) == 3) {
      const Json out = {{"status", std::string(name(found.error().code))}, {"message", describe(found.error())}};
      fmt::print("{}\n", out.dump());
    }
    return forward(found);
  }
  if (!options.out.empty()) {
    const auto stored = write_file(options.out, file_text(camera_of(*found, in, options.out), *found, options));
    if (!stored) return forward(stored, options.out);
  }
  if (options.json)
    fmt::print("{}\n", to_json(*found, options).dump());
  else
    tell(*found, options);
  return 0;
}

}  // namespace

void add_calibrate(CLI::App& app, Invocation& invocation) {
  auto options = std::make_shared<Options>();
  CLI::App* sub = app.add_subcommand("calibrate", "what a camera is, from its own pictures");
  sub->require_subcommand(1);
  sub->footer("Example:\n  astronav calibrate camera night1.tiff night2.tiff --fov 8:13 --out mine.toml");
  CLI::App* camera = sub->add_subcommand("camera", "focal length, centre and distortion from stars alone");
  camera->footer("Example:\n  astronav calibrate camera night1.tiff night2.tiff --fov 8:13 --out mine.toml");
  camera->add_option("images", options->images, "pictures of one camera: PNG, TIFF, JPEG, FITS or raw")->required();
  camera->add_option("--out", options->out, "FILE.toml: the camera, for everything that reads cameras");
  camera->add_option("--camera", options->camera, "gives what the sky does not tell: optics, detector, noise");
  camera->add_flag("--fisheye", options->fisheye, "an all-sky camera");
  camera->add_option("--fov", options->fov, "MIN:MAX, horizontal field of view in degrees");
  camera->add_option("--near", options->near, "RA,DEC,RADIUS in degrees: the centre lies there");
  camera
      ->add_option("--epoch", options->epochs,
                   "middle of the exposure: one for all images, or EPOCH,EPOCH,... one each")
      ->allow_extra_args(false)
      ->delimiter(',');
  camera->add_option("--observer", options->observer,
                     "as for `solve`: aberration and planets; ground: refraction and zenith too");
  camera->add_option("--raw", options->raw, "WIDTHxHEIGHT,u16le,OFFSET");
  camera->add_option("--kernel", options->kernels, "SPK files in place of DE405")->allow_extra_args(false);
  camera->add_option("--catalog", options->catalogue, "star catalogue in place of Hipparcos");
  camera->add_flag("--json", options->json, "one JSON object");
  camera->callback([options, &invocation] { invocation.action = [options] { return run(*options); }; });
}

}  // namespace astronav::cli
