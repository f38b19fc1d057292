// SPDX-License-Identifier: Apache-2.0
#include "simulator/server/scene.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

#include "foundation/base/nearest_word.h"
#include "models/camera_file/camera_file.h"
#include "models/ephemeris/bodies.h"

namespace astronav::server {
namespace {

using Json = nlohmann::json;
using OrderedJson = nlohmann::ordered_json;

constexpr double kMaxDistanceKm = 1e12;
constexpr std::size_t kMaxObserverBytes = 256;
constexpr std::size_t kMostBodies = 32;
constexpr std::uint64_t kMaxNumber = std::uint64_t{1} << 53;  // beyond it JSON's readers differ
constexpr std::array<std::string_view, 4> kFormats{"dn", "png", "electrons", "none"};

// The switches that belong to the sky; all others to the renderer.
struct SkySwitch {
  std::string_view name;
  bool sky::SkySettings::*field;
};
constexpr std::array<SkySwitch, 3> kSkySwitches{{{"aberration", &sky::SkySettings::aberration},
                                                 {"light_time", &sky::SkySettings::light_time},
                                                 {"centre_of_light", &sky::SkySettings::centre_of_light}}};

tl::unexpected<Error> wrong(std::string_view field, std::string_view expected) {
  return fail(ErrorCode::invalid_argument, "expected {s}", {}, field, expected);
}

template <typename Names>
tl::unexpected<Error> unknown(std::string_view word, const Names& known, std::string_view what) {
  const auto nearest = nearest_word(word, known);
  return fail(ErrorCode::invalid_argument, "{s}", {}, {},
              fmt::format("unknown {} \"{}\"; did you mean \"{}\"?", what, word.substr(0, 40), *nearest));
}

Result<double> number(const Json& value, std::string_view field, double min, double max) {
  if (!value.is_number()) return wrong(field, "a number");
  const double x = value.get<double>();
  if (!(x >= min && x <= max)) {
    return fail(ErrorCode::out_of_range, "{0} is not within {1} and {2}", {x, min, max, 0}, field);
  }
  return x;
}

Result<std::uint64_t> count(const Json& value, std::string_view field) {
  if (!value.is_number_unsigned() || value.get<std::uint64_t>() > kMaxNumber) {
    return wrong(field, "a whole number from 0 to 2^53");
  }
  return value.get<std::uint64_t>();
}

Result<bool> truth_value(const Json& value, std::string_view field) {
  if (!value.is_boolean()) return wrong(field, "true or false");
  return value.get<bool>();
}

Result<std::string> text(const Json& value, std::string_view field) {
  if (!value.is_string()) return wrong(field, "a text");
  return value.get<std::string>();
}

// An object of exactly these numbers.
template <std::size_t N>
Result<std::array<double, N>> numbers(const Json& value, std::string_view field,
                                      const std::array<std::string_view, N>& names, double limit) {
  std::array<double, N> out{};
  if (!value.is_object() || value.size() != N) return wrong(field, fmt::format("{{{}}}", fmt::join(names, ", ")));
  for (std::size_t i = 0; i < N; ++i) {
    const auto found = value.find(names[i]);
    if (found == value.end()) return wrong(field, fmt::format("{{{}}}", fmt::join(names, ", ")));
    const auto read = number(*found, field, -limit, limit);
    if (!read) return forward(read);
    out[i] = *read;
  }
  return out;
}

Result<Vec3> vector(const Json& value, std::string_view field, double limit) {
  const auto n = numbers<3>(value, field, {"x", "y", "z"}, limit);
  if (!n) return forward(n);
  return Vec3((*n)[0], (*n)[1], (*n)[2]);
}

Result<void> read_epoch(const Json& value, Scene& scene) {
  const auto written = text(value, "epoch");
  if (!written) return forward(written);
  const auto epoch = Epoch::parse(*written);
  if (!epoch) return forward(epoch, "epoch");
  scene.epoch = *epoch;
  return {};
}

// {position_km, velocity_km_s}; at rest without velocity.
Result<void> read_state(const Json& value, Scene& scene) {
  State state;
  for (const auto& [key, each] : value.items()) {
    if (key == "position_km") {
      const auto p = vector(each, "observer.position_km", kMaxDistanceKm);
      if (!p) return forward(p);
      state.p_m = 1e3 * *p;
    } else if (key == "velocity_km_s") {
      const auto v = vector(each, "observer.velocity_km_s", 1e-3 * kSpeedOfLight);
      if (!v) return forward(v);
      state.v_m_s = 1e3 * *v;
    } else {
      return wrong("observer", "{position_km, velocity_km_s}");
    }
  }
  if (!value.contains("position_km")) return wrong("observer", "{position_km, velocity_km_s}");
  if (state.p_m.norm() > 1e3 * kMaxDistanceKm || state.v_m_s.norm() >= kSpeedOfLight) {
    return fail(ErrorCode::out_of_range, "farther than {0} km, or not slower than light", {kMaxDistanceKm}, "observer");
  }
  const auto km = [](double m) { return fmt::format("{:.17g}", m * 1e-3); };
  scene.observer =
      Scene::NamedObserver{fmt::format("ssb:{},{},{},{},{},{}", km(state.p_m.x()), km(state.p_m.y()), km(state.p_m.z()),
                                       km(state.v_m_s.x()), km(state.v_m_s.y()), km(state.v_m_s.z())),
                           std::make_shared<const Observer>([state](Epoch) -> Result<State> { return state; })};
  return {};
}

Result<void> read_observer(const Json& value, const Registry& registry, Scene& scene) {
  if (value.is_object()) return read_state(value, scene);
  const auto written = text(value, "observer");
  if (!written) return forward(written);
  if (written->size() > kMaxObserverBytes) return wrong("observer", "a text of at most 256 bytes");
  const auto held = registry.observers.find(*written);
  if (held != registry.observers.end()) {
    scene.observer = Scene::NamedObserver{*written, std::make_shared<const Observer>(held->second)};
    return {};
  }
  const std::size_t first = written->find_first_not_of(" \t");
  const std::string_view bare =
      first == std::string::npos ? std::string_view() : std::string_view(*written).substr(first);
  if (bare.starts_with("spk:") || bare.starts_with("oem:")) {
    return fail(ErrorCode::unsupported,
                "files are not read on a client's word: give the name of an observer that the server was started with",
                {}, "observer");
  }
  if (bare.empty() || !registry.parse_observer) return wrong("observer", "the name of an observer");
  auto observer = registry.parse_observer(bare);
  if (!observer) {
    Error error = observer.error();
    error.where = FixedText<200>("observer");
    return tl::unexpected<Error>(error);
  }
  scene.observer = Scene::NamedObserver{std::string(bare), std::make_shared<const Observer>(std::move(*observer))};
  if (registry.parse_ground_site) {
    const auto site = registry.parse_ground_site(bare);
    if (!site) return forward(site, "observer");
    scene.observer->site = *site;
  }
  return {};
}

Result<void> read_attitude(const Json& value, Scene& scene) {
  constexpr std::string_view kForms = "{q_NC: {w, x, y, z}}, {ra_deg, dec_deg, roll_deg} or {body, roll_deg}";
  if (!value.is_object()) return wrong("attitude", kForms);
  if (value.size() == 1 && value.contains("q_NC")) {
    const auto n = numbers<4>(value["q_NC"], "attitude.q_NC", {"w", "x", "y", "z"}, 2.0);
    if (!n) return forward(n);
    const double norm = std::hypot(std::hypot((*n)[0], (*n)[1]), std::hypot((*n)[2], (*n)[3]));
    if (std::abs(norm - 1.0) > 1e-3) {
      return fail(ErrorCode::invalid_argument, "a quaternion of length {0} is no rotation", {norm}, "attitude.q_NC");
    }
    const Quaternion q_NC{(*n)[0] / norm, (*n)[1] / norm, (*n)[2] / norm, (*n)[3] / norm};
    scene.attitude = Mat3(to_matrix(q_NC).transpose());
    return {};
  }
  double roll_rad = 0.0;
  if (const auto roll = value.find("roll_deg"); roll != value.end()) {
    const auto read = number(*roll, "attitude.roll_deg", -360.0, 360.0);
    if (!read) return forward(read);
    roll_rad = *read * kDegree;
  }
  const std::size_t rolls = value.contains("roll_deg") ? 1 : 0;
  if (value.size() == 1 + rolls && value.contains("body")) {
    const auto written = text(value["body"], "attitude.body");
    if (!written) return forward(written);
    const auto body = parse_body(*written);
    if (!body) return forward(body, "attitude.body");
    scene.attitude = BodyPointing{*body, roll_rad};
    return {};
  }
  if (value.size() != 2 + rolls || !value.contains("ra_deg") || !value.contains("dec_deg")) {
    return wrong("attitude", kForms);
  }
  const auto ra = number(value["ra_deg"], "attitude.ra_deg", -360.0, 360.0);
  if (!ra) return forward(ra);
  const auto dec = number(value["dec_deg"], "attitude.dec_deg", -90.0, 90.0);
  if (!dec) return forward(dec);
  scene.attitude = R_CN_from_pointing({*ra * kDegree, *dec * kDegree, roll_rad});
  return {};
}

Result<void> read_camera(const Json& value, const Registry& registry, Scene& scene) {
  const auto written = text(value, "camera");
  if (!written) return forward(written);
  const auto found = registry.cameras.find(*written);
  if (found == registry.cameras.end()) {
    if (registry.cameras.empty()) return fail(ErrorCode::not_found, "this server has no cameras", {}, "camera");
    const auto nearest = nearest_word(*written, registry.cameras, [](const auto& each) { return each.first; });
    return fail(ErrorCode::not_found, "{s}", {}, "camera",
                fmt::format("no camera \"{}\"; did you mean \"{}\"?", written->substr(0, 40), nearest->first));
  }
  scene.camera = std::make_shared<const Scene::NamedCamera>(found->first, found->second);
  return {};
}

Result<void> read_effects(const Json& value, Scene& scene) {
  if (value.is_string()) {
    if (value == "all") {
      scene.effects = {};
      return {};
    }
    if (value == "expected") {
      scene.effects = render::Effects::expected();
      return {};
    }
  }
  if (!value.is_object()) return wrong("effects", "\"all\", \"expected\" or {name: true or false, ...}");
  for (const auto& [key, each] : value.items()) {
    const auto on = truth_value(each, "effects");
    if (!on) return forward(on);
    bool* field = render::effect(scene.effects, key);
    for (const SkySwitch& s : kSkySwitches) {
      if (s.name == key) field = &(scene.sky.*s.field);
    }
    if (field == nullptr) {
      std::vector<std::string_view> known(render::effect_names().begin(), render::effect_names().end());
      for (const SkySwitch& s : kSkySwitches) known.push_back(s.name);
      return forward(Result<void>(unknown(key, known, "effect")), "effects");
    }
    *field = *on;
  }
  return {};
}

bool is_drawn_anyway(BodyId id) {
  return (id.value >= 0 && id.value <= 10) || id == body::moon || (id.value < 1000 && id.value % 100 == 99);
}

// {id, h, g, radius_km}; the last two may be left out.
Result<SmallBody> read_body(const Json& value) {
  constexpr std::string_view kForm = "[{id, h, g, radius_km}, ...], the last two as you like";
  if (!value.is_object() || !value.contains("id") || !value.contains("h")) return wrong("bodies", kForm);
  SmallBody out;
  for (const auto& [key, each] : value.items()) {
    if (key == "id") {
      if (!each.is_number_integer() || each < INT32_MIN || each > INT32_MAX) return wrong("bodies.id", "a NAIF number");
      out.id = BodyId{each.get<std::int32_t>()};
      continue;
    }
    const auto read = key == "h"           ? number(each, "bodies.h", -10.0, 50.0)
                      : key == "g"         ? number(each, "bodies.g", -1.0, 2.0)
                      : key == "radius_km" ? number(each, "bodies.radius_km", 0.0, 1e5)
                                           : Result<double>(wrong("bodies", kForm));
    if (!read) return forward(read);
    (key == "h" ? out.law.h : key == "g" ? out.law.g1 : out.mean_radius_m) = *read * (key == "radius_km" ? 1e3 : 1.0);
  }
  return out;
}

Result<void> read_bodies(const Json& value, Scene& scene) {
  if (!value.is_array()) return wrong("bodies", "a list");
  if (value.size() > kMostBodies) {
    return fail(ErrorCode::limit_exceeded, "{0} bodies; at most {1} are read",
                {static_cast<double>(value.size()), static_cast<double>(kMostBodies)}, "bodies");
  }
  std::vector<SmallBody> bodies;
  for (const Json& each : value) {
    const auto body = read_body(each);
    if (!body) return forward(body);
    if (auto added = add_small_body(*body, bodies); !added) return forward(added, "bodies");
  }
  scene.sky.bodies = std::move(bodies);
  return {};
}

Result<void> read_format(const Json& value, Scene& scene) {
  for (std::size_t i = 0; i < kFormats.size(); ++i) {
    if (value.is_string() && value == kFormats[i]) {
      scene.format = static_cast<PixelFormat>(i);
      return {};
    }
  }
  return wrong("format", "\"dn\", \"png\", \"electrons\" or \"none\"");
}

struct Field {
  std::string_view name;
  Result<void> (*read)(const Json&, const Registry&, const Limits&, Scene&);
};

template <double Scene::*member>
Result<void> seconds_from_ms(const Json& value, const Registry&, const Limits&, Scene& scene) {
  const auto ms = number(value, "exposure_ms", 1e-6, 1e7);
  if (!ms) return forward(ms);
  scene.*member = *ms * 1e-3;
  return {};
}

// A field that is one value.
Result<void> assign(const Json& value, std::string_view field, std::uint64_t& out) {
  const auto n = count(value, field);
  if (!n) return forward(n);
  out = *n;
  return {};
}

Result<void> assign(const Json& value, std::string_view field, bool& out) {
  const auto on = truth_value(value, field);
  if (!on) return forward(on);
  out = *on;
  return {};
}

constexpr std::array kFields{
    Field{"epoch", [](const Json& v, const Registry&, const Limits&, Scene& s) { return read_epoch(v, s); }},
    Field{"observer", [](const Json& v, const Registry& r, const Limits&, Scene& s) { return read_observer(v, r, s); }},
    Field{"attitude", [](const Json& v, const Registry&, const Limits&, Scene& s) { return read_attitude(v, s); }},
    Field{"rate_deg_s",
          [](const Json& v, const Registry&, const Limits&, Scene& s) -> Result<void> {
            const auto rate = vector(v, "rate_deg_s", 360.0);
            if (!rate) return forward(rate);
            s.rate_C_rad_s = kDegree * *rate;
            return {};
          }},
    Field{"camera", [](const Json& v, const Registry& r, const Limits&, Scene& s) { return read_camera(v, r, s); }},
    Field{"camera_toml",
          [](const Json& v, const Registry&, const Limits& l, Scene& s) -> Result<void> {
            const auto toml = text(v, "camera_toml");
            if (!toml) return forward(toml);
            auto camera = read_camera_text(*toml, l);
            if (!camera) return forward(camera, "camera_toml");
            s.camera =
                std::make_shared<const Scene::NamedCamera>(*toml, std::make_shared<const Camera>(std::move(*camera)));
            return {};
          }},
    Field{"exposure_ms", seconds_from_ms<&Scene::exposure_s>},
    Field{"effects", [](const Json& v, const Registry&, const Limits&, Scene& s) { return read_effects(v, s); }},
    Field{"max_v_mag",
          [](const Json& v, const Registry&, const Limits&, Scene& s) -> Result<void> {
            const auto mag = number(v, "max_v_mag", -2.0, 20.0);
            if (!mag) return forward(mag);
            s.sky.max_v_mag = *mag;
            return {};
          }},
    Field{"refraction", [](const Json& v, const Registry&, const Limits&,
                           Scene& s) { return assign(v, "refraction", s.refraction); }},
    Field{"bodies", [](const Json& v, const Registry&, const Limits&, Scene& s) { return read_bodies(v, s); }},
    Field{"seed", [](const Json& v, const Registry&, const Limits&, Scene& s) { return assign(v, "seed", s.seed); }},
    Field{"sample",
          [](const Json& v, const Registry&, const Limits&, Scene& s) { return assign(v, "sample", s.sample); }},
    Field{"image", [](const Json& v, const Registry&, const Limits&, Scene& s) { return assign(v, "image", s.image); }},
    Field{"detector_seed", [](const Json& v, const Registry&, const Limits&,
                              Scene& s) { return assign(v, "detector_seed", s.detector_seed); }},
    Field{"format", [](const Json& v, const Registry&, const Limits&, Scene& s) { return read_format(v, s); }},
    Field{"truth", [](const Json& v, const Registry&, const Limits&, Scene& s) { return assign(v, "truth", s.truth); }},
};

}  // namespace

std::string_view name(PixelFormat format) {
  return kFormats[static_cast<std::size_t>(format)];
}

Result<void> add_small_body(const SmallBody& body, std::vector<SmallBody>& bodies) {
  if (is_drawn_anyway(body.id)) {
    return fail(ErrorCode::invalid_argument, "body {0} is drawn as it is; H and G are of others",
                {static_cast<double>(body.id.value)});
  }
  if (std::ranges::any_of(bodies, [&](const SmallBody& other) { return other.id == body.id; })) {
    return fail(ErrorCode::invalid_argument, "body {0} comes twice", {static_cast<double>(body.id.value)});
  }
  bodies.push_back(body);
  return {};
}

Scene first_settings(const Registry& registry) {
  Scene scene;
  if (const auto camera = registry.cameras.find("extrema-20deg"); camera != registry.cameras.end()) {
    scene.camera = std::make_shared<const Scene::NamedCamera>(camera->first, camera->second);
  }
  if (!registry.parse_observer) return scene;
  if (auto earth = registry.parse_observer("earth")) {
    scene.observer = Scene::NamedObserver{"earth", std::make_shared<const Observer>(std::move(*earth))};
  }
  return scene;
}

Result<void> read_scene(const Json& object, std::span<const std::string_view> others, const Registry& registry,
                        const Limits& limits, Scene& scene) {
  if (object.contains("camera") && object.contains("camera_toml")) {
    return wrong("camera", "either camera or camera_toml");
  }
  for (const auto& each : object.items()) {
    const std::string& key = each.key();
    const auto field = std::find_if(kFields.begin(), kFields.end(), [&](const Field& f) { return f.name == key; });
    if (field != kFields.end()) {
      if (auto read = field->read(each.value(), registry, limits, scene); !read) return read;
    } else if (std::find(others.begin(), others.end(), key) == others.end()) {
      std::vector<std::string_view> known(others.begin(), others.end());
      for (const Field& f : kFields) known.push_back(f.name);
      return unknown(key, known, "field");
    }
  }
  return {};
}

Result<Camera> read_camera_text(std::string_view toml, const Limits& limits) {
  if (toml.size() > limits.camera_bytes) {
    return fail(ErrorCode::limit_exceeded, "a camera's text of {0} bytes; at most {1} are read",
                {static_cast<double>(toml.size()), static_cast<double>(limits.camera_bytes)}, "camera_toml");
  }
  // A point-spread function is a file beside the camera's. A key can be hidden from a search for its letters by
  // escapes alone, so these are refused with it.
  if (toml.find("kernel") != std::string_view::npos || toml.find('\\') != std::string_view::npos) {
    return fail(ErrorCode::unsupported,
                "a camera that comes over the wire has no measured point-spread function: its text may hold neither "
                "the word kernel nor a backslash",
                {}, "camera_toml");
  }
  // Debian's toml++ runs into undefined behaviour at some of them (is_non_ascii_horizontal_whitespace, U+00A1 to
  // U+0499).
  if (std::ranges::any_of(toml, [](char c) { return static_cast<unsigned char>(c) >= 0x80; })) {
    return fail(ErrorCode::unsupported, "a camera that comes over the wire is written in ASCII", {}, "camera_toml");
  }
  auto camera = parse_camera(toml, "camera_toml");
  if (!camera) return camera;
  const double pixels = static_cast<double>(camera->intrinsics.width_px) * camera->intrinsics.height_px;
  if (pixels > static_cast<double>(limits.image_pixels)) {
    return fail(ErrorCode::limit_exceeded, "an image of {0} pixels; at most {1} are rendered",
                {pixels, static_cast<double>(limits.image_pixels)}, "camera_toml");
  }
  if (camera->name.empty()) camera->name = "camera_toml";
  return camera;
}

OrderedJson describe(std::span<const SmallBody> bodies) {
  OrderedJson out = OrderedJson::array();
  for (const SmallBody& b : bodies) {
    out.push_back({{"id", b.id.value}, {"h", b.law.h}, {"g", b.law.g1}, {"radius_km", b.mean_radius_m * 1e-3}});
  }
  return out;
}

OrderedJson describe(const Scene& scene) {
  OrderedJson out;
  if (scene.epoch) out["epoch"] = scene.epoch->iso(TimeScale::tdb, 9);
  if (scene.observer) out["observer"] = scene.observer->text;
  if (const auto* R_CN = std::get_if<Mat3>(&scene.attitude)) {
    const Quaternion q = to_quaternion(R_CN->transpose());
    out["attitude"] = {{"q_NC", {{"w", q.w}, {"x", q.x}, {"y", q.y}, {"z", q.z}}}};
  } else if (const auto* law = std::get_if<BodyPointing>(&scene.attitude)) {
    const std::string_view known = body_name(law->body);
    out["attitude"] = {{"body", known.empty() ? std::to_string(law->body.value) : std::string(known)},
                       {"roll_deg", law->roll_rad / kDegree}};
  }
  const Vec3 rate = scene.rate_C_rad_s / kDegree;
  out["rate_deg_s"] = {{"x", rate.x()}, {"y", rate.y()}, {"z", rate.z()}};
  if (scene.camera) {
    const bool text = scene.camera->key.find('\n') != std::string::npos;
    out[text ? "camera_toml" : "camera"] = scene.camera->key;
    out["exposure_ms"] = 1e3 * (scene.exposure_s > 0.0 ? scene.exposure_s : scene.camera->camera->exposure_s);
  }
  OrderedJson effects;
  render::Effects switches = scene.effects;
  for (const std::string_view each : render::effect_names()) effects[std::string(each)] = *effect(switches, each);
  for (const SkySwitch& s : kSkySwitches) effects[std::string(s.name)] = scene.sky.*s.field;
  out["effects"] = std::move(effects);
  out["max_v_mag"] = scene.sky.max_v_mag;
  out["refraction"] = scene.refraction;
  if (!scene.sky.bodies.empty()) out["bodies"] = describe(scene.sky.bodies);
  out["seed"] = scene.seed;
  out["sample"] = scene.sample;
  out["image"] = scene.image;
  out["detector_seed"] = scene.detector_seed;
  out["format"] = name(scene.format);
  out["truth"] = scene.truth;
  return out;
}

}  // namespace astronav::server
