// SPDX-License-Identifier: Apache-2.0
// What the fuzzer feeds: bytes that a client might send, through everything that reads them before a picture is taken.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>

namespace astronav::fuzz {

// An even first byte: what follows is a stream of messages, read as a session reads it. One more than a multiple of
// four: the next byte is the type of one message, all that follows its JSON (so that lengths need not be right for the
// text to be reached). Three more than a multiple of four: the head of a browser's request.
void read_messages(std::span<const std::uint8_t> bytes);

}  // namespace astronav::fuzz
