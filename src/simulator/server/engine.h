// SPDX-License-Identifier: Apache-2.0
// Engine: the one thread that moves bytes, the workers that take pictures, and who is next. Internal to this folder.
//
// Everything here is called on the thread of `io` alone, except the work of a job.
#pragma once

#include <chrono>
#include <cstdint>
#include <deque>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <utility>
#include <vector>

#include <asio.hpp>

#include "simulator/server/protocol.h"
#include "simulator/server/scene.h"
#include "simulator/server/studio.h"

namespace astronav::server {

using Clock = std::chrono::steady_clock;
inline Clock::duration in_seconds(double s) {
  return std::chrono::duration_cast<Clock::duration>(std::chrono::duration<double>(s));
}

struct Job {
  std::function<void()> work;  // by a worker
  std::function<void()> done;  // afterwards, on the thread of io
};

// Somebody with pictures to take: a session, or a browser's connection.
class JobSource {
 public:
  virtual ~JobSource() = default;
  // None where nothing can be done now; the source says ready() when that changes.
  virtual std::optional<Job> next_job() = 0;

 private:
  friend class Engine;
  bool in_line_ = false;
  std::size_t under_way_ = 0;  // of its jobs, those that wait for a worker included
};

class Engine {
 public:
  Engine(unsigned workers, const Limits& limits, Registry registry, const Ephemeris& ephemeris,
         const StarCatalogue& stars);

  // Gets in line, at its end, unless it is there already.
  void ready(const std::shared_ptr<JobSource>& source);
  void drop_waiting();  // jobs that no worker has begun
  // Drops them, and waits for the workers to end what they are at.
  void end();

  // A shot whose buffers are kept for another when the last holder lets go.
  std::shared_ptr<Shot> new_shot();

  asio::io_context io;
  const Limits limits;
  const Registry registry;
  const Studio studio;
  const unsigned workers;
  std::size_t sessions = 0;  // greeted, and not closed
  // What a session was shown last, and how many pictures there have been.
  std::shared_ptr<const Scene> latest;
  std::uint64_t frames = 0;

 private:
  void pump();
  void work_on_one();
  struct FreeShots {
    std::mutex mutex;
    std::vector<std::unique_ptr<Shot>> shots;
    std::size_t room = 0;
  };
  std::shared_ptr<FreeShots> free_ = std::make_shared<FreeShots>();
  // A source with nothing under way waits behind nobody's further jobs, neither for a place nor for a worker: whoever
  // comes waits until a worker has done what it is at, and for others who came. But where the ones who have nothing
  // under way keep coming, every so many of them let one of the others pass.
  std::deque<std::shared_ptr<JobSource>> first_line_, line_;
  struct Waiting {
    std::mutex mutex;
    std::deque<std::pair<std::shared_ptr<JobSource>, Job>> first, further;
    std::size_t passed_over = 0;  // `further` by `first`, in a row
  } waiting_;                     // for a worker
  std::size_t running_ = 0;
  std::size_t passed_over_ = 0;  // line_ by first_line_, in a row
  bool pumping_ = false;
  asio::thread_pool pool_;
};

}  // namespace astronav::server
