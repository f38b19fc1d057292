// SPDX-License-Identifier: Apache-2.0
// One reader for each format, from bytes in memory. Internal to this folder.
#pragma once

#include <cstddef>
#include <span>

#include "foundation/base/error.h"
#include "foundation/raster/raster.h"

namespace astronav::raster {

using Bytes = std::span<const std::byte>;

Result<Picture> read_png(Bytes file, const ReadLimits& limits);
Result<Picture> read_tiff(Bytes file, const ReadLimits& limits);
Result<Picture> read_jpeg(Bytes file, const ReadLimits& limits);
Result<Picture> read_fits(Bytes file, const ReadLimits& limits);

// limit_exceeded or corrupt_data where a size makes no sense.
Result<void> check_size(double width, double height, const ReadLimits& limits);

// Mean of the colour channels of interleaved samples, of which the first `colours` count.
template <typename Sample>
void luminance_row(const Sample* samples, int width, int samples_per_pixel, int colours, float* out) {
  const float share = 1.0f / static_cast<float>(colours);
  for (int u = 0; u < width; ++u, samples += samples_per_pixel) {
    float sum = 0.0f;
    for (int c = 0; c < colours; ++c) sum += static_cast<float>(samples[c]);
    out[u] = sum * share;
  }
}

}  // namespace astronav::raster
