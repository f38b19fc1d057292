// SPDX-License-Identifier: Apache-2.0
#include "onboard/vision/psf_shape_fit.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include <Eigen/Cholesky>

namespace astronav::vision {
namespace {

constexpr int kMaxIterations = 40;
constexpr int kReweighed = 20;       // steps after which the weights stay, lest they and the place chase each other
constexpr double kConverged = 1e-4;  // px

double at(const std::array<double, kMaxFitWindow>& values, int i) {
  return values[static_cast<std::size_t>(i)];
}

}  // namespace

template <typename T>
void Patch::load(ImageView<const T> image, const Window& w, const LocalLevel& level, const SensorModel& sensor) {
  window = w;
  noise_dn = level.noise_dn;
  saturated_ = false;
  const int width = w.width(), padded = padded_width();
  double brightest = -HUGE_VAL;
  for (int j = 0; j < w.height(); ++j) {
    const T* row = image.row(w.v0 + j) + w.u0;
    double* to = light.data() + j * kMaxFitWindow;
    double* use = counts.data() + j * kMaxFitWindow;
    const double first = level.plane(w.u0, w.v0 + j);
    for (int group = 0; group < padded; group += kLanes) {
      const auto pixels = lanes_of(row + group, image.width() - w.u0 - group);
      for (int l = 0; l < kLanes; ++l) {
        const int i = group + l;
        const double dn = pixels[static_cast<std::size_t>(l)], inside = i < width ? 1.0 : 0.0;
        to[i] = inside * (dn - (first + level.slope_u_dn * i));
        use[i] = dn < sensor.saturation_dn ? inside : 0.0;
        brightest = std::max(brightest, inside * dn);
      }
    }
    if (level.columns_dn != nullptr)
      for (int i = 0; i < width; ++i) to[i] -= level.column(w.u0 + i);
  }
  saturated_ = brightest >= sensor.saturation_dn;
  if (!saturated_ || !sensor.blooming) return;
  for (int i = 0; i < w.width(); ++i) {
    bool full = false;
    for (int j = 0; j < w.height(); ++j) full |= counts[static_cast<std::size_t>(j * kMaxFitWindow + i)] == 0.0;
    if (!full) continue;
    for (int j = 0; j < w.height(); ++j) counts[static_cast<std::size_t>(j * kMaxFitWindow + i)] = 0.0;
  }
}

template void Patch::load<std::uint8_t>(ImageView<const std::uint8_t>, const Window&, const LocalLevel&,
                                        const SensorModel&);
template void Patch::load<std::uint16_t>(ImageView<const std::uint16_t>, const Window&, const LocalLevel&,
                                         const SensorModel&);
template void Patch::load<float>(ImageView<const float>, const Window&, const LocalLevel&, const SensorModel&);

PsfFit inflated(PsfFit fit) {
  if (fit.chi2_per_dof > kBlendChi2) {
    const double grown = (fit.chi2_per_dof - 1.0) * 0.5 * fit.covariance_px2.trace();
    fit.repeating_sigma_px = std::hypot(fit.repeating_sigma_px, std::sqrt(grown));
    fit.covariance_px2 *= fit.chi2_per_dof;
  }
  return fit;
}

bool set_strangers_aside(Patch& patch, const WindowLight& excess, Pixel body) {
  constexpr double kStrange = 6.0;  // sigmas
  constexpr double kNearPx = 4.0;   // what is nearer may be the body's own, of a form that no model has
  constexpr double kReachPx = 2.3;  // of a star's light, or a proton's
  constexpr int kMostPlaces = 3;
  constexpr double kMostShare = 0.25;  // of the pixels that count
  const Window& w = patch.window;
  const Patch before = patch;
  const auto visit = [&](auto&& act) {
    for (int j = 0; j < w.height(); ++j)
      for (int i = 0; i < w.width(); ++i) act(i, j, static_cast<std::size_t>(j * kMaxFitWindow + i));
  };
  int counted = 0, aside = 0;
  visit([&](int, int, std::size_t k) { counted += patch.counts[k] > 0.0; });
  for (int places = 0; places < kMostPlaces; ++places) {
    double most = kStrange;
    int u = -1, v = -1;
    visit([&](int i, int j, std::size_t k) {
      if (!(patch.counts[k] > 0.0) || !(excess[k] > most)) return;
      if (std::hypot(w.u0 + i - body.u, w.v0 + j - body.v) < kNearPx) return;
      most = excess[k];
      u = i;
      v = j;
    });
    if (u < 0) break;
    visit([&](int i, int j, std::size_t k) {
      if (std::hypot(i - u, j - v) > kReachPx) return;
      aside += patch.counts[k] > 0.0;
      patch.counts[k] = 0.0;
    });
  }
  if (aside > 0 && aside < kMostShare * counted) return true;
  patch = before;
  return false;
}

bool ShapeFit::inside(const Vector& p) const {
  const Window& w = patch_.window;
  return p(0) >= w.u0 && p(0) <= w.u1 && p(1) >= w.v0 && p(1) <= w.v1 && p(kFlux) < 40.0 && std::isfinite(p.sum());
}

void SpotProfiles::compute(const Window& w, Pixel at, const LocalPsf::Vector& shape, const Vec2& spread_px2) {
  const auto along = [&](AxisProfile& u, AxisProfile& v, Pixel centre, double sigma) {
    u.compute(w.u0, w.width(), centre.u, sigma, spread_px2.x());
    v.compute(w.v0, w.height(), centre.v, sigma, spread_px2.y());
  };
  const Pixel halo{at.u + shape(LocalPsf::halo_u), at.v + shape(LocalPsf::halo_v)};
  along(x, y, at, shape(LocalPsf::width));
  along(inner_x, inner_y, halo, shape(LocalPsf::halo_width));
  along(outer_x, outer_y, halo, LocalPsf::kOuterWidth * shape(LocalPsf::halo_width));
}

namespace {

void add_core(Vec2 at_px, const Vec2& spread, double flux, double sigma, const Window& window, WindowLight& light) {
  AxisProfile x, y;
  x.compute(window.u0, window.width(), at_px.x(), sigma, spread.x());
  y.compute(window.v0, window.height(), at_px.y(), sigma, spread.y());
  for (int j = 0; j < window.height(); ++j) {
    const double row = flux * at(y.share, j);
    for (int i = 0; i < window.width(); ++i)
      light[static_cast<std::size_t>(j * kMaxFitWindow + i)] += row * at(x.share, i);
  }
}

}  // namespace

WindowLight as_of_spot(const Patch& seen, const LitDisc& disc, Pixel at, double core_flux, double sigma_px) {
  WindowLight light = seen.light;
  for (const DiscPoint& part : points_of(disc))
    add_core(at.vec() + part.offset_px, Vec2::Zero(), -core_flux * part.share, sigma_px, seen.window, light);
  add_core(at.vec(), spread_px2(disc), core_flux, sigma_px, seen.window, light);
  return light;
}

void ShapeFit::profiles(const Vector& p) {
  point_.compute(patch_.window, {p(0), p(1)}, p.tail<LocalPsf::count>(), spread_px2_);
}

// The median of the fluxes that the brightest unsaturated pixels ask for is the start. Around a very bright core they
// lie where the halo rules, so both take part.
bool ShapeFit::start_flux(Vector& p) {
  constexpr int kBrightest = 7;
  profiles(p);
  const double share = p(kShape + LocalPsf::halo_share), outer = p(kShape + LocalPsf::outer_share);
  std::array<double, kBrightest> value{}, flux{};
  int count = 0;
  for (int j = 0; j < patch_.window.height(); ++j) {
    for (int i = 0; i < patch_.window.width(); ++i) {
      const auto k = static_cast<std::size_t>(j * kMaxFitWindow + i);
      if (patch_.counts[k] == 0.0) continue;
      const double signal = patch_.light[k];
      const double halo = (1.0 - outer) * at(point_.inner_x.share, i) * at(point_.inner_y.share, j) +
                          outer * at(point_.outer_x.share, i) * at(point_.outer_y.share, j);
      const double g = at(point_.x.share, i) * at(point_.y.share, j) + share * halo;
      if (g < 1e-12) continue;
      if (count == kBrightest && signal <= value[kBrightest - 1]) continue;
      auto n = static_cast<std::size_t>(count < kBrightest ? count++ : kBrightest - 1);
      for (; n > 0 && value[n - 1] < signal; --n) {
        value[n] = value[n - 1];
        flux[n] = flux[n - 1];
      }
      value[n] = signal;
      flux[n] = signal / g;
    }
  }
  if (count < 5) return false;
  for (int k = 1; k < count; ++k) {
    for (auto i = static_cast<std::size_t>(k); i > 0 && flux[i - 1] > flux[i]; --i) std::swap(flux[i - 1], flux[i]);
  }
  const double start = flux[static_cast<std::size_t>(count / 2)];
  if (!(start > 0.0)) return false;
  p(kFlux) = std::log(start);
  return true;
}

// Weights from the model at p, whose profiles are there; held while a step is judged.
void ShapeFit::weigh(const Vector& p) {
  const double flux = std::exp(p(kFlux));
  const double share = p(kShape + LocalPsf::halo_share), outer = p(kShape + LocalPsf::outer_share);
  const double shape2 = sensor_.psf_shape_relative * sensor_.psf_shape_relative +
                        sensor_.photo_nonuniformity * sensor_.photo_nonuniformity;
  const double halo_shape2 = sensor_.halo_shape_relative * sensor_.halo_shape_relative;
  const double noise2 = patch_.noise_dn * patch_.noise_dn, shot = 1.0 / sensor_.gain_e_dn;
  const int width = patch_.padded_width();
  for (int j = 0; j < patch_.window.height(); ++j) {
    const double core_y = flux * at(point_.y.share, j);
    const double inner_y = flux * share * (1.0 - outer) * at(point_.inner_y.share, j);
    const double outer_y = flux * share * outer * at(point_.outer_y.share, j);
    double* const weight = weight_.data() + j * kMaxFitWindow;
    const double* const counts = patch_.counts.data() + j * kMaxFitWindow;
    for (int i = 0; i < width; ++i) {
      const auto k = static_cast<std::size_t>(i);
      const double halo = inner_y * point_.inner_x.share[k] + outer_y * point_.outer_x.share[k];
      const double signal = core_y * point_.x.share[k] + halo;
      weight[i] = counts[i] / (noise2 + signal * (shot + shape2 * signal) + halo_shape2 * halo * halo);
    }
  }
}

// Chi-square at p, whose profiles are there, under the weights as they are.
double ShapeFit::misfit(const Vector& p) const {
  alignas(64) std::array<double, kLanes> chi2{};
  const double flux = std::exp(p(kFlux));
  const double share = p(kShape + LocalPsf::halo_share), outer = p(kShape + LocalPsf::outer_share);
  for (int j = 0; j < patch_.window.height(); ++j) {
    const double core_y = flux * at(point_.y.share, j);
    const double inner_y = flux * share * (1.0 - outer) * at(point_.inner_y.share, j);
    const double outer_y = flux * share * outer * at(point_.outer_y.share, j);
    for (int group = 0; group < patch_.padded_width(); group += kLanes) {
      const auto first = static_cast<std::size_t>(group);
      const std::size_t pixel = static_cast<std::size_t>(j * kMaxFitWindow) + first;
      for (std::size_t l = 0; l < kLanes; ++l) {
        const std::size_t i = first + l;
        const double signal =
            core_y * point_.x.share[i] + inner_y * point_.inner_x.share[i] + outer_y * point_.outer_x.share[i];
        const double residual = patch_.light[pixel + l] - signal;
        chi2[l] += weight_[pixel + l] * residual * residual;
      }
    }
  }
  double sum = 0.0;
  for (const double lane : chi2) sum += lane;
  return sum;
}

// Sets information and gradient of the likelihood at p, whose profiles are there; returns chi-square.
double ShapeFit::linearize(const Vector& p) {
  constexpr int kSums = kParameters * (kParameters + 1) / 2;
  using Lanes = std::array<double, kLanes>;
  alignas(64) std::array<Lanes, kSums> products{};
  alignas(64) std::array<Lanes, kParameters> slopes{};
  Lanes chi2{}, used{};
  const double flux = std::exp(p(kFlux));
  const double share = p(kShape + LocalPsf::halo_share), outer = p(kShape + LocalPsf::outer_share);
  const double inner = 1.0 - outer;
  for (int j = 0; j < patch_.window.height(); ++j) {
    const double cy = flux * at(point_.y.share, j), cy_c = flux * at(point_.y.by_center, j),
                 cy_s = flux * at(point_.y.by_sigma, j);
    const double ay = flux * at(point_.inner_y.share, j), ay_c = flux * at(point_.inner_y.by_center, j),
                 ay_s = flux * at(point_.inner_y.by_sigma, j);
    const double by = flux * at(point_.outer_y.share, j), by_c = flux * at(point_.outer_y.by_center, j),
                 by_s = flux * LocalPsf::kOuterWidth * at(point_.outer_y.by_sigma, j);
    for (int group = 0; group < patch_.padded_width(); group += kLanes) {
      const auto first = static_cast<std::size_t>(group);
      const std::size_t pixel = static_cast<std::size_t>(j * kMaxFitWindow) + first;
      alignas(64) std::array<Lanes, kParameters> jacobian;
      alignas(64) Lanes weight, residual;
      for (std::size_t l = 0; l < kLanes; ++l) {
        const std::size_t i = first + l;
        const double a = ay * point_.inner_x.share[i], b = by * point_.outer_x.share[i];
        const double halo = inner * a + outer * b;
        const double core = cy * point_.x.share[i];
        const double halo_u = inner * ay * point_.inner_x.by_center[i] + outer * by * point_.outer_x.by_center[i];
        const double halo_v = inner * ay_c * point_.inner_x.share[i] + outer * by_c * point_.outer_x.share[i];
        const double signal = core + share * halo;
        weight[l] = weight_[pixel + l];
        residual[l] = patch_.light[pixel + l] - signal;
        jacobian[0][l] = cy * point_.x.by_center[i] + share * halo_u;
        jacobian[1][l] = cy_c * point_.x.share[i] + share * halo_v;
        jacobian[kFlux][l] = signal;
        jacobian[kShape + LocalPsf::width][l] = cy * point_.x.by_sigma[i] + cy_s * point_.x.share[i];
        jacobian[kShape + LocalPsf::halo_share][l] = halo;
        jacobian[kShape + LocalPsf::halo_width][l] =
            share *
            (inner * (ay * point_.inner_x.by_sigma[i] + ay_s * point_.inner_x.share[i]) +
             outer * (by * LocalPsf::kOuterWidth * point_.outer_x.by_sigma[i] + by_s * point_.outer_x.share[i]));
        jacobian[kShape + LocalPsf::outer_share][l] = share * (b - a);
        jacobian[kShape + LocalPsf::halo_u][l] = share * halo_u;
        jacobian[kShape + LocalPsf::halo_v][l] = share * halo_v;
      }
      std::size_t sum = 0;
      for (std::size_t r = 0; r < kParameters; ++r) {
        alignas(64) Lanes weighted;
        for (std::size_t l = 0; l < kLanes; ++l) weighted[l] = weight[l] * jacobian[r][l];
        for (std::size_t c = 0; c <= r; ++c, ++sum) {
          for (std::size_t l = 0; l < kLanes; ++l) products[sum][l] += weighted[l] * jacobian[c][l];
        }
        for (std::size_t l = 0; l < kLanes; ++l) slopes[r][l] += weighted[l] * residual[l];
      }
      for (std::size_t l = 0; l < kLanes; ++l) chi2[l] += weight[l] * residual[l] * residual[l];
      for (std::size_t l = 0; l < kLanes; ++l) used[l] += patch_.counts[pixel + l];
    }
  }
  const auto total = [](const Lanes& lanes) {
    double s = 0.0;
    for (const double lane : lanes) s += lane;
    return s;
  };
  std::size_t sum = 0;
  for (int r = 0; r < kParameters; ++r) {
    for (int c = 0; c <= r; ++c, ++sum) information_(r, c) = information_(c, r) = total(products[sum]);
    gradient_(r) = total(slopes[static_cast<std::size_t>(r)]);
  }
  pixels_ = static_cast<int>(total(used));
  return total(chi2);
}

WindowLight ShapeFit::excess() {
  profiles(solution_);
  weigh(solution_);
  const double flux = std::exp(solution_(kFlux));
  const double share = solution_(kShape + LocalPsf::halo_share), outer = solution_(kShape + LocalPsf::outer_share);
  WindowLight out{};
  for (int j = 0; j < patch_.window.height(); ++j) {
    for (int i = 0; i < patch_.window.width(); ++i) {
      const auto k = static_cast<std::size_t>(j * kMaxFitWindow + i);
      if (patch_.counts[k] == 0.0) continue;
      const double halo = (1.0 - outer) * at(point_.inner_x.share, i) * at(point_.inner_y.share, j) +
                          outer * at(point_.outer_x.share, i) * at(point_.outer_y.share, j);
      const double signal = flux * (at(point_.x.share, i) * at(point_.y.share, j) + share * halo);
      out[k] = (patch_.light[k] - signal) * std::sqrt(weight_[k]);
    }
  }
  return out;
}

PsfEvidence ShapeFit::evidence(const Vector& p) const {
  // Place and flux are taken out (Schur complement).
  const Mat3 place = information_.topLeftCorner<kShape, kShape>();
  const Eigen::LLT<Mat3> llt(place);
  if (llt.info() != Eigen::Success) return {};
  const Eigen::Matrix<double, LocalPsf::count, kShape> mixed = information_.bottomLeftCorner<LocalPsf::count, kShape>();
  PsfEvidence found;
  found.information = information_.bottomRightCorner<LocalPsf::count, LocalPsf::count>() -
                      mixed * llt.solve(Eigen::Matrix<double, kShape, LocalPsf::count>(mixed.transpose()));
  found.vector = gradient_.tail<LocalPsf::count>() - mixed * llt.solve(Vec3(gradient_.head<kShape>())) +
                 found.information * p.tail<LocalPsf::count>();
  return found;
}

PsfFit ShapeFit::run(Pixel guess, const LocalPsf& prior, PsfEvidence* evidence_out) {
  solution_.setConstant(std::nan(""));
  PsfFit fit;
  fit.saturated = true;
  fit.sigma_px = prior.sigma_px();
  const Eigen::LLT<LocalPsf::Matrix> believed(prior.covariance);
  if (believed.info() != Eigen::Success) return fit;
  const LocalPsf::Matrix belief = believed.solve(LocalPsf::Matrix::Identity());
  const double width = prior.value[LocalPsf::width], halo_width = prior.value[LocalPsf::halo_width];
  Vector p;
  p << guess.u, guess.v, 0.0, prior.value;
  if (!start_flux(p)) return fit;
  Matrix whole;
  Vector slope;
  // What is believed takes part as one more measurement.
  const auto judge = [&](const Vector& at) {
    const double chi2 = linearize(at);
    const LocalPsf::Vector off = prior.value - at.tail<LocalPsf::count>();
    whole = information_;
    whole.bottomRightCorner<LocalPsf::count, LocalPsf::count>() += belief;
    slope = gradient_;
    slope.tail<LocalPsf::count>() += belief * off;
    return chi2 + off.dot(belief * off);
  };
  weigh(p);
  double cost = judge(p);
  double damping = 1e-3;
  for (int iteration = 0; iteration < kMaxIterations; ++iteration) {
    Matrix damped = whole;
    damped.diagonal() *= 1.0 + damping;
    const Eigen::LLT<Matrix> llt(damped);
    if (llt.info() != Eigen::Success) return fit;
    const Vector step = llt.solve(slope);
    Vector trial = p + step;
    double& trial_width = trial(kShape + LocalPsf::width);
    trial_width = std::clamp(trial_width, 0.5 * width, 2.0 * width);
    double& trial_halo = trial(kShape + LocalPsf::halo_width);
    trial_halo = std::clamp(trial_halo, 0.5 * halo_width, 2.0 * halo_width);
    trial(kShape + LocalPsf::halo_share) = std::max(trial(kShape + LocalPsf::halo_share), 0.0);
    trial(kShape + LocalPsf::outer_share) = std::clamp(trial(kShape + LocalPsf::outer_share), 0.0, 1.0);
    double trial_cost = HUGE_VAL;
    if (inside(trial)) {
      profiles(trial);
      const LocalPsf::Vector off = prior.value - trial.tail<LocalPsf::count>();
      trial_cost = misfit(trial) + off.dot(belief * off);
    }
    if (trial_cost <= cost * (1.0 + 1e-12)) {
      p = trial;
      damping = std::max(damping * 0.1, 1e-9);
      if (iteration < kReweighed) weigh(p);
      cost = judge(p);
      const bool small =
          std::hypot(step(0), step(1)) < kConverged && std::abs(step(kShape + LocalPsf::width)) < 1e-3 * width;
      if (small) {
        fit.converged = true;
        break;
      }
    } else {
      damping *= 10.0;
      if (damping > 1e8) break;
    }
  }
  const Eigen::LLT<Matrix> llt(whole);
  if (llt.info() != Eigen::Success) return PsfFit{};
  const Matrix covariance = llt.solve(Matrix::Identity());
  fit.pixel = {p(0), p(1)};
  fit.flux_dn = std::exp(p(kFlux)) * (1.0 + p(kShape + LocalPsf::halo_share));
  fit.flux_sigma_dn = fit.flux_dn * std::sqrt(covariance(kFlux, kFlux));
  fit.sigma_px = p(kShape + LocalPsf::width);
  fit.chi2_per_dof = cost / std::max(1, pixels_ - kParameters);
  fit.covariance_px2 = covariance.topLeftCorner<2, 2>();
  // W^-1 = W^-1 (J + B) W^-1: the image's noise, and what is believed, which the next image shares.
  fit.noise_px2 = (covariance * information_ * covariance).topLeftCorner<2, 2>();
  fit.repeating_sigma_px = std::sqrt(std::max(0.0, 0.5 * (fit.covariance_px2 - fit.noise_px2).trace()));
  if (evidence_out != nullptr) *evidence_out = evidence(p);
  solution_ = p;
  return fit;
}

}  // namespace astronav::vision
