// SPDX-License-Identifier: Apache-2.0
#include "simulator/server/requests.h"

#include <algorithm>
#include <cmath>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

namespace astronav::server {
namespace {

using Json = nlohmann::json;

constexpr std::uint64_t kMaxNumber = std::uint64_t{1} << 53;
constexpr double kMaxSpanS = 200.0 * 365.25 * 86400.0;  // differences of epochs end at 292 years

Result<Hello> parse_hello(const Json& object) {
  Hello hello;
  for (const auto& [key, value] : object.items()) {
    if (key == "id" || key == "client") continue;
    if (key == "versions") {
      if (!value.is_array() || value.empty() || value.size() > 64) {
        return fail(ErrorCode::invalid_argument, "expected a list of version numbers", {}, "versions");
      }
      for (const Json& each : value) {
        if (!each.is_number_unsigned()) {
          return fail(ErrorCode::invalid_argument, "expected a list of version numbers", {}, "versions");
        }
        if (each == kProtocolVersion) hello.version = kProtocolVersion;
      }
    } else if (key == "token") {
      if (!value.is_string() || value.get_ref<const std::string&>().size() > kMaxToken) {
        return fail(ErrorCode::invalid_argument, "expected a text of at most {0} bytes", {kMaxToken}, "token");
      }
      hello.token = value.get<std::string>();
    } else {
      return fail(ErrorCode::invalid_argument, "a hello has the fields id, versions, client and token", {}, "hello");
    }
  }
  if (!object.contains("versions")) {
    return fail(ErrorCode::invalid_argument, "a hello lists the versions that the client speaks", {}, "versions");
  }
  if (hello.version == 0) {
    return fail(ErrorCode::unsupported, "no common version: this server speaks version {0}", {kProtocolVersion},
                "versions");
  }
  return hello;
}

Result<Trajectory> parse_trajectory(const Json& object, const Registry& registry, const Limits& limits,
                                    const Scene& settings) {
  constexpr std::string_view kOthers[] = {"id", "scenes", "start", "stop", "step_s"};
  Trajectory out;
  out.base = settings;
  if (auto read = read_scene(object, kOthers, registry, limits, out.base); !read) return forward(read);
  const auto too_many = [&](double frames) {
    return fail(ErrorCode::limit_exceeded, "{0} frames; at most {1} come of one request",
                {frames, static_cast<double>(limits.trajectory_frames)}, "trajectory");
  };
  if (object.contains("scenes")) {
    if (object.contains("start") || object.contains("stop") || object.contains("step_s")) {
      return fail(ErrorCode::invalid_argument, "expected either scenes or start, stop and step_s", {}, "scenes");
    }
    const Json& scenes = object["scenes"];
    if (!scenes.is_array() || scenes.empty()) {
      return fail(ErrorCode::invalid_argument, "expected a list of scenes", {}, "scenes");
    }
    if (scenes.size() > limits.listed_scenes) {
      return fail(ErrorCode::limit_exceeded, "{0} scenes in one list; at most {1} are read",
                  {static_cast<double>(scenes.size()), static_cast<double>(limits.listed_scenes)}, "scenes");
    }
    for (std::size_t i = 0; i < scenes.size(); ++i) {
      if (!scenes[i].is_object()) {
        return fail(ErrorCode::invalid_argument, "expected a list of scenes", {}, "scenes");
      }
      Scene scene = out.base;
      scene.image += i;
      if (auto read = read_scene(scenes[i], {}, registry, limits, scene); !read) {
        return forward(read, fmt::format("scenes[{}]", i));
      }
      out.scenes.push_back(std::move(scene));
    }
    out.frames = out.scenes.size();
    return out;
  }
  for (const char* field : {"start", "stop", "step_s"}) {
    if (!object.contains(field)) {
      return fail(ErrorCode::invalid_argument, "a trajectory has either scenes or start, stop and step_s", {}, field);
    }
  }
  Epoch stop;
  for (const auto& [field, epoch] : {std::pair{"start", &out.start}, std::pair{"stop", &stop}}) {
    if (!object[field].is_string()) return fail(ErrorCode::invalid_argument, "expected an epoch", {}, field);
    const auto read = Epoch::parse(object[field].get_ref<const std::string&>());
    if (!read) return forward(read, field);
    *epoch = *read;
  }
  const Json& step = object["step_s"];
  if (!step.is_number() || !(step.get<double>() >= 1e-6) || !(step.get<double>() <= 1e9)) {
    return fail(ErrorCode::invalid_argument, "expected seconds, from 1e-6 to 1e9", {}, "step_s");
  }
  out.step = Duration::seconds(step.get<double>());
  const double span_s = stop.tdb_seconds() - out.start.tdb_seconds();
  if (span_s < 0.0) return fail(ErrorCode::invalid_argument, "the trajectory ends before it begins", {}, "stop");
  if (span_s > kMaxSpanS) {
    return fail(ErrorCode::out_of_range, "a trajectory of {0} s; at most {1} are rendered", {span_s, kMaxSpanS},
                "stop");
  }
  const double frames = std::floor(span_s / out.step.seconds() + 1e-9) + 1.0;
  if (frames > static_cast<double>(limits.trajectory_frames)) return too_many(frames);
  out.frames = static_cast<std::uint64_t>(frames);
  return out;
}

Result<Cancel> parse_cancel(const Json& object) {
  const auto request = object.find("request");
  if (object.size() != 2 || request == object.end() || !request->is_number_unsigned()) {
    return fail(ErrorCode::invalid_argument, "expected the id of a trajectory", {}, "request");
  }
  return Cancel{request->get<std::uint64_t>()};
}

}  // namespace

Scene Trajectory::scene(std::uint64_t index) const {
  if (!scenes.empty()) return scenes[index];
  Scene out = base;
  out.epoch = start + step * static_cast<std::int64_t>(index);
  out.image += index;
  return out;
}

tl::expected<Request, RequestError> parse_request(std::uint16_t type, std::string_view json, const Registry& registry,
                                                  const Limits& limits, const Scene& settings) {
  Request request;
  std::optional<std::uint64_t> id;
  const auto refuse = [&](const Error& error) { return tl::unexpected<RequestError>({id, error}); };
  const auto bad = [&](ErrorCode code, const char* text) {
    return refuse(Error{code, text, {static_cast<double>(type)}, {}, {}});
  };
  if (deeper_than(json, kMaxDepth)) return bad(ErrorCode::limit_exceeded, "the JSON is nested too deeply");
  const Json object = Json::parse(json, nullptr, false);
  if (object.is_discarded() || !object.is_object()) {
    return bad(ErrorCode::corrupt_data, "a message's JSON is one object in UTF-8");
  }
  const auto given = object.find("id");
  if (given == object.end() || !given->is_number_unsigned() || given->get<std::uint64_t>() > kMaxNumber) {
    return bad(ErrorCode::invalid_argument, "a request has an id, a whole number from 0 to 2^53");
  }
  id = request.id = given->get<std::uint64_t>();

  // Moves the answer of a parser into the request.
  const auto take = [&](auto&& parsed) -> tl::expected<Request, RequestError> {
    if (!parsed) return refuse(parsed.error());
    request.what = std::move(*parsed);
    return std::move(request);
  };
  const auto scene = [&]() -> Result<Scene> {
    constexpr std::string_view kOthers[] = {"id"};
    Scene out = settings;
    if (auto read = read_scene(object, kOthers, registry, limits, out); !read) return forward(read);
    return out;
  };
  switch (static_cast<MessageType>(type)) {
    case MessageType::hello:
      return take(parse_hello(object));
    case MessageType::set:
      return take(scene().map([](Scene&& s) { return Set{std::move(s)}; }));
    case MessageType::render:
      return take(scene().map([](Scene&& s) { return Render{std::move(s)}; }));
    case MessageType::trajectory:
      return take(parse_trajectory(object, registry, limits, settings));
    case MessageType::cancel:
      return take(parse_cancel(object));
    case MessageType::ping:
      request.what = Ping{};
      return request;
    case MessageType::stimulation:
      return bad(ErrorCode::unsupported,
                 "stimulation frames (pictures for a screen before a real camera) are reserved for a later version");
    default:
      return bad(ErrorCode::unsupported, "a message of type {0} is no request");
  }
}

std::string error_json(std::optional<std::uint64_t> id, const Error& error, std::optional<std::uint64_t> index) {
  nlohmann::ordered_json out;
  out["id"] = id ? nlohmann::ordered_json(*id) : nlohmann::ordered_json(nullptr);
  if (index) out["index"] = *index;
  out["code"] = name(error.code);
  out["message"] = describe(error);
  // A sentence may quote what the client sent, cut anywhere.
  return out.dump(-1, ' ', false, nlohmann::json::error_handler_t::replace);
}

}  // namespace astronav::server
