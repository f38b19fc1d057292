// SPDX-License-Identifier: Apache-2.0
// Server: the SkySimulator over TCP (docs/protocol.md) and, with a web port, the live view over HTTP.
//
// One thread moves bytes and never waits for a client; a pool of workers takes the pictures, in turn for all who ask.
#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>

#include "foundation/base/error.h"
#include "models/ephemeris/ephemeris.h"
#include "models/stars/catalogue.h"
#include "simulator/server/protocol.h"
#include "simulator/server/scene.h"

namespace astronav::server {

struct ServerSettings {
  std::string address = "127.0.0.1";      // a number, or "localhost"; another than loopback demands a token
  std::uint16_t port = 0;                 // 0: any that is free
  std::optional<std::uint16_t> web_port;  // of the live view, on the same address
  std::string token;                      // empty: none is asked for
  unsigned workers = 0;                   // 0: as many as there are processors
  Limits limits;
  double drain_s = 10.0;         // how long a stopped server goes on with what was asked
  bool stop_on_signals = false;  // SIGINT and SIGTERM
};

class Server {
 public:
  // Listens when it returns. Ephemeris and stars must outlive the server. invalid_argument for an address that is none,
  // or without the token that it demands; io_failure where the port cannot be had.
  static Result<std::unique_ptr<Server>> create(const ServerSettings& settings, Registry registry,
                                                const Ephemeris& ephemeris, const StarCatalogue& stars);
  ~Server();
  Server(const Server&) = delete;
  Server& operator=(const Server&) = delete;

  std::uint16_t port() const;
  std::uint16_t web_port() const;  // 0: no live view
  // Serves until it is stopped, and what was asked by then is done.
  void run();
  // From any thread, also before run(): no new clients, no new requests; run() returns when what was asked is done, at
  // the latest drain_s later and when the workers have ended the pictures that they are at.
  void stop();

 private:
  struct Parts;
  explicit Server(std::unique_ptr<Parts> parts);
  std::unique_ptr<Parts> parts_;
};

}  // namespace astronav::server
