// SPDX-License-Identifier: Apache-2.0
#include <bit>
#include <csetjmp>
#include <cstring>
#include <string>
#include <vector>

#include <png.h>

#include "foundation/files/mapped_file.h"
#include "foundation/raster/codecs.h"

namespace astronav {
namespace raster {
namespace {

// libpng leaves by longjmp, which must not skip a destructor: everything that owns memory lives in the caller's frame.
struct PngError {
  char message[160] = "";
};

void on_error(png_structp png, png_const_charp message) {
  auto* error = static_cast<PngError*>(png_get_error_ptr(png));
  std::strncpy(error->message, message, sizeof error->message - 1);
  std::longjmp(png_jmpbuf(png), 1);
}
void on_warning(png_structp, png_const_charp) {}

struct Source {
  Bytes rest;
};
void read_bytes(png_structp png, png_bytep out, std::size_t count) {
  auto* source = static_cast<Source*>(png_get_io_ptr(png));
  if (source->rest.size() < count) png_error(png, "the file ends too early");
  std::memcpy(out, source->rest.data(), count);
  source->rest = source->rest.subspan(count);
}

struct Reader {
  PngError error;
  Source source;
  png_structp png = nullptr;
  png_infop info = nullptr;
  Reader() {
    png = png_create_read_struct(PNG_LIBPNG_VER_STRING, &error, on_error, on_warning);
    if (png != nullptr) info = png_create_info_struct(png);
  }
  ~Reader() { png_destroy_read_struct(&png, &info, nullptr); }
  Reader(const Reader&) = delete;
  Reader& operator=(const Reader&) = delete;
};

bool read_header(Reader& reader) {
  if (setjmp(png_jmpbuf(reader.png)) != 0) return false;
  png_set_read_fn(reader.png, &reader.source, read_bytes);
  png_set_user_limits(reader.png, 0x7fffffff, 0x7fffffff);
  png_set_chunk_malloc_max(reader.png, 16 << 20);
  png_read_info(reader.png, reader.info);
  png_set_palette_to_rgb(reader.png);
  if (png_get_bit_depth(reader.png, reader.info) < 8) png_set_expand_gray_1_2_4_to_8(reader.png);
  if (std::endian::native == std::endian::little) png_set_swap(reader.png);  // a PNG is big-endian
  png_set_interlace_handling(reader.png);
  png_read_update_info(reader.png, reader.info);
  return true;
}

bool read_rows(Reader& reader, png_bytepp rows) {
  if (setjmp(png_jmpbuf(reader.png)) != 0) return false;
  png_read_image(reader.png, rows);
  png_read_end(reader.png, nullptr);
  return true;
}

tl::unexpected<Error> broken(const Reader& reader) {
  return fail(ErrorCode::corrupt_data, "broken PNG ({s})", {}, {}, reader.error.message);
}

}  // namespace

Result<Picture> read_png(Bytes file, const ReadLimits& limits) {
  Reader reader;
  if (reader.info == nullptr) return fail(ErrorCode::internal, "libpng could not be set up");
  reader.source.rest = file;
  if (!read_header(reader)) return broken(reader);
  const auto width = png_get_image_width(reader.png, reader.info);
  const auto height = png_get_image_height(reader.png, reader.info);
  if (const auto size = check_size(width, height, limits); !size) return forward(size);
  const int channels = png_get_channels(reader.png, reader.info);
  const int bits = png_get_bit_depth(reader.png, reader.info);
  const std::size_t row_bytes = png_get_rowbytes(reader.png, reader.info);

  std::vector<std::uint16_t> samples((row_bytes * height + 1) / 2);
  auto* const bytes = reinterpret_cast<png_bytep>(samples.data());
  std::vector<png_bytep> rows(height);
  for (std::size_t v = 0; v < height; ++v) rows[v] = bytes + v * row_bytes;
  if (!read_rows(reader, rows.data())) return broken(reader);

  Picture picture;
  picture.pixels = ImageF(static_cast<int>(width), static_cast<int>(height));
  picture.bits = bits;
  picture.white_level = bits == 16 ? 65535 : 255;
  const int colours = channels >= 3 ? 3 : 1;
  for (int v = 0; v < picture.pixels.height(); ++v) {
    if (bits == 16) {
      luminance_row(reinterpret_cast<const std::uint16_t*>(rows[v]), picture.pixels.width(), channels, colours,
                    picture.pixels.row(v));
    } else {
      luminance_row(rows[v], picture.pixels.width(), channels, colours, picture.pixels.row(v));
    }
  }
  return picture;
}

namespace {

void append_bytes(png_structp png, png_bytep data, std::size_t count) {
  static_cast<std::string*>(png_get_io_ptr(png))->append(reinterpret_cast<const char*>(data), count);
}
void flush_nothing(png_structp) {}

struct Writer {
  PngError error;
  png_structp png = nullptr;
  png_infop info = nullptr;
  Writer() {
    png = png_create_write_struct(PNG_LIBPNG_VER_STRING, &error, on_error, on_warning);
    if (png != nullptr) info = png_create_info_struct(png);
  }
  ~Writer() { png_destroy_write_struct(&png, &info); }
  Writer(const Writer&) = delete;
  Writer& operator=(const Writer&) = delete;
};

bool write_rows(Writer& writer, std::string& out, int width, int height, int bits, int colour_type, png_bytepp rows) {
  if (setjmp(png_jmpbuf(writer.png)) != 0) return false;
  png_set_write_fn(writer.png, &out, append_bytes, flush_nothing);
  png_set_compression_level(writer.png, 4);  // star fields gain little from more
  png_set_IHDR(writer.png, writer.info, static_cast<png_uint_32>(width), static_cast<png_uint_32>(height), bits,
               colour_type, PNG_INTERLACE_NONE, PNG_COMPRESSION_TYPE_DEFAULT, PNG_FILTER_TYPE_DEFAULT);
  png_write_info(writer.png, writer.info);
  if (bits == 16 && std::endian::native == std::endian::little) png_set_swap(writer.png);
  png_write_image(writer.png, rows);
  png_write_end(writer.png, nullptr);
  return true;
}

template <typename Sample>
Result<std::string> encode(ImageView<const Sample> image, int samples_per_pixel) {
  if (image.width() < samples_per_pixel || image.height() < 1 || image.width() % samples_per_pixel != 0) {
    return fail(ErrorCode::invalid_argument, "a picture of {0} x {1} samples cannot be written as PNG",
                {static_cast<double>(image.width()), static_cast<double>(image.height())});
  }
  std::vector<png_bytep> rows(static_cast<std::size_t>(image.height()));
  for (int v = 0; v < image.height(); ++v) {
    rows[static_cast<std::size_t>(v)] = reinterpret_cast<png_bytep>(const_cast<Sample*>(image.row(v)));
  }
  Writer writer;
  if (writer.info == nullptr) return fail(ErrorCode::internal, "libpng could not be set up");
  std::string out;
  const int colour_type = samples_per_pixel == 3 ? PNG_COLOR_TYPE_RGB : PNG_COLOR_TYPE_GRAY;
  if (!write_rows(writer, out, image.width() / samples_per_pixel, image.height(), 8 * static_cast<int>(sizeof(Sample)),
                  colour_type, rows.data())) {
    return fail(ErrorCode::internal, "PNG could not be encoded ({s})", {}, {}, writer.error.message);
  }
  return out;
}

Result<void> store(const std::filesystem::path& path, const Result<std::string>& encoded) {
  if (!encoded) return forward(encoded, path.string());
  return write_file(path, *encoded);
}

}  // namespace
}  // namespace raster

Result<std::string> encode_png8(ImageView<const std::uint8_t> image) {
  return raster::encode(image, 1);
}
Result<std::string> encode_png16(ImageView<const std::uint16_t> image) {
  return raster::encode(image, 1);
}
Result<std::string> encode_png_rgb(ImageView<const std::uint8_t> rgb_triplets) {
  return raster::encode(rgb_triplets, 3);
}
Result<void> write_png8(const std::filesystem::path& path, ImageView<const std::uint8_t> image) {
  return raster::store(path, encode_png8(image));
}
Result<void> write_png16(const std::filesystem::path& path, ImageView<const std::uint16_t> image) {
  return raster::store(path, encode_png16(image));
}

}  // namespace astronav
