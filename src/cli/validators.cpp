// SPDX-License-Identifier: Apache-2.0
#include "cli/validators.h"

#include <charconv>
#include <cstdint>
#include <string>
#include <string_view>

#include <fmt/format.h>

namespace astronav::cli {
namespace {

// The whole text as a number.
template <typename Number>
bool read(std::string_view text, Number& out) {
  if (text.starts_with('+')) text.remove_prefix(1);
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), out);
  return error == std::errc() && end == text.data() + text.size();
}

}  // namespace

CLI::Validator number_within(double min, double max) {
  const auto check = [min, max](std::string& text) {
    double value = 0.0;
    if (read(text, value) && value >= min && value <= max) return std::string();
    return fmt::format("'{}' is not a number from {:g} to {:g}", text, min, max);
  };
  return CLI::Validator(check, {});
}

CLI::Validator seed_number() {
  const auto check = [](std::string& text) {
    std::int64_t value = 0;
    if (read(text, value) && value >= 0) return std::string();
    return fmt::format("'{}' is not a seed: a whole number from 0 to 2^63 - 1", text);
  };
  return CLI::Validator(check, {});
}

}  // namespace astronav::cli
