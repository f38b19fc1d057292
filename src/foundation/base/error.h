// SPDX-License-Identifier: Apache-2.0
// Error and Result<T>: how bad input from outside is reported.
//
// An Error is trivially copyable and never allocates, so that flight code can return one. It carries a code, a static
// text with places for numbers, and two short fields: `where` (file:line:column, path, key) and `subject` (the thing
// that was found there). describe() puts the sentence together, at the edge only.
#pragma once

#include <array>
#include <cstddef>
#include <string>
#include <string_view>
#include <type_traits>

#include <tl/expected.hpp>

namespace astronav {

// The codes are also the codes of the wire protocol and decide the exit status of the command line.
enum class ErrorCode : unsigned char {
  invalid_argument,  // a value that makes no sense here
  not_found,         // a file, body, star or key that is not there
  corrupt_data,      // a file or message that breaks its own format
  unsupported,       // well formed, but of a kind that is not handled
  out_of_range,      // outside the span that data cover (time, place, size)
  io_failure,        // the operating system said no
  no_match,          // ran, but nothing was recognised
  not_converged,     // ran, but reached no result
  limit_exceeded,    // more than a stated limit allows
  internal,          // a defect of ours
};

std::string_view name(ErrorCode code);

// Exit status of the command line: 2 bad input, 3 ran without a result, 1 a defect of ours.
int exit_status(ErrorCode code);

// A string of at most N bytes held in place. What does not fit loses its head ("..." marks it), since the end of a path
// or message tells more than its beginning.
template <std::size_t N>
class FixedText {
 public:
  FixedText() = default;
  FixedText(std::string_view s) {  // NOLINT(google-explicit-constructor)
    if (s.size() > N) {
      s.remove_prefix(s.size() - (N - 3));
      for (const char c : {'.', '.', '.'}) bytes_[size_++] = c;
    }
    for (const char c : s) bytes_[size_++] = c;
  }
  FixedText(const char* s) : FixedText(std::string_view(s)) {}         // NOLINT(google-explicit-constructor)
  FixedText(const std::string& s) : FixedText(std::string_view(s)) {}  // NOLINT(google-explicit-constructor)
  std::string_view view() const { return {bytes_.data(), size_}; }
  bool empty() const { return size_ == 0; }

 private:
  std::array<char, N> bytes_{};
  std::size_t size_ = 0;
};

struct Error {
  ErrorCode code = ErrorCode::internal;
  // Static storage. {0} to {3} stand for numbers, {s} for the subject:
  // "record at byte {0} is {1} bytes long, but only {2} remain".
  const char* text = "";
  std::array<double, 4> numbers{};
  FixedText<200> where{};
  FixedText<200> subject{};

  // The same error, said of a place, unless a more precise place is known already.
  Error at(std::string_view place) const {
    Error copy = *this;
    if (copy.where.empty()) copy.where = FixedText<200>(place);
    return copy;
  }
};
static_assert(std::is_trivially_copyable_v<Error>);

// "where: text", with numbers and subject put in.
std::string describe(const Error& error);

template <typename T>
using Result = tl::expected<T, Error>;

inline tl::unexpected<Error> fail(ErrorCode code, const char* text, std::array<double, 4> numbers = {},
                                  std::string_view where = {}, std::string_view subject = {}) {
  return tl::unexpected<Error>(Error{code, text, numbers, FixedText<200>(where), FixedText<200>(subject)});
}

// Hands an error on: `return forward(result)`, or with a place: `return forward(result, path)`.
template <typename T>
tl::unexpected<Error> forward(const Result<T>& failed, std::string_view place = {}) {
  return tl::unexpected<Error>(place.empty() ? failed.error() : failed.error().at(place));
}

}  // namespace astronav
