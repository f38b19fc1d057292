// SPDX-License-Identifier: Apache-2.0
#include "simulator/server/protocol.h"

#include <bit>
#include <cstring>

namespace astronav::server {
namespace {

static_assert(std::endian::native == std::endian::little, "headers are copied as they lie in memory");

struct WireHeader {
  std::array<char, 4> magic;
  std::uint16_t version;
  std::uint16_t type;
  std::uint32_t json_bytes;
  std::uint32_t binary_bytes;
};
static_assert(sizeof(WireHeader) == kHeaderBytes);

}  // namespace

std::string_view name(MessageType type) {
  switch (type) {
    case MessageType::hello:
      return "hello";
    case MessageType::set:
      return "set";
    case MessageType::render:
      return "render";
    case MessageType::trajectory:
      return "trajectory";
    case MessageType::cancel:
      return "cancel";
    case MessageType::ping:
      return "ping";
    case MessageType::stimulation:
      return "stimulation";
    case MessageType::welcome:
      return "welcome";
    case MessageType::settings:
      return "settings";
    case MessageType::frame:
      return "frame";
    case MessageType::end:
      return "end";
    case MessageType::cancelled:
      return "cancelled";
    case MessageType::pong:
      return "pong";
    case MessageType::error:
      return "error";
  }
  return {};
}

void encode(const Header& header, std::byte* out) {
  const WireHeader wire{kMagic, header.version, header.type, header.json_bytes, header.binary_bytes};
  std::memcpy(out, &wire, sizeof wire);
}

Result<Header> decode_header(std::span<const std::byte, kHeaderBytes> bytes) {
  WireHeader wire;
  std::memcpy(&wire, bytes.data(), sizeof wire);
  if (wire.magic != kMagic) {
    return fail(ErrorCode::corrupt_data, "a message begins with the four bytes ANAV; the connection is out of step");
  }
  return Header{wire.version, wire.type, wire.json_bytes, wire.binary_bytes};
}

std::string message_head(MessageType type, std::string_view json, std::uint32_t binary_bytes, std::uint16_t version) {
  std::string out(kHeaderBytes + json.size(), '\0');
  encode({version, static_cast<std::uint16_t>(type), static_cast<std::uint32_t>(json.size()), binary_bytes},
         reinterpret_cast<std::byte*>(out.data()));
  std::memcpy(out.data() + kHeaderBytes, json.data(), json.size());
  return out;
}

ErrorCode error_code(std::string_view code_name) {
  for (int i = 0; i < static_cast<int>(ErrorCode::internal); ++i) {
    if (astronav::name(static_cast<ErrorCode>(i)) == code_name) return static_cast<ErrorCode>(i);
  }
  return ErrorCode::internal;
}

bool same_token(std::string_view a, std::string_view b) {
  unsigned different = a.size() == b.size() ? 0u : 1u;
  for (std::size_t i = 0; i < kMaxToken; ++i) {
    const unsigned char left = i < a.size() ? static_cast<unsigned char>(a[i]) : 0;
    const unsigned char right = i < b.size() ? static_cast<unsigned char>(b[i]) : 0;
    different |= static_cast<unsigned>(left ^ right);
  }
  return different == 0 && a.size() <= kMaxToken;
}

bool deeper_than(std::string_view json, int depth) {
  int open = 0;
  bool text = false;
  for (std::size_t i = 0; i < json.size(); ++i) {
    const char c = json[i];
    if (text) {
      if (c == '\\') ++i;
      if (c == '"') text = false;
    } else if (c == '"') {
      text = true;
    } else if (c == '{' || c == '[') {
      if (++open > depth) return true;
    } else if (c == '}' || c == ']') {
      --open;
    }
  }
  return false;
}

}  // namespace astronav::server
