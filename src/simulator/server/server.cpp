// SPDX-License-Identifier: Apache-2.0
#include "simulator/server/server.h"

#include <algorithm>
#include <list>
#include <thread>
#include <utility>

#include <asio.hpp>

#include "simulator/server/engine.h"
#include "simulator/server/live_view.h"
#include "simulator/server/session.h"

namespace astronav::server {
namespace {

using asio::ip::tcp;

constexpr std::size_t kMostBrowsers = 32;  // connections
constexpr auto kTick = std::chrono::milliseconds(100);
constexpr auto kAcceptPause = std::chrono::milliseconds(200);

Result<tcp::acceptor> listen(asio::io_context& io, const asio::ip::address& address, std::uint16_t port) {
  tcp::acceptor acceptor(io);
  asio::error_code error;
  const tcp::endpoint endpoint(address, port);
  acceptor.open(endpoint.protocol(), error);
  if (!error) acceptor.set_option(tcp::acceptor::reuse_address(true), error);
  if (!error) acceptor.bind(endpoint, error);
  if (!error) acceptor.listen(asio::socket_base::max_listen_connections, error);
  if (error) {
    return fail(ErrorCode::io_failure, "port {0} cannot be listened on: {s}", {static_cast<double>(port)},
                address.to_string(), error.message());
  }
  return acceptor;
}

}  // namespace

struct Server::Parts {
  Parts(const ServerSettings& s, unsigned workers, Registry registry, const Ephemeris& ephemeris,
        const StarCatalogue& stars)
      : settings(s),
        engine(workers, s.limits, std::move(registry), ephemeris, stars),
        acceptor(engine.io),
        web_acceptor(engine.io),
        ticker(engine.io),
        accept_pause(engine.io),
        web_pause(engine.io),
        signals(engine.io) {}

  void accept();
  void make_room();
  void accept_web();
  void tick();
  void stop();

  const ServerSettings settings;
  Engine engine;
  tcp::acceptor acceptor, web_acceptor;
  asio::steady_timer ticker, accept_pause, web_pause;
  asio::signal_set signals;
  std::list<std::shared_ptr<Session>> sessions;  // the oldest first
  std::list<std::shared_ptr<WebConnection>> browsers;
  bool stopping = false;
  Clock::time_point stop_due;
};

void Server::Parts::accept() {
  acceptor.async_accept([this](asio::error_code error, tcp::socket socket) {
    if (stopping || error == asio::error::operation_aborted) return;
    if (error) {  // out of file descriptors, most likely: they come back
      accept_pause.expires_after(kAcceptPause);
      accept_pause.async_wait([this](asio::error_code cancelled) {
        if (!cancelled) accept();
      });
      return;
    }
    make_room();
    sessions.push_back(std::make_shared<Session>(engine, std::move(socket), settings.token));
    sessions.back()->start();
    accept();
  });
}

// Whoever says nothing cannot keep others from saying hello.
void Server::Parts::make_room() {
  sessions.remove_if([](const auto& session) { return session->closed(); });
  const auto stranger = [](const auto& session) { return !session->greeted(); };
  if (std::ranges::count_if(sessions, stranger) < static_cast<std::ptrdiff_t>(settings.limits.greetings)) return;
  const auto oldest = std::ranges::find_if(sessions, stranger);
  (*oldest)->close();
  sessions.erase(oldest);
}

void Server::Parts::accept_web() {
  web_acceptor.async_accept([this](asio::error_code error, tcp::socket socket) {
    if (stopping || error == asio::error::operation_aborted) return;
    if (error) {
      web_pause.expires_after(kAcceptPause);
      web_pause.async_wait([this](asio::error_code cancelled) {
        if (!cancelled) accept_web();
      });
      return;
    }
    browsers.remove_if([](const auto& browser) { return browser->closed(); });
    if (browsers.size() < kMostBrowsers) {  // else it is closed at once
      const bool loopback = web_acceptor.local_endpoint(error).address().is_loopback();
      browsers.push_back(std::make_shared<WebConnection>(engine, std::move(socket), settings.token, loopback));
      browsers.back()->start();
    }
    accept_web();
  });
}

void Server::Parts::tick() {
  ticker.expires_after(kTick);
  ticker.async_wait([this](asio::error_code error) {
    if (error) return;
    const Clock::time_point now = Clock::now();
    for (const auto& session : sessions) {
      session->tick(now);
      if (stopping && now > stop_due) session->close();
    }
    sessions.remove_if([](const auto& session) { return session->closed(); });
    for (const auto& browser : browsers) {
      browser->tick(now);
      if (stopping && now > stop_due) browser->close();
    }
    browsers.remove_if([](const auto& browser) { return browser->closed(); });
    if (stopping && sessions.empty() && browsers.empty()) {
      engine.io.stop();
    } else {
      tick();
    }
  });
}

void Server::Parts::stop() {
  if (stopping) return;
  stopping = true;
  stop_due = Clock::now() + in_seconds(settings.drain_s);
  asio::error_code ignored;
  acceptor.close(ignored);
  web_acceptor.close(ignored);
  accept_pause.cancel();
  web_pause.cancel();
  signals.cancel(ignored);
  for (const auto& session : sessions) session->drain();
  for (const auto& browser : browsers) browser->drain();
}

Result<std::unique_ptr<Server>> Server::create(const ServerSettings& settings, Registry registry,
                                               const Ephemeris& ephemeris, const StarCatalogue& stars) {
  asio::error_code error;
  const auto address = asio::ip::make_address(settings.address == "localhost" ? "127.0.0.1" : settings.address, error);
  if (error) {
    return fail(ErrorCode::invalid_argument, "\"{s}\" is no address of this machine, like 127.0.0.1 or ::1", {}, {},
                settings.address);
  }
  if (!address.is_loopback() && settings.token.empty()) {
    return fail(ErrorCode::invalid_argument,
                "{s} can be reached from other machines: that demands a token (--token-file or ASTRONAV_TOKEN)", {}, {},
                settings.address);
  }
  if (settings.token.size() > kMaxToken) {
    return fail(ErrorCode::limit_exceeded, "a token of more than {0} bytes", {kMaxToken});
  }
  const unsigned workers = settings.workers > 0 ? settings.workers : std::max(1u, std::thread::hardware_concurrency());
  auto parts = std::make_unique<Parts>(settings, workers, std::move(registry), ephemeris, stars);
  auto acceptor = listen(parts->engine.io, address, settings.port);
  if (!acceptor) return forward(acceptor);
  parts->acceptor = std::move(*acceptor);
  if (settings.web_port) {
    auto web = listen(parts->engine.io, address, *settings.web_port);
    if (!web) return forward(web);
    parts->web_acceptor = std::move(*web);
    parts->accept_web();
  }
  if (settings.stop_on_signals) {
    parts->signals.add(SIGINT, error);
    if (!error) parts->signals.add(SIGTERM, error);
    if (error) return fail(ErrorCode::internal, "signals cannot be caught: {s}", {}, {}, error.message());
    parts->signals.async_wait([p = parts.get()](asio::error_code cancelled, int) {
      if (!cancelled) p->stop();
    });
  }
  parts->accept();
  parts->tick();
  return std::unique_ptr<Server>(new Server(std::move(parts)));
}

Server::Server(std::unique_ptr<Parts> parts) : parts_(std::move(parts)) {}
Server::~Server() {
  parts_->engine.end();
}

std::uint16_t Server::port() const {
  asio::error_code ignored;
  return parts_->acceptor.local_endpoint(ignored).port();
}
std::uint16_t Server::web_port() const {
  asio::error_code ignored;
  return parts_->web_acceptor.is_open() ? parts_->web_acceptor.local_endpoint(ignored).port() : std::uint16_t{0};
}

void Server::run() {
  parts_->engine.io.run();
  parts_->engine.end();
}

void Server::stop() {
  asio::post(parts_->engine.io, [this] { parts_->stop(); });
}

}  // namespace astronav::server
