// SPDX-License-Identifier: Apache-2.0
// Image<T> and ImageView<T>: rows of pixels, row 0 at the top, (u, v) = (column, row), no files.
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <type_traits>
#include <vector>

#include "foundation/base/check.h"

namespace astronav {

// Pixels that somebody else owns. `stride` is the distance between rows in pixels.
template <typename T>
class ImageView {
 public:
  ImageView() = default;
  ImageView(T* data, int width, int height, int stride) : data_(data), width_(width), height_(height), stride_(stride) {
    ASTRONAV_CHECK(width >= 0 && height >= 0 && stride >= width);
  }
  ImageView(T* data, int width, int height) : ImageView(data, width, height, width) {}
  // A view of constant pixels from one of mutable pixels.
  template <typename U>
    requires(std::is_same_v<const U, T> && !std::is_const_v<U>)
  ImageView(const ImageView<U>& other)  // NOLINT(google-explicit-constructor)
      : ImageView(other.data(), other.width(), other.height(), other.stride()) {}

  int width() const { return width_; }
  int height() const { return height_; }
  int stride() const { return stride_; }
  T* data() const { return data_; }
  T* row(int v) const { return data_ + static_cast<std::ptrdiff_t>(v) * stride_; }
  T& operator()(int u, int v) const { return row(v)[u]; }
  bool contains(int u, int v) const { return u >= 0 && v >= 0 && u < width_ && v < height_; }

 private:
  T* data_ = nullptr;
  int width_ = 0;
  int height_ = 0;
  int stride_ = 0;
};

template <typename T>
class Image {
 public:
  Image() = default;
  Image(int width, int height, T value = T{})
      : pixels_(static_cast<std::size_t>(width) * static_cast<std::size_t>(height), value),
        width_(width),
        height_(height) {}

  int width() const { return width_; }
  int height() const { return height_; }
  T* row(int v) { return pixels_.data() + static_cast<std::ptrdiff_t>(v) * width_; }
  const T* row(int v) const { return pixels_.data() + static_cast<std::ptrdiff_t>(v) * width_; }
  T& operator()(int u, int v) { return row(v)[u]; }
  const T& operator()(int u, int v) const { return row(v)[u]; }
  std::span<T> pixels() { return pixels_; }
  std::span<const T> pixels() const { return pixels_; }
  ImageView<T> view() { return {pixels_.data(), width_, height_}; }
  ImageView<const T> view() const { return {pixels_.data(), width_, height_}; }
  operator ImageView<T>() { return view(); }              // NOLINT(google-explicit-constructor)
  operator ImageView<const T>() const { return view(); }  // NOLINT(google-explicit-constructor)

 private:
  std::vector<T> pixels_;
  int width_ = 0;
  int height_ = 0;
};

using ImageU16 = Image<std::uint16_t>;
using ImageF = Image<float>;

}  // namespace astronav
