// SPDX-License-Identifier: Apache-2.0
#include "models/ephemeris/daf.h"

#include <string_view>

#include "models/ephemeris/spk_segment.h"

namespace astronav::daf {
namespace {

constexpr std::size_t kRecordBytes = 1024;
constexpr int kSummaryBytes = 40;  // SPK: ND = 2 doubles, NI = 6 integers
constexpr int kMaxSummaries = 25;  // (1024 - 24) / 40
// Where a transfer in text mode has changed line ends or dropped bits, these bytes show it.
constexpr std::string_view kTransferCheck("FTPSTR:\r:\n:\r\n:\r\0:\x81:\x10\xce:ENDFTP", 28);
constexpr std::size_t kTransferCheckAt = 699;

std::int32_t load_int(const std::byte* at, bool swap) {
  std::uint32_t bits;
  std::memcpy(&bits, at, sizeof bits);
  return static_cast<std::int32_t>(swap ? __builtin_bswap32(bits) : bits);
}

std::string_view text_at(std::span<const std::byte> bytes, std::size_t at, std::size_t count) {
  return {reinterpret_cast<const char*>(bytes.data()) + at, count};
}

Result<bool> byte_order(std::span<const std::byte> file) {
  constexpr bool kLittle = std::endian::native == std::endian::little;
  if (file.size() < kRecordBytes)
    return fail(ErrorCode::corrupt_data, "is not an SPK kernel: it has {0} bytes, but its first record alone has 1024",
                {static_cast<double>(file.size()), 0, 0, 0});
  const std::string_view id = text_at(file, 0, 8);
  if (id != "DAF/SPK " && id != "NAIF/DAF") {
    if (id.starts_with("DAF/"))
      return fail(ErrorCode::unsupported, "is a DAF file, but not an SPK kernel ('{s}')", {}, {}, id);
    return fail(ErrorCode::corrupt_data, "is not an SPK kernel: byte 0 does not begin with 'DAF/SPK '");
  }
  const std::string_view format = text_at(file, 88, 8);
  bool swap = false;
  if (format == "LTL-IEEE") {
    swap = !kLittle;
  } else if (format == "BIG-IEEE") {
    swap = kLittle;
  } else if (id == "NAIF/DAF") {  // files of before 1994 do not name their byte order
    swap = load_int(file.data() + 8, false) != 2;
  } else {
    return fail(ErrorCode::unsupported, "byte 88: the number format is neither LTL-IEEE nor BIG-IEEE");
  }
  if (load_int(file.data() + 8, swap) != 2 || load_int(file.data() + 12, swap) != 6)
    return corrupt("byte {0}: an SPK kernel has ND = 2 and NI = 6, not {1} and {2}", 8, load_int(file.data() + 8, swap),
                   load_int(file.data() + 12, swap));
  const std::string_view check = text_at(file, kTransferCheckAt, kTransferCheck.size());
  if (check.starts_with("FTPSTR") && check != kTransferCheck)
    return corrupt("byte {0}: the file was damaged by a transfer in text mode", kTransferCheckAt);
  return swap;
}

}  // namespace

Result<void> read_segments(std::span<const std::byte> file, int kernel, std::vector<Ephemeris::Segment>& segments) {
  const auto swapped = byte_order(file);
  if (!swapped) return forward(swapped);
  const bool swap = *swapped;
  const auto whole_records = static_cast<double>(file.size() / kRecordBytes);
  const std::size_t words = file.size() / kWordBytes;

  double record = load_int(file.data() + 76, swap);
  std::size_t named_at = 76;
  for (double visited = 0; record != 0.0; ++visited) {
    if (!is_count(record, 2, whole_records))
      return corrupt("byte {0}: points to a summary record {1}, but the file has {2} whole records", named_at, record,
                     whole_records);
    if (visited >= whole_records) return corrupt("byte {0}: the summary records form a circle", named_at);
    const std::size_t start = (static_cast<std::size_t>(record) - 1) * kRecordBytes;
    const double count = load_double(file.data() + start + 16, swap);
    if (!is_count(count, 0, kMaxSummaries))
      return corrupt("byte {0}: a record cannot hold {1} summaries", start + 16, count);

    for (int i = 0; i < static_cast<int>(count); ++i) {
      const std::size_t at = start + 24 + static_cast<std::size_t>(i * kSummaryBytes);
      const std::byte* const summary = file.data() + at;
      Ephemeris::Segment segment;
      segment.begin_tdb_s = load_double(summary, swap);
      segment.end_tdb_s = load_double(summary + 8, swap);
      segment.target.value = load_int(summary + 16, swap);
      segment.center.value = load_int(summary + 20, swap);
      segment.frame = load_int(summary + 24, swap);
      segment.type = load_int(summary + 28, swap);
      const std::int64_t first_word = load_int(summary + 32, swap);
      const std::int64_t last_word = load_int(summary + 36, swap);
      segment.kernel = kernel;
      segment.swap_bytes = swap;
      if (!std::isfinite(segment.begin_tdb_s) || !std::isfinite(segment.end_tdb_s) ||
          segment.begin_tdb_s > segment.end_tdb_s)
        return corrupt("byte {0}: a segment cannot last from {1} s to {2} s", at, segment.begin_tdb_s,
                       segment.end_tdb_s);
      if (segment.target == segment.center)
        return corrupt("byte {0}: body {1} cannot be its own centre", at + 16, segment.target.value);
      if (first_word <= static_cast<std::int64_t>(kRecordBytes / kWordBytes) || last_word < first_word ||
          static_cast<std::uint64_t>(last_word) > words)
        return corrupt("byte {0}: the segment's words {1} to {2} are not inside the file", at + 32,
                       static_cast<double>(first_word), static_cast<double>(last_word));
      segment.first_byte = static_cast<std::size_t>(first_word - 1) * kWordBytes;
      segment.last_byte = static_cast<std::size_t>(last_word) * kWordBytes - 1;
      if (const auto layout = spk::read_layout(file, segment); !layout) return forward(layout);
      segments.push_back(segment);
    }
    named_at = start;
    record = load_double(file.data() + start, swap);
  }
  return {};
}

}  // namespace astronav::daf
