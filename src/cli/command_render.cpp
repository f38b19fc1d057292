// SPDX-License-Identifier: Apache-2.0
#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "cli/command.h"
#include "cli/commands.h"
#include "cli/inputs.h"
#include "cli/outputs.h"
#include "cli/validators.h"
#include "cli/wcs.h"
#include "foundation/base/nearest_word.h"
#include "foundation/raster/raster.h"
#include "models/camera_file/camera_file.h"
#include "simulator/server/studio.h"

namespace astronav::cli {
namespace {

using Json = nlohmann::ordered_json;
using server::Shot;

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
  std::vector<std::string> bodies;
  bool no_noise = false;
  bool no_aberration = false;
  bool centre_of_figure = false;
  bool refraction = false;
  bool json = false;
};

std::vector<FitsCard> header(const Shot& shot, const Options& options) {
  std::vector<FitsCard> cards = wcs_cards(shot.camera->intrinsics, shot.R_CN);
  const Detector& d = shot.camera->detector;
  const auto text = [&](const char* key, std::string value, const char* comment) {
    cards.push_back({.key = key, .text = std::move(value), .number = {}, .comment = comment});
  };
  const auto number = [&](const char* key, double value, const char* comment) {
    cards.push_back({.key = key, .text = {}, .number = value, .comment = comment});
  };
  const Duration half = Duration::seconds(0.5 * shot.exposure_s);
  text("TIMESYS", "UTC", "");
  text("DATE-OBS", (shot.epoch - half).iso(TimeScale::utc, 6, false), "start of the exposure");
  text("DATE-AVG", shot.epoch.iso(TimeScale::utc, 6, false), "middle of the exposure");
  number("EXPTIME", shot.exposure_s, "s");
  text("INSTRUME", shot.camera->name, "");
  number("GAIN", d.gain_e_dn, "electrons per DN");
  number("RDNOISE", d.read_noise_e, "electrons, 1 sigma");
  number("BIAS", d.bias_dn, "DN");
  text("OBSERVER", options.observer, "where the camera was");
  number("SEED", static_cast<double>(options.seed), "of the noise");
  text("CREATOR", "astronav " ASTRONAV_VERSION, "simulated");
  return cards;
}

Result<void> store(const Shot& shot, const Options& options) {
  const std::string extension = std::filesystem::path(options.out).extension().string();
  return extension == ".png" ? write_png16(options.out, shot.dn)
                             : write_fits(options.out, shot.dn, header(shot, options));
}

// What was drawn, as its truth tells.
void report(const Json& truth, const Shot& shot, const Options& options) {
  std::size_t stars = 0;
  std::vector<std::string> planets;
  for (const Json& source : truth["sources"]) {
    if (source["kind"] == "star") {
      ++stars;
    } else {
      planets.push_back(source["name"]);
    }
  }
  if (options.json) {
    const Json out = {{"image", options.out},
                      {"truth", options.truth.empty() ? Json(nullptr) : Json(options.truth)},
                      {"camera", truth["camera"]},
                      {"epoch_tdb", truth["epoch_tdb"]},
                      {"stars", stars},
                      {"planets", planets}};
    fmt::print("{}\n", out.dump());
    return;
  }
  std::string list;
  for (const std::string& planet : planets) list += (list.empty() ? "; " : ", ") + planet;
  fmt::print("{}: {} x {} pixels of {}, {} stars to V {:g}{}\n", options.out, shot.dn.width(), shot.dn.height(),
             shot.camera->name, stars, options.max_v, list);
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
  const auto numbers = parse_numbers(text, 3, 3, "X,Y,Z in degrees a second");
  if (!numbers) return forward(numbers);
  return Vec3(numbers->data()) * kDegree;
}

// ID,H,G[,RADIUS_KM]; the first may be a name.
Result<SmallBody> parse_small_body(const std::string& text) {
  const std::size_t comma = text.find(',');
  const auto id = parse_body(std::string_view(text).substr(0, comma));
  if (!id) return forward(id);
  const auto numbers =
      parse_numbers(comma == std::string::npos ? std::string_view() : std::string_view(text).substr(comma + 1), 2, 3,
                    "H,G[,RADIUS_KM] of ID,H,G[,RADIUS_KM]");
  if (!numbers) return forward(numbers);
  SmallBody body{.id = *id, .law = {.h = numbers->at(0), .g1 = numbers->at(1)}};
  if (numbers->size() == 3) body.mean_radius_m = 1e3 * numbers->at(2);
  if (body.mean_radius_m < 0.0 || body.mean_radius_m > 1e8) {
    return fail(ErrorCode::out_of_range, "a radius of {0} km is not within 0 and 1e5", {body.mean_radius_m * 1e-3});
  }
  return body;
}

// The option that a scene's field comes from: the studio speaks of fields.
Error of_option(Error error) {
  constexpr std::pair<std::string_view, const char*> kOptions[] = {
      {"epoch", "--epoch"}, {"observer", "--observer"},     {"attitude", "--pointing"},      {"rate_deg_s", "--rate"},
      {"bodies", "--body"}, {"refraction", "--refraction"}, {"exposure_ms", "--exposure-ms"}};
  for (const auto& [field, option] : kOptions) {
    if (error.where.view() == field) error.where = FixedText<200>(option);
  }
  return error;
}

Result<server::Scene> scene_of(const Options& options, Epoch epoch, const std::shared_ptr<const Kernels>& kernels) {
  server::Scene scene;
  auto camera = read_camera(options.camera);
  if (!camera) return forward(camera);
  scene.camera =
      std::make_shared<server::Scene::NamedCamera>(options.camera, std::make_shared<const Camera>(std::move(*camera)));
  scene.epoch = epoch;
  const auto pointing = parse_pointing(options.pointing);
  if (!pointing) return forward(pointing, "--pointing");
  scene.attitude = R_CN_from_pointing(*pointing);
  auto observer = parse_observer(options.observer, kernels);
  if (!observer) return forward(observer, "--observer");
  const auto site = parse_ground_site(options.observer);
  if (!site) return forward(site, "--observer");
  scene.observer = {options.observer, std::make_shared<const server::Observer>(std::move(*observer)), *site};
  scene.refraction = options.refraction;
  for (const std::string& text : options.bodies) {
    const auto body = parse_small_body(text);
    if (!body) return forward(body, "--body");
    if (auto added = server::add_small_body(*body, scene.sky.bodies); !added) return forward(added, "--body");
  }
  const auto effects = effects_of(options);
  if (!effects) return forward(effects);
  scene.effects = *effects;
  if (!options.rate.empty()) {
    const auto rate = parse_rate(options.rate);
    if (!rate) return forward(rate, "--rate");
    scene.rate_C_rad_s = *rate;
  }
  scene.exposure_s = options.exposure_ms * 1e-3;
  scene.sky.max_v_mag = options.max_v;
  scene.sky.aberration = !options.no_aberration;
  scene.sky.centre_of_light = !options.centre_of_figure;
  scene.seed = scene.detector_seed = options.seed;
  return scene;
}

Result<int> run(const Options& options) {
  if (const auto ending = check_ending(options.out, {".fits", ".fit", ".png"}, "--out"); !ending)
    return forward(ending);
  if (const auto apart = check_apart(options.truth, options.out, "--truth"); !apart) return forward(apart);
  if (const auto writable = check_writable({options.out, options.truth}); !writable) return forward(writable);
  const auto epoch = Epoch::parse(options.epoch);
  if (!epoch) return forward(epoch, "--epoch");
  const auto kernels = open_kernels_for(options.kernels, {body::sun, body::earth}, *epoch);
  if (!kernels) return forward(kernels);
  const auto scene = scene_of(options, *epoch, *kernels);
  if (!scene) return forward(scene);
  const auto catalogue = open_catalogue(options.catalogue);
  if (!catalogue) return forward(catalogue);

  Shot shot;
  const server::Studio studio((*kernels)->ephemeris, catalogue->stars, {});
  if (const auto taken = studio.take(*scene, shot); !taken) return tl::unexpected<Error>(of_option(taken.error()));
  if (const auto stored = store(shot, options); !stored) return forward(stored);
  Json truth = {{"image", options.out}};
  truth.update(server::truth(shot));
  if (!options.truth.empty()) {
    const auto stored = write_file(options.truth, truth.dump(1) + "\n");
    if (!stored) return forward(stored);
  }
  report(truth, shot, options);
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
  sub->add_option("--body", options->bodies, "ID,H,G[,RADIUS_KM]: an asteroid or moon of the kernels; once for each")
      ->expected(1)
      ->take_all();
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
  sub->add_flag("--refraction", options->refraction, "of air at 1010 hPa and 10 C, for an observer on the ground");
  sub->add_flag("--json", options->json, "one JSON object");
  sub->callback([options, &invocation] { invocation.action = [options] { return run(*options); }; });
}

}  // namespace astronav::cli
