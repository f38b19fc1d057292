// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
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
#include "cli/outputs.h"
#include "cli/picture_header.h"
#include "cli/validators.h"
#include "cli/wcs.h"
#include "foundation/raster/raster.h"
#include "models/camera_file/camera_file.h"
#include "verification/opensky/compare.h"
#include "verification/opensky/compare_picture.h"
#include "verification/opensky/solver.h"

namespace astronav::cli {
namespace {

using Json = nlohmann::ordered_json;

struct Options {
  std::string image;
  std::string camera, fov, epoch, observer, catalogue, targets, out, save_camera;
  std::vector<std::string> kernels;
  double max_v = 13.0;
  double least_snr = 10.0;
  bool wcs_from_header = false;
  bool json = false;
};

// A camera of which nothing is known: silicon behind clear glass. Zero point and colour are fitted.
Camera unknown_camera() {
  Camera camera;
  camera.name = "fitted";
  camera.optics.focal_length_m = 0.05;
  camera.optics.pupil_diameter_m = 0.02;
  camera.detector.pixel_pitch_m = 5e-6;  // the focal length follows
  for (int nm = 400; nm <= 1000; nm += 25) camera.optics.transmission.push_back({nm * 1e-9, 1.0});
  const std::pair<int, double> silicon[] = {{380, 0.2},  {400, 0.35}, {450, 0.5}, {500, 0.6},  {550, 0.62}, {600, 0.6},
                                            {650, 0.53}, {700, 0.45}, {800, 0.3}, {900, 0.15}, {1000, 0.03}};
  for (const auto& [nm, share] : silicon) camera.detector.quantum_efficiency.push_back({nm * 1e-9, share});
  return camera;
}

Result<std::vector<opensky::NamedStar>> read_targets(const std::string& path) {
  const auto listed = read_near_stars(path);
  if (!listed) return forward(listed);
  std::vector<opensky::NamedStar> stars;
  for (const ListedStar& star : *listed) stars.push_back({star.name, star.star, star.v_i});
  return stars;
}

// What the comparison is made with, and what must live as long.
struct Asked {
  Picture picture;
  std::shared_ptr<const Kernels> kernels;
  std::shared_ptr<const OpenCatalogue> catalogue;
  opensky::CompareRequest request;
};

Result<void> solve_for_plate(const Options& options, Asked& asked, std::optional<Epoch> epoch) {
  opensky::CompareRequest& request = asked.request;
  opensky::SolveRequest solve;
  if (!options.fov.empty()) {
    std::string commas = options.fov;
    std::replace(commas.begin(), commas.end(), ':', ',');
    const auto range = parse_numbers(commas, 1, 2, "MIN:MAX");
    if (!range) return forward(range, "--fov");
    solve.field = opensky::FieldRange{range->front() * kDegree, range->back() * kDegree};
  } else if (request.camera_known) {
    solve.camera = request.camera.intrinsics;
  }
  solve.epoch = epoch;
  if (request.observer_known) solve.observer = request.observer;
  opensky::Solver solver(asked.catalogue->stars);
  const auto solution = solver.solve(asked.picture, solve);
  if (!solution) return forward(solution, options.image);
  request.plate = solution->attitude.intrinsics;
  request.R_CN = solution->attitude.R_CN;
  request.mirrored = solution->mirrored;
  request.epoch = solution->epoch;
  return {};
}

Result<Asked> read_request(const Options& options) {
  Asked asked;
  opensky::CompareRequest& request = asked.request;
  auto kernels = open_kernels(options.kernels);
  if (!kernels) return forward(kernels);
  asked.kernels = *kernels;
  auto catalogue = open_catalogue(options.catalogue);
  if (!catalogue) return forward(catalogue);
  asked.catalogue = std::make_shared<const OpenCatalogue>(std::move(*catalogue));
  if (!options.camera.empty()) {
    auto camera = read_camera(options.camera);
    if (!camera) return forward(camera, "--camera");
    request.camera = std::move(*camera);
    request.camera_known = true;
    request.exposure_s = request.camera.exposure_s;
  } else {
    request.camera = unknown_camera();
  }
  if (!options.targets.empty()) {
    auto targets = read_targets(options.targets);
    if (!targets) return forward(targets, "--targets");
    request.named = std::move(*targets);
  }
  std::optional<Epoch> epoch;
  if (!options.epoch.empty()) {
    const auto told = Epoch::parse(options.epoch);
    if (!told) return forward(told, "--epoch");
    epoch = *told;
  }
  auto picture = read_picture(options.image);
  if (!picture) return forward(picture);
  asked.picture = std::move(*picture);
  if (!epoch) epoch = header_epoch(asked.picture);

  request.ephemeris = &asked.kernels->ephemeris;
  request.catalogue = &asked.catalogue->stars;
  request.max_v_mag = options.max_v;
  request.least_snr = options.least_snr;
  if (!options.observer.empty()) {
    if (!epoch)
      return fail(ErrorCode::invalid_argument, "an observer is somewhere only at an --epoch", {}, "--observer");
    const auto observer = parse_observer(options.observer, asked.kernels);
    if (!observer) return forward(observer, "--observer");
    const auto state = (*observer)(*epoch);
    if (!state) return forward(state, "--observer");
    request.observer = *state;
    request.observer_known = true;
  } else if (epoch) {
    const auto state = header_observer(asked.picture, asked.kernels->ephemeris, *epoch);
    if (!state) return forward(state, options.image);
    if (*state) request.observer = **state;
    request.observer_known = state->has_value();
  }
  if (const auto exposure = header_number(asked.picture, "EXPTIME")) request.exposure_s = *exposure;
  if (!(request.exposure_s > 0.0))
    return fail(ErrorCode::corrupt_data, "an exposure of {0} s", {request.exposure_s}, options.image);

  const bool plate_in_header = asked.picture.header.count("CTYPE1") > 0;
  if (options.wcs_from_header ||
      (plate_in_header && options.fov.empty() && (options.camera.empty() || !options.targets.empty()))) {
    const auto plate =
        plate_from_header(asked.picture.header, asked.picture.pixels.width(), asked.picture.pixels.height());
    if (!plate) return forward(plate, options.image);
    request.plate = plate->camera;
    request.R_CN = plate->R_CN;
    request.mirrored = plate->mirrored;
    request.fit_plate = false;
    // Plates from catalogue places hold no aberration; ours do.
    const auto creator = asked.picture.header.find("CREATOR");
    request.aberration = creator != asked.picture.header.end() && creator->second.starts_with("astronav");
    request.epoch = epoch.value_or(Epoch{});
    return asked;
  }
  if (const auto solved = solve_for_plate(options, asked, epoch); !solved) return forward(solved);
  return asked;
}

Json windows_json(const opensky::WindowFigures& w) {
  return {{"windows", w.windows},
          {"rmse_dn", w.rmse_dn},
          {"noise_dn", w.noise_dn},
          {"rmse_over_noise", w.rmse_over_noise},
          {"starless_over_noise", w.starless_over_noise},
          {"ssim_loss", w.ssim_loss},
          {"starless_ssim_loss", w.starless_ssim_loss},
          {"ssim_loss_ratio", w.ssim_loss_ratio()}};
}

// Magnitude of the light within 4 px by the zero point that a header gives (LORRI's PHOTZPT: of 1 DN/s), without a
// colour term.
std::optional<double> header_magnitude(const Picture& picture, const opensky::Comparison& c,
                                       const opensky::ComparedStar& star) {
  const auto zero = header_number(picture, "PHOTZPT");
  if (!zero || !(star.measured_e > 0.0)) return {};
  return *zero - 2.5 * std::log10(star.measured_e * star.aperture_share / c.gain_e_dn / c.exposure_s);
}

Json to_json(const Options& options, const Asked& asked, const opensky::Comparison& c) {
  Json out;
  out["image"] = options.image;
  out["status"] = "compared";
  out["stars"] = c.counted;
  out["stars_lost"] = c.lost;
  out["stars_crowded"] = c.crowded;
  out["stars_saturated"] = c.saturated;
  out["halves"] = c.halves;
  out["geometric_rms_px"] = c.geometric_rms_px;
  out["geometric_median_px"] = c.geometric_median_px;
  out["geometric_clipped_rms_px"] = c.clipped_geometric_rms_px;
  out["geometric_clipped"] = c.clipped_places;
  out["photometric_rms_mag"] = c.photometric_rms_mag;
  out["photometric_median_mag"] = c.photometric_median_mag;
  out["photometric_clipped_rms_mag"] = c.clipped_photometric_rms_mag;
  out["photometric_clipped"] = c.clipped_magnitudes;
  out.update(windows_json(c.windows));
  out["own_fit"] = windows_json(c.own_windows);
  out["own_fit"]["geometric_rms_px"] = c.own_geometric_rms_px;
  out["own_fit"]["photometric_rms_mag"] = c.own_photometric_rms_mag;
  out["all_stars"] = windows_json(c.deep_windows);
  out["zero_point_mag"] = c.zero_point_mag;
  out["colour_mag"] = c.colour_mag;
  out["psf_sigma_px"] = c.psf_sigma_px;
  out["psf_fwhm_px"] = c.psf_fwhm_px;
  out["background_dn"] = c.background_dn;
  out["background_scatter"] = c.background_scatter;
  out["noise_floor_dn"] = c.noise_floor_dn;
  out["gain_e_dn"] = c.gain_e_dn;
  const Intrinsics& i = c.camera.intrinsics;
  out["focal_px"] = {{"x", i.fx_px}, {"y", i.fy_px}};
  out["plate_scale_arcsec"] = i.plate_scale_rad_px() / kArcsecond;
  out["distortion"] = {
      {"k1", i.distortion.k1}, {"k2", i.distortion.k2}, {"p1", i.distortion.p1}, {"p2", i.distortion.p2}};
  out["vignetting_corner_loss"] = c.camera.optics.vignetting_corner_loss;
  out["parity"] = c.mirrored ? "mirrored" : "direct";
  const auto star_json = [&](const opensky::ComparedStar& s) {
    Json one = {{"id", s.id},
                {"mag", rounded(s.v_mag, 1e3)},
                {"snr", rounded(s.snr, 10.0)},
                {"predicted_u_px", rounded(s.predicted.u, 1e4)},
                {"predicted_v_px", rounded(s.predicted.v, 1e4)},
                {"counts", s.counts}};
    if (!s.name.empty()) one["name"] = s.name;
    if (s.found) {
      one["u_px"] = rounded(s.measured.u, 1e4);
      one["v_px"] = rounded(s.measured.v, 1e4);
      one["residual_px"] = rounded(s.residual_px(), 1e4);
      one["residual_mag"] = rounded(s.residual_mag(), 1e4);
    }
    return one;
  };
  out["targets"] = Json::array();
  out["star_list"] = Json::array();
  for (const opensky::ComparedStar& s : c.stars) {
    if (!s.name.empty()) {
      Json one = star_json(s);
      one["measured_dn"] = s.measured_e / c.gain_e_dn;
      if (const auto mag = header_magnitude(asked.picture, c, s)) one["mag_by_header"] = *mag;
      out["targets"].push_back(std::move(one));
    } else if (s.snr >= options.least_snr) {
      out["star_list"].push_back(star_json(s));
    }
  }
  return out;
}

void tell(const Options& options, const Asked& asked, const opensky::Comparison& c) {
  fmt::print("{}: {} stars of S/N {:g} and more count{}; besides {} crowded, {} saturated, {} not found\n",
             options.image, c.counted, options.least_snr,
             c.halves ? ", each by the camera that was fitted without it" : "", c.crowded, c.saturated, c.lost);
  if (c.counted > 0) {
    fmt::print("  geometry     {:.3f} px rms ({:.3f} median; {:.3f} without the {} beyond 4 sigma)\n",
               c.geometric_rms_px, c.geometric_median_px, c.clipped_geometric_rms_px, c.clipped_places);
    fmt::print("  brightness   {:.3f} mag rms ({:.3f} median; {:.3f} without the {} beyond 4 sigma)\n",
               c.photometric_rms_mag, c.photometric_median_mag, c.clipped_photometric_rms_mag, c.clipped_magnitudes);
  }
  const opensky::WindowFigures& w = c.windows;
  if (w.windows > 0) {
    fmt::print(
        "  pixels       RMSE {:.3g} DN, expected noise {:.3g} DN; {:.3f} of it pixel by pixel, {:.2f} without stars\n",
        w.rmse_dn, w.noise_dn, w.rmse_over_noise, w.starless_over_noise);
    fmt::print("  structure    1-SSIM {:.2e}, {:.2e} without stars: ratio {:.3f}\n", w.ssim_loss, w.starless_ssim_loss,
               w.ssim_loss_ratio());
  }
  const Intrinsics& i = c.camera.intrinsics;
  fmt::print(
      "  camera       {:.3f} arcsec/px, k1 {:.4f}, PSF {:.2f} px FWHM, zero point {:.2f} mag, sky {:.4g} DN, "
      "gain {:.3g} e/DN{}\n",
      i.plate_scale_rad_px() / kArcsecond, i.distortion.k1, c.psf_fwhm_px, c.zero_point_mag, c.background_dn,
      c.gain_e_dn, c.mirrored ? ", mirrored" : "");
  for (const opensky::ComparedStar& s : c.stars) {
    if (s.name.empty()) continue;
    fmt::print("  {}: predicted ({:.2f}, {:.2f}) px, seen ({:.2f}, {:.2f}), {:.3f} px off; {:+.2f} mag off", s.name,
               s.predicted.u, s.predicted.v, s.measured.u, s.measured.v, s.residual_px(), s.residual_mag());
    if (const auto mag = header_magnitude(asked.picture, c, s)) fmt::print("; {:.3f} mag by the header", *mag);
    fmt::print("\n");
  }
}

// Before the long work.
Result<void> check_outputs(const Options& options) {
  if (const auto ending = check_ending(options.out, {".png"}, "--out"); !ending) return ending;
  if (const auto writable = check_writable({options.out, options.save_camera}); !writable) return writable;
  if (const auto apart = check_apart(options.out, options.image, "--out"); !apart) return apart;
  for (const std::string& path : {options.image, options.out, options.camera}) {
    if (const auto apart = check_apart(options.save_camera, path, "--save-camera"); !apart) return apart;
  }
  return {};
}

Result<int> run(const Options& options) {
  if (const auto checked = check_outputs(options); !checked) return forward(checked);
  const auto asked = read_request(options);
  if (!asked) return forward(asked);
  const auto compared = opensky::compare(asked->picture, asked->request);
  if (!compared) return forward(compared, options.image);
  if (!options.out.empty()) {
    const auto stored = write_png8(options.out, opensky::side_by_side(asked->picture.pixels, *compared));
    if (!stored) return forward(stored, options.out);
  }
  if (!options.save_camera.empty()) {
    // A camera's file knows no star that is sharper at the edge than on the axis: it gets their mean over the picture.
    Camera camera = compared->camera;
    if (camera.psf.sigma_growth_px < 0.0) {
      camera.psf.sigma_px += 0.5 * camera.psf.sigma_growth_px;
      camera.psf.sigma_growth_px = 0.0;
    }
    const auto stored = write_file(options.save_camera, to_toml(camera));
    if (!stored) return forward(stored, options.save_camera);
  }
  if (options.json)
    fmt::print("{}\n", to_json(options, *asked, *compared).dump());
  else
    tell(options, *asked, *compared);
  return 0;
}

}  // namespace

void add_compare(CLI::App& app, Invocation& invocation) {
  auto options = std::make_shared<Options>();
  CLI::App* sub = app.add_subcommand("compare", "a real picture held against the rendering of the same sky");
  sub->footer("Example:\n  astronav compare night.tiff --fov 9:13 --epoch 2019-07-29T20:47:26 --observer earth");
  sub->add_option("image", options->image, "PNG, TIFF, JPEG or FITS")->required();
  sub->add_option("--camera", options->camera, "its curves, gain and PSF (file or name); otherwise all is fitted");
  sub->add_option("--fov", options->fov, "MIN:MAX, horizontal field of view in degrees");
  sub->add_option("--epoch", options->epoch, "middle of the exposure, ISO 8601 with scale; default: the header's");
  sub->add_option("--observer", options->observer, "as for render; default: the header's, else unknown");
  sub->add_flag("--wcs-from-header", options->wcs_from_header, "the header's plate: neither solved nor fitted");
  sub->add_option("--targets", options->targets, "CSV of near stars, as Gaia gives them, to be told by name");
  sub->add_option("--catalog", options->catalogue, "star catalogue in place of Hipparcos");
  sub->add_option("--max-v", options->max_v, "faintest stars drawn")
      ->check(number_within(-2, 20))
      ->capture_default_str();
  sub->add_option("--snr", options->least_snr, "expected S/N of stars that count")
      ->check(number_within(3, 1e4))
      ->capture_default_str();
  sub->add_option("--kernel", options->kernels, "SPK files in place of DE405; later ones take precedence");
  sub->add_option("--out", options->out, "FILE.png: picture, rendering and difference side by side");
  sub->add_option("--save-camera", options->save_camera, "FILE.toml: the camera that fits");
  sub->add_flag("--json", options->json, "one JSON object");
  sub->callback([options, &invocation] { invocation.action = [options] { return run(*options); }; });
}

}  // namespace astronav::cli
