// SPDX-License-Identifier: Apache-2.0
#include "simulator/server/client.h"

#include <array>
#include <cerrno>
#include <chrono>
#include <cmath>
#include <cstring>

#include <netdb.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <nlohmann/json.hpp>
#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>

#include "models/ephemeris/bodies.h"

namespace astronav::server {
namespace {

using Json = nlohmann::ordered_json;

Json xyz(const Vec3& v) {
  return {{"x", v.x()}, {"y", v.y()}, {"z", v.z()}};
}

Json json_of(const SceneRequest& scene) {
  Json out = Json::object();
  if (scene.epoch) out["epoch"] = scene.epoch->iso(TimeScale::tdb, 9);
  if (!scene.observer.empty()) out["observer"] = scene.observer;
  if (scene.observer_state_O) {
    out["observer"] = {{"position_km", xyz(scene.observer_state_O->p_m * 1e-3)},
                       {"velocity_km_s", xyz(scene.observer_state_O->v_m_s * 1e-3)}};
  }
  if (scene.q_NC) {
    const Quaternion& q = *scene.q_NC;
    out["attitude"] = {{"q_NC", {{"w", q.w}, {"x", q.x}, {"y", q.y}, {"z", q.z}}}};
  }
  if (scene.pointing) {
    out["attitude"] = {{"ra_deg", scene.pointing->ra_rad / kDegree},
                       {"dec_deg", scene.pointing->dec_rad / kDegree},
                       {"roll_deg", scene.pointing->roll_rad / kDegree}};
  }
  if (!scene.body.empty()) out["attitude"] = {{"body", scene.body}, {"roll_deg", scene.body_roll_rad / kDegree}};
  if (scene.rate_C_rad_s) out["rate_deg_s"] = xyz(*scene.rate_C_rad_s / kDegree);
  if (!scene.camera.empty()) out["camera"] = scene.camera;
  if (!scene.camera_toml.empty()) out["camera_toml"] = scene.camera_toml;
  if (scene.exposure_s) out["exposure_ms"] = *scene.exposure_s * 1e3;
  if (scene.expected) out["effects"] = "expected";
  if (!scene.effects.empty()) {
    Json effects;
    if (scene.expected) {
      render::Effects all = render::Effects::expected();
      for (const std::string_view name : render::effect_names()) effects[std::string(name)] = *effect(all, name);
    }
    for (const auto& [name, on] : scene.effects) effects[name] = on;
    out["effects"] = std::move(effects);
  }
  if (scene.max_v_mag) out["max_v_mag"] = *scene.max_v_mag;
  if (scene.refraction) out["refraction"] = *scene.refraction;
  if (scene.bodies) out["bodies"] = describe(*scene.bodies);
  if (scene.seed) out["seed"] = *scene.seed;
  if (scene.sample) out["sample"] = *scene.sample;
  if (scene.image) out["image"] = *scene.image;
  if (scene.detector_seed) out["detector_seed"] = *scene.detector_seed;
  if (scene.format) out["format"] = name(*scene.format);
  if (scene.truth) out["truth"] = *scene.truth;
  return out;
}

tl::unexpected<Error> broken(const char* text) {
  return fail(ErrorCode::io_failure, text, {}, "server");
}

// Reads fields of an answer; what is missing or of another kind keeps its value.
template <typename T>
void read(const Json& object, const char* field, T& out) {
  const auto found = object.find(field);
  if (found == object.end()) return;
  if constexpr (std::is_same_v<T, std::string>) {
    if (found->is_string()) out = found->template get<std::string>();
  } else if constexpr (std::is_same_v<T, bool>) {
    if (found->is_boolean()) out = found->template get<bool>();
  } else {
    if (found->is_number()) out = found->template get<T>();
  }
}

void read(const Json& object, const char* field, std::vector<std::string>& out) {
  const auto found = object.find(field);
  if (found == object.end() || !found->is_array()) return;
  for (const Json& each : *found) {
    if (each.is_string()) out.push_back(each.get<std::string>());
  }
}

Error error_of(const Json& json) {
  std::string code, message;
  read(json, "code", code);
  read(json, "message", message);
  return {error_code(code), "{s}", {}, FixedText<200>("server"), FixedText<200>(message)};
}

Limits limits_of(const Json& json) {
  Limits l;
  read(json, "json_bytes", l.json_bytes);
  read(json, "binary_bytes", l.binary_bytes);
  read(json, "camera_bytes", l.camera_bytes);
  read(json, "image_pixels", l.image_pixels);
  read(json, "scene_work", l.scene_work);
  read(json, "sessions", l.sessions);
  read(json, "greetings", l.greetings);
  read(json, "queued_requests", l.queued_requests);
  read(json, "queued_bytes", l.queued_bytes);
  read(json, "trajectory_frames", l.trajectory_frames);
  read(json, "listed_scenes", l.listed_scenes);
  read(json, "hello_s", l.hello_s);
  read(json, "message_s", l.message_s);
  read(json, "idle_s", l.idle_s);
  read(json, "write_s", l.write_s);
  return l;
}

// Of an answer, so that a server that lies about lengths cannot have this side's memory.
constexpr std::uint32_t kMostJsonBytes = 256u << 20;
constexpr std::uint32_t kMostBinaryBytes = 2048u << 20;

}  // namespace

Client::Client(Client&& other) noexcept
    : socket_(std::exchange(other.socket_, -1)),
      settings_(std::move(other.settings_)),
      welcome_(std::move(other.welcome_)),
      next_id_(other.next_id_),
      cancels_(std::move(other.cancels_)) {}

Client& Client::operator=(Client&& other) noexcept {
  std::swap(socket_, other.socket_);
  std::swap(settings_, other.settings_);
  std::swap(welcome_, other.welcome_);
  std::swap(next_id_, other.next_id_);
  std::swap(cancels_, other.cancels_);
  return *this;
}

Client::~Client() {
  if (socket_ >= 0) ::close(socket_);
}

Result<Client> Client::open(const std::string& host, std::uint16_t port, const Settings& settings) {
  addrinfo hints{};
  hints.ai_family = AF_UNSPEC;
  hints.ai_socktype = SOCK_STREAM;
  addrinfo* found = nullptr;
  if (const int status = getaddrinfo(host.c_str(), std::to_string(port).c_str(), &hints, &found); status != 0) {
    return fail(ErrorCode::not_found, "no such host ({s})", {}, host, gai_strerror(status));
  }
  int socket = -1, why = 0;
  for (const addrinfo* each = found; each != nullptr && socket < 0; each = each->ai_next) {
    socket = ::socket(each->ai_family, each->ai_socktype | SOCK_CLOEXEC, each->ai_protocol);
    if (socket < 0 || ::connect(socket, each->ai_addr, each->ai_addrlen) == 0) continue;
    why = errno;
    ::close(socket);
    socket = -1;
  }
  freeaddrinfo(found);
  if (socket < 0) {
    return fail(ErrorCode::io_failure, "no connection to port {0} ({s})", {static_cast<double>(port)}, host,
                std::strerror(why));
  }
  const int on = 1;
  setsockopt(socket, IPPROTO_TCP, TCP_NODELAY, &on, sizeof on);
  return Client(socket, settings);
}

Result<Client> Client::connect(const std::string& host, std::uint16_t port, const Settings& settings) {
  auto client = open(host, port, settings);
  if (!client) return client;
  if (auto greeted = client->greet(); !greeted) return forward(greeted);
  return client;
}

Result<void> Client::greet() {
  Json hello{{"id", 0}, {"versions", {kProtocolVersion}}, {"client", settings_.name}};
  if (!settings_.token.empty()) hello["token"] = settings_.token;
  if (auto sent = send_raw(static_cast<std::uint16_t>(MessageType::hello), hello.dump()); !sent) return sent;
  const auto answer = receive_raw();
  if (!answer) return forward(answer);
  const Json json = Json::parse(answer->json, nullptr, false);
  if (!json.is_object()) return broken("the greeting is no JSON");
  if (answer->type == static_cast<std::uint16_t>(MessageType::error)) return tl::unexpected<Error>(error_of(json));
  if (answer->type != static_cast<std::uint16_t>(MessageType::welcome)) return broken("the greeting is no welcome");
  read(json, "server", welcome_.server);
  read(json, "cameras", welcome_.cameras);
  read(json, "observers", welcome_.observers);
  if (const auto limits = json.find("limits"); limits != json.end() && limits->is_object()) {
    welcome_.limits = limits_of(*limits);
  }
  return {};
}

Result<void> Client::wait(short events) {
  pollfd one{socket_, events, 0};
  const int ready = poll(&one, 1, static_cast<int>(settings_.timeout_s * 1e3));
  if (ready == 0) return broken("nothing came or went in time");
  if (ready < 0 && errno != EINTR) return broken("the connection failed");
  return {};
}

Result<void> Client::write_all(std::string_view bytes) {
  while (!bytes.empty()) {
    const ssize_t n = ::send(socket_, bytes.data(), bytes.size(), MSG_NOSIGNAL | MSG_DONTWAIT);
    if (n > 0) {
      bytes.remove_prefix(static_cast<std::size_t>(n));
    } else if (errno == EAGAIN || errno == EWOULDBLOCK || errno == EINTR) {
      if (auto waited = wait(POLLOUT); !waited) return waited;
    } else {
      return broken("the server has closed the connection");
    }
  }
  return {};
}

Result<void> Client::read_all(std::byte* out, std::size_t n) {
  while (n > 0) {
    const ssize_t got = ::recv(socket_, out, n, MSG_DONTWAIT);
    if (got > 0) {
      out += got;
      n -= static_cast<std::size_t>(got);
    } else if (got < 0 && (errno == EAGAIN || errno == EWOULDBLOCK || errno == EINTR)) {
      if (auto waited = wait(POLLIN); !waited) return waited;
    } else {
      return broken("the server has closed the connection");
    }
  }
  return {};
}

Result<void> Client::send_raw(std::uint16_t type, std::string_view json) {
  return write_all(message_head(static_cast<MessageType>(type), json));
}

Result<Header> Client::receive_head(std::string& json) {
  std::array<std::byte, kHeaderBytes> bytes;
  if (auto read = read_all(bytes.data(), bytes.size()); !read) return forward(read);
  const auto header = decode_header(bytes);
  if (!header) return header;
  if (header->json_bytes > kMostJsonBytes || header->binary_bytes > kMostBinaryBytes) {
    return broken("a message larger than any picture");
  }
  json.resize(header->json_bytes);
  if (auto read = read_all(reinterpret_cast<std::byte*>(json.data()), json.size()); !read) return forward(read);
  return header;
}

// What comes of a cancel is of no interest: its trajectory's end tells, or it had ended already.
Result<Header> Client::receive_answer(std::string& json) {
  while (true) {
    auto header = receive_head(json);
    if (!header) return header;
    const auto type = static_cast<MessageType>(header->type);
    if (type == MessageType::cancelled) {
      if (!cancels_.empty()) cancels_.erase(cancels_.begin());
      continue;
    }
    if (type != MessageType::error || cancels_.empty()) return header;
    std::uint64_t id = 0;
    if (const Json said = Json::parse(json, nullptr, false); said.is_object()) read(said, "id", id);
    if (id != cancels_.front()) return header;
    cancels_.erase(cancels_.begin());
  }
}

// Of a request that brings one message without raw bytes.
Result<void> Client::expect(MessageType type) {
  std::string text;
  const auto header = receive_answer(text);
  if (!header) return forward(header);
  if (header->type == static_cast<std::uint16_t>(type)) return {};
  const Json said = Json::parse(text, nullptr, false);
  if (header->type == static_cast<std::uint16_t>(MessageType::error) && said.is_object()) {
    return tl::unexpected<Error>(error_of(said));
  }
  return broken("another answer than was asked for: receive() what is under way first");
}

Result<Client::Raw> Client::receive_raw() {
  Raw raw;
  const auto header = receive_head(raw.json);
  if (!header) return forward(header);
  raw.type = header->type;
  raw.binary.resize(header->binary_bytes);
  if (auto read = read_all(raw.binary.data(), raw.binary.size()); !read) return forward(read);
  return raw;
}

Result<std::uint64_t> Client::send(const SceneRequest& scene) {
  Json json{{"id", next_id_}};
  json.update(json_of(scene));
  if (auto sent = send_raw(static_cast<std::uint16_t>(MessageType::render), json.dump()); !sent) return forward(sent);
  return next_id_++;
}

Result<std::uint64_t> Client::send_trajectory(const SceneRequest& scene, Epoch start, Epoch stop, double step_s) {
  Json json{{"id", next_id_}};
  json.update(json_of(scene));
  json["start"] = start.iso(TimeScale::tdb, 9);
  json["stop"] = stop.iso(TimeScale::tdb, 9);
  json["step_s"] = step_s;
  const auto sent = send_raw(static_cast<std::uint16_t>(MessageType::trajectory), json.dump());
  if (!sent) return forward(sent);
  return next_id_++;
}

Result<std::uint64_t> Client::send_trajectory(const SceneRequest& common, const std::vector<SceneRequest>& scenes) {
  Json json{{"id", next_id_}};
  json.update(json_of(common));
  Json list = Json::array();
  for (const SceneRequest& scene : scenes) list.push_back(json_of(scene));
  json["scenes"] = std::move(list);
  const auto sent = send_raw(static_cast<std::uint16_t>(MessageType::trajectory), json.dump());
  if (!sent) return forward(sent);
  return next_id_++;
}

Result<void> Client::cancel(std::uint64_t request) {
  const Json json{{"id", next_id_}, {"request", request}};
  cancels_.push_back(next_id_++);
  return send_raw(static_cast<std::uint16_t>(MessageType::cancel), json.dump());
}

Result<void> Client::set(const SceneRequest& scene) {
  Json json{{"id", next_id_++}};
  json.update(json_of(scene));
  if (auto sent = send_raw(static_cast<std::uint16_t>(MessageType::set), json.dump()); !sent) return sent;
  return expect(MessageType::settings);
}

Result<double> Client::ping() {
  const auto begin = std::chrono::steady_clock::now();
  const Json json{{"id", next_id_++}};
  if (auto sent = send_raw(static_cast<std::uint16_t>(MessageType::ping), json.dump()); !sent) return forward(sent);
  if (auto answered = expect(MessageType::pong); !answered) return forward(answered);
  return std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
}

Result<Frame> Client::render(const SceneRequest& scene) {
  if (auto sent = send(scene); !sent) return forward(sent);
  Frame frame;
  if (auto received = receive(frame); !received) return forward(received);
  return frame;
}

Result<void> Client::receive(Frame& frame) {
  const auto header = receive_answer(frame.json);
  if (!header) return forward(header);
  const auto type = static_cast<MessageType>(header->type);
  const Json json = Json::parse(frame.json, nullptr, false);
  if (!json.is_object()) return broken("an answer is no JSON");
  if (type == MessageType::error) return tl::unexpected<Error>(error_of(json));
  frame.end = type == MessageType::end;
  frame.index = 0;
  read(json, "id", frame.id);
  read(json, "index", frame.index);
  if (frame.end) {
    read(json, "frames", frame.index);
    read(json, "status", frame.status);
    return {};
  }
  if (type != MessageType::frame) return broken("another answer than was asked for");
  std::string format;
  read(json, "format", format);
  read(json, "width_px", frame.width_px);
  read(json, "height_px", frame.height_px);
  double exposure_ms = 0.0;
  read(json, "exposure_ms", exposure_ms);
  frame.exposure_s = exposure_ms * 1e-3;
  for (const auto& [field, epoch] :
       {std::pair{"epoch_tdb", &frame.epoch}, std::pair{"time_tag_tdb", &frame.time_tag}}) {
    std::string text;
    read(json, field, text);
    if (const auto said = Epoch::parse(text, TimeScale::tdb)) *epoch = *said;
  }
  if (const auto q = json.find("q_NC"); q != json.end() && q->is_object()) {
    read(*q, "w", frame.q_NC.w);
    read(*q, "x", frame.q_NC.x);
    read(*q, "y", frame.q_NC.y);
    read(*q, "z", frame.q_NC.z);
  }
  for (int i = 0; i < 4; ++i) {
    if (format == name(static_cast<PixelFormat>(i))) frame.format = static_cast<PixelFormat>(i);
  }
  const bool sane = frame.width_px >= 0 && frame.height_px >= 0 && frame.width_px <= 65536 && frame.height_px <= 65536;
  const std::size_t pixels =
      sane ? static_cast<std::size_t>(frame.width_px) * static_cast<std::size_t>(frame.height_px) : 0;
  const auto into = [&](auto& image, std::size_t pixel_bytes) -> Result<void> {
    if (!sane || header->binary_bytes != pixels * pixel_bytes) return broken("a picture of another size than was said");
    if (image.width() != frame.width_px || image.height() != frame.height_px) {
      image = std::remove_reference_t<decltype(image)>(frame.width_px, frame.height_px);
    }
    return read_all(reinterpret_cast<std::byte*>(image.pixels().data()), header->binary_bytes);
  };
  Result<void> got;
  if (frame.format == PixelFormat::dn) {
    got = into(frame.dn, 2);
  } else if (frame.format == PixelFormat::electrons) {
    got = into(frame.electrons, 4);
  } else {
    frame.png.resize(header->binary_bytes);
    got = read_all(reinterpret_cast<std::byte*>(frame.png.data()), frame.png.size());
  }
  if (!got) return got;
  frame.truth.clear();
  const auto truth = json.find("truth");
  if (truth == json.end() || !truth->is_object() || !truth->contains("sources")) return {};
  for (const Json& each : (*truth)["sources"]) {
    if (!each.is_object()) continue;
    TrueSource source;
    read(each, "id", source.id);
    read(each, "kind", source.kind);
    read(each, "name", source.name);
    read(each, "u_px", source.pixel.u);
    read(each, "v_px", source.pixel.v);
    read(each, "electrons", source.electrons);
    read(each, "mag", source.v_mag);
    frame.truth.push_back(std::move(source));
  }
  return {};
}

}  // namespace astronav::server
