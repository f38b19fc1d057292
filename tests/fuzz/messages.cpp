// SPDX-License-Identifier: Apache-2.0
#include "fuzz/messages.h"

#include <memory>
#include <string>
#include <string_view>

#include <nlohmann/json.hpp>

#include "foundation/base/check.h"
#include "models/ephemeris/bodies.h"
#include "simulator/server/http.h"
#include "simulator/server/protocol.h"
#include "simulator/server/requests.h"
#include "simulator/server/scene.h"

namespace astronav::fuzz {
namespace {

using namespace astronav::server;

const Registry& registry() {
  static const Registry made = [] {
    Registry r;
    auto camera = std::make_shared<Camera>();
    camera->name = "extrema-20deg";
    camera->intrinsics = Intrinsics::from_field_of_view(1024, 1024, 0.35);
    r.cameras["extrema-20deg"] = r.cameras["navcam"] = camera;
    r.observers["craft"] = [](Epoch) -> Result<State> { return State{}; };
    r.parse_observer = [](std::string_view text) -> Result<Observer> {
      // A name of a file must never come so far.
      ASTRONAV_CHECK(!text.starts_with("spk:") && !text.starts_with("oem:"));
      const auto body = parse_body(text);
      if (!body) return tl::unexpected<Error>(body.error());
      return Observer([](Epoch) -> Result<State> { return State{}; });
    };
    return r;
  }();
  return made;
}

void read_one(std::uint16_t type, std::string_view json, Scene& settings) {
  const Limits limits;
  const auto request = parse_request(type, json, registry(), limits, settings);
  if (!request) {
    ASTRONAV_CHECK(!error_json(request.error().id, request.error().error).empty());
    return;
  }
  if (const auto* set = std::get_if<Set>(&request->what)) {
    settings = set->settings;
    (void)describe(settings);
  } else if (const auto* trajectory = std::get_if<Trajectory>(&request->what)) {
    ASTRONAV_CHECK(trajectory->frames >= 1 && trajectory->frames <= limits.trajectory_frames);
    (void)trajectory->scene(0);
    (void)trajectory->scene(trajectory->frames - 1);
  }
  if (settings.camera) {
    const Camera& camera = *settings.camera->camera;
    ASTRONAV_CHECK(camera.psf.kernel.empty());
    ASTRONAV_CHECK(static_cast<std::uint64_t>(camera.intrinsics.width_px) *
                       static_cast<std::uint64_t>(camera.intrinsics.height_px) <=
                   limits.image_pixels);
  }
}

}  // namespace

void read_messages(std::span<const std::uint8_t> bytes) {
  if (bytes.empty()) return;
  Scene settings;
  const bool stream = bytes[0] % 2 == 0, http = bytes[0] % 4 == 3;
  bytes = bytes.subspan(1);
  const auto text = [](std::span<const std::uint8_t> part) {
    return std::string_view(reinterpret_cast<const char*>(part.data()), part.size());
  };
  if (http) {
    const auto request = parse_http(text(bytes));
    if (!request) return;
    const auto scene = request->query.find("scene");
    if (scene != request->query.end()) read_one(static_cast<std::uint16_t>(MessageType::set), scene->second, settings);
    return;
  }
  if (!stream) {
    if (!bytes.empty()) read_one(bytes[0], text(bytes.subspan(1)), settings);
    return;
  }
  const Limits limits;
  while (bytes.size() >= kHeaderBytes) {
    const auto header = decode_header(
        std::span<const std::byte, kHeaderBytes>(reinterpret_cast<const std::byte*>(bytes.data()), kHeaderBytes));
    if (!header || header->json_bytes > limits.json_bytes || header->binary_bytes > limits.binary_bytes) return;
    bytes = bytes.subspan(kHeaderBytes);
    if (header->json_bytes + std::size_t{header->binary_bytes} > bytes.size()) return;
    read_one(header->type, text(bytes.first(header->json_bytes)), settings);
    bytes = bytes.subspan(header->json_bytes + std::size_t{header->binary_bytes});
  }
}

}  // namespace astronav::fuzz
