// SPDX-License-Identifier: Apache-2.0
#include "simulator/server/session.h"

#include <algorithm>
#include <array>
#include <cstring>

#include <fmt/format.h>
#include <nlohmann/json.hpp>

namespace astronav::server {
namespace {

using Json = nlohmann::ordered_json;

constexpr std::size_t kReadBytes = 65536;
constexpr int kSendBytes = 1 << 18;
constexpr std::size_t kMostPlaces = 64;      // answers under way, of a session
constexpr double kSlowestBytesPerS = 100e3;  // that a client has to take
constexpr std::uint32_t kMostHelloBytes = 65536;
constexpr double kLingerS = 2.0;               // for a client to read why it was closed
constexpr std::size_t kFrameJsonBytes = 4096;  // about
constexpr std::size_t kTruthJsonBytes = 1 << 20;

std::size_t frame_bytes(const Scene& scene) {
  std::size_t bytes = kFrameJsonBytes + (scene.truth ? kTruthJsonBytes : 0);
  if (!scene.camera || scene.format == PixelFormat::none) return bytes;
  const Intrinsics& k = scene.camera->camera->intrinsics;
  const std::size_t pixels = static_cast<std::size_t>(k.width_px) * static_cast<std::size_t>(k.height_px);
  return bytes + pixels * (scene.format == PixelFormat::electrons ? 4 : 2);
}

std::string frame_json(std::uint64_t id, std::optional<std::uint64_t> index, const Shot& shot, bool with_truth) {
  const Intrinsics& k = shot.camera->intrinsics;
  const Quaternion q_NC = to_quaternion(shot.R_CN.transpose());
  Json out;
  out["id"] = id;
  if (index) out["index"] = *index;
  out["format"] = name(shot.format);
  out["width_px"] = k.width_px;
  out["height_px"] = k.height_px;
  out["epoch_tdb"] = shot.epoch.iso(TimeScale::tdb, 9, false);
  out["time_tag_tdb"] = shot.time_tag.iso(TimeScale::tdb, 9, false);
  out["exposure_ms"] = 1e3 * shot.exposure_s;
  out["q_NC"] = {{"w", q_NC.w}, {"x", q_NC.x}, {"y", q_NC.y}, {"z", q_NC.z}};
  if (with_truth) out["truth"] = truth(shot);
  return out.dump(-1, ' ', false, Json::error_handler_t::replace);
}

std::string welcome_json(std::uint64_t id, const Engine& engine) {
  const Limits& l = engine.limits;
  Json out;
  out["id"] = id;
  out["version"] = kProtocolVersion;
  out["server"] = "astronav " ASTRONAV_VERSION;
  out["limits"] = {{"json_bytes", l.json_bytes},
                   {"binary_bytes", l.binary_bytes},
                   {"camera_bytes", l.camera_bytes},
                   {"image_pixels", l.image_pixels},
                   {"scene_work", l.scene_work},
                   {"sessions", l.sessions},
                   {"greetings", l.greetings},
                   {"queued_requests", l.queued_requests},
                   {"queued_bytes", l.queued_bytes},
                   {"trajectory_frames", l.trajectory_frames},
                   {"listed_scenes", l.listed_scenes},
                   {"hello_s", l.hello_s},
                   {"message_s", l.message_s},
                   {"idle_s", l.idle_s},
                   {"write_s", l.write_s}};
  Json cameras = Json::array(), observers = Json::array();
  for (const auto& [each, camera] : engine.registry.cameras) cameras.push_back(each);
  for (const auto& [each, observer] : engine.registry.observers) observers.push_back(each);
  out["cameras"] = std::move(cameras);
  out["observers"] = std::move(observers);
  return out.dump(-1, ' ', false, Json::error_handler_t::replace);
}

}  // namespace

Session::Session(Engine& engine, asio::ip::tcp::socket socket, std::string token)
    : engine_(engine),
      socket_(std::move(socket)),
      token_(std::move(token)),
      settings_(first_settings(engine.registry)),
      in_(kReadBytes),
      started_(Clock::now()),
      last_heard_(started_) {
  asio::error_code ignored;
  socket_.set_option(asio::ip::tcp::no_delay(true), ignored);
  socket_.set_option(asio::socket_base::keep_alive(true), ignored);
  socket_.non_blocking(true, ignored);
  // A picture goes out in pieces that stay in the processor's cache until the client has them.
  socket_.set_option(asio::socket_base::send_buffer_size(kSendBytes), ignored);
}

void Session::start() {
  read();
}

void Session::drain() {
  asio::error_code ignored;
  // What has arrived can still be read; then it looks as if the client had ended.
  socket_.shutdown(asio::socket_base::shutdown_receive, ignored);
  finish_if_done();
}

void Session::close() {
  if (closed_) return;
  closed_ = true;
  if (greeted_) --engine_.sessions;
  asio::error_code ignored;
  socket_.close(ignored);
  asked_.clear();
  places_.clear();
}

void Session::tick(Clock::time_point now) {
  if (closed_) return;
  const Limits& l = engine_.limits;
  if (writing_ && now > write_due_) return close();
  if (lingering_) {
    if (now > linger_due_) close();
    return;
  }
  if (input_ended_) return;
  const auto late = [&](const char* what, double s) {
    give_up({}, Error{ErrorCode::limit_exceeded, what, {s}, {}, {}});
  };
  if (!greeted_ && now > started_ + in_seconds(l.hello_s)) return late("no hello within {0} s", l.hello_s);
  if (reading_ && filled_ > 0 && now > message_began_ + in_seconds(l.message_s)) {
    return late("a message was not complete within {0} s", l.message_s);
  }
  const bool nothing_to_do = asked_.empty() && places_.empty() && out_.empty();
  if (nothing_to_do && now > last_heard_ + in_seconds(l.idle_s)) return late("nothing was asked for {0} s", l.idle_s);
}

// --- what comes in

void Session::read() {
  if (reading_ || closed_ || input_ended_) return;
  if (asked_.size() >= engine_.limits.queued_requests) {
    paused_ = true;
    return;
  }
  if (paused_) {
    paused_ = false;
    message_began_ = Clock::now();
    return take_messages();  // what came with those before it
  }
  if (in_.size() < wanted_) in_.resize(wanted_);
  reading_ = true;
  socket_.async_read_some(asio::buffer(in_.data() + filled_, in_.size() - filled_),
                          [self = shared_from_this()](asio::error_code error, std::size_t n) {
                            self->reading_ = false;
                            self->heard(error, n);
                          });
}

void Session::heard(asio::error_code error, std::size_t n) {
  if (closed_) return;
  if (error && (lingering_ || error != asio::error::eof)) return close();
  if (lingering_) return linger();
  if (error) {
    input_ended_ = true;
    return finish_if_done();
  }
  if (input_ended_) return;
  if (filled_ == 0) message_began_ = Clock::now();
  filled_ += n;
  take_messages();
}

// All messages that are complete, as far as there is room for requests.
void Session::take_messages() {
  std::size_t at = 0;
  wanted_ = kHeaderBytes;
  while (!closed_ && !input_ended_ && asked_.size() < engine_.limits.queued_requests) {
    if (filled_ - at < kHeaderBytes) break;
    const auto header = decode_header(std::span<const std::byte, kHeaderBytes>(in_.data() + at, kHeaderBytes));
    if (!header) return give_up({}, header.error());
    const Limits& l = engine_.limits;
    const std::uint32_t json_bytes = greeted_ ? l.json_bytes : std::min(l.json_bytes, kMostHelloBytes);
    if (header->json_bytes > json_bytes || header->binary_bytes > l.binary_bytes) {
      return give_up({}, Error{ErrorCode::limit_exceeded,
                               "a message of {0} + {1} bytes; at most {2} of JSON and {3} of raw bytes are read",
                               {static_cast<double>(header->json_bytes), static_cast<double>(header->binary_bytes),
                                static_cast<double>(json_bytes), static_cast<double>(l.binary_bytes)},
                               {},
                               {}});
    }
    const std::size_t size = kHeaderBytes + std::size_t{header->json_bytes} + std::size_t{header->binary_bytes};
    if (filled_ - at < size) {
      wanted_ = size;
      break;
    }
    handle(*header, {reinterpret_cast<const char*>(in_.data()) + at + kHeaderBytes, header->json_bytes});
    at += size;
  }
  if (at > 0) {
    std::memmove(in_.data(), in_.data() + at, filled_ - at);
    filled_ -= at;
    message_began_ = last_heard_ = Clock::now();
  }
  if (filled_ == 0 && in_.size() > kReadBytes) in_ = std::vector<std::byte>(kReadBytes);
  read();
  engine_.ready(shared_from_this());
}

void Session::handle(const Header& header, std::string_view json) {
  const bool hello = header.type == static_cast<std::uint16_t>(MessageType::hello);
  if (hello == greeted_) {
    return give_up({}, Error{ErrorCode::invalid_argument,
                             greeted_ ? "there is one hello in a session" : "a session begins with a hello",
                             {},
                             {},
                             {}});
  }
  if (greeted_ && header.version != kProtocolVersion) {
    return give_up({}, Error{ErrorCode::unsupported,
                             "a message of version {0} after version {1} was agreed on",
                             {static_cast<double>(header.version), kProtocolVersion},
                             {},
                             {}});
  }
  auto request = parse_request(header.type, json, engine_.registry, engine_.limits, settings_);
  if (!request) {
    const RequestError& bad = request.error();
    return greeted_ ? answer_error(bad.id, bad.error) : give_up(bad.id, bad.error);
  }
  const std::uint64_t id = request->id;
  if (!greeted_) {
    greet(*request);
  } else if (auto* set = std::get_if<Set>(&request->what)) {
    settings_ = std::move(set->settings);
    Json json_out{{"id", id}};
    json_out.update(describe(settings_));
    answer(id, MessageType::settings, json_out.dump(-1, ' ', false, Json::error_handler_t::replace));
  } else if (auto* render = std::get_if<Render>(&request->what)) {
    ask(id, std::move(render->scene));
  } else if (auto* trajectory = std::get_if<Trajectory>(&request->what)) {
    auto stream = std::make_shared<Stream>();
    stream->id = id;
    stream->trajectory = std::move(*trajectory);
    ask(id, std::move(stream));
  } else if (const auto* cancel = std::get_if<Cancel>(&request->what)) {
    bool found = false;
    const auto stop = [&](const StreamPtr& stream) {
      if (stream && stream->id == cancel->request) stream->cancelled = found = true;
    };
    for (const Asked& each : asked_) {
      if (const auto* stream = std::get_if<StreamPtr>(&each.what)) stop(*stream);
    }
    for (const auto& place : places_) stop(place->stream);
    if (found) {
      answer(id, MessageType::cancelled, Json{{"id", id}, {"request", cancel->request}}.dump());
    } else {
      answer_error(
          id,
          Error{
              ErrorCode::not_found, "no trajectory {0} is under way", {static_cast<double>(cancel->request)}, {}, {}});
    }
    flush();
  } else {
    answer(id, MessageType::pong, Json{{"id", id}}.dump());
  }
}

void Session::greet(const Request& request) {
  const Hello& hello = std::get<Hello>(request.what);
  if (!token_.empty() && !same_token(hello.token, token_)) {
    return give_up(
        request.id,
        Error{ErrorCode::invalid_argument, "the token is missing or wrong", {}, FixedText<200>("token"), {}});
  }
  if (engine_.sessions >= engine_.limits.sessions) {
    return give_up(request.id, Error{ErrorCode::limit_exceeded,
                                     "this server has its {0} clients already",
                                     {static_cast<double>(engine_.limits.sessions)},
                                     {},
                                     {}});
  }
  greeted_ = true;
  ++engine_.sessions;
  answer(request.id, MessageType::welcome, welcome_json(request.id, engine_));
}

void Session::ask(std::uint64_t id, std::variant<Message, Scene, StreamPtr> what) {
  asked_.push_back({id, std::move(what)});
}

void Session::answer(std::uint64_t id, MessageType type, std::string_view json) {
  ask(id, Message{message_head(type, json), nullptr, 0});
}

void Session::answer_error(std::optional<std::uint64_t> id, const Error& error) {
  ask(id.value_or(0), Message{message_head(MessageType::error, error_json(id, error)), nullptr, 0});
}

// The last answer: nothing more is read.
void Session::give_up(std::optional<std::uint64_t> id, const Error& error) {
  answer_error(id, error);
  input_ended_ = true;
  engine_.ready(shared_from_this());
}

// --- what is done

bool Session::room_for(const Scene& scene) const {
  return reserved_ == 0 || reserved_ + frame_bytes(scene) <= engine_.limits.queued_bytes;
}

std::optional<Job> Session::next_job() {
  std::optional<Job> job;
  while (!closed_ && !asked_.empty() && places_.size() + out_.size() < kMostPlaces && !job) {
    Asked& first = asked_.front();
    if (auto* message = std::get_if<Message>(&first.what)) {
      auto place = std::make_shared<Place>();
      place->ready = true;
      place->message = std::move(*message);
      places_.push_back(std::move(place));
      asked_.pop_front();
    } else if (auto* scene = std::get_if<Scene>(&first.what)) {
      if (!room_for(*scene)) break;
      job = picture(first.id, *scene, nullptr);
      asked_.pop_front();
    } else {
      const StreamPtr stream = std::get<StreamPtr>(first.what);
      if (stream->cancelled || stream->failed || stream->issued == stream->trajectory.frames) {
        auto place = std::make_shared<Place>();
        place->ready = place->end = true;
        place->stream = stream;
        places_.push_back(std::move(place));
        asked_.pop_front();
        continue;
      }
      const Scene scene_now = stream->trajectory.scene(stream->issued);
      if (!room_for(scene_now)) break;
      job = picture(stream->id, scene_now, stream);
    }
  }
  flush();
  read();
  return job;
}

std::optional<Job> Session::picture(std::uint64_t id, const Scene& scene, const StreamPtr& stream) {
  auto place = std::make_shared<Place>();
  place->stream = stream;
  place->message.reserved = frame_bytes(scene);
  reserved_ += place->message.reserved;
  places_.push_back(place);
  std::optional<std::uint64_t> index;
  if (stream) index = stream->issued++;
  // The place belongs to the worker until it is done.
  const auto kept = std::make_shared<const Scene>(scene);
  auto work = [&engine = engine_, place, kept, id, index] {
    std::shared_ptr<Shot> shot = engine.new_shot();
    if (const auto taken = engine.studio.take(*kept, *shot); !taken) {
      place->failed = true;
      place->message.head = message_head(MessageType::error, error_json(id, taken.error(), index));
      return;
    }
    const auto bytes = static_cast<std::uint32_t>(shot->pixels().size());
    place->message.head = message_head(MessageType::frame, frame_json(id, index, *shot, kept->truth), bytes);
    place->message.shot = std::move(shot);
  };
  auto done = [self = shared_from_this(), place, kept] {
    place->ready = true;
    if (!place->failed) {
      self->engine_.latest = kept;
      ++self->engine_.frames;
    }
    self->flush();
    self->engine_.ready(self);
    self->finish_if_done();
  };
  return Job{std::move(work), std::move(done)};
}

// --- what goes out

void Session::flush() {
  while (!closed_ && !places_.empty() && places_.front()->ready) {
    const std::shared_ptr<Place> place = std::move(places_.front());
    places_.pop_front();
    const StreamPtr& stream = place->stream;
    if (place->end) {
      const Json json{{"id", stream->id},
                      {"frames", stream->sent},
                      {"status", stream->failed      ? "failed"
                                 : stream->cancelled ? "cancelled"
                                                     : "done"}};
      place->message.head = message_head(MessageType::end, json.dump());
    } else if (stream) {
      if (stream->failed || stream->cancelled) {
        reserved_ -= place->message.reserved;
        continue;
      }
      stream->failed = place->failed;
      if (!place->failed) ++stream->sent;
    }
    out_.push_back(std::move(place->message));
  }
  write();
}

void Session::write() {
  if (writing_ || closed_ || out_.empty()) return;
  writing_ = true;
  const Message& message = out_.front();
  write_due_ =
      Clock::now() + in_seconds(engine_.limits.write_s + static_cast<double>(message.bytes()) / kSlowestBytesPerS);
  const auto pixels = message.shot ? message.shot->pixels() : std::span<const std::byte>();
  const std::array<asio::const_buffer, 2> parts{asio::buffer(message.head), asio::buffer(pixels.data(), pixels.size())};
  // As much at once as the system takes; asio's own choice is 64 KiB.
  const auto all = [](asio::error_code error, std::size_t) { return error ? 0 : std::size_t{1} << 30; };
  asio::async_write(socket_, parts, all, [self = shared_from_this()](asio::error_code error, std::size_t) {
    self->writing_ = false;
    self->reserved_ -= self->out_.front().reserved;
    self->out_.pop_front();
    self->last_heard_ = Clock::now();
    if (self->closed_) return;
    if (error) return self->close();
    self->write();
    self->engine_.ready(self);
    self->finish_if_done();
  });
}

void Session::finish_if_done() {
  if (closed_ || lingering_ || !input_ended_ || !asked_.empty() || !places_.empty() || !out_.empty()) return;
  asio::error_code ignored;
  socket_.shutdown(asio::socket_base::shutdown_send, ignored);
  lingering_ = true;
  linger_due_ = Clock::now() + in_seconds(kLingerS);
  linger();
}

// Closing with bytes unread would take back what was sent last; so they are read, and forgotten.
void Session::linger() {
  if (reading_) return;
  reading_ = true;
  socket_.async_read_some(asio::buffer(in_), [self = shared_from_this()](asio::error_code error, std::size_t n) {
    self->reading_ = false;
    self->heard(error, n);
  });
}

}  // namespace astronav::server
