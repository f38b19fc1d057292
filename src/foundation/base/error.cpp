// SPDX-License-Identifier: Apache-2.0
#include "foundation/base/error.h"

#include <cmath>

#include <fmt/format.h>

namespace astronav {

std::string_view name(ErrorCode code) {
  switch (code) {
    case ErrorCode::invalid_argument:
      return "invalid_argument";
    case ErrorCode::not_found:
      return "not_found";
    case ErrorCode::corrupt_data:
      return "corrupt_data";
    case ErrorCode::unsupported:
      return "unsupported";
    case ErrorCode::out_of_range:
      return "out_of_range";
    case ErrorCode::io_failure:
      return "io_failure";
    case ErrorCode::no_match:
      return "no_match";
    case ErrorCode::not_converged:
      return "not_converged";
    case ErrorCode::limit_exceeded:
      return "limit_exceeded";
    case ErrorCode::internal:
      return "internal";
  }
  return "internal";
}

int exit_status(ErrorCode code) {
  switch (code) {
    case ErrorCode::no_match:
    case ErrorCode::not_converged:
      return 3;
    case ErrorCode::internal:
      return 1;
    default:
      return 2;
  }
}

std::string describe(const Error& error) {
  std::string out;
  if (!error.where.empty()) out.append(error.where.view()).append(": ");
  const std::string_view text = error.text;
  for (std::size_t i = 0; i < text.size(); ++i) {
    const bool placeholder = text[i] == '{' && i + 2 < text.size() && text[i + 2] == '}';
    if (placeholder && text[i + 1] == 's') {
      out.append(error.subject.view());
      i += 2;
    } else if (placeholder && text[i + 1] >= '0' && text[i + 1] <= '3') {
      const double v = error.numbers[static_cast<std::size_t>(text[i + 1] - '0')];
      const bool whole = std::abs(v) < 1e15 && v == std::floor(v);
      out += whole ? fmt::format("{:.0f}", v) : fmt::format("{:.9g}", v);
      i += 2;
    } else {
      out += text[i];
    }
  }
  return out;
}

}  // namespace astronav
