// SPDX-License-Identifier: Apache-2.0
// Requests: what the JSON of a client's message asks for. The parser of everything that comes over the wire.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <variant>
#include <vector>

#include "foundation/base/error.h"
#include "simulator/server/protocol.h"
#include "simulator/server/scene.h"

namespace astronav::server {

struct Hello {
  std::uint16_t version = 0;  // the newest that both sides speak
  std::string token;
};
struct Set {
  Scene settings;  // the session's from now on
};
struct Render {
  Scene scene;
};
// Scenes one by one, or one every `step` from `start`; `image` of the noise counts on from the scene's.
struct Trajectory {
  Scene base;
  std::vector<Scene> scenes;  // empty: start and step
  Epoch start;
  Duration step;
  std::uint64_t frames = 0;
  Scene scene(std::uint64_t index) const;
};
struct Cancel {
  std::uint64_t request = 0;
};
struct Ping {};

struct Request {
  std::uint64_t id = 0;
  std::variant<Hello, Set, Render, Trajectory, Cancel, Ping> what;
};

struct RequestError {
  std::optional<std::uint64_t> id;  // where it could be read
  Error error;
};

// `settings` are the session's.
tl::expected<Request, RequestError> parse_request(std::uint16_t type, std::string_view json, const Registry& registry,
                                                  const Limits& limits, const Scene& settings);

// {"id": ..., "code": ..., "message": ..., "index": ...}
std::string error_json(std::optional<std::uint64_t> id, const Error& error, std::optional<std::uint64_t> index = {});

}  // namespace astronav::server
