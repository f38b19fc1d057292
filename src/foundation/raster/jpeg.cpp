// SPDX-License-Identifier: Apache-2.0
#include <csetjmp>
#include <cstdio>
#include <vector>

// jpeglib.h needs FILE, and jerror.h needs jpeglib.h.
// clang-format off
#include <jpeglib.h>
#include <jerror.h>
// clang-format on

#include "foundation/raster/codecs.h"

namespace astronav::raster {
namespace {

struct Reader {
  jpeg_decompress_struct jpeg{};
  jpeg_error_mgr manager{};
  std::jmp_buf leave{};
  char message[JMSG_LENGTH_MAX] = "";
  ~Reader() { jpeg_destroy_decompress(&jpeg); }
};

Reader& owner(j_common_ptr jpeg) {
  return *static_cast<Reader*>(jpeg->client_data);
}

// libjpeg leaves by longjmp, which must not skip a destructor: everything that owns memory lives in the caller's frame.
void on_error(j_common_ptr jpeg) {
  jpeg->err->format_message(jpeg, owner(jpeg).message);
  std::longjmp(owner(jpeg).leave, 1);
}

// Damage that libjpeg would patch over with grey is an error here; stray bytes between segments are not.
void on_message(j_common_ptr jpeg, int level) {
  if (level >= 0) return;
  switch (jpeg->err->msg_code) {
    case JWRN_JPEG_EOF:
    case JWRN_HIT_MARKER:
    case JWRN_HUFF_BAD_CODE:
    case JWRN_MUST_RESYNC:
    case JWRN_ARITH_BAD_CODE:
      on_error(jpeg);
      break;
    default:
      break;
  }
}

bool read_header(Reader& reader, Bytes file) {
  if (setjmp(reader.leave) != 0) return false;
  jpeg_create_decompress(&reader.jpeg);
  jpeg_mem_src(&reader.jpeg, reinterpret_cast<const unsigned char*>(file.data()), file.size());
  jpeg_read_header(&reader.jpeg, TRUE);
  reader.jpeg.out_color_space = reader.jpeg.num_components == 1 ? JCS_GRAYSCALE : JCS_RGB;
  jpeg_calc_output_dimensions(&reader.jpeg);
  return true;
}

bool read_rows(Reader& reader, unsigned char* row, ImageF& pixels) {
  if (setjmp(reader.leave) != 0) return false;
  jpeg_start_decompress(&reader.jpeg);
  while (reader.jpeg.output_scanline < reader.jpeg.output_height) {
    const int v = static_cast<int>(reader.jpeg.output_scanline);
    jpeg_read_scanlines(&reader.jpeg, &row, 1);
    luminance_row(row, pixels.width(), reader.jpeg.output_components, reader.jpeg.output_components, pixels.row(v));
  }
  jpeg_finish_decompress(&reader.jpeg);
  return true;
}

}  // namespace

Result<Picture> read_jpeg(Bytes file, const ReadLimits& limits) {
  Reader reader;
  reader.jpeg.err = jpeg_std_error(&reader.manager);
  reader.manager.error_exit = on_error;
  reader.manager.emit_message = on_message;
  reader.jpeg.client_data = &reader;
  const auto broken = [&] { return fail(ErrorCode::corrupt_data, "broken JPEG ({s})", {}, {}, reader.message); };
  if (!read_header(reader, file)) return broken();
  if (const auto size = check_size(reader.jpeg.output_width, reader.jpeg.output_height, limits); !size) {
    return forward(size);
  }
  Picture picture;
  picture.pixels = ImageF(static_cast<int>(reader.jpeg.output_width), static_cast<int>(reader.jpeg.output_height));
  picture.bits = 8;
  picture.white_level = 255;
  std::vector<unsigned char> row(static_cast<std::size_t>(reader.jpeg.output_width) * 4);
  if (!read_rows(reader, row.data(), picture.pixels)) return broken();
  return picture;
}

}  // namespace astronav::raster
