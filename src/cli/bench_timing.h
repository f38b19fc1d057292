// SPDX-License-Identifier: Apache-2.0
// How long something takes, by the wall clock: warmed up, then repeated for about a second; median and spread. Where
// the machine has other things to do, the processor's time beside it says so.
#pragma once

#include <algorithm>
#include <chrono>
#include <cstddef>
#include <ctime>
#include <string>
#include <vector>

#include <fmt/format.h>

#include "foundation/math/statistics.h"

namespace astronav::cli::bench {

inline double seconds_now() {
  return std::chrono::duration<double>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

inline double processor_seconds_now() {
  timespec t{};
  clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
  return static_cast<double>(t.tv_sec) + 1e-9 * static_cast<double>(t.tv_nsec);
}

struct Timing {
  std::vector<double> samples_s;  // of one operation each, mean over a batch
  std::size_t batch = 1;
  double processor_s = 0.0;  // of one operation, mean
  double median_s() const { return median(samples_s); }
};

// Short operations are timed in batches of two milliseconds, beside which reading the clock is nothing.
template <typename Operation>
Timing measure(Operation&& operation) {
  constexpr double kWarmUpS = 0.1, kBatchS = 2e-3, kTotalS = 1.0;
  constexpr std::size_t kLeastSamples = 15;
  Timing timing;
  std::size_t warm = 0;
  const double begin = seconds_now();
  while (seconds_now() - begin < kWarmUpS || warm < 2) {
    operation();
    ++warm;
  }
  const double one_s = (seconds_now() - begin) / static_cast<double>(warm);
  timing.batch = std::max<std::size_t>(1, static_cast<std::size_t>(kBatchS / one_s));
  const double started = seconds_now(), processor_started = processor_seconds_now();
  while (seconds_now() - started < kTotalS || timing.samples_s.size() < kLeastSamples) {
    const double before = seconds_now();
    for (std::size_t i = 0; i < timing.batch; ++i) operation();
    timing.samples_s.push_back((seconds_now() - before) / static_cast<double>(timing.batch));
  }
  timing.processor_s =
      (processor_seconds_now() - processor_started) / static_cast<double>(timing.samples_s.size() * timing.batch);
  return timing;
}

// "median of 512 x 100; 10 to 90 %: 3.1 to 3.4 us; processor time 3.2"
inline std::string spread(const Timing& timing, double per_second, const char* unit) {
  return fmt::format("median of {} x {}; 10 to 90 %: {:.4g} to {:.4g} {}; processor time {:.4g}",
                     timing.samples_s.size(), timing.batch, quantile(timing.samples_s, 0.1) * per_second,
                     quantile(timing.samples_s, 0.9) * per_second, unit, timing.processor_s * per_second);
}

// Makes the compiler believe that somebody looks at the value.
template <typename T>
void keep(const T& value) {
  asm volatile("" : : "r"(&value) : "memory");
}

}  // namespace astronav::cli::bench
