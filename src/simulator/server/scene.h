// SPDX-License-Identifier: Apache-2.0
// Scene: one picture as a client asks for it, read from JSON (docs/protocol.md, "Scenes").
//
// A scene is filled field by field: first from the session's settings, then from the request. Observers and cameras are
// what the Registry knows: nothing that comes over the wire opens a file.
#pragma once

#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <variant>
#include <vector>

#include <nlohmann/json_fwd.hpp>

#include "foundation/base/error.h"
#include "foundation/math/rotation.h"
#include "foundation/time/epoch.h"
#include "models/camera/camera.h"
#include "models/ephemeris/ephemeris.h"
#include "models/ephemeris/ground.h"
#include "simulator/render/renderer.h"
#include "simulator/server/protocol.h"
#include "simulator/sky/sky.h"

namespace astronav::server {

// Barycentric state at an epoch (N, metres).
using Observer = std::function<Result<State>(Epoch)>;

// What a client may name.
struct Registry {
  std::map<std::string, std::shared_ptr<const Camera>, std::less<>> cameras;
  std::map<std::string, Observer, std::less<>> observers;  // trajectories the server was started with
  // Observers that need no file: `ssb:...`, `ground:...`, a body. Texts that name files never come here.
  std::function<Result<Observer>(std::string_view)> parse_observer;
  // The place on the ground where such a text names one.
  std::function<Result<std::optional<GroundSite>>(std::string_view)> parse_ground_site;
};

enum class PixelFormat : unsigned char { dn, png, electrons, none };
std::string_view name(PixelFormat format);

// The boresight on a body's apparent place.
struct BodyPointing {
  BodyId body;
  double roll_rad = 0.0;
};

struct Scene {
  struct NamedCamera {
    NamedCamera(std::string k, std::shared_ptr<const Camera> c) : key(std::move(k)), camera(std::move(c)) {}
    std::string key;  // the preset's name, or the text itself: equal keys are equal cameras
    std::shared_ptr<const Camera> camera;
  };
  struct NamedObserver {
    std::string text;
    std::shared_ptr<const Observer> observer;
    std::optional<GroundSite> site{};  // where it stands on the ground
  };
  std::optional<Epoch> epoch;  // middle of the exposure
  std::optional<NamedObserver> observer;
  std::variant<std::monostate, Mat3, BodyPointing> attitude;  // Mat3: R_CN
  Vec3 rate_C_rad_s = Vec3::Zero();
  std::shared_ptr<const NamedCamera> camera;
  double exposure_s = 0.0;  // 0: the camera's own
  render::Effects effects;
  sky::SkySettings sky{.max_v_mag = 12.0};  // its refraction is the studio's to fill in
  bool refraction = false;                  // of the air above the observer's site
  std::uint64_t seed = 1;
  std::uint64_t sample = 0;
  std::uint64_t image = 0;
  std::uint64_t detector_seed = 1;
  PixelFormat format = PixelFormat::dn;
  bool truth = false;
};

// What a session begins with, as far as the registry has it: the camera extrema-20deg, the Earth as observer.
Scene first_settings(const Registry& registry);
// Reads scene fields from a JSON object; fields listed in `others` belong to the request and are passed over, all else
// is refused with its nearest known name. On an error the scene is left half read. Errors carry the field in `where`.
Result<void> read_scene(const nlohmann::json& object, std::span<const std::string_view> others,
                        const Registry& registry, const Limits& limits, Scene& scene);
// Adds a body; invalid_argument for the Sun, the planets and the Moon, which are drawn anyway, and for one that is
// there.
Result<void> add_small_body(const SmallBody& body, std::vector<SmallBody>& bodies);
// A camera's text; its point-spread function cannot come from a file.
Result<Camera> read_camera_text(std::string_view toml, const Limits& limits);
// As the field `bodies`.
nlohmann::ordered_json describe(std::span<const SmallBody> bodies);
// The scene as the fields that make it.
nlohmann::ordered_json describe(const Scene& scene);

}  // namespace astronav::server
