// SPDX-License-Identifier: Apache-2.0
#include "models/stars/gzip.h"

#include <algorithm>
#include <limits>
#include <vector>

#include <zlib.h>

#include "foundation/base/check.h"

namespace astronav {
namespace {

constexpr int kGzipOnly = 16 + MAX_WBITS;

struct Inflater {
  z_stream stream{};
  Inflater() { ASTRONAV_CHECK(inflateInit2(&stream, kGzipOnly) == Z_OK); }
  ~Inflater() { inflateEnd(&stream); }
  Inflater(const Inflater&) = delete;
  Inflater& operator=(const Inflater&) = delete;
};

}  // namespace

bool is_gzip(std::span<const std::byte> bytes) {
  return bytes.size() >= 2 && bytes[0] == std::byte{0x1f} && bytes[1] == std::byte{0x8b};
}

Result<std::string> gunzip(std::span<const std::byte> bytes, std::size_t limit) {
  std::string text;
  std::vector<char> chunk(std::size_t{1} << 18);
  Inflater inflater;
  z_stream& stream = inflater.stream;
  std::size_t read = 0;
  bool inside_member = true;
  while (inside_member || read < bytes.size()) {
    if (!inside_member) ASTRONAV_CHECK(inflateReset(&stream) == Z_OK);
    const std::size_t offered = std::min<std::size_t>(bytes.size() - read, std::numeric_limits<uInt>::max());
    // zlib's interface is not const-correct; it only reads its input.
    stream.next_in = const_cast<Bytef*>(reinterpret_cast<const Bytef*>(bytes.data() + read));
    stream.avail_in = static_cast<uInt>(offered);
    stream.next_out = reinterpret_cast<Bytef*>(chunk.data());
    stream.avail_out = static_cast<uInt>(chunk.size());
    const int status = inflate(&stream, Z_NO_FLUSH);
    read += offered - stream.avail_in;
    if (status != Z_OK && status != Z_STREAM_END) {
      return fail(ErrorCode::corrupt_data, "the gzip data break off at byte {0} of {1}",
                  {static_cast<double>(read), static_cast<double>(bytes.size())});
    }
    const std::size_t produced = chunk.size() - stream.avail_out;
    if (produced > limit - text.size()) {
      return fail(ErrorCode::limit_exceeded, "the gzip data hold more than {0} bytes", {static_cast<double>(limit)});
    }
    text.append(chunk.data(), produced);
    inside_member = status != Z_STREAM_END;
  }
  return text;
}

}  // namespace astronav
