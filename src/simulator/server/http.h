// SPDX-License-Identifier: Apache-2.0
// HTTP/1.1, as much of it as the live view needs: one GET at a time on a connection, read from bytes that may be
// hostile.
#pragma once

#include <cstddef>
#include <map>
#include <optional>
#include <string>
#include <string_view>

#include "foundation/base/error.h"

namespace astronav::server {

inline constexpr std::size_t kMaxHttpHead = 98304;  // a camera's text may stand in it

struct HttpRequest {
  std::string method;
  std::string path;                          // decoded
  std::map<std::string, std::string> query;  // decoded
  std::string host;                          // without the port, lower case
  std::string token;                         // of "Authorization: Bearer"
  bool keep_alive = true;
};

// Length of the head (with its empty line) where it is complete.
std::optional<std::size_t> http_head_length(std::string_view bytes);
// corrupt_data where it is no head of a request; unsupported where it brings a body.
Result<HttpRequest> parse_http(std::string_view head);

// The head of an answer; `more` are further lines, each with its end.
std::string http_head(int status, std::string_view type, std::size_t bytes, bool keep_alive,
                      std::string_view more = {});
int http_status(ErrorCode code);

}  // namespace astronav::server
