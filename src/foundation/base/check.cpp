// SPDX-License-Identifier: Apache-2.0
#include "foundation/base/check.h"

#include <atomic>
#include <cmath>
#include <cstdio>
#include <cstdlib>

namespace astronav {
namespace {

void print_and_abort(const CheckFailure& f) {
  if (std::isnan(f.left)) {
    std::fprintf(stderr, "%s:%d: check failed: %s\n", f.file, f.line, f.condition);
  } else {
    std::fprintf(stderr, "%s:%d: check failed: %s (%.17g, %.17g)\n", f.file, f.line, f.condition, f.left, f.right);
  }
  std::abort();
}

std::atomic<CheckHook> current_hook{&print_and_abort};

}  // namespace

void set_check_hook(CheckHook hook) {
  current_hook = hook != nullptr ? hook : &print_and_abort;
}

void check_failed(const CheckFailure& failure) {
  current_hook.load()(failure);
  std::abort();
}

}  // namespace astronav
