// SPDX-License-Identifier: Apache-2.0
// CentroidFinder: spots of light in a frame, brightest first, each with the covariance of its place.
//
// Regions: pixels above background + n sigma (or a level given in DN), grown over 8 neighbours, with a margin of one
// pixel; background and noise are one number each, or a map where the frame is uneven (background.h). Place: either the
// centre of the squared intensities, as in the EXTREMA papers, or a fit of the point-spread function (psf_fit.h), which
// is learned in flight from saturated and bright stars (psf_model.h). The covariance is that of the estimator used
// (docs/theory/vision.md eq. 1 to 8). Regions at the border of the image are left out; what is no point of light is set
// apart. Allocates in its constructor and never again.
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "foundation/image/image.h"
#include "onboard/vision/background.h"
#include "onboard/vision/psf_fit.h"
#include "onboard/vision/psf_group_fit.h"
#include "onboard/vision/psf_lessons.h"
#include "onboard/vision/regions.h"
#include "onboard/vision/spot_shape.h"
#include "onboard/vision/types.h"

namespace astronav::vision {

enum class CentroidMethod : unsigned char { squared_intensity, psf_fit };

struct CentroidSettings {
  CentroidMethod method = CentroidMethod::psf_fit;
  double threshold_sigma = 5.0;  // above the background, in its noise
  double threshold_dn = 0.0;     // above the background; used instead where > 0
  int min_region_px = 1;
  int max_region_px = 2000;  // more is an extended object
  int max_centroids = 200;   // the brightest are measured
  bool refuse_sharp = true;  // sets apart what is no point of light
  bool learn_psf = true;     // from frame to frame
};

class CentroidFinder {
 public:
  CentroidFinder(const CentroidSettings& settings, const SensorModel& sensor, int max_width, int max_height);

  // Writes at most out.size() centroids, in order of falling flux; returns how many. Pixels of 8 bits, 16 bits (or
  // fewer, in the low ones) or float.
  std::size_t find(ImageView<const std::uint8_t> image, std::span<Centroid> out, FrameLevel* level = nullptr);
  std::size_t find(ImageView<const std::uint16_t> image, std::span<Centroid> out, FrameLevel* level = nullptr);
  std::size_t find(ImageView<const float> image, std::span<Centroid> out, FrameLevel* level = nullptr);

  // Only where something is expected. Nothing where that will not do and the whole frame must be looked at: an uneven
  // background, a saturated spot or one all along a column that reaches beyond, a turning camera. At first a glance:
  // level and rough places, of which nothing is remembered.
  std::optional<std::size_t> glance(ImageView<const std::uint16_t> image, const Attention& attention,
                                    std::span<Centroid> out, FrameLevel& level);
  std::optional<std::size_t> find_within(ImageView<const std::uint16_t> image, const Attention& attention,
                                         const FrameLevel& level, std::span<Centroid> out);
  // The next frame is the last one once more: what was remembered of the one before stays, what was learned of this one
  // is not learned twice.
  void look_again();

  // Where the level is known to the caller (threshold included).
  std::size_t find_above(ImageView<const std::uint16_t> image, const FrameLevel& level, std::span<Centroid> out);
  std::size_t find_above(ImageView<const float> image, const FrameLevel& level, std::span<Centroid> out);

  // Measures one body of the last frame, of about `flux_dn`, beside others whose light runs into its own (`disc`: of
  // the radius 0 where it is a point's); from the first guess that leads to a good fit, or the best. False, and `spot`
  // untouched, where that fails.
  bool measure_beside(ImageView<const std::uint16_t> image, const FrameLevel& level, std::span<const Pixel> guesses,
                      double flux_dn, const LitDisc& disc, std::span<const LightBeside> beside, Centroid& spot);

  // Measures a saturated spot of the last frame once more, as the disc that it is; what it taught of the point-spread
  // function as a point's is learnt anew. False, and `spot` untouched, where that fails.
  bool measure_disc(ImageView<const std::uint16_t> image, const FrameLevel& level, const LitDisc& disc, Centroid& spot);

  // What the last frame showed beside points of light, by its kind; places by the centre of light.
  std::span<const Centroid> others() const { return others_; }
  // More regions than there is room for: the threshold is too low for this frame.
  bool overflowed() const { return regions_.overflowed(); }
  // The stars of the last frame were streaks, all alike: the camera turned.
  bool moving() const { return moving_; }
  // Whether the last frame's background was a map.
  bool uneven() const { return !background_.even(); }
  // Systematic part of the squared-intensity centroid (1 sigma an axis, px): the S-curve of a Gaussian of this width.
  double s_curve_rms_px() const { return s_curve_rms_px_; }

  const PsfBelief& psf() const { return lessons_.belief(); }
  void forget_psf() { lessons_.forget(); }

 private:
  struct Candidate {
    std::uint32_t region = 0;
    Window core;  // of a saturated one
    Moments moments;
    SpotKind kind = SpotKind::point;
  };
  template <typename T>
  std::size_t find_whole(ImageView<const T> image, std::span<Centroid> out, FrameLevel* level);
  template <typename T>
  std::size_t find_in(ImageView<const T> image, const FrameLevel& level, std::span<Centroid> out);
  FrameLevel with_threshold(FrameLevel level) const;
  template <typename T>
  void grow_regions(ImageView<const T> image, const FrameLevel& level);
  template <typename T>
  std::size_t measure_chosen(ImageView<const T> image, CentroidMethod method, std::span<Centroid> out);
  bool choose_within(ImageView<const std::uint16_t> image, const Attention& attention, const FrameLevel& level,
                     std::size_t wanted);
  template <typename T>
  void choose(ImageView<const T> image, std::size_t wanted);
  Mat2 common_motion();
  bool smeared(int height) const;
  SpotKind kind_of_sharp(Pixel peak);
  template <typename T>
  bool by_squares(ImageView<const T> image, const Region& region, Centroid& out) const;
  template <typename T>
  bool by_fit(ImageView<const T> image, const Candidate& candidate, Centroid& out);
  template <typename T>
  void consider_lesson(ImageView<const T> image, const Region& region, const PsfFit& fit, const LocalPsf& psf,
                       const LocalLevel& level, const PsfEvidence& evidence);
  bool alone(const Window& window, const Region& region) const;
  // The saturated pixels that hang together about a place; that pixel alone where it is none of them.
  Window core_about(ImageView<const std::uint16_t> image, Pixel place, int most_px) const;
  // That and what a fit wants about it; nothing where it is more than a fit can hold.
  std::optional<Window> window_about(ImageView<const std::uint16_t> image, Pixel place, const LocalPsf& psf) const;
  LocalLevel level_under(Pixel place, const FrameLevel& level) const;

  CentroidSettings settings_;
  SensorModel sensor_;
  double s_curve_rms_px_ = 0.0;
  bool moving_ = false;
  PsfLessons lessons_;
  Background background_;
  Regions regions_;
  const Attention* attention_ = nullptr;  // of this frame; nullptr: everywhere
  struct Ranked {
    double light;
    std::uint32_t region;
  };
  std::vector<Ranked> order_;
  std::vector<Candidate> candidates_;
  std::vector<Centroid> others_;
  std::vector<double> excess_;
  // Pixels that were sharper than any star, in this frame and in the last.
  static constexpr std::size_t kSharp = 256;
  std::array<std::array<Pixel, kSharp>, 2> sharp_;
  std::array<std::size_t, 2> sharp_count_{};
};

}  // namespace astronav::vision
