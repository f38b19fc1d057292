// SPDX-License-Identifier: Apache-2.0
#include "simulator/server/http.h"

#include <algorithm>

#include <fmt/format.h>

namespace astronav::server {
namespace {

std::string lower(std::string_view text) {
  std::string out(text);
  for (char& c : out) {
    if (c >= 'A' && c <= 'Z') c = static_cast<char>(c - 'A' + 'a');
  }
  return out;
}

std::string_view trimmed(std::string_view s) {
  while (!s.empty() && (s.front() == ' ' || s.front() == '\t')) s.remove_prefix(1);
  while (!s.empty() && (s.back() == ' ' || s.back() == '\t')) s.remove_suffix(1);
  return s;
}

int hex(char c) {
  if (c >= '0' && c <= '9') return c - '0';
  if (c >= 'a' && c <= 'f') return c - 'a' + 10;
  if (c >= 'A' && c <= 'F') return c - 'A' + 10;
  return -1;
}

// Percent signs and plus.
std::optional<std::string> decoded(std::string_view text) {
  std::string out;
  for (std::size_t i = 0; i < text.size(); ++i) {
    if (text[i] == '+') {
      out += ' ';
    } else if (text[i] == '%') {
      if (i + 2 >= text.size() || hex(text[i + 1]) < 0 || hex(text[i + 2]) < 0) return {};
      out += static_cast<char>(16 * hex(text[i + 1]) + hex(text[i + 2]));
      i += 2;
    } else {
      out += text[i];
    }
  }
  return out;
}

tl::unexpected<Error> broken() {
  return fail(ErrorCode::corrupt_data, "this is no request of HTTP/1.1");
}

std::string_view reason(int status) {
  switch (status) {
    case 200:
      return "OK";
    case 400:
      return "Bad Request";
    case 401:
      return "Unauthorized";
    case 403:
      return "Forbidden";
    case 404:
      return "Not Found";
    case 405:
      return "Method Not Allowed";
    case 408:
      return "Request Timeout";
    case 413:
      return "Content Too Large";
    default:
      return "Internal Server Error";
  }
}

}  // namespace

std::optional<std::size_t> http_head_length(std::string_view bytes) {
  const std::size_t end = bytes.find("\r\n\r\n");
  if (end == std::string_view::npos) return {};
  return end + 4;
}

Result<HttpRequest> parse_http(std::string_view head) {
  HttpRequest out;
  const std::size_t line_end = head.find("\r\n");
  if (line_end == std::string_view::npos) return broken();
  const std::string_view line = head.substr(0, line_end);
  const std::size_t first = line.find(' '), last = line.rfind(' ');
  if (first == std::string_view::npos || first == last) return broken();
  out.method = std::string(line.substr(0, first));
  const std::string_view version = line.substr(last + 1);
  if (version != "HTTP/1.1" && version != "HTTP/1.0") return broken();
  out.keep_alive = version == "HTTP/1.1";
  const std::string_view target = line.substr(first + 1, last - first - 1);
  if (!target.starts_with('/')) return broken();
  const std::size_t question = target.find('?');
  const auto path = decoded(target.substr(0, question));
  if (!path) return broken();
  out.path = *path;
  std::string_view rest = question == std::string_view::npos ? std::string_view() : target.substr(question + 1);
  while (!rest.empty()) {
    const std::string_view pair = rest.substr(0, rest.find('&'));
    rest.remove_prefix(std::min(rest.size(), pair.size() + 1));
    const std::size_t equals = pair.find('=');
    const auto key = decoded(pair.substr(0, equals));
    const auto value = decoded(equals == std::string_view::npos ? std::string_view() : pair.substr(equals + 1));
    if (!key || !value) return broken();
    out.query[*key] = *value;
  }
  std::string_view fields = head.substr(line_end + 2);
  while (!fields.empty() && !fields.starts_with("\r\n")) {
    const std::size_t end = fields.find("\r\n");
    if (end == std::string_view::npos) return broken();
    const std::string_view field = fields.substr(0, end);
    fields.remove_prefix(end + 2);
    const std::size_t colon = field.find(':');
    if (colon == std::string_view::npos || colon == 0) return broken();
    const std::string name = lower(field.substr(0, colon));
    const std::string_view value = trimmed(field.substr(colon + 1));
    if (name == "host") {
      const bool bracket = value.starts_with('[');
      const std::size_t end_of_host = bracket ? value.find(']') : value.find(':');
      out.host =
          lower(value.substr(0, bracket && end_of_host != std::string_view::npos ? end_of_host + 1 : end_of_host));
    } else if (name == "connection") {
      if (lower(value) == "close") out.keep_alive = false;
    } else if (name == "authorization") {
      if (lower(value.substr(0, 7)) == "bearer ") out.token = std::string(trimmed(value.substr(7)));
    } else if ((name == "content-length" && value != "0") || name == "transfer-encoding") {
      return fail(ErrorCode::unsupported, "a request with a body");
    }
  }
  return out;
}

std::string http_head(int status, std::string_view type, std::size_t bytes, bool keep_alive, std::string_view more) {
  return fmt::format(
      "HTTP/1.1 {} {}\r\nContent-Type: {}\r\nContent-Length: {}\r\nCache-Control: no-store\r\n"
      "X-Content-Type-Options: nosniff\r\nX-Frame-Options: DENY\r\nReferrer-Policy: no-referrer\r\n"
      "Connection: {}\r\n{}\r\n",
      status, reason(status), type, bytes, keep_alive ? "keep-alive" : "close", more);
}

int http_status(ErrorCode code) {
  switch (code) {
    case ErrorCode::not_found:
      return 404;
    case ErrorCode::limit_exceeded:
      return 413;
    case ErrorCode::io_failure:
    case ErrorCode::internal:
      return 500;
    default:
      return 400;
  }
}

}  // namespace astronav::server
