// SPDX-License-Identifier: Apache-2.0
#include "simulator/server/engine.h"

#include <utility>

namespace astronav::server {
namespace {

constexpr std::size_t kKeptShotBytes = 16 << 20;

// Which of two lines gives the next: the first, but not more often in a row than `most` while somebody waits in the
// other.
template <typename Line>
bool first_is_next(const Line& first, const Line& other, std::size_t& in_a_row, std::size_t most) {
  const bool is_first = !first.empty() && (other.empty() || in_a_row < most);
  in_a_row = is_first && !other.empty() ? in_a_row + 1 : 0;
  return is_first;
}

std::size_t held_bytes(const Shot& shot) {
  return shot.dn.pixels().size_bytes() + shot.electrons.pixels().size_bytes() + shot.png.capacity();
}

}  // namespace

Engine::Engine(unsigned worker_count, const Limits& limits_, Registry registry_, const Ephemeris& ephemeris,
               const StarCatalogue& stars)
    : io(1),
      limits(limits_),
      registry(std::move(registry_)),
      studio(ephemeris, stars,
             {.cameras = 8,
              .pixels = 2 * static_cast<std::size_t>(limits_.image_pixels),
              .scene_work = limits_.scene_work}),
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
    (source->under_way_ == 0 ? first_line_ : line_).push_back(source);
  }
  pump();
}

// One job more than there are workers is under way for each worker: none waits for this thread to give it the next.
void Engine::pump() {
  if (pumping_) return;
  pumping_ = true;
  const std::size_t places = 2 * static_cast<std::size_t>(workers);
  while (!first_line_.empty() || (!line_.empty() && running_ < places)) {
    auto& line = first_is_next(first_line_, line_, passed_over_, places) ? first_line_ : line_;
    const std::shared_ptr<JobSource> source = std::move(line.front());
    line.pop_front();
    source->in_line_ = false;
    std::optional<Job> job = source->next_job();
    if (!job) continue;
    const bool first = source->under_way_++ == 0;
    source->in_line_ = true;
    line_.push_back(source);
    ++running_;
    {
      const std::lock_guard lock(waiting_.mutex);
      (first ? waiting_.first : waiting_.further).emplace_back(source, std::move(*job));
    }
    asio::post(pool_, [this] { work_on_one(); });
  }
  pumping_ = false;
}

void Engine::work_on_one() {
  std::pair<std::shared_ptr<JobSource>, Job> next;
  {
    const std::lock_guard lock(waiting_.mutex);
    const bool first =
        first_is_next(waiting_.first, waiting_.further, waiting_.passed_over, 2 * static_cast<std::size_t>(workers));
    auto& jobs = first ? waiting_.first : waiting_.further;
    if (jobs.empty()) return;  // dropped
    next = std::move(jobs.front());
    jobs.pop_front();
  }
  next.second.work();
  asio::post(io, [this, source = std::move(next.first), done = std::move(next.second.done)] {
    --running_;
    if (--source->under_way_ == 0 && source->in_line_ && std::erase(line_, source) > 0) first_line_.push_back(source);
    done();
    pump();
  });
}

void Engine::drop_waiting() {
  const std::lock_guard lock(waiting_.mutex);
  waiting_.first.clear();
  waiting_.further.clear();
}

void Engine::end() {
  drop_waiting();
  pool_.join();
}

}  // namespace astronav::server
