// SPDX-License-Identifier: Apache-2.0
// What a frame shows where no source is: level and noise of the whole frame, and a map of both where one number will
// not do (stray light, glow of the sky, columns that a bright source smeared).
//
// Level and noise come from at most 32,768 pixels spread over the frame, clipped at four sigma. Whether a map is
// needed is seen from them: the means of 16 x 16 tiles scatter more than their noise explains. Allocates in its
// constructor and never again.
#pragma once

#include <span>
#include <vector>

#include "foundation/image/image.h"
#include "onboard/vision/psf_fit.h"

namespace astronav::vision {

struct FrameLevel {
  double background_dn = 0.0;  // mean of the pixels without sources
  double noise_dn = 0.0;       // their standard deviation
  double threshold_dn = 0.0;   // absolute
};

class Background {
 public:
  explicit Background(int max_width);

  // Looks at a frame; the threshold is left to the caller. Of an uneven frame: the middle values of the map.
  static constexpr std::size_t kMaxSamples = 32768;
  template <typename T>
  FrameLevel measure(ImageView<const T> image, std::size_t samples = kMaxSamples);
  // Level and noise are told; even everywhere.
  void set(const FrameLevel& level);
  // What bright sources left all along their columns, from 64 rows; beside what is known.
  template <typename T>
  void measure_columns(ImageView<const T> image);

  bool even() const { return !mapped_ && !columned_; }
  // The plane under a pixel and its surroundings.
  LocalLevel at(Pixel pixel) const;
  // Background plus `sigma` times the noise (or `threshold_dn`, where that is given) along a row; until the next call.
  std::span<const float> threshold_row(int v, double sigma, double threshold_dn, int width) const;

 private:
  static constexpr int kTiles = 16;
  struct Node {
    float background = 0.0f, noise = 0.0f;
  };
  template <typename T>
  FrameLevel measure_even(ImageView<const T> image, std::size_t samples);
  bool is_uneven(int height) const;
  int row_of(int sample, int height) const;
  template <typename T>
  FrameLevel measure_map(ImageView<const T> image);
  template <typename T>
  Node measure_tile(ImageView<const T> image, int column, int row);
  // Nodes about a coordinate (pixels), and how far it lies between them; beyond the outermost the line goes on.
  struct Between {
    int node;
    double t;
  };
  Between between(double at, double tile) const;

  FrameLevel level_;
  bool mapped_ = false;
  bool columned_ = false;
  double tile_width_ = 1.0, tile_height_ = 1.0;
  std::vector<Node> nodes_;
  std::vector<float> columns_;
  int rows_ = 1, step_ = 1;  // of the samples: so many rows, and of them every so many pixels
  std::vector<float> samples_;
  mutable std::vector<float> row_;
};

}  // namespace astronav::vision
