// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <memory>
#include <set>
#include <string>
#include <vector>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "cli/answers.h"
#include "cli/command.h"
#include "cli/commands.h"
#include "cli/inputs.h"
#include "cli/validators.h"
#include "cli/wcs.h"
#include "foundation/base/nearest_word.h"
#include "foundation/raster/raster.h"
#include "models/camera_file/camera_file.h"
#include "simulator/render/renderer.h"
#include "simulator/sky/sky.h"

namespace astronav::cli {
namespace {

using Json = nlohmann::ordered_json;

struct Options {
  std::string camera = "extrema-20deg";
  std::string epoch;
  std::string observer = "earth";
  std::string pointing;
  double exposure_ms = 0.0;  // 0: the camera's own
  std::uint64_t seed = 1;
  double max_v = 12.0;
  std::string out;
  std::string truth;
  std::vector<std::string> kernels;
  std::string catalogue;
  std::string rate;
  std::vector<std::string> without;
  bool no_noise = false;
  bool no_aberration = false;
  bool centre_of_figure = false;
  bool json = false;
};

// Everything that the frame, its header and its truth file tell.
struct Shot {
  Camera camera;
  Epoch epoch;
  State observer_O;
  Mat3 R_CN;
  render::Exposure exposure;
  render::Effects effects;
  std::vector<render::RenderedSource> sources;  // brightest first
};

bool on_detector(const Intrinsics& c, Pixel p) {
  return p.u >= -0.5 && p.v >= -0.5 && p.u < c.width_px - 0.5 && p.v < c.height_px - 0.5;
}

std::vector<FitsCard> header(const Shot& shot, const Options& options) {
  std::vector<FitsCard> cards = wcs_cards(shot.camera.intrinsics, shot.R_CN);
  const Detector& d = shot.camera.detector;
  const auto text = [&](const char* key, std::string value, const char* comment) {
    cards.push_back({.key = key, .text = std::move(value), .number = {}, .comment = comment});
  };
  const auto number = [&](const char* key, double value, const char* comment) {
    cards.push_back({.key = key, .text = {}, .number = value, .comment = comment});
  };
  const Duration half = Duration::seconds(0.5 * shot.exposure.duration_s);
  text("TIMESYS", "UTC", "");
  text("DATE-OBS", (shot.epoch - half).iso(TimeScale::utc, 6, false), "start of the exposure");
  text("DATE-AVG", shot.epoch.iso(TimeScale::utc, 6, false), "middle of the exposure");
  number("EXPTIME", shot.exposure.duration_s, "s");
  text("INSTRUME", shot.camera.name, "");
  number("GAIN", d.gain_e_dn, "electrons per DN");
  number("RDNOISE", d.read_noise_e, "electrons, 1 sigma");
  number("BIAS", d.bias_dn, "DN");
  text("OBSERVER", options.observer, "where the camera was");
  number("SEED", static_cast<double>(options.seed), "of the noise");
  text("CREATOR", "astronav " ASTRONAV_VERSION, "simulated");
  return cards;
}

Json truth(const Shot& shot, const Options& options) {
  const Quaternion q_NC = to_quaternion(shot.R_CN.transpose());
  const Pointing pointing = pointing_from_R_CN(shot.R_CN);
  Json out;
  out["image"] = options.out;
  out["camera"] = shot.camera.name;
  out["exposure_ms"] = shot.exposure.duration_s * 1e3;
  out["seed"] = options.seed;
  out["epoch_tdb"] = shot.epoch.iso(TimeScale::tdb, 6, false);
  out["ra_deg"] = pointing.ra_rad / kDegree;
  out["dec_deg"] = pointing.dec_rad / kDegree;
  out["roll_deg"] = pointing.roll_rad / kDegree;
  out["q_NC"] = {{"w", q_NC.w}, {"x", q_NC.x}, {"y", q_NC.y}, {"z", q_NC.z}};
  out["observer"] = {{"position_km", xyz(shot.observer_O.p_m, 1e3)},
                     {"velocity_km_s", xyz(shot.observer_O.v_m_s, 1e3)}};
  Json sources = Json::array();
  for (const render::RenderedSource& s : shot.sources) {
    if (!on_detector(shot.camera.intrinsics, s.pixel)) continue;
    const bool star = s.source.kind == sky::SourceKind::star;
    const RaDec place = radec_from_direction(s.source.direction_N);
    Json one;
    one["id"] = s.source.id;
    one["kind"] = star ? "star" : s.source.kind == sky::SourceKind::planet ? "planet" : "small_body";
    if (!star) one["name"] = body_name(BodyId{static_cast<std::int32_t>(s.source.id)});
    one["u_px"] = s.pixel.u;
    one["v_px"] = s.pixel.v;
    one["ra_deg"] = place.ra_rad / kDegree;
    one["dec_deg"] = place.dec_rad / kDegree;
    one["electrons"] = s.electrons;
    one["mag"] = std::round(s.source.v_mag * 1e4) / 1e4;
    one["irradiance_w_m2"] = s.source.flux.irradiance_w_m2;
    sources.push_back(std::move(one));
  }
  out["sources"] = std::move(sources);
  return out;
}

Result<void> store(const Shot& shot, const Options& options, const ImageU16& frame) {
  const std::string extension = std::filesystem::path(options.out).extension().string();
  return extension == ".png" ? write_png16(options.out, frame) : write_fits(options.out, frame, header(shot, options));
}

void report(const Shot& shot, const Options& options) {
  std::size_t stars = 0;
  std::vector<std::string> planets;
  for (const render::RenderedSource& s : shot.sources) {
    if (!on_detector(shot.camera.intrinsics, s.pixel)) continue;
    if (s.source.kind == sky::SourceKind::star) {
      ++stars;
    } else {
      planets.emplace_back(body_name(BodyId{static_cast<std::int32_t>(s.source.id)}));
    }
  }
  if (options.json) {
    const Json out = {{"image", options.out},
                      {"truth", options.truth.empty() ? Json(nullptr) : Json(options.truth)},
                      {"camera", shot.camera.name},
                      {"epoch_tdb", shot.epoch.iso(TimeScale::tdb, 6, false)},
                      {"stars", stars},
                      {"planets", planets}};
    fmt::print("{}\n", out.dump());
    return;
  }
  std::string list;
  for (const std::string& planet : planets) list += (list.empty() ? "; " : ", ") + planet;
  fmt::print("{}: {} x {} pixels of {}, {} stars to V {:g}{}\n", options.out, shot.camera.intrinsics.width_px,
             shot.camera.intrinsics.height_px, shot.camera.name, stars, options.max_v, list);
}

Result<render::Effects> effects_of(const Options& options) {
  render::Effects effects = options.no_noise ? render::Effects::expected() : render::Effects{};
  for (const std::string& name : options.without) {
    bool* const on = render::effect(effects, name);
    if (on == nullptr) {
      const auto known = render::effect_names();
      return fail(ErrorCode::invalid_argument, "no effect is called '{s}'?", {}, "--without",
                  fmt::format("{}'; did you mean '{}", name, *nearest_word(name, known)));
    }
    *on = false;
  }
  return effects;
}

// X,Y,Z in degrees a second, in rad/s.
Result<Vec3> parse_rate(const std::string& text) {
  Vec3 rate;
  char rest = 0;
  if (std::sscanf(text.c_str(), "%lf,%lf,%lf%c", &rate.x(), &rate.y(), &rate.z(), &rest) != 3 ||
      !(rate.norm() <= 360.0)) {
    return fail(ErrorCode::invalid_argument, "'{s}' is not X,Y,Z in degrees a second", {}, {}, text);
  }
  return rate * kDegree;
}

Result<int> run(const Options& options) {
  const std::string extension = std::filesystem::path(options.out).extension().string();
  if (extension != ".png" && extension != ".fits" && extension != ".fit") {
    return fail(ErrorCode::invalid_argument, "'{s}' ends neither in .fits nor in .png", {}, "--out", options.out);
  }
  auto camera = read_camera(options.camera);
  if (!camera) return forward(camera);
  const auto epoch = Epoch::parse(options.epoch);
  if (!epoch) return forward(epoch, "--epoch");
  const auto pointing = parse_pointing(options.pointing);
  if (!pointing) return forward(pointing, "--pointing");
  const auto kernels = open_kernels(options.kernels);
  if (!kernels) return forward(kernels);
  const auto observer = parse_observer(options.observer, *kernels);
  if (!observer) return forward(observer, "--observer");
  const auto state = (*observer)(*epoch);
  if (!state) return forward(state, "--observer");
  const auto catalogue = open_catalogue(options.catalogue);
  if (!catalogue) return forward(catalogue);

  Shot shot;
  shot.camera = std::move(*camera);
  shot.epoch = *epoch;
  shot.observer_O = *state;
  shot.R_CN = R_CN_from_pointing(*pointing);
  shot.exposure.duration_s = options.exposure_ms > 0.0 ? options.exposure_ms * 1e-3 : shot.camera.exposure_s;

  const auto effects = effects_of(options);
  if (!effects) return forward(effects);
  shot.effects = *effects;
  if (!options.rate.empty()) {
    const auto rate = parse_rate(options.rate);
    if (!rate) return forward(rate, "--rate");
    shot.exposure.rate_C_rad_s = *rate;
  }
  // For stray light; a kernel without the Sun has none.
  if (const auto sun = light_time((*kernels)->ephemeris, body::sun, shot.observer_O, shot.epoch)) {
    shot.exposure.sun_C_m = shot.R_CN * sun->relative.p_m;
  }

  sky::SkySettings settings;
  settings.max_v_mag = options.max_v;
  settings.aberration = !options.no_aberration;
  settings.centre_of_light = !options.centre_of_figure;
  const double margin_px = 20.0;
  const double radius_rad = shot.camera.intrinsics.half_diagonal_rad() +
                            2.0 * margin_px * shot.camera.intrinsics.plate_scale_rad_px() +
                            0.5 * shot.exposure.rate_C_rad_s.norm() * shot.exposure.duration_s;
  const auto seen = sky::Sky((*kernels)->ephemeris, catalogue->stars)
                        .look(shot.epoch, shot.observer_O, shot.R_CN.row(2).transpose(), radius_rad,
                              BandPhotometry(shot.camera), settings);
  if (!seen) return forward(seen);
  shot.sources = render::place_sources(*seen, shot.camera, shot.R_CN, shot.exposure, margin_px, shot.effects);

  const render::Renderer renderer(shot.camera, options.seed);
  ImageU16 frame;
  renderer.frame(shot.sources, shot.exposure, {.seed = options.seed, .sample = 0, .image = 0, .purpose = ""}, frame,
                 shot.effects);
  if (const auto stored = store(shot, options, frame); !stored) return forward(stored);
  if (!options.truth.empty()) {
    const auto stored = write_file(options.truth, truth(shot, options).dump(1) + "\n");
    if (!stored) return forward(stored);
  }
  report(shot, options);
  return 0;
}

}  // namespace

void add_render(CLI::App& app, Invocation& invocation) {
  auto options = std::make_shared<Options>();
  CLI::App* sub =
      app.add_subcommand("render", "one image of the sky as a camera somewhere in the solar system takes it");
  sub->footer(
      "Example:\n  astronav render --epoch 2026-11-22 --pointing 83.8,-1.2,0 --out orion.fits --truth orion.json");
  sub->add_option("--camera", options->camera, "camera file, or the name of one in scenarios/cameras")
      ->capture_default_str();
  sub->add_option("--epoch", options->epoch, "middle of the exposure, ISO 8601 with scale (UTC if none)")->required();
  sub->add_option("--observer", options->observer,
                  "ssb:X,Y,Z[,VX,VY,VZ] (km, km/s), ground:LAT,LON,HEIGHT_M, spk:ID@FILE, oem:FILE or a body")
      ->capture_default_str();
  sub->add_option("--pointing", options->pointing, "RA,DEC,ROLL of the boresight in degrees, ICRF, apparent")
      ->required();
  sub->add_option("--exposure-ms", options->exposure_ms, "default: the camera's own")->check(number_within(1e-6, 1e7));
  sub->add_option("--rate", options->rate, "X,Y,Z turning of the camera in its axes, degrees a second: stars smear");
  sub->add_option("--without", options->without, "effects to leave out, such as shot, read, psf_aberrations, blooming");
  sub->add_option("--seed", options->seed, "of detector and noise")->check(seed_number())->capture_default_str();
  sub->add_option("--max-v", options->max_v, "faintest stars")->check(number_within(-2.0, 20.0))->capture_default_str();
  sub->add_option("--out", options->out, "FILE.fits (with WCS) or FILE.png (16 bit, values are DN)")->required();
  sub->add_option("--truth", options->truth, "FILE.json: attitude, observer and every source in the image");
  sub->add_option("--kernel", options->kernels, "SPK files in place of DE405; later ones take precedence");
  sub->add_option("--catalog", options->catalogue, "star catalogue in place of Hipparcos");
  sub->add_flag("--no-noise", options->no_noise, "expected values: no shot or read noise, no fixed pattern");
  sub->add_flag("--no-aberration", options->no_aberration, "as if the observer were at rest");
  sub->add_flag("--centre-of-figure", options->centre_of_figure,
                "planets shine from their centre, not from their lit side");
  sub->add_flag("--json", options->json, "one JSON object");
  sub->callback([options, &invocation] { invocation.action = [options] { return run(*options); }; });
}

}  // namespace astronav::cli
