// SPDX-License-Identifier: Apache-2.0
#include "onboard/vision/psf_fit.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>

#include <Eigen/Cholesky>
#include <Eigen/LU>

#include "onboard/vision/psf_shape_fit.h"

namespace astronav::vision {
namespace {

constexpr int kMaxIterations = 40;
// A step this short is the last: the next would be a hundredth of it.
constexpr double kConverged = 1e-3;       // px
constexpr double kConvergedSigmas = 0.2;  // of the place's own noise

ShapeFit::Vector parameters(const PsfFit& fit, const LocalPsf& psf) {
  ShapeFit::Vector p;
  const double core = fit.flux_dn / (1.0 + psf.value[LocalPsf::halo_share]);
  p << fit.pixel.u, fit.pixel.v, std::log(core), psf.value;
  return p;
}

// Free: u, v and the flux of the core. The halo follows in steps.
class PointFit {
 public:
  PointFit(const Patch& patch, const SensorModel& sensor, const LocalPsf& psf)
      : patch_(patch), sensor_(sensor), psf_(psf) {}

  PsfFit run(Pixel guess) {
    const Window& w = patch_.window;
    PsfFit fit;
    fit.sigma_px = psf_.sigma_px();
    place(guess);
    double u = guess.u, v = guess.v, flux = start_flux();
    if (!(flux > 0.0)) return fit;
    // Where the halo stays far below the noise it may be left out.
    const double halo_peak = psf_.value[LocalPsf::halo_share] /
                             (2.0 * kPi * psf_.value[LocalPsf::halo_width] * psf_.value[LocalPsf::halo_width]);
    with_halo_ = flux * halo_peak > 0.1 * patch_.noise_dn;
    if (with_halo_) place_halo({u, v});
    for (int iteration = 0; iteration < kMaxIterations; ++iteration) {
      linearize(flux);
      fit.chi2_per_dof = chi2_ / std::max(1, w.width() * w.height() - 3);
      Mat3 covariance;
      bool known = false;
      information_.computeInverseWithCheck(covariance, known, 0.0);
      if (!known || !(covariance.diagonal().minCoeff() > 0.0)) return fit;
      Vec3 step = covariance * gradient_;
      const double length = step.head<2>().norm();
      if (length > 0.5) step *= 0.5 / length;
      u += step(0);
      v += step(1);
      flux = std::max(flux + step(2), 0.2 * flux);
      if (!(u >= w.u0 - 0.5 && u <= w.u1 + 0.5 && v >= w.v0 - 0.5 && v <= w.v1 + 0.5)) return fit;
      const double noise = std::sqrt(0.5 * (covariance(0, 0) + covariance(1, 1)));
      if (length < std::max(kConverged, kConvergedSigmas * noise)) {
        fit.converged = true;
        fit.covariance_px2 = fit.noise_px2 = covariance.topLeftCorner<2, 2>();
        fit.flux_sigma_dn = std::sqrt(covariance(2, 2));
        break;
      }
      place({u, v});
      if (with_halo_ && length > 0.05) place_halo({u, v});
    }
    fit.pixel = {u, v};
    fit.flux_dn = flux * (1.0 + psf_.value[LocalPsf::halo_share]);
    return fit;
  }

 private:
  void place(Pixel at) {
    const Window& w = patch_.window;
    x_.compute(w.u0, w.width(), at.u, psf_.sigma_px());
    y_.compute(w.v0, w.height(), at.v, psf_.sigma_px());
  }

  void place_halo(Pixel at) {
    const Window& w = patch_.window;
    const double u = at.u + psf_.value[LocalPsf::halo_u], v = at.v + psf_.value[LocalPsf::halo_v];
    const double width = psf_.value[LocalPsf::halo_width], share = psf_.value[LocalPsf::halo_share];
    const double outer = share * psf_.value[LocalPsf::outer_share], inner = share - outer;
    AxisProfile ax, ay, bx, by;
    ax.compute(w.u0, w.width(), u, width);
    ay.compute(w.v0, w.height(), v, width);
    bx.compute(w.u0, w.width(), u, LocalPsf::kOuterWidth * width);
    by.compute(w.v0, w.height(), v, LocalPsf::kOuterWidth * width);
    for (int j = 0; j < w.height(); ++j) {
      const double of_inner = inner * ay.share[static_cast<std::size_t>(j)];
      const double of_outer = outer * by.share[static_cast<std::size_t>(j)];
      for (int i = 0; i < patch_.padded_width(); ++i) {
        const auto k = static_cast<std::size_t>(i);
        halo_[static_cast<std::size_t>(j * kMaxFitWindow) + k] = of_inner * ax.share[k] + of_outer * bx.share[k];
      }
    }
  }

  // The flux that fits the guess best.
  double start_flux() const {
    double gd = 0.0, gg = 0.0;
    for (int j = 0; j < patch_.window.height(); ++j) {
      const double* light = patch_.light.data() + j * kMaxFitWindow;
      for (int i = 0; i < patch_.window.width(); ++i) {
        const double g = x_.share[static_cast<std::size_t>(i)] * y_.share[static_cast<std::size_t>(j)];
        gd += g * light[i];
        gg += g * g;
      }
    }
    return gd / gg;
  }

  void linearize(double flux) {
    using Lanes = std::array<double, kLanes>;
    alignas(64) std::array<Lanes, 6> products{};
    alignas(64) std::array<Lanes, 3> slopes{};
    alignas(64) Lanes chi2{};
    const double noise2 = patch_.noise_dn * patch_.noise_dn, shot = 1.0 / sensor_.gain_e_dn;
    const double prnu2 = sensor_.photo_nonuniformity * sensor_.photo_nonuniformity;
    for (int j = 0; j < patch_.window.height(); ++j) {
      const double sy = y_.share[static_cast<std::size_t>(j)];
      const double fy = flux * sy, fdy = flux * y_.by_center[static_cast<std::size_t>(j)];
      for (int group = 0; group < patch_.padded_width(); group += kLanes) {
        const auto first = static_cast<std::size_t>(group);
        const std::size_t pixel = static_cast<std::size_t>(j * kMaxFitWindow) + first;
        alignas(64) Lanes halo{};
        if (with_halo_) std::copy_n(halo_.begin() + static_cast<std::ptrdiff_t>(pixel), kLanes, halo.begin());
        for (std::size_t l = 0; l < kLanes; ++l) {
          const std::size_t i = first + l;
          const double jf = sy * x_.share[i] + halo[l];
          const double signal = flux * jf;
          const double weight = patch_.counts[pixel + l] / (noise2 + signal * (shot + prnu2 * signal));
          const double residual = patch_.light[pixel + l] - signal;
          const double ju = fy * x_.by_center[i], jv = fdy * x_.share[i];
          const double wu = weight * ju, wv = weight * jv, wf = weight * jf, wr = weight * residual;
          products[0][l] += wu * ju;
          products[1][l] += wu * jv;
          products[2][l] += wu * jf;
          products[3][l] += wv * jv;
          products[4][l] += wv * jf;
          products[5][l] += wf * jf;
          slopes[0][l] += wr * ju;
          slopes[1][l] += wr * jv;
          slopes[2][l] += wr * jf;
          chi2[l] += wr * residual;
        }
      }
    }
    const auto total = [](const Lanes& lanes) {
      double s = 0.0;
      for (const double lane : lanes) s += lane;
      return s;
    };
    information_ << total(products[0]), total(products[1]), total(products[2]), total(products[1]), total(products[3]),
        total(products[4]), total(products[2]), total(products[4]), total(products[5]);
    gradient_ << total(slopes[0]), total(slopes[1]), total(slopes[2]);
    chi2_ = total(chi2);
  }

  const Patch& patch_;
  const SensorModel& sensor_;
  const LocalPsf& psf_;
  AxisProfile x_, y_;
  bool with_halo_ = false;
  alignas(64) std::array<double, kMaxFitWindow * kMaxFitWindow> halo_;
  Mat3 information_;
  Vec3 gradient_;
  double chi2_ = 0.0;
};

// What an error of the point-spread function moves the place by (eq. 7), as it stands in the normal equations.
void consider_shape(const ShapeFit& about, const LocalPsf& psf, PsfFit& fit) {
  const Eigen::LLT<Mat3> llt(Mat3(about.information().topLeftCorner<ShapeFit::kShape, ShapeFit::kShape>()));
  if (llt.info() != Eigen::Success) return;
  const Eigen::Matrix<double, ShapeFit::kShape, LocalPsf::count> mixed =
      about.information().topRightCorner<ShapeFit::kShape, LocalPsf::count>();
  const Eigen::Matrix<double, 2, LocalPsf::count> moved = llt.solve(mixed).topRows<2>();
  const Mat2 by_shape = moved * psf.covariance * moved.transpose();
  fit.covariance_px2 += by_shape;
  fit.repeating_sigma_px = std::sqrt(0.5 * by_shape.trace());
}

// Once more where strangers are in the window, without them.
PsfFit fit_saturated(Patch& patch, Pixel guess, const SensorModel& sensor, const LocalPsf& psf, PsfEvidence* evidence) {
  ShapeFit about(patch, sensor);
  const PsfFit fit = about.run(guess, psf, evidence);
  if (!is_odd(fit) || !about.solution().allFinite() || !set_strangers_aside(patch, about.excess(), fit.pixel))
    return inflated(fit);
  const PsfFit alone = about.run(guess, psf, nullptr);
  // What a disc has beyond a point is no stranger's.
  constexpr double kWiderThanAPoint = 1.15;
  if (!is_better(alone, fit) || alone.sigma_px > kWiderThanAPoint * psf.sigma_px()) return inflated(fit);
  if (evidence != nullptr) *evidence = {};
  return inflated(alone);
}

PsfFit fit_patch(Patch& patch, Pixel guess, const SensorModel& sensor, const LocalPsf& psf, PsfEvidence* evidence) {
  // Beyond this signal-to-noise ratio a width that is off by some percent shows.
  constexpr double kConsidered = 80.0;
  if (patch.saturated()) return fit_saturated(patch, guess, sensor, psf.of_body(), evidence);
  PsfFit fit = PointFit(patch, sensor, psf).run(guess);
  if (fit.converged && fit.flux_dn > kConsidered * fit.flux_sigma_dn) {
    ShapeFit about(patch, sensor);
    const ShapeFit::Vector p = parameters(fit, psf);
    about.look(p);
    consider_shape(about, psf, fit);
    if (evidence != nullptr) *evidence = about.evidence(p);
  }
  return inflated(fit);
}

}  // namespace

int reach_about_full_px(const Window& full, const LocalPsf& psf) {
  const int least = psf.reach_px() + 1, room = (kMaxFitWindow - std::max(full.width(), full.height())) / 2;
  return std::clamp(room, least, least + 4);
}

template <typename T>
PsfFit fit_psf(ImageView<const T> image, const Window& window, Pixel guess, const LocalLevel& level,
               const SensorModel& sensor, const LocalPsf& psf, PsfEvidence* evidence) {
  ASTRONAV_CHECK(image.contains(window.u0, window.v0) && image.contains(window.u1, window.v1));
  ASTRONAV_CHECK(window.width() <= kMaxFitWindow && window.height() <= kMaxFitWindow);
  Patch patch;
  patch.load(image, window, level, sensor);
  return fit_patch(patch, guess, sensor, psf, evidence);
}

PsfFit fit_psf_of_disc(ImageView<const std::uint16_t> image, const Window& window, Pixel guess, const LocalLevel& level,
                       const SensorModel& sensor, const LocalPsf& psf, const LitDisc& disc, PsfEvidence* evidence) {
  ASTRONAV_CHECK(image.contains(window.u0, window.v0) && image.contains(window.u1, window.v1));
  ASTRONAV_CHECK(window.width() <= kMaxFitWindow && window.height() <= kMaxFitWindow);
  Patch seen;
  seen.load(image, window, level, sensor);
  Patch as_spot = seen;
  ShapeFit about(as_spot, sensor, spread_px2(disc));
  const auto settle = [&](Pixel start, PsfEvidence* told) {
    PsfFit fit = about.run(start, psf.of_disc(), told);
    ShapeFit::Vector p = about.solution();
    for (int pass = 0; pass < kMostDiscPasses && p.allFinite(); ++pass) {
      as_spot.light =
          as_of_spot(seen, disc, {p(0), p(1)}, std::exp(p(ShapeFit::kFlux)), p(ShapeFit::kShape + LocalPsf::width));
      fit = about.run(fit.pixel, psf.of_disc(), told);
      const double moved = (about.solution() - p).head<2>().norm();
      p = about.solution();
      if (moved < kDiscSettledPx) break;
    }
    return fit;
  };
  const PsfFit fit = settle(guess, evidence);
  const bool small = disc.radius_px < kMostAmongStrangersPx;
  if (!small || !is_odd(fit) || !about.solution().allFinite() ||
      !set_strangers_aside(as_spot, about.excess(), fit.pixel))
    return inflated(fit);
  const PsfFit alone = settle(guess, nullptr);
  if (!is_better(alone, fit)) return inflated(fit);
  if (evidence != nullptr) *evidence = {};
  return inflated(alone);
}

template <typename T>
PsfFit fit_psf(ImageView<const T> image, const Window& window, Pixel guess, double background_dn,
               double background_sigma_dn, const SensorModel& sensor) {
  return fit_psf(image, window, guess, {guess, background_dn, 0.0, 0.0, background_sigma_dn, nullptr}, sensor,
                 LocalPsf::from(sensor));
}

template <typename T>
bool psf_evidence(ImageView<const T> image, const Window& window, const PsfFit& fit, const LocalLevel& level,
                  const SensorModel& sensor, const LocalPsf& psf, PsfEvidence& evidence) {
  if (window.width() > kMaxFitWindow || window.height() > kMaxFitWindow) return false;
  Patch patch;
  patch.load(image, window, level, sensor);
  if (patch.saturated()) return false;
  ShapeFit about(patch, sensor);
  const ShapeFit::Vector p = parameters(fit, psf);
  about.look(p);
  const double degrees = std::max(1, about.pixels() - ShapeFit::kParameters);
  // About as believed: one step says it all. Else the shape is sought from there.
  constexpr double kAsBelieved = 1.5;
  double misfit = about.chi2() / degrees;
  if (misfit < kAsBelieved) {
    evidence = about.evidence(p);
  } else {
    const PsfFit sought = about.run(fit.pixel, psf, &evidence);
    if (!sought.converged || (sought.pixel.vec() - fit.pixel.vec()).norm() > 0.5) return false;
    misfit = sought.chi2_per_dof;
  }
  // No point-spread function is of this form, so a bright star always leaves something; beyond this it is two stars.
  constexpr double kMostMisfit = 10.0;
  if (misfit > kMostMisfit) return false;
  evidence.weaken(misfit);
  return true;
}

#define ASTRONAV_FITS_OF(T)                                                                                   \
  template PsfFit fit_psf<T>(ImageView<const T>, const Window&, Pixel, const LocalLevel&, const SensorModel&, \
                             const LocalPsf&, PsfEvidence*);                                                  \
  template PsfFit fit_psf<T>(ImageView<const T>, const Window&, Pixel, double, double, const SensorModel&);   \
  template bool psf_evidence<T>(ImageView<const T>, const Window&, const PsfFit&, const LocalLevel&,          \
                                const SensorModel&, const LocalPsf&, PsfEvidence&);
ASTRONAV_FITS_OF(std::uint8_t)
ASTRONAV_FITS_OF(std::uint16_t)
ASTRONAV_FITS_OF(float)
#undef ASTRONAV_FITS_OF

}  // namespace astronav::vision
