// SPDX-License-Identifier: Apache-2.0
#include "foundation/base/progress.h"

#include <algorithm>
#include <cstdio>

#include <fmt/format.h>
#include <unistd.h>

namespace astronav {
namespace {

using Clock = std::chrono::steady_clock;

double seconds(Clock::duration d) {
  return std::chrono::duration<double>(d).count();
}

std::string clock_text(double s) {
  const int total = static_cast<int>(s + 0.5);
  return fmt::format("{}:{:02}", total / 60, total % 60);
}

}  // namespace

ProgressBar::ProgressBar(std::string title)
    : title_(std::move(title)), terminal_(isatty(STDERR_FILENO) == 1), start_(Clock::now()), last_(start_) {}

ProgressBar::~ProgressBar() {
  finish();
}

void ProgressBar::update(double done, std::string_view note) {
  const auto now = Clock::now();
  const double since_last = seconds(now - last_);
  if (open_ && done < 1.0 && since_last < (terminal_ ? 0.1 : 10.0)) return;
  last_ = now;
  open_ = true;
  const double elapsed = seconds(now - start_);
  const std::string left = done > 0.01 ? clock_text(elapsed * (1.0 - done) / done) : std::string("-:--");
  if (terminal_) {
    constexpr int width = 32;
    const int filled = std::clamp(static_cast<int>(done * width), 0, width);
    const std::string bar =
        std::string(static_cast<std::size_t>(filled), '#') + std::string(static_cast<std::size_t>(width - filled), '.');
    std::fputs(fmt::format("\r\x1b[K{} [{}] {:3.0f} %  {} left  {}", title_, bar, 100.0 * done, left, note).c_str(),
               stderr);
  } else {
    std::fputs(fmt::format("{} {:3.0f} %  {} left  {}\n", title_, 100.0 * done, left, note).c_str(), stderr);
  }
  std::fflush(stderr);
}

void ProgressBar::finish() {
  if (open_ && terminal_) std::fputc('\n', stderr);
  open_ = false;
}

}  // namespace astronav
