// SPDX-License-Identifier: Apache-2.0
#include "onboard/vision/psf_fit.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <utility>

#include <Eigen/Cholesky>

namespace astronav::vision {
namespace {

constexpr int kMaxIterations = 40;
constexpr double kConverged = 1e-4;  // px
constexpr double kBlendChi2 = 2.5;   // per degree of freedom: beyond it something else is in the window

// A Gaussian integrated over the pixels of one axis, and its derivatives by centre and width (eq. 4, 5).
struct AxisProfile {
  std::array<double, kMaxFitWindow> share;
  std::array<double, kMaxFitWindow> by_center;
  std::array<double, kMaxFitWindow> by_sigma;

  void compute(int first, int count, double center, double sigma) {
    const double to_erf = 1.0 / (std::sqrt(2.0) * sigma);
    const double to_density = 1.0 / (std::sqrt(2.0 * kPi) * sigma);
    double edge = first - 0.5 - center;
    double cumulative = 0.5 * std::erf(edge * to_erf);
    double density = to_density * std::exp(-(edge * to_erf) * (edge * to_erf));
    for (int i = 0; i < count; ++i) {
      const double next_edge = edge + 1.0;
      const double next_cumulative = 0.5 * std::erf(next_edge * to_erf);
      const double next_density = to_density * std::exp(-(next_edge * to_erf) * (next_edge * to_erf));
      share[i] = next_cumulative - cumulative;
      by_center[i] = density - next_density;
      by_sigma[i] = (edge * density - next_edge * next_density) / sigma;
      edge = next_edge;
      cumulative = next_cumulative;
      density = next_density;
    }
  }
};

Mat2 inflate(const Mat2& covariance, double chi2_per_dof) {
  return chi2_per_dof > kBlendChi2 ? Mat2(covariance * chi2_per_dof) : covariance;
}

template <typename T>
PsfFit fit_unsaturated(ImageView<const T> image, const Window& window, Pixel guess, double background,
                       double background_sigma, const SensorModel& sensor) {
  using Vec = Vec3;
  using Mat = Mat3;
  AxisProfile x, y;
  PsfFit fit;
  fit.sigma_px = sensor.psf_sigma_px;
  double u = guess.u, v = guess.v, flux = 0.0;
  const int w = window.width(), h = window.height();
  const double halo_peak = sensor.halo_fraction / (2.0 * kPi * sensor.halo_sigma_px * sensor.halo_sigma_px);

  // The flux that fits the guess best is the start.
  x.compute(window.u0, w, u, fit.sigma_px);
  y.compute(window.v0, h, v, fit.sigma_px);
  double gd = 0.0, gg = 0.0;
  for (int j = 0; j < h; ++j) {
    const T* row = image.row(window.v0 + j) + window.u0;
    for (int i = 0; i < w; ++i) {
      const double g = x.share[i] * y.share[j];
      gd += g * (static_cast<double>(row[i]) - background);
      gg += g * g;
    }
  }
  flux = gd / gg;
  if (!(flux > 0.0)) return fit;

  Mat information;
  for (int iteration = 0; iteration < kMaxIterations; ++iteration) {
    information.setZero();
    Vec gradient = Vec::Zero();
    double chi2 = 0.0;
    const double model_error = halo_peak * flux;
    const double base_variance = background_sigma * background_sigma + model_error * model_error;
    const double shot = 1.0 / sensor.gain_e_dn;
    const double prnu2 = sensor.photo_nonuniformity * sensor.photo_nonuniformity;
    for (int j = 0; j < h; ++j) {
      const T* row = image.row(window.v0 + j) + window.u0;
      const double fy = flux * y.share[j], fdy = flux * y.by_center[j], sy = y.share[j];
      for (int i = 0; i < w; ++i) {
        const double signal = fy * x.share[i];
        const double weight = 1.0 / (base_variance + signal * (shot + prnu2 * signal));
        const double residual = static_cast<double>(row[i]) - background - signal;
        const double ju = fy * x.by_center[i], jv = fdy * x.share[i], jf = sy * x.share[i];
        const double wu = weight * ju, wv = weight * jv, wf = weight * jf;
        information(0, 0) += wu * ju;
        information(1, 0) += wu * jv;
        information(2, 0) += wu * jf;
        information(1, 1) += wv * jv;
        information(2, 1) += wv * jf;
        information(2, 2) += wf * jf;
        gradient(0) += wu * residual;
        gradient(1) += wv * residual;
        gradient(2) += wf * residual;
        chi2 += weight * residual * residual;
      }
    }
    information(0, 1) = information(1, 0);
    information(0, 2) = information(2, 0);
    information(1, 2) = information(2, 1);
    fit.chi2_per_dof = chi2 / std::max(1, w * h - 3);
    const Eigen::LLT<Mat> llt(information);
    if (llt.info() != Eigen::Success) return fit;
    Vec step = llt.solve(gradient);
    const double length = std::hypot(step(0), step(1));
    if (length > 0.5) step *= 0.5 / length;
    u += step(0);
    v += step(1);
    flux = std::max(flux + step(2), 0.2 * flux);
    if (u < window.u0 - 0.5 || u > window.u1 + 0.5 || v < window.v0 - 0.5 || v > window.v1 + 0.5) return fit;
    if (length < kConverged) {
      const Mat covariance = llt.solve(Mat::Identity());
      fit.converged = true;
      fit.covariance_px2 = inflate(covariance.topLeftCorner<2, 2>(), fit.chi2_per_dof);
      fit.flux_sigma_dn = std::sqrt(covariance(2, 2));
      break;
    }
    x.compute(window.u0, w, u, fit.sigma_px);
    y.compute(window.v0, h, v, fit.sigma_px);
  }
  fit.pixel = {u, v};
  fit.flux_dn = flux;
  return fit;
}

// Free: u, v, ln(flux), width, share of the halo, its displacement and its width. Levenberg-Marquardt.
template <typename T>
class SaturatedFit {
 public:
  SaturatedFit(ImageView<const T> image, const Window& window, double background, double background_sigma,
               const SensorModel& sensor)
      : image_(image), window_(window), background_(background), background_sigma_(background_sigma), sensor_(sensor) {}

  PsfFit run(Pixel guess) {
    PsfFit fit;
    fit.saturated = true;
    fit.sigma_px = sensor_.psf_sigma_px;
    Vec p;
    p << guess.u, guess.v, 0.0, sensor_.psf_sigma_px, sensor_.halo_fraction, 0.0, 0.0, sensor_.halo_sigma_px;
    if (!start_flux(p)) return fit;
    weigh(p);
    double cost = linearize(p);
    double damping = 1e-3;
    for (int iteration = 0; iteration < kMaxIterations; ++iteration) {
      Mat damped = information_;
      damped.diagonal() *= 1.0 + damping;
      const Eigen::LLT<Mat> llt(damped);
      if (llt.info() != Eigen::Success) return fit;
      const Vec step = llt.solve(gradient_);
      Vec trial = p + step;
      trial(3) = std::clamp(trial(3), 0.5 * sensor_.psf_sigma_px, 2.0 * sensor_.psf_sigma_px);
      trial(4) = std::max(trial(4), 0.0);
      trial(7) = std::clamp(trial(7), 0.4 * sensor_.halo_sigma_px, 2.5 * sensor_.halo_sigma_px);
      if (!inside(trial)) {
        damping *= 10.0;
        if (damping > 1e8) return fit;
        continue;
      }
      const double trial_cost = linearize(trial);
      if (trial_cost <= cost * (1.0 + 1e-12)) {
        p = trial;
        damping = std::max(damping * 0.1, 1e-9);
        const bool small = std::hypot(step(0), step(1)) < kConverged && std::abs(step(3)) < 1e-3;
        weigh(p);
        cost = linearize(p);
        if (small) {
          fit.converged = true;
          break;
        }
      } else {
        damping *= 10.0;
        cost = linearize(p);
        if (damping > 1e8) break;
      }
    }
    const Eigen::LLT<Mat> llt(information_);
    if (llt.info() != Eigen::Success) return PsfFit{};
    const Mat covariance = llt.solve(Mat::Identity());
    fit.pixel = {p(0), p(1)};
    fit.flux_dn = std::exp(p(2));
    fit.flux_sigma_dn = fit.flux_dn * std::sqrt(covariance(2, 2));
    fit.sigma_px = p(3);
    fit.chi2_per_dof = cost / std::max(1, used_ - 8);
    fit.covariance_px2 = inflate(covariance.topLeftCorner<2, 2>(), fit.chi2_per_dof);
    return fit;
  }

 private:
  using Vec = Eigen::Matrix<double, 8, 1>;
  using Mat = Eigen::Matrix<double, 8, 8>;

  bool inside(const Vec& p) const {
    return p(0) >= window_.u0 && p(0) <= window_.u1 && p(1) >= window_.v0 && p(1) <= window_.v1 && p(2) < 40.0 &&
           std::isfinite(p.sum());
  }

  void profiles(const Vec& p) {
    x_.compute(window_.u0, window_.width(), p(0), p(3));
    y_.compute(window_.v0, window_.height(), p(1), p(3));
    halo_x_.compute(window_.u0, window_.width(), p(0) + p(5), p(7));
    halo_y_.compute(window_.v0, window_.height(), p(1) + p(6), p(7));
  }

  // The median of the fluxes that the brightest unsaturated pixels ask for is the start. Around a very bright core they
  // lie where the halo rules, so both take part.
  bool start_flux(Vec& p) {
    constexpr int kBrightest = 7;
    profiles(p);
    std::array<double, kBrightest> value{}, flux{};
    int count = 0;
    for (int j = 0; j < window_.height(); ++j) {
      for (int i = 0; i < window_.width(); ++i) {
        const double dn = static_cast<double>(image_(window_.u0 + i, window_.v0 + j));
        if (dn >= sensor_.saturation_dn) continue;
        const double signal = dn - background_;
        const double g = x_.share[i] * y_.share[j] + p(4) * halo_x_.share[i] * halo_y_.share[j];
        if (g < 1e-12) continue;
        if (count == kBrightest && signal <= value[kBrightest - 1]) continue;
        int k = count < kBrightest ? count++ : kBrightest - 1;
        for (; k > 0 && value[k - 1] < signal; --k) {
          value[k] = value[k - 1];
          flux[k] = flux[k - 1];
        }
        value[k] = signal;
        flux[k] = signal / g;
      }
    }
    if (count < 5) return false;
    for (int k = 1; k < count; ++k) {
      for (int i = k; i > 0 && flux[i - 1] > flux[i]; --i) std::swap(flux[i - 1], flux[i]);
    }
    const double start = flux[count / 2];
    if (!(start > 0.0)) return false;
    p(2) = std::log(start);
    return true;
  }

  // Weights from the current model; held while a step is judged.
  void weigh(const Vec& p) {
    profiles(p);
    const double flux = std::exp(p(2));
    for (int j = 0; j < window_.height(); ++j) {
      for (int i = 0; i < window_.width(); ++i) {
        const double halo = halo_x_.share[i] * halo_y_.share[j];
        const double core = x_.share[i] * y_.share[j];
        const double signal = flux * (core + p(4) * halo);
        const double shape = sensor_.psf_shape_relative * signal;
        const double wing = sensor_.halo_shape_relative * p(4) * flux * halo;
        weight_[j * kMaxFitWindow + i] =
            1.0 / (sensor_.pixel_variance_dn2(signal, background_sigma_) + shape * shape + wing * wing);
      }
    }
  }

  // Sets information and gradient at p; returns the cost.
  double linearize(const Vec& p) {
    profiles(p);
    information_.setZero();
    gradient_.setZero();
    used_ = 0;
    double cost = 0.0;
    const double flux = std::exp(p(2));
    for (int j = 0; j < window_.height(); ++j) {
      for (int i = 0; i < window_.width(); ++i) {
        const double dn = static_cast<double>(image_(window_.u0 + i, window_.v0 + j));
        if (dn >= sensor_.saturation_dn) continue;
        ++used_;
        const double weight = weight_[j * kMaxFitWindow + i];
        const double halo = halo_x_.share[i] * halo_y_.share[j];
        const double signal = flux * (x_.share[i] * y_.share[j] + p(4) * halo);
        const double residual = dn - background_ - signal;
        const double halo_u = flux * p(4) * halo_x_.by_center[i] * halo_y_.share[j];
        const double halo_v = flux * p(4) * halo_x_.share[i] * halo_y_.by_center[j];
        Vec jacobian;
        jacobian << flux * x_.by_center[i] * y_.share[j] + halo_u, flux * x_.share[i] * y_.by_center[j] + halo_v,
            signal, flux * (x_.by_sigma[i] * y_.share[j] + x_.share[i] * y_.by_sigma[j]), flux * halo, halo_u, halo_v,
            flux * p(4) * (halo_x_.by_sigma[i] * halo_y_.share[j] + halo_x_.share[i] * halo_y_.by_sigma[j]);
        information_.noalias() += weight * jacobian * jacobian.transpose();
        gradient_ += weight * residual * jacobian;
        cost += weight * residual * residual;
      }
    }
    // What is believed of width and halo takes part as more measurements.
    const auto believe = [&](int k, double value, double sigma) {
      const double weight = 1.0 / (sigma * sigma);
      information_(k, k) += weight;
      gradient_(k) += weight * (value - p(k));
      cost += weight * (value - p(k)) * (value - p(k));
    };
    believe(3, sensor_.psf_sigma_px, sensor_.psf_sigma_relative * sensor_.psf_sigma_px);
    believe(4, sensor_.halo_fraction, 2.0 * sensor_.halo_fraction);
    believe(5, 0.0, sensor_.halo_offset_px);
    believe(6, 0.0, sensor_.halo_offset_px);
    believe(7, sensor_.halo_sigma_px, 0.3 * sensor_.halo_sigma_px);
    return cost;
  }

  ImageView<const T> image_;
  Window window_;
  double background_;
  double background_sigma_;
  const SensorModel& sensor_;
  AxisProfile x_, y_, halo_x_, halo_y_;
  std::array<double, kMaxFitWindow * kMaxFitWindow> weight_;
  Mat information_;
  Vec gradient_;
  int used_ = 0;
};

}  // namespace

SensorModel SensorModel::from(const Camera& camera) {
  SensorModel model;
  const Detector& d = camera.detector;
  model.gain_e_dn = d.gain_e_dn;
  model.read_noise_e = d.read_noise_e;
  model.photo_nonuniformity = d.photo_nonuniformity;
  const double converter = std::ldexp(1.0, d.bits) - 1.0;
  const double full_well = d.full_well_e > 0.0 ? d.full_well_e / d.gain_e_dn : converter;
  model.saturation_dn = d.bias_dn + 0.95 * std::min(full_well, converter - d.bias_dn);
  model.psf_sigma_px = camera.psf.sigma_px;
  return model;
}

template <typename T>
PsfFit fit_psf(ImageView<const T> image, const Window& window, Pixel guess, double background_dn,
               double background_sigma_dn, const SensorModel& sensor) {
  ASTRONAV_CHECK(image.contains(window.u0, window.v0) && image.contains(window.u1, window.v1));
  ASTRONAV_CHECK(window.width() <= kMaxFitWindow && window.height() <= kMaxFitWindow);
  bool saturated = false;
  for (int v = window.v0; v <= window.v1 && !saturated; ++v) {
    const T* row = image.row(v);
    for (int u = window.u0; u <= window.u1; ++u) saturated |= static_cast<double>(row[u]) >= sensor.saturation_dn;
  }
  if (!saturated) return fit_unsaturated(image, window, guess, background_dn, background_sigma_dn, sensor);
  return SaturatedFit<T>(image, window, background_dn, background_sigma_dn, sensor).run(guess);
}

template <typename T>
PsfFit fit_psf_beside(ImageView<const T> image, const Window& window, Pixel guess, double background_dn,
                      double background_sigma_dn, const SensorModel& sensor, const Companion& companion) {
  constexpr int kMaxRounds = 8;
  constexpr double kFluxError = 0.1;
  PsfFit fit = fit_psf(image, window, guess, background_dn, background_sigma_dn, sensor);
  const Vec2 first = fit.pixel.vec();
  std::array<float, kMaxFitWindow * kMaxFitWindow> light;
  const ImageView<float> alone(light.data(), window.width(), window.height());
  const Window whole{0, 0, window.width() - 1, window.height() - 1};
  AxisProfile x, y;
  for (int round = 0; round < kMaxRounds && fit.converged; ++round) {
    x.compute(window.u0, window.width(), fit.pixel.u + companion.offset_px.x(), fit.sigma_px);
    y.compute(window.v0, window.height(), fit.pixel.v + companion.offset_px.y(), fit.sigma_px);
    for (int j = 0; j < window.height(); ++j) {
      for (int i = 0; i < window.width(); ++i) {
        const auto dn = static_cast<double>(image(window.u0 + i, window.v0 + j));
        const double other = companion.flux_dn * x.share[i] * y.share[j];
        // A saturated pixel stays one, whoever filled it.
        alone(i, j) = static_cast<float>(dn >= sensor.saturation_dn ? dn : dn - other);
      }
    }
    const Pixel start{fit.pixel.u - window.u0, fit.pixel.v - window.v0};
    PsfFit next = fit_psf(ImageView<const float>(alone), whole, start, background_dn, background_sigma_dn, sensor);
    next.pixel = {next.pixel.u + window.u0, next.pixel.v + window.v0};
    const double moved = (next.pixel.vec() - fit.pixel.vec()).norm();
    fit = next;
    if (moved < 10.0 * kConverged) break;
  }
  const Vec2 shift = kFluxError * (fit.pixel.vec() - first);
  fit.covariance_px2 += shift * shift.transpose();
  return fit;
}

template PsfFit fit_psf_beside<std::uint16_t>(ImageView<const std::uint16_t>, const Window&, Pixel, double, double,
                                              const SensorModel&, const Companion&);
template PsfFit fit_psf<std::uint16_t>(ImageView<const std::uint16_t>, const Window&, Pixel, double, double,
                                       const SensorModel&);
template PsfFit fit_psf<float>(ImageView<const float>, const Window&, Pixel, double, double, const SensorModel&);

}  // namespace astronav::vision
