// SPDX-License-Identifier: Apache-2.0
// Session: one client of the protocol. Requests are read ahead, pictures taken in parallel, answers sent in the order
// of the requests. Internal to this folder.
#pragma once

#include <deque>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <variant>
#include <vector>

#include "simulator/server/engine.h"
#include "simulator/server/requests.h"

namespace astronav::server {

class Session final : public JobSource, public std::enable_shared_from_this<Session> {
 public:
  Session(Engine& engine, asio::ip::tcp::socket socket, std::string token);

  void start();
  // Whether it is one of the server's sessions, which are counted.
  bool greeted() const { return greeted_; }
  // Reads nothing that is not there yet; closes when everything asked has been answered.
  void drain();
  void close();
  bool closed() const { return closed_; }
  // Looks after the limits of time.
  void tick(Clock::time_point now);

  std::optional<Job> next_job() override;

 private:
  struct Message {
    std::string head;  // header and JSON
    std::shared_ptr<Shot> shot;
    std::size_t reserved = 0;  // of the session's room for frames
    std::size_t bytes() const { return head.size() + (shot ? shot->pixels().size() : 0); }
  };
  // A trajectory under way. Frames after a failure, or after the client has cancelled, are not sent.
  struct Stream {
    std::uint64_t id = 0;
    Trajectory trajectory;
    std::uint64_t issued = 0;
    std::uint64_t sent = 0;
    bool cancelled = false;
    bool failed = false;
  };
  using StreamPtr = std::shared_ptr<Stream>;
  struct Asked {
    std::uint64_t id = 0;
    std::variant<Message, Scene, StreamPtr> what;  // an answer that is there already, a picture, a trajectory
  };
  // An answer's place in the order.
  struct Place {
    bool ready = false;
    bool failed = false;
    bool end = false;  // of the stream
    StreamPtr stream;
    Message message;
  };

  void read();
  void heard(asio::error_code error, std::size_t n);
  void take_messages();
  void handle(const Header& header, std::string_view json);
  void greet(const Request& request);
  void ask(std::uint64_t id, std::variant<Message, Scene, StreamPtr> what);
  void answer(std::uint64_t id, MessageType type, std::string_view json);
  void answer_error(std::optional<std::uint64_t> id, const Error& error);
  void give_up(std::optional<std::uint64_t> id, const Error& error);
  std::optional<Job> picture(std::uint64_t id, const Scene& scene, const StreamPtr& stream);
  bool room_for(const Scene& scene) const;
  void flush();
  void write();
  void finish_if_done();
  void linger();

  Engine& engine_;
  asio::ip::tcp::socket socket_;
  const std::string token_;
  Scene settings_;
  bool greeted_ = false;

  std::vector<std::byte> in_;
  std::size_t filled_ = 0;
  std::size_t wanted_ = kHeaderBytes;  // of the message under way
  bool reading_ = false;
  bool paused_ = false;  // no room for further requests
  bool input_ended_ = false;

  std::deque<Asked> asked_;
  std::deque<std::shared_ptr<Place>> places_;
  std::deque<Message> out_;
  std::size_t reserved_ = 0;
  bool writing_ = false;
  bool lingering_ = false;
  bool closed_ = false;

  Clock::time_point started_, last_heard_, message_began_, write_due_, linger_due_;
};

}  // namespace astronav::server
