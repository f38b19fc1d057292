// SPDX-License-Identifier: Apache-2.0
// Progress: what a long job tells those who wait for it.
#pragma once

#include <chrono>
#include <functional>
#include <string>
#include <string_view>

namespace astronav {

// done is in [0, 1]; note is a short phrase ("cycle 12 of 30, Earth and Mars"). Called from one thread at a time.
using ProgressSink = std::function<void(double done, std::string_view note)>;

// A bar with time left on a terminal, a line every ten seconds elsewhere; on standard error.
class ProgressBar {
 public:
  explicit ProgressBar(std::string title);
  ~ProgressBar();
  ProgressBar(const ProgressBar&) = delete;
  ProgressBar& operator=(const ProgressBar&) = delete;
  void update(double done, std::string_view note);
  void finish();

 private:
  std::string title_;
  bool terminal_;
  bool open_ = false;
  std::chrono::steady_clock::time_point start_;
  std::chrono::steady_clock::time_point last_;
};

}  // namespace astronav
