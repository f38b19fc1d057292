// SPDX-License-Identifier: Apache-2.0
#include "simulator/server/studio.h"

#include <algorithm>
#include <cmath>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "foundation/raster/raster.h"
#include "models/aberration/aberration.h"
#include "models/ephemeris/bodies.h"

namespace astronav::server {
namespace {

using Json = nlohmann::ordered_json;

constexpr double kMarginPx = 20.0;
constexpr double kMaxSmearRad = 30.0 * kDegree;
constexpr double kChartMag = 4.5;

const char* kind_name(sky::SourceKind kind) {
  switch (kind) {
    case sky::SourceKind::star:
      return "star";
    case sky::SourceKind::planet:
      return "planet";
    case sky::SourceKind::small_body:
      return "small_body";
    case sky::SourceKind::sun:
      return "sun";
  }
  return "";
}

Json xyz(const Vec3& v, double unit) {
  return {{"x", v.x() / unit}, {"y", v.y() / unit}, {"z", v.z() / unit}};
}

template <typename T>
std::span<const std::byte> bytes_of(std::span<const T> values) {
  return std::as_bytes(values);
}

}  // namespace

std::span<const std::byte> Shot::pixels() const {
  switch (format) {
    case PixelFormat::dn:
      return bytes_of(dn.pixels());
    case PixelFormat::electrons:
      return bytes_of(electrons.pixels());
    case PixelFormat::png:
      return bytes_of(std::span<const char>(png));
    case PixelFormat::none:
      break;
  }
  return {};
}

Json truth(const Shot& shot) {
  const Quaternion q_NC = to_quaternion(shot.R_CN.transpose());
  const Pointing pointing = pointing_from_R_CN(shot.R_CN);
  Json out;
  out["camera"] = shot.camera->name;
  out["exposure_ms"] = shot.exposure_s * 1e3;
  out["seed"] = shot.seed;
  out["epoch_tdb"] = shot.epoch.iso(TimeScale::tdb, 6, false);
  out["ra_deg"] = pointing.ra_rad / kDegree;
  out["dec_deg"] = pointing.dec_rad / kDegree;
  out["roll_deg"] = pointing.roll_rad / kDegree;
  out["q_NC"] = {{"w", q_NC.w}, {"x", q_NC.x}, {"y", q_NC.y}, {"z", q_NC.z}};
  out["observer"] = {{"position_km", xyz(shot.observer_O.p_m, 1e3)},
                     {"velocity_km_s", xyz(shot.observer_O.v_m_s, 1e3)}};
  Json sources = Json::array();
  for (const render::RenderedSource& s : shot.sources) {
    if (!shot.camera->intrinsics.contains(s.pixel)) continue;
    const bool star = s.source.kind == sky::SourceKind::star;
    const RaDec place = radec_from_direction(s.source.direction_N);
    Json one;
    one["id"] = s.source.id;
    one["kind"] = kind_name(s.source.kind);
    if (!star) {
      const std::string_view known = body_name(BodyId{static_cast<std::int32_t>(s.source.id)});
      one["name"] = known.empty() ? std::to_string(s.source.id) : std::string(known);
    }
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

Studio::Ready::Ready(const Scene& scene)
    : camera(scene.camera->camera), band(*camera), renderer(*camera, scene.detector_seed) {}

std::size_t Studio::cameras_made() const {
  const std::lock_guard lock(mutex_);
  return made_;
}

std::shared_ptr<const Studio::Ready> Studio::ready(const Scene& scene) const {
  std::shared_ptr<Place> place;
  {
    const std::lock_guard lock(mutex_);
    const auto found = std::find_if(places_.begin(), places_.end(), [&](const auto& p) {
      return p->detector_seed == scene.detector_seed && p->key == scene.camera->key;
    });
    if (found != places_.end()) {
      places_.splice(places_.begin(), places_, found);
      place = places_.front();
    } else {
      place = std::make_shared<Place>();
      place->key = scene.camera->key;
      place->detector_seed = scene.detector_seed;
      const Intrinsics& k = scene.camera->camera->intrinsics;
      place->pixels = static_cast<std::size_t>(k.width_px) * static_cast<std::size_t>(k.height_px);
      places_.push_front(place);
      ++made_;
      std::size_t pixels = 0;
      for (const auto& each : places_) pixels += each->pixels;
      while (places_.size() > 1 && (places_.size() > room_.cameras || pixels > room_.pixels)) {
        pixels -= places_.back()->pixels;
        places_.pop_back();
      }
    }
  }
  std::call_once(place->once, [&] { place->ready = std::make_shared<const Ready>(scene); });
  return place->ready;
}

// With what depends on epoch and observer; bodies that cannot be drawn are told.
Result<sky::SkySettings> Studio::sky_settings(const Scene& scene) const {
  sky::SkySettings out = scene.sky;
  if (scene.refraction) {
    if (!scene.observer->site) {
      return fail(ErrorCode::invalid_argument, "there is no air at '{s}'; refraction is for ground:LAT,LON,HEIGHT_M",
                  {}, "refraction", scene.observer->text);
    }
    out.refraction = Refraction({}, ground_zenith(*scene.observer->site, *scene.epoch));
  }
  for (const SmallBody& body : out.bodies) {
    if (const auto held = ephemeris_->resolve(body.id); !held) return forward(held, "bodies");
  }
  return out;
}

Result<void> Studio::check_work(const Scene& scene, const Shot& shot) const {
  if (std::isinf(room_.scene_work)) return {};
  const auto refuse = [&](const char* field, const char* text, double work) {
    return fail(ErrorCode::limit_exceeded, text, {work, room_.scene_work}, field);
  };
  const double light = render::painting_work(shot.sources, *shot.camera, scene.effects);
  if (light > room_.scene_work) {
    return scene.effects.motion && scene.rate_C_rad_s.norm() > 0.0
               ? refuse("rate_deg_s",
                        "the light of this scene takes {0} additions to pixels, and at most {1} are made for a "
                        "picture: lower the rate, exposure_ms or max_v_mag",
                        light)
               : refuse("max_v_mag",
                        "the light of this scene takes {0} additions to pixels, and at most {1} are made for a "
                        "picture: lower max_v_mag or exposure_ms, or switch psf_aberrations off",
                        light);
  }
  const double protons = scene.effects.cosmic_rays && scene.format != PixelFormat::electrons
                             ? render::proton_work(*shot.camera, shot.exposure_s)
                             : 0.0;
  if (protons > room_.scene_work) {
    return refuse(
        "exposure_ms",
        "the protons of this exposure take as long as {0} additions to pixels, and at most {1} are made for a "
        "picture: lower exposure_ms, or switch cosmic_rays off",
        protons);
  }
  return {};
}

Result<Mat3> Studio::attitude(const Scene& scene, const sky::SkySettings& settings, const State& observer_O) const {
  if (const auto* R_CN = std::get_if<Mat3>(&scene.attitude)) return *R_CN;
  const auto* law = std::get_if<BodyPointing>(&scene.attitude);
  if (law == nullptr) return fail(ErrorCode::invalid_argument, "a scene needs an attitude", {}, "attitude");
  const auto body = ephemeris_->resolve(law->body);
  if (!body) return forward(body, "attitude.body");
  const auto seen = light_time(*ephemeris_, *body, observer_O, *scene.epoch);
  if (!seen) return forward(seen, "attitude.body");
  const double distance = seen->relative.p_m.norm();
  if (!(distance > 0.0)) {
    return fail(ErrorCode::invalid_argument, "the observer is at the body's centre", {}, "attitude.body");
  }
  Vec3 direction = seen->relative.p_m / distance;
  if (settings.aberration) direction = aberrate(direction, observer_O.v_m_s);
  if (settings.refraction) direction = settings.refraction->refract(direction);
  const RaDec at = radec_from_direction(direction);
  return R_CN_from_pointing({at.ra_rad, at.dec_rad, law->roll_rad});
}

Result<void> Studio::take(const Scene& scene, Shot& shot) const {
  if (!scene.epoch) return fail(ErrorCode::invalid_argument, "a scene needs an epoch", {}, "epoch");
  if (!scene.observer) return fail(ErrorCode::invalid_argument, "a scene needs an observer", {}, "observer");
  if (!scene.camera) return fail(ErrorCode::invalid_argument, "a scene needs a camera", {}, "camera");
  const auto state = (*scene.observer->observer)(*scene.epoch);
  if (!state) return forward(state, "observer");
  const auto settings = sky_settings(scene);
  if (!settings) return forward(settings);
  const auto R_CN = attitude(scene, *settings, *state);
  if (!R_CN) return forward(R_CN);

  shot.exposure_s = scene.exposure_s > 0.0 ? scene.exposure_s : scene.camera->camera->exposure_s;
  const double smear_rad = scene.rate_C_rad_s.norm() * shot.exposure_s;
  if (smear_rad > kMaxSmearRad) {
    return fail(ErrorCode::limit_exceeded, "the camera turns by {0} degrees in the exposure; at most {1} are drawn",
                {smear_rad / kDegree, kMaxSmearRad / kDegree}, "rate_deg_s");
  }

  const std::shared_ptr<const Ready> camera = ready(scene);
  const Intrinsics& intrinsics = camera->camera->intrinsics;
  shot.camera = camera->camera;
  shot.epoch = *scene.epoch;
  shot.observer_O = *state;
  shot.R_CN = *R_CN;
  shot.seed = scene.seed;
  shot.format = scene.format;
  const StreamId noise{.seed = scene.seed, .sample = scene.sample, .image = scene.image, .purpose = ""};
  shot.time_tag = *scene.epoch + Duration::seconds(render::time_tag_error_s(camera->camera->detector, noise));

  // What smears into the picture during the exposure counts too.
  const double margin_px = kMarginPx + 0.5 * smear_rad / intrinsics.plate_scale_rad_px();
  const double radius_rad =
      std::min(intrinsics.half_diagonal_rad() + 2.0 * margin_px * intrinsics.plate_scale_rad_px(), kPi);
  const auto seen = sky_.look(*scene.epoch, *state, R_CN->row(2).transpose(), radius_rad, camera->band, *settings);
  if (!seen) return forward(seen, "epoch");
  render::Exposure exposure{.duration_s = shot.exposure_s, .rate_C_rad_s = scene.rate_C_rad_s};
  exposure.sun_C_m = *R_CN * sky_.sun_N_m(*scene.epoch, *state);
  shot.sources = render::place_sources(*seen, *camera->camera, *R_CN, exposure, margin_px, scene.effects);
  if (scene.format == PixelFormat::none) return {};
  if (auto light = check_work(scene, shot); !light) return light;
  if (scene.format == PixelFormat::electrons) {
    camera->renderer.electrons(shot.sources, exposure, shot.electrons, scene.effects);
    return {};
  }
  camera->renderer.frame(shot.sources, exposure, noise, shot.dn, scene.effects);
  if (scene.format == PixelFormat::png) {
    auto png = encode_png16(shot.dn.view());
    if (!png) return forward(png);
    shot.png = std::move(*png);
  }
  return {};
}

Result<Json> Studio::surroundings(const Scene& scene, Shot& shot) const {
  Scene bare = scene;
  bare.format = PixelFormat::none;
  if (auto taken = take(bare, shot); !taken) return forward(taken);
  const auto place = [](const Vec3& direction) -> Json {
    const RaDec at = radec_from_direction(direction);
    return {std::round(at.ra_rad / kDegree * 1e4) / 1e4, std::round(at.dec_rad / kDegree * 1e4) / 1e4};
  };
  Json out;
  out["epoch_tdb"] = shot.epoch.iso(TimeScale::tdb, 3, false);
  const Pointing pointing = pointing_from_R_CN(shot.R_CN);
  out["ra_deg"] = pointing.ra_rad / kDegree;
  out["dec_deg"] = pointing.dec_rad / kDegree;
  out["roll_deg"] = pointing.roll_rad / kDegree;
  const Quaternion q_NC = to_quaternion(shot.R_CN.transpose());
  out["q_NC"] = {{"w", q_NC.w}, {"x", q_NC.x}, {"y", q_NC.y}, {"z", q_NC.z}};
  out["observer_km"] = xyz(shot.observer_O.p_m, 1e3);

  // The outline, clockwise; where the lens has no inverse a point is left out.
  const Intrinsics& k = shot.camera->intrinsics;
  Json field = Json::array();
  constexpr int kSteps = 16;
  for (int i = 0; i < 4 * kSteps; ++i) {
    const double t = static_cast<double>(i % kSteps) / kSteps;
    const int side = i / kSteps;
    const double u = side == 0 ? t : side == 1 ? 1.0 : side == 2 ? 1.0 - t : 0.0;
    const double v = side == 0 ? 0.0 : side == 1 ? t : side == 2 ? 1.0 : 1.0 - t;
    const auto direction = unproject(k, {u * k.width_px - 0.5, v * k.height_px - 0.5});
    if (direction) field.push_back(place(shot.R_CN.transpose() * *direction));
  }
  out["field"] = std::move(field);

  auto settings = sky_settings(scene);
  if (!settings) return forward(settings);
  settings->max_v_mag = kChartMag;
  const auto all =
      sky_.look(shot.epoch, shot.observer_O, shot.R_CN.row(2).transpose(), kPi, ready(scene)->band, *settings);
  if (!all) return forward(all, "epoch");
  Json stars = Json::array(), bodies = Json::array();
  for (const sky::SkySource& s : *all) {
    Json at = place(s.direction_N);
    if (s.kind == sky::SourceKind::star) {
      at.push_back(std::round(s.v_mag * 100.0) / 100.0);
      stars.push_back(std::move(at));
      continue;
    }
    const std::string_view known = body_name(BodyId{static_cast<std::int32_t>(s.id)});
    bodies.push_back({{"name", known.empty() ? std::to_string(s.id) : std::string(known)},
                      {"ra_deg", at[0]},
                      {"dec_deg", at[1]},
                      {"mag", std::round(s.v_mag * 100.0) / 100.0}});
  }
  out["stars"] = std::move(stars);
  out["bodies"] = std::move(bodies);
  if (const Vec3 sun_N_m = sky_.sun_N_m(shot.epoch, shot.observer_O); sun_N_m.norm() > 0.0) {
    const Json at = place(sun_N_m);
    out["sun"] = {{"ra_deg", at[0]}, {"dec_deg", at[1]}, {"distance_km", sun_N_m.norm() * 1e-3}};
  }
  return out;
}

}  // namespace astronav::server
