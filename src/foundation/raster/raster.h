// SPDX-License-Identifier: Apache-2.0
// Pictures on disk: PNG, TIFF, JPEG, FITS and raw frames to and from Image<T>.
//
// Colour becomes luminance (mean of the channels), alpha is ignored. The row v = 0 is the top of the picture; a FITS
// file stores it last (y = height - v), so that a viewer shows what the camera saw.
#pragma once

#include <cstdint>
#include <filesystem>
#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "foundation/base/error.h"
#include "foundation/image/image.h"

namespace astronav {

struct RawLayout {  // --raw WIDTHxHEIGHT,u16le,OFFSET
  int width = 0;
  int height = 0;
  std::string type;  // u8, u16le, u16be
  std::size_t offset = 0;
};
Result<RawLayout> parse_raw_layout(std::string_view text);

struct Picture {
  ImageF pixels;               // values as stored (0..255, 0..65535, or as in the FITS file)
  double white_level = 65535;  // largest value that the format can hold (255, 65535; FITS float: largest found)
  int bits = 16;
  std::map<std::string, std::string> header;  // FITS keywords, values as text
  std::vector<std::string> header_cards;      // the same as they stand in the file, comments and history with them
};

struct ReadLimits {
  std::size_t max_pixels = 200'000'000;
};
// By content, not by name. not_found, corrupt_data, unsupported, limit_exceeded.
Result<Picture> read_picture(const std::filesystem::path& path, const std::optional<RawLayout>& raw = {},
                             const ReadLimits& limits = {});

Result<void> write_png16(const std::filesystem::path& path, ImageView<const std::uint16_t> image);
Result<void> write_png8(const std::filesystem::path& path, ImageView<const std::uint8_t> image);
// PNG in memory (for reports and the wire). rgb: three bytes a pixel, width*3 per row.
Result<std::string> encode_png8(ImageView<const std::uint8_t> image);
Result<std::string> encode_png16(ImageView<const std::uint16_t> image);
Result<std::string> encode_png_rgb(ImageView<const std::uint8_t> rgb_triplets);

struct FitsCard {
  std::string key;
  std::string text;  // used where `number` has no value
  std::optional<double> number;
  std::string comment;
};
// `kept`: whole cards of another picture's header, written before `cards`. Those that say how its pixels are stored,
// and what `cards` say anew, are left out.
Result<void> write_fits(const std::filesystem::path& path, ImageView<const std::uint16_t> image,
                        const std::vector<FitsCard>& cards, const std::vector<std::string>& kept = {});
Result<void> write_fits(const std::filesystem::path& path, ImageView<const float> image,
                        const std::vector<FitsCard>& cards, const std::vector<std::string>& kept = {});

}  // namespace astronav
