// SPDX-License-Identifier: Apache-2.0
#include "foundation/raster/raster.h"

#include <charconv>
#include <cstring>

#include "foundation/files/mapped_file.h"
#include "foundation/raster/codecs.h"

namespace astronav {
namespace raster {

Result<void> check_size(double width, double height, const ReadLimits& limits) {
  if (!(width >= 1.0 && height >= 1.0)) {
    return fail(ErrorCode::corrupt_data, "the picture is said to be {0} x {1} pixels", {width, height});
  }
  if (width * height > static_cast<double>(limits.max_pixels) || width > 1e6 || height > 1e6) {
    return fail(ErrorCode::limit_exceeded, "the picture has {0} x {1} pixels; at most {2} in all are read",
                {width, height, static_cast<double>(limits.max_pixels)});
  }
  return {};
}

namespace {

bool starts_with(Bytes file, std::string_view magic) {
  return file.size() >= magic.size() && std::memcmp(file.data(), magic.data(), magic.size()) == 0;
}

Result<Picture> read_raw(Bytes file, const RawLayout& layout, const ReadLimits& limits) {
  if (const auto size = check_size(layout.width, layout.height, limits); !size) return forward(size);
  const std::size_t sample_bytes = layout.type == "u8" ? 1 : 2;
  const std::size_t count = static_cast<std::size_t>(layout.width) * static_cast<std::size_t>(layout.height);
  if (layout.offset > file.size() || (file.size() - layout.offset) / sample_bytes < count) {
    return fail(ErrorCode::corrupt_data, "the file has {0} bytes, but this raw layout needs {1}",
                {static_cast<double>(file.size()), static_cast<double>(layout.offset + count * sample_bytes)});
  }
  Picture picture;
  picture.pixels = ImageF(layout.width, layout.height);
  const auto* in = reinterpret_cast<const unsigned char*>(file.data()) + layout.offset;
  auto out = picture.pixels.pixels();
  if (layout.type == "u8") {
    for (std::size_t i = 0; i < count; ++i) out[i] = in[i];
    picture.white_level = 255;
    picture.bits = 8;
  } else {
    const int low = layout.type == "u16le" ? 0 : 1;
    for (std::size_t i = 0; i < count; ++i) out[i] = static_cast<float>(in[2 * i + low] | in[2 * i + 1 - low] << 8);
  }
  return picture;
}

Result<Picture> read_any(Bytes file, const ReadLimits& limits) {
  if (file.empty()) return fail(ErrorCode::corrupt_data, "the file is empty");
  if (starts_with(file, "\x89PNG")) return read_png(file, limits);
  if (starts_with(file, "\xff\xd8\xff")) return read_jpeg(file, limits);
  if (starts_with(file, "SIMPLE  =")) return read_fits(file, limits);
  for (const std::string_view magic : {std::string_view("II\x2a\0", 4), std::string_view("MM\0\x2a", 4),
                                       std::string_view("II\x2b\0", 4), std::string_view("MM\0\x2b", 4)}) {
    if (starts_with(file, magic)) return read_tiff(file, limits);
  }
  if (starts_with(file, "\x1f\x8b")) {
    return fail(ErrorCode::unsupported, "the file is compressed with gzip; unpack it first");
  }
  return fail(ErrorCode::unsupported,
              "not a picture: PNG, TIFF, JPEG and FITS are read (a raw frame needs its layout)");
}

}  // namespace
}  // namespace raster

Result<RawLayout> parse_raw_layout(std::string_view text) {
  const auto bad = [&] {
    return fail(ErrorCode::invalid_argument,
                "'{s}' is not a raw layout: WIDTHxHEIGHT,TYPE,OFFSET with TYPE u8, u16le or u16be (512x512,u16le,66)",
                {}, {}, text);
  };
  RawLayout layout;
  const char* at = text.data();
  const char* const end = text.data() + text.size();
  const auto number = [&](auto& value) {
    const auto [next, error] = std::from_chars(at, end, value);
    at = next;
    return error == std::errc();
  };
  const auto literal = [&](char c) { return at != end && *at++ == c; };
  if (!number(layout.width) || !literal('x') || !number(layout.height) || !literal(',')) return bad();
  const std::string_view rest(at, static_cast<std::size_t>(end - at));
  layout.type = std::string(rest.substr(0, rest.find(',')));
  at += layout.type.size();
  if (layout.type != "u8" && layout.type != "u16le" && layout.type != "u16be") return bad();
  if (at != end && (!literal(',') || !number(layout.offset))) return bad();
  if (at != end || layout.width < 1 || layout.height < 1) return bad();
  return layout;
}

Result<Picture> read_picture(const std::filesystem::path& path, const std::optional<RawLayout>& raw,
                             const ReadLimits& limits) {
  const Result<MappedFile> file = MappedFile::open(path);
  if (!file) return forward(file);
  Result<Picture> picture =
      raw ? raster::read_raw(file->bytes(), *raw, limits) : raster::read_any(file->bytes(), limits);
  if (!picture) return forward(picture, path.string());
  return picture;
}

}  // namespace astronav
