// SPDX-License-Identifier: Apache-2.0
// Who is next. Jobs of the heavy sources end when the test lets them, so that the order depends on no clock.
#include "simulator/server/engine.h"

#include <algorithm>
#include <array>
#include <mutex>
#include <semaphore>
#include <string>
#include <thread>

#include <gtest/gtest.h>

#include "simulator/server/server_for_tests.h"

namespace astronav::server {
namespace {

struct Begun {
  std::ptrdiff_t count(char name) {
    const std::lock_guard lock(mutex);
    return std::ranges::count(names, name);
  }
  std::mutex mutex;
  std::string names;
};

class Asker final : public JobSource, public std::enable_shared_from_this<Asker> {
 public:
  Asker(Engine& engine, char name, Begun& begun, std::counting_semaphore<>* go = nullptr)
      : engine_(engine), name_(name), begun_(begun), go_(go) {}
  void ask(int jobs) {
    asked_ += jobs;
    engine_.ready(shared_from_this());
  }
  std::optional<Job> next_job() override {
    if (asked_ == 0) return {};
    --asked_;
    return Job{[this] {
                 {
                   const std::lock_guard lock(begun_.mutex);
                   begun_.names += name_;
                 }
                 if (go_ != nullptr) go_->acquire();
               },
               [self = shared_from_this()] {
                 ++self->done;
                 self->engine_.ready(self);
               }};
  }
  int done = 0;

 private:
  Engine& engine_;
  const char name_;
  Begun& begun_;
  std::counting_semaphore<>* const go_;
  int asked_ = 0;
};

struct Running {
  explicit Running(unsigned workers)
      : engine(workers, {}, registry_for_tests(), ShippedSky::get().ephemeris, ShippedSky::get().stars),
        guard(asio::make_work_guard(engine.io)) {}
  // An asker that stays silent says that something is stuck: the test's time limit then.
  void wait_for(const Asker& asker, int jobs) {
    while (asker.done < jobs) engine.io.run_one();
  }
  Engine engine;
  asio::executor_work_guard<asio::io_context::executor_type> guard;
};

TEST(Engine, WhoeverAsksForLittleWaitsForNoFurtherJobOfAnother) {
  Running running(1);
  Begun begun;
  std::counting_semaphore go(0);
  const auto heavy = std::make_shared<Asker>(running.engine, 'A', begun, &go);
  const auto little = std::make_shared<Asker>(running.engine, '.', begun);
  heavy->ask(100);
  constexpr int kRounds = 12;
  std::string expected;
  for (int round = 1; round <= kRounds; ++round) {
    while (begun.count('A') < round) std::this_thread::yield();
    little->ask(1);
    go.release();
    running.wait_for(*little, round);
    expected += "A.";
  }
  go.release(100);
  running.wait_for(*heavy, 100);
  running.engine.end();
  EXPECT_EQ(begun.names.substr(0, expected.size()), expected);
}

TEST(Engine, SourcesTakeTurns) {
  Running running(2);
  Begun begun;
  std::counting_semaphore go(0);
  std::vector<std::shared_ptr<Asker>> askers;
  for (const char name : {'A', 'B', 'C', 'D', 'E'}) {
    askers.push_back(std::make_shared<Asker>(running.engine, name, begun, &go));
    askers.back()->ask(30);
  }
  go.release(150);
  for (const auto& asker : askers) running.wait_for(*asker, 30);
  running.engine.end();
  ASSERT_EQ(begun.names.size(), 150u);
  for (std::size_t n = 1; n <= begun.names.size(); ++n) {
    std::array<std::ptrdiff_t, 5> counts{};
    for (std::size_t i = 0; i < 5; ++i) {
      counts[i] = std::count(begun.names.begin(), begun.names.begin() + static_cast<std::ptrdiff_t>(n),
                             static_cast<char>('A' + i));
    }
    const auto [least, most] = std::ranges::minmax(counts);
    // Who was first had some under way before others came, and two workers may begin out of turn; without turns it
    // would be thirty.
    ASSERT_LE(most - least, 10) << begun.names.substr(0, n);
  }
}

TEST(Engine, EndingDropsWhatNoWorkerHasBegun) {
  Begun begun;
  std::counting_semaphore go(0);
  Running running(2);
  std::vector<std::shared_ptr<Asker>> askers;
  for (int i = 0; i < 20; ++i) {
    askers.push_back(std::make_shared<Asker>(running.engine, 'A', begun, &go));
    askers.back()->ask(3);
  }
  while (begun.count('A') < 2) std::this_thread::yield();
  // Nothing that is done is heard of, and nothing else begins.
  running.engine.drop_waiting();
  go.release(100);
  running.engine.end();
  EXPECT_EQ(begun.names.size(), 2u);
}

}  // namespace
}  // namespace astronav::server
