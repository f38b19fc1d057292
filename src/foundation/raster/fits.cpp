// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <cstring>
#include <string>
#include <vector>

#include <fitsio.h>

#include "foundation/files/mapped_file.h"
#include "foundation/raster/codecs.h"

namespace astronav {
namespace raster {
namespace {

// The oldest message of CFITSIO's stack, which tells more than the status.
std::string reason(int status) {
  char message[FLEN_ERRMSG] = "";
  if (fits_read_errmsg(message) == 0) fits_get_errstatus(status, message);
  fits_clear_errmsg();
  return message;
}

tl::unexpected<Error> broken(int status) {
  return fail(ErrorCode::corrupt_data, "broken FITS file ({s})", {}, {}, reason(status));
}

struct Fits {
  fitsfile* file = nullptr;
  ~Fits() {
    int status = 0;
    if (file != nullptr) fits_close_file(file, &status);
    fits_clear_errmsg();
  }
};

struct Geometry {
  static constexpr int kMostAxes = 9;
  int bitpix = 0;
  int axes = 0;
  long size[kMostAxes] = {};
};

// Text of a card's value without quotes and padding.
std::string plain_value(std::string value) {
  if (value.size() >= 2 && value.front() == '\'') {
    value = value.substr(1, value.rfind('\'') - 1);
    while (!value.empty() && value.back() == ' ') value.pop_back();
  }
  return value;
}

void read_header(fitsfile* file, Picture& picture) {
  int status = 0;
  int cards = 0;
  fits_get_hdrspace(file, &cards, nullptr, &status);
  for (int i = 1; i <= cards && status == 0; ++i) {
    char card[FLEN_CARD] = "";
    char key[FLEN_CARD] = "";
    char value[FLEN_CARD] = "";
    char comment[FLEN_CARD] = "";
    int one = 0;
    if (fits_read_record(file, i, card, &status) == 0) picture.header_cards.emplace_back(card);
    if (fits_read_keyn(file, i, key, value, comment, &one) != 0) continue;
    if (key[0] != '\0' && std::strcmp(key, "COMMENT") != 0 && std::strcmp(key, "HISTORY") != 0) {
      picture.header[key] = plain_value(value);
    }
  }
  fits_clear_errmsg();
}

}  // namespace

Result<Picture> read_fits(Bytes file, const ReadLimits& limits) {
  if (file.size() < 2880) {
    return fail(ErrorCode::corrupt_data, "broken FITS file: {0} bytes are less than one header block of 2880",
                {static_cast<double>(file.size())});
  }
  Fits fits;
  int status = 0;
  // CFITSIO wants memory that it may write to, though it only reads here.
  void* memory = const_cast<std::byte*>(file.data());
  std::size_t size = file.size();
  if (fits_open_memfile(&fits.file, "memory", READONLY, &memory, &size, 0, nullptr, &status) != 0)
    return broken(status);

  // The first extension that holds a picture.
  Geometry geometry;
  while (true) {
    int type = 0;
    fits_get_hdu_type(fits.file, &type, &status);
    if (status == 0 && type == IMAGE_HDU) {
      fits_get_img_param(fits.file, Geometry::kMostAxes, &geometry.bitpix, &geometry.axes, geometry.size, &status);
      if (status == 0 && geometry.axes >= 2) break;
    }
    if (status != 0) return broken(status);
    if (fits_movrel_hdu(fits.file, 1, nullptr, &status) != 0) {
      fits_clear_errmsg();
      return fail(ErrorCode::unsupported, "this FITS file holds no picture");
    }
  }
  const long width = geometry.size[0];
  const long height = geometry.size[1];
  if (const auto within = check_size(static_cast<double>(width), static_cast<double>(height), limits); !within) {
    return forward(within);
  }
  const int colours = geometry.axes >= 3 && geometry.size[2] == 3 ? 3 : 1;
  bool flat = geometry.axes <= Geometry::kMostAxes;
  for (int axis = colours == 3 ? 3 : 2; axis < std::min(geometry.axes, Geometry::kMostAxes); ++axis)
    flat = flat && geometry.size[axis] == 1;
  if (!flat) {
    return fail(ErrorCode::unsupported, "this FITS file holds a cube; a picture or three colours are read");
  }

  if (fits_is_compressed_image(fits.file, &status) != 0) {
    return fail(ErrorCode::unsupported, "this FITS picture is compressed in tiles; unpack it first (funpack)");
  }
  // CFITSIO pads a truncated file with what happens to lie there: compare with what the header promises.
  LONGLONG header_start = 0;
  LONGLONG data_start = 0;
  LONGLONG data_end = 0;
  fits_get_hduaddrll(fits.file, &header_start, &data_start, &data_end, &status);
  if (status != 0) return broken(status);
  const double needed = static_cast<double>(data_start) + static_cast<double>(width) * static_cast<double>(height) *
                                                              colours * std::abs(geometry.bitpix) / 8.0;
  if (needed > static_cast<double>(file.size())) {
    return fail(ErrorCode::corrupt_data, "broken FITS file: {0} bytes, but its header promises {1}",
                {static_cast<double>(file.size()), needed});
  }

  Picture picture;
  picture.pixels = ImageF(static_cast<int>(width), static_cast<int>(height));
  std::vector<double> row(static_cast<std::size_t>(width));
  double largest = 0.0;
  for (int plane = 1; plane <= colours; ++plane) {
    for (long y = 1; y <= height; ++y) {
      long first[Geometry::kMostAxes] = {1, y, plane, 1, 1, 1, 1, 1, 1};
      double null_value = 0.0;  // blank and undefined pixels read as zero
      fits_read_pix(fits.file, TDOUBLE, first, width, &null_value, row.data(), nullptr, &status);
      if (status != 0) return broken(status);
      float* out = picture.pixels.row(static_cast<int>(height - y));
      for (long u = 0; u < width; ++u) {
        const double value = row[static_cast<std::size_t>(u)];
        if (!std::isfinite(value)) continue;
        largest = std::max(largest, std::abs(value));
        out[u] += static_cast<float>(value) / static_cast<float>(colours);
      }
    }
  }
  // Squares of pixels must stay within single precision.
  constexpr double kLeast = 1e-9, kMost = 1e24;
  if (largest > kMost || (largest > 0.0 && largest < kLeast)) {
    return fail(ErrorCode::unsupported, "the largest value of this FITS picture is {0}; from {1} to {2} can be read",
                {largest, kLeast, kMost});
  }
  read_header(fits.file, picture);

  int equivalent = 0;
  fits_get_img_equivtype(fits.file, &equivalent, &status);
  switch (equivalent) {
    case BYTE_IMG:
      picture.bits = 8, picture.white_level = 255;
      break;
    case SHORT_IMG:
      picture.bits = 16, picture.white_level = 32767;
      break;
    case USHORT_IMG:
      picture.bits = 16, picture.white_level = 65535;
      break;
    default: {
      const auto pixels = picture.pixels.pixels();
      picture.white_level = *std::max_element(pixels.begin(), pixels.end());
      picture.bits = equivalent < 0 ? -equivalent : 32;
      if (picture.bits > 64) picture.bits = 32;
    }
  }
  return picture;
}

namespace {

// What CFITSIO allocates while it writes to memory; it is freed after the file is closed.
struct Memory {
  void* bytes = nullptr;
  std::size_t size = 0;
  ~Memory() { std::free(bytes); }
};

// Whether a card of another picture's header still holds: not what says how pixels are stored or where they lie on the
// sky, which is another's now.
bool still_holds(const std::string& card, const std::vector<FitsCard>& anew) {
  std::string key = card.substr(0, 8);
  key.erase(key.find_last_not_of(' ') + 1);
  char text[FLEN_CARD] = "";
  card.copy(text, FLEN_CARD - 1);
  const int type = fits_get_keyclass(text);
  if (type == TYP_STRUC_KEY || type == TYP_CMPRS_KEY || type == TYP_SCAL_KEY || type == TYP_NULL_KEY ||
      type == TYP_CKSUM_KEY || type == TYP_WCS_KEY || type == TYP_DIM_KEY || key == "EXTNAME" || key == "EQUINOX" ||
      key == "RADECSYS")
    return false;
  // SIP, which CFITSIO does not count among world coordinates: A_0_2, BP_ORDER, A_DMAX.
  for (const char* prefix : {"A_", "B_", "AP_", "BP_"})
    if (key.starts_with(prefix)) return false;
  return std::none_of(anew.begin(), anew.end(), [&](const FitsCard& c) { return c.key == key; });
}

template <typename Sample>
Result<void> write(const std::filesystem::path& path, ImageView<const Sample> image, const std::vector<FitsCard>& cards,
                   const std::vector<std::string>& kept, int image_type, int sample_type) {
  if (image.width() < 1 || image.height() < 1) {
    return fail(ErrorCode::invalid_argument, "an empty picture cannot be written as FITS", {}, path.string());
  }
  Memory memory;
  LONGLONG data_end = 0;  // the memory grows in larger steps than the file
  {
    Fits fits;
    int status = 0;
    memory.size = 2880;
    memory.bytes = std::malloc(memory.size);
    fits_create_memfile(&fits.file, &memory.bytes, &memory.size, 2880 * 256, std::realloc, &status);
    long axes[2] = {image.width(), image.height()};
    fits_create_img(fits.file, image_type, 2, axes, &status);
    bool holds = false;
    for (const std::string& card : kept) {
      if (!card.starts_with("CONTINUE")) holds = still_holds(card, cards);  // else it goes on with the card before
      if (status == 0 && holds) fits_write_record(fits.file, card.c_str(), &status);
    }
    for (const FitsCard& card : cards) {
      if (status != 0) break;
      const char* comment = card.comment.empty() ? nullptr : card.comment.c_str();
      if (!card.number) {
        fits_update_key_longstr(fits.file, card.key.c_str(), card.text.c_str(), comment, &status);
      } else if (*card.number == std::floor(*card.number) && std::abs(*card.number) < 1e15) {
        fits_update_key_lng(fits.file, card.key.c_str(), static_cast<LONGLONG>(*card.number), comment, &status);
      } else {
        fits_update_key_dbl(fits.file, card.key.c_str(), *card.number, -15, comment, &status);
      }
    }
    for (int v = 0; v < image.height() && status == 0; ++v) {
      long first[2] = {1, image.height() - v};
      fits_write_pix(fits.file, sample_type, first, image.width(), const_cast<Sample*>(image.row(v)), &status);
    }
    fits_flush_file(fits.file, &status);
    fits_get_hduaddrll(fits.file, nullptr, nullptr, &data_end, &status);
    if (status != 0) {
      return fail(ErrorCode::internal, "FITS could not be encoded ({s})", {}, path.string(), reason(status));
    }
  }
  const auto* bytes = static_cast<const char*>(memory.bytes);
  return write_file(path, std::string_view(bytes, std::min(memory.size, static_cast<std::size_t>(data_end))));
}

}  // namespace
}  // namespace raster

Result<void> write_fits(const std::filesystem::path& path, ImageView<const std::uint16_t> image,
                        const std::vector<FitsCard>& cards, const std::vector<std::string>& kept) {
  return raster::write(path, image, cards, kept, USHORT_IMG, TUSHORT);
}
Result<void> write_fits(const std::filesystem::path& path, ImageView<const float> image,
                        const std::vector<FitsCard>& cards, const std::vector<std::string>& kept) {
  return raster::write(path, image, cards, kept, FLOAT_IMG, TFLOAT);
}

}  // namespace astronav
