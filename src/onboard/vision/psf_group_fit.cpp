// SPDX-License-Identifier: Apache-2.0
#include "onboard/vision/psf_group_fit.h"

#include <algorithm>
#include <array>
#include <cmath>

#include <Eigen/Cholesky>
#include <Eigen/LU>

#include "onboard/vision/psf_shape_fit.h"

namespace astronav::vision {
namespace {

constexpr int kMaxIterations = 40;
// A step this short is the last: px, and ln(flux).
constexpr double kConverged = 1e-4, kOthersConverged = 1e-3, kFluxConverged = 1e-2;
// What is believed of the body's light is right to 0.3 mag: phase laws and colours.
constexpr double kFluxSigma = 0.3;
// No place beside another is known better than a lens is.
constexpr double kLeastOffsetPx = 0.003;

// The body's place, the logarithm of its core's flux and the shape of all, as in ShapeFit; then of each of the others
// place (or offset) and flux.
constexpr int kOthers = ShapeFit::kParameters, kEach = 3;
constexpr int kMostParameters = kOthers + kEach * static_cast<int>(kMostBeside);
using Vector = Eigen::Matrix<double, Eigen::Dynamic, 1, 0, kMostParameters, 1>;
using Matrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, 0, kMostParameters, kMostParameters>;

LocalPsf::Vector shape_of(const Vector& p) {
  return p.segment<LocalPsf::count>(ShapeFit::kShape);
}

// Light of one point in one pixel, and its slopes by place, ln(flux) and shape.
struct Light {
  double signal, halo;
  ShapeFit::Vector slopes;

  Light(const SpotProfiles& of, std::size_t i, std::size_t j, double flux, const LocalPsf::Vector& shape) {
    const double share = shape(LocalPsf::halo_share), outer = shape(LocalPsf::outer_share), inner = 1.0 - outer;
    const double a = of.inner_x.share[i] * of.inner_y.share[j], b = of.outer_x.share[i] * of.outer_y.share[j];
    const double around = flux * (inner * a + outer * b);
    const double halo_u = flux * (inner * of.inner_x.by_center[i] * of.inner_y.share[j] +
                                  outer * of.outer_x.by_center[i] * of.outer_y.share[j]);
    const double halo_v = flux * (inner * of.inner_x.share[i] * of.inner_y.by_center[j] +
                                  outer * of.outer_x.share[i] * of.outer_y.by_center[j]);
    const double a_width = of.inner_x.by_sigma[i] * of.inner_y.share[j] + of.inner_x.share[i] * of.inner_y.by_sigma[j];
    const double b_width = of.outer_x.by_sigma[i] * of.outer_y.share[j] + of.outer_x.share[i] * of.outer_y.by_sigma[j];
    halo = share * around;
    signal = flux * of.x.share[i] * of.y.share[j] + halo;
    slopes << flux * of.x.by_center[i] * of.y.share[j] + share * halo_u,
        flux * of.x.share[i] * of.y.by_center[j] + share * halo_v, signal,
        flux * (of.x.by_sigma[i] * of.y.share[j] + of.x.share[i] * of.y.by_sigma[j]), around,
        share * flux * (inner * a_width + outer * LocalPsf::kOuterWidth * b_width), share * flux * (b - a),
        share * halo_u, share * halo_v;
  }
};

class GroupFitter {
 public:
  GroupFitter(const Patch& patch, const SensorModel& sensor, const LocalPsf& psf, double flux_dn, const LitDisc& disc,
              std::span<const LightBeside> beside)
      : patch_(patch),
        light_(patch.light),
        sensor_(sensor),
        disc_(disc),
        spread_px2_(spread_px2(disc)),
        beside_(beside),
        believed_(Vector::Zero(kOthers + kEach * static_cast<int>(beside.size()))),
        belief_(Matrix::Zero(believed_.size(), believed_.size())) {
    const LocalPsf prior = disc.radius_px > 0.0 ? psf.of_disc() : patch.saturated() ? psf.of_body() : psf;
    const double whole = 1.0 + prior.value[LocalPsf::halo_share];
    believed_(ShapeFit::kFlux) = std::log(flux_dn / whole);
    believed_.segment<LocalPsf::count>(ShapeFit::kShape) = prior.value;
    belief_.block<LocalPsf::count, LocalPsf::count>(ShapeFit::kShape, ShapeFit::kShape) =
        prior.covariance.llt().solve(LocalPsf::Matrix::Identity());
    belief_(ShapeFit::kFlux, ShapeFit::kFlux) = 1.0 / (kFluxSigma * kFluxSigma);
    for (std::size_t k = 0; k < beside.size(); ++k) {
      const int at = of_other(k);
      believed_.segment<2>(at) = beside[k].at_px;
      believed_(at + ShapeFit::kFlux) = std::log(beside[k].flux_dn / whole);
      const Mat2 place = beside[k].covariance_px2 + Mat2::Identity() * kLeastOffsetPx * kLeastOffsetPx;
      belief_.block<2, 2>(at, at) = place.inverse();
      belief_(at + ShapeFit::kFlux, at + ShapeFit::kFlux) = 1.0 / (beside[k].flux_sigma * beside[k].flux_sigma);
    }
  }

  PsfFit run(Pixel guess) {
    believed_.head<2>() = guess.vec();  // of no weight
    Vector p = believed_;
    PsfFit fit = settle(p);
    if (!(disc_.radius_px > 0.0)) return fit;
    for (int pass = 0; pass < kMostDiscPasses && fit.converged; ++pass) {
      const Vec2 before = p.head<2>();
      light_ =
          as_of_spot(patch_, disc_, {p(0), p(1)}, std::exp(p(ShapeFit::kFlux)), p(ShapeFit::kShape + LocalPsf::width));
      fit = settle(p);
      if ((p.head<2>() - before).norm() < kDiscSettledPx) break;
    }
    return fit;
  }

  // Where a fit ended with other light than it was told, as with one body in the other's place, strangers are not what
  // is wrong.
  bool as_believed() const {
    constexpr double kMostSigmas = 4.0;
    const Vector off = (solution_ - believed_).cwiseAbs();
    bool alike = off(ShapeFit::kFlux) < kMostSigmas * kFluxSigma;
    for (std::size_t k = 0; k < beside_.size(); ++k)
      alike &= off(of_other(k) + ShapeFit::kFlux) < kMostSigmas * beside_[k].flux_sigma;
    return alike;
  }
  Pixel solved() const { return {solution_(0), solution_(1)}; }
  // Light less model where the last run ended, in sigmas; 0 where nothing counts.
  WindowLight excess() {
    place(solution_);
    weigh(solution_);
    WindowLight out{};
    for_each_pixel(solution_, [&](std::size_t k, double signal, double, const Vector&) {
      out[k] = (light_[k] - signal) * std::sqrt(weight_[k]);
    });
    return out;
  }

 private:
  // From p to where the fit ends.
  PsfFit settle(Vector& p) {
    PsfFit fit;
    fit.saturated = patch_.saturated();
    solution_ = p;
    place(p);
    weigh(p);
    double cost = linearize(p), damping = 1e-3;
    bool converged = false;
    for (int iteration = 0; iteration < kMaxIterations && !converged && damping < 1e8; ++iteration) {
      Matrix damped = whole_;
      damped.diagonal() *= 1.0 + damping;
      const Eigen::LLT<Matrix> llt(damped);
      if (llt.info() != Eigen::Success) return fit;
      const Vector step = llt.solve(slope_);
      const Vector trial = within_bounds(p + step);
      if (!inside(trial) || !(misfit(trial) <= cost * (1.0 + 1e-12))) {
        damping *= 10.0;
        continue;
      }
      p = trial;
      damping = std::max(0.1 * damping, 1e-9);
      place(p);
      weigh(p);
      cost = linearize(p);
      converged = small(step, 0, kConverged);
      for (std::size_t k = 0; k < beside_.size(); ++k)
        converged = converged && small(step, of_other(k), kOthersConverged);
    }
    if (converged) tell(p, cost, fit);
    solution_ = p;
    return fit;
  }

  static bool small(const Vector& step, int at, double place_px) {
    return step.segment<2>(at).norm() < place_px && std::abs(step(at + ShapeFit::kFlux)) < kFluxConverged;
  }
  static int of_other(std::size_t k) { return kOthers + kEach * static_cast<int>(k); }

  void place(const Vector& p) {
    body_.compute(patch_.window, {p(0), p(1)}, shape_of(p), spread_px2_);
    for (std::size_t k = 0; k < beside_.size(); ++k) {
      const Vec2 at = place_of_other(p, k);
      others_[k].compute(patch_.window, {at.x(), at.y()}, shape_of(p), Vec2::Zero());
    }
  }

  // visit(pixel, signal, halo, slopes)
  template <typename Visit>
  void for_each_pixel(const Vector& p, Visit visit) const {
    const LocalPsf::Vector shape = shape_of(p);
    const double flux = std::exp(p(ShapeFit::kFlux));
    std::array<double, kMostBeside> others{};
    for (std::size_t k = 0; k < beside_.size(); ++k) others[k] = std::exp(p(of_other(k) + ShapeFit::kFlux));
    Vector slopes(p.size());
    for (int j = 0; j < patch_.window.height(); ++j) {
      for (int i = 0; i < patch_.window.width(); ++i) {
        const auto pixel = static_cast<std::size_t>(j * kMaxFitWindow + i);
        if (patch_.counts[pixel] == 0.0) continue;
        const auto x = static_cast<std::size_t>(i), y = static_cast<std::size_t>(j);
        const Light own(body_, x, y, flux, shape);
        double signal = own.signal, halo = own.halo;
        slopes.head<ShapeFit::kParameters>() = own.slopes;
        for (std::size_t k = 0; k < beside_.size(); ++k) {
          const Light other(others_[k], x, y, others[k], shape);
          signal += other.signal;
          halo += other.halo;
          slopes.segment<LocalPsf::count>(ShapeFit::kShape) += other.slopes.tail<LocalPsf::count>();
          slopes.segment<kEach>(of_other(k)) = other.slopes.head<kEach>();
          if (beside_[k].from_body) slopes.head<2>() += other.slopes.head<2>();
        }
        visit(pixel, signal, halo, slopes);
      }
    }
  }

  // As in ShapeFit; held while a step is judged.
  void weigh(const Vector& p) {
    const double shape2 = sensor_.psf_shape_relative * sensor_.psf_shape_relative +
                          sensor_.photo_nonuniformity * sensor_.photo_nonuniformity;
    const double halo_shape2 = sensor_.halo_shape_relative * sensor_.halo_shape_relative;
    const double noise2 = patch_.noise_dn * patch_.noise_dn, shot = 1.0 / sensor_.gain_e_dn;
    for_each_pixel(p, [&](std::size_t k, double signal, double halo, const Vector&) {
      weight_[k] = 1.0 / (noise2 + signal * (shot + shape2 * signal) + halo_shape2 * halo * halo);
    });
  }

  double misfit(const Vector& p) {
    place(p);
    double chi2 = (believed_ - p).dot(belief_ * (believed_ - p));
    for_each_pixel(p, [&](std::size_t k, double signal, double, const Vector&) {
      const double residual = light_[k] - signal;
      chi2 += weight_[k] * residual * residual;
    });
    return chi2;
  }

  double linearize(const Vector& p) {
    information_.setZero(p.size(), p.size());
    slope_ = belief_ * (believed_ - p);
    double chi2 = (believed_ - p).dot(slope_);
    pixels_ = 0;
    for_each_pixel(p, [&](std::size_t k, double signal, double, const Vector& slopes) {
      const double residual = light_[k] - signal;
      const Vector weighted = weight_[k] * slopes;
      information_.noalias() += weighted * slopes.transpose();
      slope_ += residual * weighted;
      chi2 += weight_[k] * residual * residual;
      ++pixels_;
    });
    whole_ = information_ + belief_;
    return chi2;
  }

  Vector within_bounds(Vector p) const {
    const auto clamp = [&](int shape, double least, double most) {
      p(ShapeFit::kShape + shape) = std::clamp(p(ShapeFit::kShape + shape), least, most);
    };
    const double width = believed_(ShapeFit::kShape + LocalPsf::width);
    const double halo = believed_(ShapeFit::kShape + LocalPsf::halo_width);
    clamp(LocalPsf::width, 0.5 * width, 2.0 * width);
    clamp(LocalPsf::halo_width, 0.5 * halo, 2.0 * halo);
    clamp(LocalPsf::halo_share, 0.0, 1.0);
    clamp(LocalPsf::outer_share, 0.0, 1.0);
    return p;
  }

  bool inside(const Vector& p) const {
    constexpr double kMostLnFlux = 40.0;
    const Window& w = patch_.window;
    bool faint_enough = p(ShapeFit::kFlux) < kMostLnFlux;
    for (std::size_t k = 0; k < beside_.size(); ++k) faint_enough &= p(of_other(k) + ShapeFit::kFlux) < kMostLnFlux;
    return p.allFinite() && p(0) >= w.u0 && p(0) <= w.u1 && p(1) >= w.v0 && p(1) <= w.v1 && faint_enough;
  }

  void tell(const Vector& p, double cost, PsfFit& fit) const {
    const Eigen::LLT<Matrix> llt(whole_);
    if (llt.info() != Eigen::Success) return;
    const Matrix covariance = llt.solve(Matrix::Identity(p.size(), p.size()));
    fit.converged = true;
    fit.pixel = {p(0), p(1)};
    fit.covariance_px2 = covariance.topLeftCorner<2, 2>();
    fit.flux_dn = std::exp(p(ShapeFit::kFlux)) * (1.0 + p(ShapeFit::kShape + LocalPsf::halo_share));
    // The belief, as one more measurement of the flux, is taken off again.
    const double told = 1.0 / covariance(ShapeFit::kFlux, ShapeFit::kFlux) - belief_(ShapeFit::kFlux, ShapeFit::kFlux);
    fit.sigma_px = p(ShapeFit::kShape + LocalPsf::width);
    fit.chi2_per_dof = cost / std::max(1, pixels_ - ShapeFit::kShape);
    fit.flux_sigma_dn = fit.flux_dn * std::sqrt(std::max(1.0, fit.chi2_per_dof) / std::max(told, 1e-12));
    // What shape and the others' places and light move the place by comes again in the next image.
    fit.noise_px2 = Matrix(covariance * information_ * covariance).topLeftCorner<2, 2>();
    fit.repeating_sigma_px = std::sqrt(std::max(0.0, 0.5 * (fit.covariance_px2 - fit.noise_px2).trace()));
  }

  Vec2 place_of_other(const Vector& p, std::size_t k) const {
    const Vec2 at = p.segment<2>(of_other(k));
    return beside_[k].from_body ? Vec2(p.head<2>() + at) : at;
  }

  const Patch& patch_;
  WindowLight light_;  // as if the body were such a spot
  const SensorModel& sensor_;
  LitDisc disc_;
  Vec2 spread_px2_;
  std::span<const LightBeside> beside_;
  Vector believed_;
  Matrix belief_;
  SpotProfiles body_;
  std::array<SpotProfiles, kMostBeside> others_;
  std::array<double, kMaxFitWindow * kMaxFitWindow> weight_;
  Matrix information_, whole_;
  Vector slope_, solution_;
  int pixels_ = 0;
};

}  // namespace

PsfFit fit_psf_beside(ImageView<const std::uint16_t> image, const Window& window, Pixel guess, const LocalLevel& level,
                      const SensorModel& sensor, const LocalPsf& psf, double flux_dn, const LitDisc& disc,
                      std::span<const LightBeside> beside) {
  ASTRONAV_CHECK(image.contains(window.u0, window.v0) && image.contains(window.u1, window.v1));
  ASTRONAV_CHECK(window.width() <= kMaxFitWindow && window.height() <= kMaxFitWindow);
  ASTRONAV_CHECK(flux_dn > 0.0 && beside.size() <= kMostBeside);
  Patch patch;
  patch.load(image, window, level, sensor);
  GroupFitter about(patch, sensor, psf, flux_dn, disc, beside);
  const PsfFit fit = about.run(guess);
  const bool small = disc.radius_px < kMostAmongStrangersPx;
  if (!small || !is_odd(fit) || !about.as_believed() || !set_strangers_aside(patch, about.excess(), about.solved()))
    return inflated(fit);
  const PsfFit alone = about.run(guess);
  return inflated(is_better(alone, fit) ? alone : fit);
}

}  // namespace astronav::vision
