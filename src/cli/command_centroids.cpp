// SPDX-License-Identifier: Apache-2.0
#include <chrono>
#include <cmath>
#include <memory>
#include <optional>
#include <string>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "cli/command.h"
#include "cli/commands.h"
#include "cli/validators.h"
#include "foundation/raster/raster.h"
#include "models/camera_file/camera_file.h"
#include "onboard/vision/centroids.h"
#include "verification/opensky/spots.h"

namespace astronav::cli {
namespace {

using Json = nlohmann::ordered_json;

struct Options {
  std::string image, camera, method = "psf-fit", raw;
  double sigma = 5.0;
  bool json = false;
};

Result<int> run(const Options& options) {
  std::optional<RawLayout> raw;
  if (!options.raw.empty()) {
    const auto layout = parse_raw_layout(options.raw);
    if (!layout) return forward(layout, "--raw");
    raw = *layout;
  }
  const auto picture = read_picture(options.image, raw);
  if (!picture) return forward(picture);
  const auto begin = std::chrono::steady_clock::now();
  opensky::Spots found;
  if (options.camera.empty()) {
    opensky::SpotSettings settings;
    settings.threshold_sigma = options.sigma;
    found = opensky::find_spots(*picture, settings);
  } else {
    // As the flight software does it, knowing its camera.
    const auto camera = read_camera(options.camera);
    if (!camera) return forward(camera, "--camera");
    vision::CentroidSettings settings;
    settings.threshold_sigma = options.sigma;
    settings.max_centroids = 2000;
    settings.method =
        options.method == "psf-fit" ? vision::CentroidMethod::psf_fit : vision::CentroidMethod::squared_intensity;
    const int width = picture->pixels.width(), height = picture->pixels.height();
    if (width < 16 || height < 16)
      return fail(ErrorCode::invalid_argument, "{0} x {1} pixels; at least 16 x 16",
                  {static_cast<double>(width), static_cast<double>(height)}, options.image);
    vision::CentroidFinder finder(settings, vision::SensorModel::from(*camera), width, height);
    found.spots.resize(2000);
    vision::FrameLevel level;
    found.spots.resize(finder.find(picture->pixels.view(), found.spots, &level));
    found.background_dn = level.background_dn;
    found.noise_dn = level.noise_dn;
    found.threshold_dn = level.threshold_dn - level.background_dn;
  }
  const double ms = std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - begin).count();
  if (options.json) {
    Json out;
    out["image"] = options.image;
    out["count"] = found.spots.size();
    out["threshold_dn"] = found.threshold_dn;
    out["background_dn"] = found.background_dn;
    out["noise_dn"] = found.noise_dn;
    out["time_ms"] = ms;
    out["centroids"] = Json::array();
    for (const vision::Centroid& c : found.spots)
      out["centroids"].push_back({{"u_px", c.pixel.u},
                                  {"v_px", c.pixel.v},
                                  {"sigma_u_px", std::sqrt(c.covariance_px2(0, 0))},
                                  {"sigma_v_px", std::sqrt(c.covariance_px2(1, 1))},
                                  {"flux_dn", c.flux_dn},
                                  {"snr", c.snr},
                                  {"pixels", c.pixels},
                                  {"saturated", c.saturated}});
    fmt::print("{}\n", out.dump());
    return 0;
  }
  fmt::print("{}: {} spots; background {:.2f} DN, noise {:.3f} DN, threshold {:.2f} DN above it; {:.1f} ms\n",
             options.image, found.spots.size(), found.background_dn, found.noise_dn, found.threshold_dn, ms);
  fmt::print("{:>10} {:>10} {:>9} {:>9} {:>12} {:>8} {:>7}\n", "u px", "v px", "sigma u", "sigma v", "flux DN", "S/N",
             "pixels");
  for (const vision::Centroid& c : found.spots)
    fmt::print("{:10.3f} {:10.3f} {:9.4f} {:9.4f} {:12.1f} {:8.1f} {:7}{}\n", c.pixel.u, c.pixel.v,
               std::sqrt(c.covariance_px2(0, 0)), std::sqrt(c.covariance_px2(1, 1)), c.flux_dn, c.snr, c.pixels,
               c.saturated ? " saturated" : "");
  return 0;
}

}  // namespace

void add_centroids(CLI::App& app, Invocation& invocation) {
  auto options = std::make_shared<Options>();
  CLI::App* sub = app.add_subcommand("centroids", "what the image processing sees before identification");
  sub->footer("Example:\n  astronav centroids frame.fits --camera extrema-20deg --json");
  sub->add_option("image", options->image, "PNG, TIFF, JPEG, FITS or raw frame")->required();
  CLI::Option* camera =
      sub->add_option("--camera", options->camera, "as the flight software sees it through this camera (file or name)");
  sub->add_option("--method", options->method, "with --camera: psf-fit or squares")
      ->check(CLI::IsMember({"psf-fit", "squares"}))
      ->needs(camera)
      ->capture_default_str();
  sub->add_option("--sigma", options->sigma, "threshold above the background, in its noise")
      ->check(number_within(1.0, 1e6))
      ->capture_default_str();
  sub->add_option("--raw", options->raw, "WIDTHxHEIGHT,u16le,OFFSET");
  sub->add_flag("--json", options->json, "one JSON object");
  sub->callback([options, &invocation] { invocation.action = [options] { return run(*options); }; });
}

}  // namespace astronav::cli
