// SPDX-License-Identifier: Apache-2.0
// Files are made with the codec libraries themselves, so that writer and reader cannot share a mistake of ours.
#include "foundation/raster/raster.h"

#include <cstdio>  // jpeglib.h needs FILE
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <iterator>
#include <string>

#include <gtest/gtest.h>
#include <jpeglib.h>
#include <png.h>
#include <tiffio.h>
#include <unistd.h>

#include "foundation/files/mapped_file.h"

namespace astronav {
namespace {

namespace fs = std::filesystem;

class Raster : public ::testing::Test {
 protected:
  void SetUp() override {
    folder_ = fs::temp_directory_path() / ("astronav_raster_" + std::to_string(::getpid()));
    fs::create_directories(folder_);
  }
  void TearDown() override { fs::remove_all(folder_); }
  fs::path file(const std::string& name) const { return folder_ / name; }
  fs::path folder_;
};

std::string bytes_of(const fs::path& path) {
  std::ifstream in(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(in), {}};
}

ImageU16 ramp(int width, int height) {
  ImageU16 image(width, height);
  for (int v = 0; v < height; ++v) {
    for (int u = 0; u < width; ++u) image(u, v) = static_cast<std::uint16_t>(1000 * v + 7 * u + 3);
  }
  return image;
}

void expect_ramp(const Picture& picture, int width, int height) {
  ASSERT_EQ(picture.pixels.width(), width);
  ASSERT_EQ(picture.pixels.height(), height);
  for (int v = 0; v < height; ++v) {
    for (int u = 0; u < width; ++u) ASSERT_EQ(picture.pixels(u, v), static_cast<float>(1000 * v + 7 * u + 3));
  }
}

// PNG of any colour type, big-endian samples as the format has them.
void make_png(const fs::path& path, int width, int height, int bits, int colour_type, const std::string& samples,
              const std::vector<png_color>& palette = {}, int interlace = PNG_INTERLACE_NONE) {
  std::FILE* out = std::fopen(path.c_str(), "wb");
  png_structp png = png_create_write_struct(PNG_LIBPNG_VER_STRING, nullptr, nullptr, nullptr);
  png_infop info = png_create_info_struct(png);
  png_init_io(png, out);
  png_set_IHDR(png, info, static_cast<png_uint_32>(width), static_cast<png_uint_32>(height), bits, colour_type,
               interlace, PNG_COMPRESSION_TYPE_DEFAULT, PNG_FILTER_TYPE_DEFAULT);
  if (!palette.empty()) png_set_PLTE(png, info, palette.data(), static_cast<int>(palette.size()));
  png_write_info(png, info);
  std::vector<png_bytep> rows;
  const std::size_t row_bytes = samples.size() / static_cast<std::size_t>(height);
  for (int v = 0; v < height; ++v) {
    rows.push_back(reinterpret_cast<png_bytep>(const_cast<char*>(samples.data())) +
                   row_bytes * static_cast<std::size_t>(v));
  }
  png_write_image(png, rows.data());
  png_write_end(png, nullptr);
  png_destroy_write_struct(&png, &info);
  std::fclose(out);
}

void make_tiff(const fs::path& path, int width, int height, int bits, int samples, int photometric, const void* data,
               int compression, const char* mode = "w") {
  TIFF* tiff = TIFFOpen(path.c_str(), mode);
  TIFFSetField(tiff, TIFFTAG_IMAGEWIDTH, width);
  TIFFSetField(tiff, TIFFTAG_IMAGELENGTH, height);
  TIFFSetField(tiff, TIFFTAG_BITSPERSAMPLE, bits);
  TIFFSetField(tiff, TIFFTAG_SAMPLESPERPIXEL, samples);
  TIFFSetField(tiff, TIFFTAG_PHOTOMETRIC, photometric);
  TIFFSetField(tiff, TIFFTAG_PLANARCONFIG, PLANARCONFIG_CONTIG);
  TIFFSetField(tiff, TIFFTAG_COMPRESSION, compression);
  TIFFSetField(tiff, TIFFTAG_ROWSPERSTRIP, 4);
  if (samples == 4) {
    const std::uint16_t alpha = EXTRASAMPLE_UNASSALPHA;
    TIFFSetField(tiff, TIFFTAG_EXTRASAMPLES, 1, &alpha);
  }
  if (photometric == PHOTOMETRIC_PALETTE) {
    std::vector<std::uint16_t> red(256), green(256), blue(256);
    for (std::size_t i = 0; i < 256; ++i) {
      red[i] = static_cast<std::uint16_t>(257 * i);
      green[i] = static_cast<std::uint16_t>(257 * (255 - i));
      blue[i] = 257 * 30;
    }
    TIFFSetField(tiff, TIFFTAG_COLORMAP, red.data(), green.data(), blue.data());
  }
  const auto row_bytes = static_cast<std::size_t>(width * samples * bits / 8);
  std::vector<char> row(row_bytes);
  for (int v = 0; v < height; ++v) {
    std::memcpy(row.data(), static_cast<const char*>(data) + row_bytes * static_cast<std::size_t>(v), row_bytes);
    TIFFWriteScanline(tiff, row.data(), static_cast<std::uint32_t>(v));
  }
  TIFFClose(tiff);
}

void make_jpeg(const fs::path& path, int width, int height, int components, const std::string& samples) {
  std::FILE* out = std::fopen(path.c_str(), "wb");
  jpeg_compress_struct jpeg{};
  jpeg_error_mgr errors{};
  jpeg.err = jpeg_std_error(&errors);
  jpeg_create_compress(&jpeg);
  jpeg_stdio_dest(&jpeg, out);
  jpeg.image_width = static_cast<JDIMENSION>(width);
  jpeg.image_height = static_cast<JDIMENSION>(height);
  jpeg.input_components = components;
  jpeg.in_color_space = components == 1 ? JCS_GRAYSCALE : JCS_RGB;
  jpeg_set_defaults(&jpeg);
  jpeg_set_quality(&jpeg, 98, TRUE);
  jpeg_start_compress(&jpeg, TRUE);
  while (jpeg.next_scanline < jpeg.image_height) {
    auto* row = reinterpret_cast<JSAMPROW>(
        const_cast<char*>(samples.data() + static_cast<std::size_t>(jpeg.next_scanline) * width * components));
    jpeg_write_scanlines(&jpeg, &row, 1);
  }
  jpeg_finish_compress(&jpeg);
  jpeg_destroy_compress(&jpeg);
  std::fclose(out);
}

TEST_F(Raster, Png16RoundTripAndByteOrder) {
  ASSERT_TRUE(write_png16(file("a.png"), ramp(9, 5)));
  const Result<Picture> picture = read_picture(file("a.png"));
  ASSERT_TRUE(picture) << describe(picture.error());
  expect_ramp(*picture, 9, 5);
  EXPECT_EQ(picture->bits, 16);
  EXPECT_EQ(picture->white_level, 65535);
  // Big-endian samples written by libpng itself: 0x0102 is 258.
  make_png(file("b.png"), 2, 1, 16, PNG_COLOR_TYPE_GRAY, std::string("\x01\x02\xff\xfe", 4));
  const Result<Picture> big_endian = read_picture(file("b.png"));
  ASSERT_TRUE(big_endian);
  EXPECT_EQ(big_endian->pixels(0, 0), 258.0f);
  EXPECT_EQ(big_endian->pixels(1, 0), 65534.0f);
}

TEST_F(Raster, PngColoursBecomeTheirMeanAndAlphaIsIgnored) {
  const std::string rgb("\x00\x1e\x3c\xff\xff\xff", 6);
  make_png(file("rgb.png"), 2, 1, 8, PNG_COLOR_TYPE_RGB, rgb);
  const std::string rgba("\x00\x1e\x3c\x00\xff\xff\xff\x80", 8);
  make_png(file("rgba.png"), 2, 1, 8, PNG_COLOR_TYPE_RGBA, rgba, {}, PNG_INTERLACE_ADAM7);
  make_png(file("palette.png"), 2, 1, 8, PNG_COLOR_TYPE_PALETTE, std::string("\x01\x00", 2),
           {{255, 255, 255}, {0, 30, 60}});
  make_png(file("ga.png"), 2, 1, 8, PNG_COLOR_TYPE_GRAY_ALPHA, std::string("\x1e\x00\xff\x80", 4));
  for (const char* name : {"rgb.png", "rgba.png", "palette.png", "ga.png"}) {
    const Result<Picture> picture = read_picture(file(name));
    ASSERT_TRUE(picture) << describe(picture.error());
    EXPECT_FLOAT_EQ(picture->pixels(0, 0), 30.0f) << name;
    EXPECT_FLOAT_EQ(picture->pixels(1, 0), 255.0f) << name;
    EXPECT_EQ(picture->bits, 8);
  }
  make_png(file("one.png"), 8, 1, 1, PNG_COLOR_TYPE_GRAY, std::string("\xa0", 1));
  const Result<Picture> one_bit = read_picture(file("one.png"));
  ASSERT_TRUE(one_bit);
  EXPECT_EQ(one_bit->pixels(0, 0), 255.0f);
  EXPECT_EQ(one_bit->pixels(1, 0), 0.0f);
}

TEST_F(Raster, Png8AndRgbEncoders) {
  Image<std::uint8_t> grey(3, 2);
  grey(2, 1) = 200;
  ASSERT_TRUE(write_png8(file("g.png"), grey));
  EXPECT_EQ(read_picture(file("g.png"))->pixels(2, 1), 200.0f);
  Image<std::uint8_t> triplets(6, 1);
  triplets(3, 0) = 90;
  const Result<std::string> png = encode_png_rgb(triplets);
  ASSERT_TRUE(png);
  ASSERT_TRUE(write_file(file("t.png"), *png));
  const Result<Picture> picture = read_picture(file("t.png"));
  ASSERT_EQ(picture->pixels.width(), 2);
  EXPECT_FLOAT_EQ(picture->pixels(1, 0), 30.0f);
}

TEST_F(Raster, TiffOfAllUsualKinds) {
  const ImageU16 image = ramp(9, 10);
  for (const int compression : {COMPRESSION_NONE, COMPRESSION_LZW, COMPRESSION_ADOBE_DEFLATE}) {
    for (const char* mode : {"wl", "wb", "w8"}) {  // little-endian, big-endian, BigTIFF
      make_tiff(file("a.tif"), 9, 10, 16, 1, PHOTOMETRIC_MINISBLACK, image.pixels().data(), compression, mode);
      const Result<Picture> picture = read_picture(file("a.tif"));
      ASSERT_TRUE(picture) << describe(picture.error());
      expect_ramp(*picture, 9, 10);
    }
  }
  const std::string rgba("\x00\x1e\x3c\x80\xff\xff\xff\x10", 8);
  make_tiff(file("rgba.tif"), 2, 1, 8, 4, PHOTOMETRIC_RGB, rgba.data(), COMPRESSION_NONE);
  Result<Picture> picture = read_picture(file("rgba.tif"));
  ASSERT_TRUE(picture) << describe(picture.error());
  EXPECT_FLOAT_EQ(picture->pixels(0, 0), 30.0f);
  EXPECT_EQ(picture->white_level, 255);
  const std::string indices("\x0a\xff", 2);
  make_tiff(file("palette.tif"), 2, 1, 8, 1, PHOTOMETRIC_PALETTE, indices.data(), COMPRESSION_NONE);
  picture = read_picture(file("palette.tif"));
  ASSERT_TRUE(picture) << describe(picture.error());
  EXPECT_FLOAT_EQ(picture->pixels(0, 0), (10.0f + 245.0f + 30.0f) / 3.0f);
}

TEST_F(Raster, JpegGreyAndColour) {
  std::string grey;
  std::string colour;
  for (int i = 0; i < 32 * 32; ++i) {
    grey.push_back(static_cast<char>(100));
    colour.push_back(static_cast<char>(60));
    colour.push_back(static_cast<char>(100));
    colour.push_back(static_cast<char>(140));
  }
  make_jpeg(file("g.jpg"), 32, 32, 1, grey);
  make_jpeg(file("c.jpg"), 32, 32, 3, colour);
  for (const char* name : {"g.jpg", "c.jpg"}) {
    const Result<Picture> picture = read_picture(file(name));
    ASSERT_TRUE(picture) << describe(picture.error());
    EXPECT_EQ(picture->pixels.width(), 32);
    EXPECT_NEAR(picture->pixels(16, 16), 100.0f, 1.5f);
    EXPECT_EQ(picture->white_level, 255);
  }
}

TEST_F(Raster, AnotherPicturesHeaderIsKeptWhereItStillHolds) {
  const auto text = [](const char* key, const std::string& value) {
    return FitsCard{.key = key, .text = value, .number = {}, .comment = ""};
  };
  const std::string letter(100, 'x');
  ASSERT_TRUE(write_fits(file("a.fits"), ramp(9, 5),
                         {text("OBJECT", "O'Neil"),
                          text("LETTER", letter),
                          text("CTYPE1", "RA---TAN"),
                          {.key = "CRVAL1", .text = {}, .number = 5.0, .comment = ""},
                          {.key = "A_ORDER", .text = {}, .number = 2.0, .comment = ""},
                          {.key = "GAIN", .text = {}, .number = 1.5, .comment = "e/DN"}}));
  const Result<Picture> first = read_picture(file("a.fits"));
  ASSERT_TRUE(first) << describe(first.error());
  // Other pixels, another place on the sky.
  ASSERT_TRUE(write_fits(file("b.fits"), ImageF(4, 3, 1.5f),
                         {{.key = "CRVAL1", .text = {}, .number = 7.0, .comment = ""}}, first->header_cards));
  const Result<Picture> second = read_picture(file("b.fits"));
  ASSERT_TRUE(second) << describe(second.error());
  EXPECT_EQ(second->pixels.width(), 4);
  EXPECT_EQ(second->pixels(1, 1), 1.5f);
  EXPECT_EQ(second->header.at("OBJECT"), first->header.at("OBJECT"));
  EXPECT_EQ(second->header.at("GAIN"), "1.5");
  EXPECT_EQ(std::stod(second->header.at("CRVAL1")), 7.0);
  EXPECT_FALSE(second->header.contains("CTYPE1"));
  EXPECT_FALSE(second->header.contains("A_ORDER"));
  EXPECT_EQ(second->header.at("BITPIX"), "-32");
  EXPECT_NE(bytes_of(file("b.fits")).find("CONTINUE  'xxx"), std::string::npos);
}

TEST_F(Raster, FitsRoundTripWithTheTopRowLast) {
  const std::vector<FitsCard> cards = {{.key = "CRPIX1", .text = {}, .number = 512.25, .comment = "a number"},
                                       {.key = "CTYPE1", .text = "RA---TAN", .number = {}, .comment = ""},
                                       {.key = "NFRAMES", .text = {}, .number = 3.0, .comment = ""}};
  ASSERT_TRUE(write_fits(file("a.fits"), ramp(9, 5), cards));
  const Result<Picture> picture = read_picture(file("a.fits"));
  ASSERT_TRUE(picture) << describe(picture.error());
  expect_ramp(*picture, 9, 5);
  EXPECT_EQ(picture->white_level, 65535);
  EXPECT_EQ(picture->header.at("CTYPE1"), "RA---TAN");
  EXPECT_EQ(std::stod(picture->header.at("CRPIX1")), 512.25);
  EXPECT_EQ(picture->header.at("NFRAMES"), "3");
  // In the bytes: the last of the five rows of 18 bytes is row v = 0, big-endian with BZERO 32768.
  const std::string bytes = bytes_of(file("a.fits"));
  ASSERT_EQ(bytes.size() % 2880, 0u);
  const std::size_t data = bytes.size() - 2880;
  const auto sample = [&](std::size_t i) {
    return static_cast<int>(static_cast<std::int16_t>((static_cast<unsigned char>(bytes[data + 2 * i]) << 8) |
                                                      static_cast<unsigned char>(bytes[data + 2 * i + 1]))) +
           32768;
  };
  EXPECT_EQ(sample(4 * 9), 3);
  EXPECT_EQ(sample(0), 4003);

  ImageF floats(4, 3, 1.5f);
  floats(1, 0) = -2.25f;
  ASSERT_TRUE(write_fits(file("f.fits"), floats, {}));
  const Result<Picture> back = read_picture(file("f.fits"));
  ASSERT_TRUE(back);
  EXPECT_EQ(back->pixels(1, 0), -2.25f);
  EXPECT_EQ(back->white_level, 1.5);
  for (const float scale : {1e30f, 1e-30f}) {
    floats(2, 1) = scale;
    floats(1, 0) = 0.5f * scale;
    for (float& value : floats.pixels()) value = std::min(value, scale);
    ASSERT_TRUE(write_fits(file("far.fits"), floats, {}));
    const Result<Picture> far = read_picture(file("far.fits"));
    ASSERT_FALSE(far);
    EXPECT_EQ(far.error().code, ErrorCode::unsupported);
  }
}

TEST_F(Raster, RawFrames) {
  const Result<RawLayout> layout = parse_raw_layout("3x2,u16be,5");
  ASSERT_TRUE(layout);
  ASSERT_TRUE(write_file(file("a.raw"), std::string("HEAD!\x01\x02\x00\x03\x00\x04\x00\x05\x00\x06\x00\x07", 17)));
  const Result<Picture> picture = read_picture(file("a.raw"), *layout);
  ASSERT_TRUE(picture) << describe(picture.error());
  EXPECT_EQ(picture->pixels(0, 0), 258.0f);
  EXPECT_EQ(picture->pixels(2, 1), 7.0f);
  EXPECT_EQ(read_picture(file("a.raw"), *parse_raw_layout("3x2,u16le,5"))->pixels(0, 0), 513.0f);
  EXPECT_EQ(read_picture(file("a.raw"), *parse_raw_layout("17x1,u8,0"))->pixels(1, 0), 69.0f);
  const Result<Picture> short_file = read_picture(file("a.raw"), *parse_raw_layout("3x3,u16be,5"));
  ASSERT_FALSE(short_file);
  EXPECT_EQ(short_file.error().code, ErrorCode::corrupt_data);
  for (const char* text :
       {"", "3x2", "3x2,u32,0", "0x2,u8,0", "3x2,u8,", "3x2,u8,-1", "3x2,u8,0,", "3x2,u8,0x", "3*2,u8,0"}) {
    EXPECT_FALSE(parse_raw_layout(text)) << text;
  }
}

TEST_F(Raster, WhatIsNoPictureGetsOneClearError) {
  EXPECT_EQ(read_picture(file("none.png")).error().code, ErrorCode::not_found);
  ASSERT_TRUE(write_file(file("empty.png"), ""));
  EXPECT_EQ(read_picture(file("empty.png")).error().code, ErrorCode::corrupt_data);
  ASSERT_TRUE(write_file(file("text.png"), "This is not a picture.\n"));
  const Result<Picture> text = read_picture(file("text.png"));
  EXPECT_EQ(text.error().code, ErrorCode::unsupported);
  EXPECT_NE(describe(text.error()).find("text.png"), std::string::npos);
  EXPECT_FALSE(read_picture(folder_));
}

TEST_F(Raster, PicturesBeyondTheLimitAreRefusedBeforeMemoryIsTaken) {
  const std::string grey(64, '\x10');
  ASSERT_TRUE(write_png16(file("a.png"), ramp(8, 8)));
  ASSERT_TRUE(write_fits(file("a.fits"), ramp(8, 8), {}));
  make_tiff(file("a.tif"), 8, 8, 8, 1, PHOTOMETRIC_MINISBLACK, grey.data(), COMPRESSION_NONE);
  make_jpeg(file("a.jpg"), 8, 8, 1, grey);
  for (const char* name : {"a.png", "a.fits", "a.tif", "a.jpg"}) {
    const Result<Picture> picture = read_picture(file(name), {}, {.max_pixels = 63});
    ASSERT_FALSE(picture) << name;
    EXPECT_EQ(picture.error().code, ErrorCode::limit_exceeded) << name;
  }
  // A FITS header that promises 10^10 pixels in 2880 bytes.
  std::string bytes = bytes_of(file("a.fits"));
  const std::size_t at = bytes.find("NAXIS1  =");
  bytes.replace(at, 30, "NAXIS1  =               100000");
  bytes.replace(at + 80, 30, "NAXIS2  =               100000");
  ASSERT_TRUE(write_file(file("huge.fits"), bytes));
  EXPECT_EQ(read_picture(file("huge.fits")).error().code, ErrorCode::limit_exceeded);
}

// Every truncation and 400 random mutations of a file of each kind: an error with a text or a picture of a sane size,
// never a crash, and not a byte on standard error.
TEST_F(Raster, DamagedFilesNeverCrashAndStayQuiet) {
  std::string colour;
  for (int i = 0; i < 24 * 24 * 3; ++i) colour.push_back(static_cast<char>(i * 37 % 251));
  ASSERT_TRUE(write_png16(file("a.png"), ramp(24, 24)));
  make_png(file("b.png"), 24, 24, 8, PNG_COLOR_TYPE_RGB, colour, {}, PNG_INTERLACE_ADAM7);
  ASSERT_TRUE(write_fits(file("a.fits"), ramp(24, 24), {}));
  make_tiff(file("a.tif"), 24, 24, 8, 3, PHOTOMETRIC_RGB, colour.data(), COMPRESSION_LZW);
  make_tiff(file("b.tif"), 24, 24, 8, 1, PHOTOMETRIC_PALETTE, colour.data(), COMPRESSION_NONE);
  make_jpeg(file("a.jpg"), 24, 24, 3, colour);

  std::fflush(stderr);
  const int saved = ::dup(STDERR_FILENO);
  std::FILE* captured = std::tmpfile();
  ::dup2(::fileno(captured), STDERR_FILENO);

  std::uint64_t state = 12345;
  const auto random = [&](std::size_t below) {
    state = state * 6364136223846793005u + 1442695040888963407u;
    return static_cast<std::size_t>((state >> 33) % below);
  };
  int errors = 0;
  std::map<std::string, int> accepted;  // truncated, yet read
  const auto try_one = [&](const std::string& bytes) {
    ASSERT_TRUE(write_file(file("damaged"), bytes));
    const Result<Picture> picture = read_picture(file("damaged"), {}, {.max_pixels = 4'000'000});
    if (picture) {
      EXPECT_GT(picture->pixels.width(), 0);
    } else {
      ++errors;
      EXPECT_FALSE(describe(picture.error()).empty());
    }
  };
  for (const char* name : {"a.png", "b.png", "a.fits", "a.tif", "b.tif", "a.jpg"}) {
    const std::string good = bytes_of(file(name));
    ASSERT_TRUE(read_picture(file(name))) << name;
    const std::size_t step = good.size() / 150 + 1;
    for (std::size_t length = 0; length < good.size() - 64; length += step) {
      const int before = errors;
      try_one(good.substr(0, length));
      if (errors == before) ++accepted[name];
    }
    for (int i = 0; i < 400; ++i) {
      std::string bytes = good;
      const std::size_t changes = 1 + random(4);
      // Half of the changes strike the head, where sizes and addresses lie.
      for (std::size_t c = 0; c < changes; ++c) {
        const std::size_t span = random(2) == 0 ? std::min<std::size_t>(bytes.size(), 200) : bytes.size();
        bytes[random(span)] = static_cast<char>(random(256));
      }
      try_one(bytes);
    }
  }

  std::fflush(stderr);
  ::dup2(saved, STDERR_FILENO);
  ::close(saved);
  const long noise = (std::fseek(captured, 0, SEEK_END), std::ftell(captured));
  std::fclose(captured);
  EXPECT_EQ(noise, 0) << "bytes on standard error";
  EXPECT_GT(errors, 1000);
  // Of a FITS file the padding behind the last pixel may be missing (1728 of 5760 bytes, cut in steps of 39).
  EXPECT_LE(accepted["a.fits"], 45);
  accepted.erase("a.fits");
  EXPECT_TRUE(accepted.empty()) << accepted.begin()->first;
}

}  // namespace
}  // namespace astronav
