// SPDX-License-Identifier: Apache-2.0
// The live view: one page for a browser, and the JSON and pictures that it asks for (docs/live-view.md). Internal to
// this folder.
#pragma once

#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "simulator/server/engine.h"
#include "simulator/server/http.h"

namespace astronav::server {

// One browser's connection.
class WebConnection final : public JobSource, public std::enable_shared_from_this<WebConnection> {
 public:
  WebConnection(Engine& engine, asio::ip::tcp::socket socket, std::string token, bool loopback);
  void start() { read(); }
  void drain();
  void close();
  bool closed() const { return closed_; }
  void tick(Clock::time_point now);
  std::optional<Job> next_job() override;

 private:
  struct Content {
    int status = 200;
    std::string_view type = "application/json";
    std::string body;
  };
  void read();
  void take_request();
  void handle(const HttpRequest& request);
  void handle_api(const HttpRequest& request);
  void answer(Content content);
  void answer_error(int status, const Error& error);

  Engine& engine_;
  asio::ip::tcp::socket socket_;
  const std::string token_;
  const bool loopback_;  // the server can be reached from this machine alone
  std::string in_;
  std::vector<char> piece_;
  bool busy_ = false;  // between a request and the end of its answer
  bool writing_ = false;
  bool keep_alive_ = true;
  bool draining_ = false;
  bool closed_ = false;
  std::function<Content()> waiting_;  // work to be done
  std::string head_, body_;
  Clock::time_point due_;
};

}  // namespace astronav::server
