// SPDX-License-Identifier: Apache-2.0
#include "simulator/server/engine.h"

#include <utility>

namespace astronav::server {
namespace {

constexpr std::size_t kKeptShotBytes = 16 << 20;

std::size_t held_bytes(const Shot& shot) {
  return shot.dn.pixels().size_bytes() + shot.electrons.pixels().size_bytes() + shot.png.capacity();
}

}  // namespace

Engine::Engine(unsigned worker_count, const Limits& limits_, Registry registry_, const Ephemeris& ephemeris,
               const StarCatalogue& stars)
    : io(1),
      limits(limits_),
      registry(std::move(registry_)),
      studio(ephemeris, stars, {.cameras = 8, .pixels = 2 * static_cast<std::size_t>(limits_.image_pixels)}),
      workers(worker_count),
      pool_(worker_count) {
  free_->room = 4 * worker_count + 4;
}

std::shared_ptr<Shot> Engine::new_shot() {
  std::unique_ptr<Shot> shot;
  {
    const std::lock_guard lock(free_->mutex);
    if (!free_->shots.empty()) {
      shot = std::move(free_->shots.back());
      free_->shots.pop_back();
    }
  }
  if (!shot) shot = std::make_unique<Shot>();
  return {shot.release(), [free = free_](Shot* used) {
            std::unique_ptr<Shot> owned(used);
            if (held_bytes(*owned) > kKeptShotBytes) return;
            const std::lock_guard lock(free->mutex);
            if (free->shots.size() < free->room) free->shots.push_back(std::move(owned));
          }};
}

void Engine::ready(const std::shared_ptr<JobSource>& source) {
  if (!source->in_line_) {
    source->in_line_ = true;
    line_.push_back(source);
  }
  pump();
}

// One job more than there are workers is under way for each worker: none waits for this thread to give it the next.
void Engine::pump() {
  if (pumping_) return;
  pumping_ = true;
  while (running_ < 2 * static_cast<std::size_t>(workers) && !line_.empty()) {
    const std::shared_ptr<JobSource> source = std::move(line_.front());
    line_.pop_front();
    source->in_line_ = false;
    std::optional<Job> job = source->next_job();
    if (!job) continue;
    source->in_line_ = true;
    line_.push_back(source);
    ++running_;
    asio::post(pool_, [this, job = std::move(*job)]() mutable {
      job.work();
      asio::post(io, [this, done = std::move(job.done)] {
        --running_;
        done();
        pump();
      });
    });
  }
  pumping_ = false;
}

}  // namespace astronav::server
