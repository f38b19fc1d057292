// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cstdio>
#include <cstring>
#include <memory>
#include <vector>

#include <tiffio.h>

#include "foundation/raster/codecs.h"

namespace astronav::raster {
namespace {

struct Source {
  Bytes file;
  toff_t at = 0;
  char message[160] = "";
};

Source& source_of(thandle_t handle) {
  return *static_cast<Source*>(handle);
}

tmsize_t read_bytes(thandle_t handle, void* out, tmsize_t count) {
  Source& source = source_of(handle);
  if (source.at >= source.file.size() || count <= 0) return 0;
  const auto n = std::min<std::size_t>(static_cast<std::size_t>(count), source.file.size() - source.at);
  std::memcpy(out, source.file.data() + source.at, n);
  source.at += n;
  return static_cast<tmsize_t>(n);
}
tmsize_t write_bytes(thandle_t, void*, tmsize_t) {
  return 0;
}
toff_t seek(thandle_t handle, toff_t offset, int whence) {
  Source& source = source_of(handle);
  switch (whence) {
    case SEEK_CUR:
      source.at += offset;
      break;
    case SEEK_END:
      source.at = source.file.size() + offset;
      break;
    default:
      source.at = offset;
      break;
  }
  return source.at;
}
int close_nothing(thandle_t) {
  return 0;
}
toff_t size_of(thandle_t handle) {
  return source_of(handle).file.size();
}

int on_error(TIFF*, void* user, const char*, const char* format, va_list arguments) {
  Source& source = source_of(user);
  if (source.message[0] == '\0') std::vsnprintf(source.message, sizeof source.message, format, arguments);
  return 1;
}
// Only a warning to libtiff: a tag whose values lie beyond the end of the file is left out. A picture without its
// colour map would be a wrong one.
int on_warning(TIFF* tiff, void* user, const char* module, const char* format, va_list arguments) {
  return std::strncmp(format, "IO error", 8) == 0 ? on_error(tiff, user, module, format, arguments) : 1;
}

struct Close {
  void operator()(TIFF* tiff) const { TIFFClose(tiff); }
};
using Handle = std::unique_ptr<TIFF, Close>;

Handle open(Source& source) {
  TIFFOpenOptions* options = TIFFOpenOptionsAlloc();
  if (options == nullptr) return nullptr;
  TIFFOpenOptionsSetMaxSingleMemAlloc(options, tmsize_t{1} << 30);
  TIFFOpenOptionsSetErrorHandlerExtR(options, on_error, &source);
  TIFFOpenOptionsSetWarningHandlerExtR(options, on_warning, &source);
  Handle tiff(TIFFClientOpenExt("picture", "rm", &source, read_bytes, write_bytes, seek, close_nothing, size_of,
                                nullptr, nullptr, options));
  TIFFOpenOptionsFree(options);
  return tiff;
}

struct Layout {
  std::uint32_t width = 0, height = 0;
  std::uint16_t bits = 1, samples = 1, format = SAMPLEFORMAT_UINT, planar = PLANARCONFIG_CONTIG,
                photometric = PHOTOMETRIC_MINISBLACK, compression = COMPRESSION_NONE;
  bool plain() const {
    const bool grey_or_rgb = photometric == PHOTOMETRIC_MINISBLACK || photometric == PHOTOMETRIC_RGB;
    const bool type =
        (format == SAMPLEFORMAT_UINT && (bits == 8 || bits == 16)) || (format == SAMPLEFORMAT_IEEEFP && bits == 32);
    return grey_or_rgb && type && samples >= 1 && samples <= 8;
  }
  int colours() const { return photometric == PHOTOMETRIC_RGB && samples >= 3 ? 3 : 1; }
};

Layout layout_of(TIFF* tiff) {
  Layout layout;
  TIFFGetField(tiff, TIFFTAG_IMAGEWIDTH, &layout.width);
  TIFFGetField(tiff, TIFFTAG_IMAGELENGTH, &layout.height);
  TIFFGetFieldDefaulted(tiff, TIFFTAG_BITSPERSAMPLE, &layout.bits);
  TIFFGetFieldDefaulted(tiff, TIFFTAG_SAMPLESPERPIXEL, &layout.samples);
  TIFFGetFieldDefaulted(tiff, TIFFTAG_SAMPLEFORMAT, &layout.format);
  TIFFGetFieldDefaulted(tiff, TIFFTAG_PLANARCONFIG, &layout.planar);
  TIFFGetFieldDefaulted(tiff, TIFFTAG_COMPRESSION, &layout.compression);
  TIFFGetField(tiff, TIFFTAG_PHOTOMETRIC, &layout.photometric);
  return layout;
}

void add_row(const void* samples, const Layout& layout, int samples_per_pixel, int colours, float* out) {
  const int width = static_cast<int>(layout.width);
  if (layout.format == SAMPLEFORMAT_IEEEFP) {
    luminance_row(static_cast<const float*>(samples), width, samples_per_pixel, colours, out);
  } else if (layout.bits == 16) {
    luminance_row(static_cast<const std::uint16_t*>(samples), width, samples_per_pixel, colours, out);
  } else {
    luminance_row(static_cast<const std::uint8_t*>(samples), width, samples_per_pixel, colours, out);
  }
}

// Values as stored, row by row.
bool read_plain(TIFF* tiff, const Layout& layout, ImageF& pixels) {
  const bool separate = layout.planar == PLANARCONFIG_SEPARATE && layout.samples > 1;
  const int samples_per_pixel = separate ? 1 : layout.samples;
  const auto row_bytes = static_cast<std::size_t>(TIFFScanlineSize64(tiff));
  const std::size_t needed =
      static_cast<std::size_t>(layout.width) * static_cast<std::size_t>(samples_per_pixel) * (layout.bits / 8u);
  if (row_bytes < needed) return false;
  std::vector<double> row(row_bytes / sizeof(double) + 1);
  std::vector<float> plane(separate ? layout.width : 0u);
  const int planes = separate ? layout.colours() : 1;
  for (int p = 0; p < planes; ++p) {
    for (std::uint32_t v = 0; v < layout.height; ++v) {
      if (TIFFReadScanline(tiff, row.data(), v, static_cast<std::uint16_t>(p)) != 1) return false;
      float* out = pixels.row(static_cast<int>(v));
      if (!separate) {
        add_row(row.data(), layout, samples_per_pixel, layout.colours(), out);
        continue;
      }
      add_row(row.data(), layout, 1, 1, plane.data());
      for (std::uint32_t u = 0; u < layout.width; ++u) out[u] += plane[u] / static_cast<float>(planes);
    }
  }
  return true;
}

// Palettes, tiles, YCbCr and the like: libtiff's own conversion to 8-bit colour.
bool read_converted(TIFF* tiff, const Layout& layout, ImageF& pixels) {
  std::vector<std::uint32_t> rgba(static_cast<std::size_t>(layout.width) * layout.height);
  if (TIFFReadRGBAImageOriented(tiff, layout.width, layout.height, rgba.data(), ORIENTATION_TOPLEFT, 1) != 1) {
    return false;
  }
  auto out = pixels.pixels();
  for (std::size_t i = 0; i < rgba.size(); ++i) {
    out[i] = static_cast<float>(TIFFGetR(rgba[i]) + TIFFGetG(rgba[i]) + TIFFGetB(rgba[i])) / 3.0f;
  }
  return true;
}

}  // namespace

Result<Picture> read_tiff(Bytes file, const ReadLimits& limits) {
  Source source{.file = file};
  const Handle tiff = open(source);
  const auto broken = [&] {
    return fail(ErrorCode::corrupt_data, "broken TIFF ({s})", {}, {},
                source.message[0] != '\0' ? source.message : "it contradicts itself");
  };
  if (!tiff || source.message[0] != '\0') return broken();
  const Layout layout = layout_of(tiff.get());
  if (const auto size = check_size(layout.width, layout.height, limits); !size) return forward(size);
  Picture picture;
  picture.pixels = ImageF(static_cast<int>(layout.width), static_cast<int>(layout.height));
  if (layout.plain() && TIFFIsTiled(tiff.get()) == 0) {
    if (!read_plain(tiff.get(), layout, picture.pixels) || source.message[0] != '\0') return broken();
    picture.bits = layout.bits;
    picture.white_level = layout.bits == 16 ? 65535 : 255;
    if (layout.format == SAMPLEFORMAT_IEEEFP) {
      const auto pixels = picture.pixels.pixels();
      picture.white_level = *std::max_element(pixels.begin(), pixels.end());
    }
    return picture;
  }
  char reason[1024] = "";
  if (TIFFRGBAImageOK(tiff.get(), reason) != 1) {
    return fail(ErrorCode::unsupported, "this kind of TIFF is not read ({s})", {}, {}, reason);
  }
  if (!read_converted(tiff.get(), layout, picture.pixels) || source.message[0] != '\0') return broken();
  picture.bits = 8;
  picture.white_level = 255;
  return picture;
}

}  // namespace astronav::raster
