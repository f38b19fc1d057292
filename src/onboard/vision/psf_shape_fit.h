// SPDX-License-Identifier: Apache-2.0
// Place, flux and all six numbers of the point-spread function against the light in a window: the normal equations, and
// Levenberg-Marquardt on them with a prior. Internal to this folder.
#pragma once

#include <array>

#include "onboard/vision/psf_fit.h"

namespace astronav::vision {

// Pixels of a window in rows of kMaxFitWindow, above the background, and which of them count.
struct Patch {
  Window window;
  double noise_dn = 0.0;
  alignas(64) std::array<double, kMaxFitWindow * kMaxFitWindow> light;
  alignas(64) std::array<double, kMaxFitWindow * kMaxFitWindow> counts;  // 1 or 0

  // Width, rounded up to whole groups of lanes.
  int padded_width() const { return (window.width() + kLanes - 1) / kLanes * kLanes; }
  bool saturated() const { return saturated_; }

  // Saturated pixels do not count; where the detector blooms, no pixel of their columns does.
  template <typename T>
  void load(ImageView<const T> image, const Window& w, const LocalLevel& level, const SensorModel& sensor);

 private:
  bool saturated_ = false;
};

// One spot of light on the axes of a window: its core, and the halo's two parts. A disc's, as spread_px2() tells it, is
// that of a point, wider.
struct SpotProfiles {
  AxisProfile x, y, inner_x, inner_y, outer_x, outer_y;
  void compute(const Window& w, Pixel at, const LocalPsf::Vector& shape, const Vec2& spread_px2);
};

// The light of a patch less what the core of a disc in it has beyond such a spot's, in rows of kMaxFitWindow. (A halo
// is so much wider than the disc that its form is the spot's.) A fit of the spot to it moves the disc's place, from
// which it is made anew, until it stays (eq. 8d).
using WindowLight = std::array<double, kMaxFitWindow * kMaxFitWindow>;
WindowLight as_of_spot(const Patch& seen, const LitDisc& disc, Pixel at, double core_flux, double sigma_px);
inline constexpr int kMostDiscPasses = 8;
inline constexpr double kDiscSettledPx = 2e-4;

// Beyond this chi-square per degree of freedom something else is in the window.
inline constexpr double kBlendChi2 = 2.5;
// A fit that strangers may have spoilt (no neighbour whose light is like its own: that is no stranger), and one that
// did better without them. What a window with strangers tells of the point-spread function is not learned.
inline bool is_odd(const PsfFit& fit) {
  constexpr double kLeastChi2 = 1.3, kMostChi2 = 100.0;
  return fit.converged && fit.chi2_per_dof > kLeastChi2 && fit.chi2_per_dof < kMostChi2;
}
inline bool is_better(const PsfFit& alone, const PsfFit& before) {
  return alone.converged && alone.chi2_per_dof < before.chi2_per_dof;
}
// Then the covariance grows with it: not as this image's noise, since most of what is there will be there in the next.
PsfFit inflated(PsfFit fit);

// Sets aside (counts = 0) what lies about pixels that hold much more light than the model of the body at `body`, and
// are not near it: a star that nobody listed, a proton. `excess`: light less model, in sigmas. False, and nothing set
// aside: there is none, or so much that the model must be wrong.
inline constexpr double kMostAmongStrangersPx = 1.5;  // the radius of a disc whose own limb is not taken for one
bool set_strangers_aside(Patch& patch, const WindowLight& excess, Pixel body);

class ShapeFit {
 public:
  static constexpr int kFlux = 2, kShape = 3, kParameters = kShape + LocalPsf::count;
  using Vector = Eigen::Matrix<double, kParameters, 1>;  // u, v, ln(flux of the core), shape
  using Matrix = Eigen::Matrix<double, kParameters, kParameters>;

  ShapeFit(const Patch& patch, const SensorModel& sensor, const Vec2& spread_px2 = Vec2::Zero())
      : patch_(patch), sensor_(sensor), spread_px2_(spread_px2) {}

  // A saturated spot. `prior`: what is believed of the point-spread function here.
  PsfFit run(Pixel guess, const LocalPsf& prior, PsfEvidence* evidence);
  // Where the last run ended.
  const Vector& solution() const { return solution_; }

  // Weights from the model at p, then information and gradient of the likelihood, and chi-square.
  void look(const Vector& p) {
    profiles(p);
    weigh(p);
    cost_ = linearize(p);
  }
  const Matrix& information() const { return information_; }
  const Vector& gradient() const { return gradient_; }
  double chi2() const { return cost_; }
  int pixels() const { return pixels_; }
  // Light less model where the last run ended, in sigmas; 0 where nothing counts.
  WindowLight excess();
  PsfEvidence evidence(const Vector& p) const;

 private:
  bool inside(const Vector& p) const;
  bool start_flux(Vector& p);
  void profiles(const Vector& p);
  void weigh(const Vector& p);
  double misfit(const Vector& p) const;
  double linearize(const Vector& p);

  const Patch& patch_;
  const SensorModel& sensor_;
  Vec2 spread_px2_;
  SpotProfiles point_;
  alignas(64) std::array<double, kMaxFitWindow * kMaxFitWindow> weight_;
  Vector solution_ = Vector::Zero();
  Matrix information_;
  Vector gradient_;
  double cost_ = 0.0;
  int pixels_ = 0;
};

}  // namespace astronav::vision
