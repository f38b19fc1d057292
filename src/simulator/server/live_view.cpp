// SPDX-License-Identifier: Apache-2.0
#include "simulator/server/live_view.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <utility>

#include <nlohmann/json.hpp>

#include "foundation/raster/raster.h"
#include "simulator/server/assets.h"
#include "simulator/server/requests.h"

namespace astronav::server {
namespace {

using Json = nlohmann::ordered_json;

constexpr double kHeadS = 10.0;  // for a request's head, once begun
constexpr double kIdleS = 60.0;  // between requests
constexpr double kSlowestBytesPerS = 100e3;
constexpr std::string_view kPolicy =
    "Content-Security-Policy: default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; "
    "img-src blob: data:; connect-src 'self'; base-uri 'none'; form-action 'none'\r\n";

std::string dump(const Json& json) {
  return json.dump(-1, ' ', false, Json::error_handler_t::replace);
}

// Eight bits for the eye: the sky's noise just seen, bright stars not all white.
Result<std::string> stretched_png(const ImageU16& image) {
  const auto pixels = image.pixels();
  std::vector<std::uint32_t> histogram(65536);
  for (const std::uint16_t dn : pixels) ++histogram[dn];
  const auto level = [&](double share) {
    double rest = share * static_cast<double>(pixels.size());
    std::size_t dn = 0;
    while (dn < 65535 && (rest -= histogram[dn]) > 0.0) ++dn;
    return static_cast<double>(dn);
  };
  const double sky = level(0.5), sigma = std::max(0.7, sky - level(0.1587));
  const double top = std::asinh(std::max(level(1.0 - 2e-5) - sky, 20.0 * sigma) / (4.0 * sigma));
  std::vector<std::uint8_t> grey(65536);
  for (std::size_t dn = 0; dn < grey.size(); ++dn) {
    const double value = std::asinh((static_cast<double>(dn) - sky + sigma) / (4.0 * sigma)) / top;
    grey[dn] = static_cast<std::uint8_t>(std::clamp(255.0 * value, 0.0, 255.0));
  }
  Image<std::uint8_t> out(image.width(), image.height());
  std::ranges::transform(pixels, out.pixels().begin(), [&](std::uint16_t dn) { return grey[dn]; });
  return encode_png8(out);
}

Result<Scene> scene_of(const HttpRequest& request, const Engine& engine) {
  Scene scene = first_settings(engine.registry);
  scene.epoch = Epoch::tdb_seconds(0.0);
  scene.attitude = R_CN_from_pointing({});
  const auto given = request.query.find("scene");
  if (given == request.query.end()) return scene;
  if (deeper_than(given->second, kMaxDepth)) return fail(ErrorCode::limit_exceeded, "the JSON is nested too deeply");
  const auto object = nlohmann::json::parse(given->second, nullptr, false);
  if (!object.is_object()) return fail(ErrorCode::corrupt_data, "scene is one JSON object", {}, "scene");
  if (auto read = read_scene(object, {}, engine.registry, engine.limits, scene); !read) return forward(read);
  return scene;
}

}  // namespace

WebConnection::WebConnection(Engine& engine, asio::ip::tcp::socket socket, std::string token, bool loopback)
    : engine_(engine),
      socket_(std::move(socket)),
      token_(std::move(token)),
      loopback_(loopback),
      piece_(8192),
      due_(Clock::now() + in_seconds(kHeadS)) {
  asio::error_code ignored;
  socket_.set_option(asio::ip::tcp::no_delay(true), ignored);
  socket_.non_blocking(true, ignored);
}

void WebConnection::close() {
  closed_ = true;
  asio::error_code ignored;
  socket_.close(ignored);
  waiting_ = nullptr;
}

void WebConnection::drain() {
  draining_ = true;
  if (!busy_) close();
}

void WebConnection::tick(Clock::time_point now) {
  if (!closed_ && now > due_ && (writing_ || !busy_)) close();
}

void WebConnection::read() {
  socket_.async_read_some(asio::buffer(piece_), [self = shared_from_this()](asio::error_code error, std::size_t n) {
    if (self->closed_) return;
    if (error) return self->close();
    if (self->in_.empty()) self->due_ = Clock::now() + in_seconds(kHeadS);
    self->in_.append(self->piece_.data(), n);
    self->take_request();
  });
}

void WebConnection::take_request() {
  const auto length = http_head_length(in_);
  if (!length) {
    if (in_.size() <= kMaxHttpHead) return read();
    keep_alive_ = false;
    return answer_error(413, Error{ErrorCode::limit_exceeded,
                                   "a request's head of more than {0} bytes",
                                   {static_cast<double>(kMaxHttpHead)},
                                   {},
                                   {}});
  }
  const auto request = parse_http(std::string_view(in_).substr(0, *length));
  in_.erase(0, *length);
  busy_ = true;
  if (!request) {
    keep_alive_ = false;
    return answer_error(400, request.error());
  }
  keep_alive_ = request->keep_alive;
  handle(*request);
}

void WebConnection::handle(const HttpRequest& request) {
  if (request.method != "GET") {
    keep_alive_ = false;
    return answer_error(405, Error{ErrorCode::unsupported, "GET is the one method here", {}, {}, {}});
  }
  // A page of another site may name this machine as its own (DNS rebinding): then it would read what is here.
  if (token_.empty() && loopback_ && request.host != "localhost" && request.host != "127.0.0.1" &&
      request.host != "[::1]") {
    return answer_error(403, Error{ErrorCode::invalid_argument, "ask for 127.0.0.1 or localhost", {}, "Host", {}});
  }
  if (request.path == "/") return answer({200, "text/html; charset=utf-8", std::string(kLivePage)});
  if (!request.path.starts_with("/api/")) {
    return answer_error(404, Error{ErrorCode::not_found, "there is no such page", {}, {}, {}});
  }
  if (!token_.empty() && !same_token(request.token, token_)) {
    return answer_error(401, Error{ErrorCode::invalid_argument, "the token is missing or wrong", {}, "token", {}});
  }
  handle_api(request);
}

void WebConnection::handle_api(const HttpRequest& request) {
  const std::string_view what = std::string_view(request.path).substr(5);
  if (what == "info") {
    Json out{{"server", "astronav " ASTRONAV_VERSION}};
    Json cameras = Json::array(), observers = Json::array();
    for (const auto& [each, camera] : engine_.registry.cameras) {
      const Intrinsics& k = camera->intrinsics;
      cameras.push_back({{"name", each},
                         {"width_px", k.width_px},
                         {"height_px", k.height_px},
                         {"fov_h_deg", k.field_of_view_horizontal_rad() / kDegree},
                         {"exposure_ms", 1e3 * camera->exposure_s}});
    }
    for (const auto& [each, observer] : engine_.registry.observers) observers.push_back(each);
    out["cameras"] = std::move(cameras);
    out["observers"] = std::move(observers);
    out["settings"] = describe(first_settings(engine_.registry));
    return answer({.body = dump(out)});
  }
  if (what == "latest") {
    const Json scene = engine_.latest ? describe(*engine_.latest) : Json(nullptr);
    return answer({.body = dump(Json{{"frames", engine_.frames}, {"scene", scene}})});
  }
  if (what != "view.png" && what != "frame.png" && what != "truth" && what != "sky") {
    return answer_error(404, Error{ErrorCode::not_found, "there is no such thing here", {}, "api", what});
  }
  auto scene = scene_of(request, engine_);
  if (!scene) return answer_error(http_status(scene.error().code), scene.error());
  scene->truth = false;
  scene->format = what == "view.png" ? PixelFormat::dn : what == "frame.png" ? PixelFormat::png : PixelFormat::none;
  const auto kept = std::make_shared<const Scene>(std::move(*scene));
  waiting_ = [&engine = engine_, kept, name = std::string(what)]() -> Content {
    const auto refused = [](const Error& error) {
      return Content{http_status(error.code), "application/json", error_json({}, error)};
    };
    const std::shared_ptr<Shot> shot = engine.new_shot();
    if (name == "sky") {
      const auto sky = engine.studio.surroundings(*kept, *shot);
      return sky ? Content{.body = dump(*sky)} : refused(sky.error());
    }
    if (const auto taken = engine.studio.take(*kept, *shot); !taken) return refused(taken.error());
    if (name == "truth") return {.body = dump(truth(*shot))};
    if (name == "frame.png") return {200, "image/png", shot->png};
    auto png = stretched_png(shot->dn);
    return png ? Content{200, "image/png", std::move(*png)} : refused(png.error());
  };
  engine_.ready(shared_from_this());
}

std::optional<Job> WebConnection::next_job() {
  if (!waiting_ || closed_) return {};
  auto content = std::make_shared<Content>();
  return Job{[work = std::exchange(waiting_, nullptr), content] { *content = work(); },
             [self = shared_from_this(), content] { self->answer(std::move(*content)); }};
}

void WebConnection::answer_error(int status, const Error& error) {
  answer({status, "application/json", error_json({}, error)});
}

void WebConnection::answer(Content content) {
  if (closed_) return;
  busy_ = true;
  if (draining_) keep_alive_ = false;
  body_ = std::move(content.body);
  head_ = http_head(content.status, content.type, body_.size(), keep_alive_, kPolicy);
  writing_ = true;
  due_ = Clock::now() + in_seconds(engine_.limits.write_s + static_cast<double>(body_.size()) / kSlowestBytesPerS);
  const std::array<asio::const_buffer, 2> parts{asio::buffer(head_), asio::buffer(body_)};
  asio::async_write(socket_, parts, [self = shared_from_this()](asio::error_code error, std::size_t) {
    if (self->closed_) return;
    if (error || !self->keep_alive_) return self->close();
    self->busy_ = self->writing_ = false;
    self->due_ = Clock::now() + in_seconds(kIdleS);
    if (self->in_.empty()) return self->read();
    self->take_request();
  });
}

}  // namespace astronav::server
