// SPDX-License-Identifier: Apache-2.0
// CentroidFinder: spots of light in a frame, brightest first, each with the covariance of its place.
//
// Regions: pixels above a constant threshold (background + n sigma, or a level given in DN), grown over 8 neighbours,
// with a margin of one pixel. Place: either the centre of the squared intensities, as in the EXTREMA papers, or a fit
// of the point-spread function (psf_fit.h). The covariance is that of the estimator used (docs/theory/vision.md eq. 1
// to 8). Regions at the border of the image, larger than `max_region_px` or sharper than any star are left out.
// Allocates in its constructor and never again.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "foundation/image/image.h"
#include "onboard/vision/psf_fit.h"
#include "onboard/vision/types.h"

namespace astronav::vision {

enum class CentroidMethod : unsigned char { squared_intensity, psf_fit };

struct CentroidSettings {
  CentroidMethod method = CentroidMethod::psf_fit;
  double threshold_sigma = 5.0;  // above the background, in its noise
  double threshold_dn = 0.0;     // above the background; used instead where > 0
  int min_region_px = 1;
  int max_region_px = 2000;
  int max_centroids = 200;   // the brightest are measured
  bool refuse_sharp = true;  // hot pixels and cosmic rays
};

struct FrameLevel {
  double background_dn = 0.0;  // mean of the pixels without sources
  double noise_dn = 0.0;       // their standard deviation
  double threshold_dn = 0.0;   // absolute
};

// Background and noise by a clipped mean over at most 32,768 pixels spread over the frame.
class CentroidFinder {
 public:
  CentroidFinder(const CentroidSettings& settings, const SensorModel& sensor, int max_width, int max_height);

  // Writes at most out.size() centroids, in order of falling flux; returns how many.
  std::size_t find(ImageView<const std::uint16_t> image, std::span<Centroid> out, FrameLevel* level = nullptr);
  std::size_t find(ImageView<const float> image, std::span<Centroid> out, FrameLevel* level = nullptr);

  // Where the level is known to the caller (threshold included).
  std::size_t find_above(ImageView<const std::uint16_t> image, const FrameLevel& level, std::span<Centroid> out);
  std::size_t find_above(ImageView<const float> image, const FrameLevel& level, std::span<Centroid> out);

  // Measures one spot again, its companion's light taken away. False, and `spot` untouched, where that fails.
  bool measure_beside(ImageView<const std::uint16_t> image, const FrameLevel& level, Pixel guess,
                      const Companion& companion, Centroid& spot) const;

  // More regions than there is room for: the threshold is too low for this frame.
  bool overflowed() const { return overflowed_; }
  // Systematic part of the squared-intensity centroid (1 sigma an axis, px): the S-curve of a Gaussian of this width.
  double s_curve_rms_px() const { return s_curve_rms_px_; }

 private:
  struct Run {
    std::int32_t parent;
    std::int16_t v, u0, u1;  // inclusive
    std::int16_t s0, s1;     // of the saturated pixels; s0 > s1 where there are none
    float sum, peak;         // above the background
  };
  struct Region {
    Window box;
    int pixels = 0;
    bool saturated = false;
    double sum = 0.0, peak = 0.0;
    Window saturated_box;
  };

  template <typename T>
  FrameLevel measure_level(ImageView<const T> image);
  template <typename T>
  std::size_t find_in(ImageView<const T> image, const FrameLevel& level, std::span<Centroid> out);
  template <typename T>
  void collect_runs(ImageView<const T> image, const FrameLevel& level);
  template <typename T>
  void add_run(ImageView<const T> image, const FrameLevel& level, int v, int u0, int u1);
  void join_rows(std::size_t above_first, std::size_t above_last, std::size_t first, std::size_t last);
  std::int32_t root(std::int32_t run);
  void collect_regions();
  template <typename T>
  bool by_squares(ImageView<const T> image, const FrameLevel& level, const Region& region, Centroid& out) const;
  template <typename T>
  bool by_fit(ImageView<const T> image, const FrameLevel& level, const Region& region, Centroid& out) const;

  CentroidSettings settings_;
  SensorModel sensor_;
  double s_curve_rms_px_ = 0.0;
  double sharpest_star_ = 1.0;  // largest share of a star's 3x3 light in one pixel
  bool overflowed_ = false;
  std::vector<Run> runs_;
  std::vector<std::int32_t> region_of_run_;
  std::vector<Region> regions_;
  std::vector<std::uint32_t> order_;
  std::vector<std::uint32_t> histogram_;
  std::vector<float> samples_;
};

}  // namespace astronav::vision
