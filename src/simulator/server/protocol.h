// SPDX-License-Identifier: Apache-2.0
// Messages of the SkySimulator protocol, version 1 (docs/protocol.md is normative): a header of 16 bytes, a JSON object
// in UTF-8, raw bytes.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <string_view>

#include "foundation/base/error.h"

namespace astronav::server {

inline constexpr std::array<char, 4> kMagic{'A', 'N', 'A', 'V'};
inline constexpr std::uint16_t kProtocolVersion = 1;
inline constexpr std::size_t kHeaderBytes = 16;

enum class MessageType : std::uint16_t {
  // requests
  hello = 1,
  set = 2,
  render = 3,
  trajectory = 4,
  cancel = 5,
  ping = 6,
  stimulation = 7,  // reserved
  // answers
  welcome = 101,
  settings = 102,
  frame = 103,
  end = 104,
  cancelled = 105,
  pong = 106,
  error = 199,
};
// "hello", "frame", ...; empty where the number is no message's.
std::string_view name(MessageType type);

struct Header {
  std::uint16_t version = kProtocolVersion;
  std::uint16_t type = 0;
  std::uint32_t json_bytes = 0;
  std::uint32_t binary_bytes = 0;
};
void encode(const Header& header, std::byte* out);  // kHeaderBytes of them
// corrupt_data where the magic is another one.
Result<Header> decode_header(std::span<const std::byte, kHeaderBytes> bytes);

// Header and JSON in one string.
std::string message_head(MessageType type, std::string_view json, std::uint32_t binary_bytes = 0,
                         std::uint16_t version = kProtocolVersion);

// What a server lets its clients do; `welcome` tells them.
struct Limits {
  std::uint32_t json_bytes = 1 << 20;  // of a request
  std::uint32_t binary_bytes = 0;      // of a request
  std::uint32_t camera_bytes = 65536;  // of a camera's text
  std::uint64_t image_pixels = 1 << 24;
  double scene_work = 2e8;  // additions of light to pixels for one picture (render::painting_work): about a second
  std::uint32_t sessions = 16;
  std::uint32_t greetings = 64;           // connections that have not been greeted; the oldest makes room
  std::uint32_t queued_requests = 64;     // of a session; further ones are read when there is room
  std::uint64_t queued_bytes = 64 << 20;  // of a session: frames that its client has not taken yet
  std::uint64_t trajectory_frames = 1'000'000;
  std::uint64_t listed_scenes = 1000;
  double hello_s = 10.0;    // from the connection to its hello
  double message_s = 30.0;  // from the first byte of a message to its last
  double idle_s = 600.0;    // without anything asked or sent
  double write_s = 30.0;    // for the client to take a message, and a second more for each 100 kB
};

// The name of an error code, and back; `internal` where the name is none.
ErrorCode error_code(std::string_view code_name);

// Whether both are the same, in a time that does not depend on where they differ. Both at most kMaxToken bytes.
inline constexpr std::size_t kMaxToken = 256;
bool same_token(std::string_view a, std::string_view b);

// JSON nested deeper than this is refused unread.
inline constexpr int kMaxDepth = 16;
bool deeper_than(std::string_view json, int depth);

}  // namespace astronav::server
