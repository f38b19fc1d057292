// SPDX-License-Identifier: Apache-2.0
// ASTRONAV_CHECK: programmer errors stop at once, always on, printing both values. Never for input from outside.
//
//   ASTRONAV_CHECK(index < size);
//   ASTRONAV_CHECK_OP(index, <, size);   // prints both values
#pragma once

namespace astronav {

struct CheckFailure {
  const char* file;
  int line;
  const char* condition;
  double left;  // NaN where the check has no operands
  double right;
};

// Must not return. The default prints one line to standard error and aborts; the flight build sets its own.
using CheckHook = void (*)(const CheckFailure&);
void set_check_hook(CheckHook hook);

[[noreturn]] void check_failed(const CheckFailure& failure);

}  // namespace astronav

#define ASTRONAV_CHECK(condition)                                                                       \
  do {                                                                                                  \
    if (!(condition)) [[unlikely]]                                                                      \
      ::astronav::check_failed({__FILE__, __LINE__, #condition, __builtin_nan(""), __builtin_nan("")}); \
  } while (false)

#define ASTRONAV_CHECK_OP(left, op, right)                                                                        \
  do {                                                                                                            \
    if (!((left)op(right))) [[unlikely]]                                                                          \
      ::astronav::check_failed(                                                                                   \
          {__FILE__, __LINE__, #left " " #op " " #right, static_cast<double>(left), static_cast<double>(right)}); \
  } while (false)
