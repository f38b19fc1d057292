// SPDX-License-Identifier: Apache-2.0
#include "verification/opensky/calibrate_adjust.h"

#include <algorithm>
#include <cmath>
#include <numeric>

#include <ceres/ceres.h>
#include <glog/logging.h>

#include "foundation/math/random.h"
#include "foundation/math/rotation.h"
#include "foundation/math/statistics.h"

namespace astronav::opensky {
namespace {

constexpr double kFarOffPx = 1e6;  // residual of a star that falls nowhere
constexpr double kLeastSigmaPx = 1e-3;
constexpr int kStarsForScale = 40;
constexpr double kLossSigma = 3.0;
constexpr double kMostSurprise = 50.0;  // one star that falls off the rim must not decide between models

using Lens = Eigen::VectorXd;  // changes of the free parameters
using ByLens = Eigen::MatrixXd;

// The nine parameters as a linear function of the free ones (docs/theory/camera.md eq. 9).
ByLens intrinsics_by_lens(const Intrinsics& first, const LensFreedom& freedom) {
  ByLens map = ByLens::Zero(9, freedom.count());
  int column = 0;
  if (freedom.focal) {
    map(0, column) = 1.0;
    if (!freedom.aspect) map(1, column) = first.fy_px / first.fx_px;
    ++column;
  }
  if (freedom.aspect) map(1, column++) = 1.0;
  const std::array<bool, 9> free = freedom.free();
  for (int i = 2; i < 9; ++i) {
    if (free[static_cast<std::size_t>(i)]) map(i, column++) = 1.0;
  }
  return map;
}

Intrinsics changed(const Intrinsics& first, const ByLens& map, const Lens& lens) {
  const Eigen::VectorXd d = map * lens;
  Intrinsics camera = first;
  camera.fx_px += d[0];
  camera.fy_px += d[1];
  camera.cx_px += d[2];
  camera.cy_px += d[3];
  camera.distortion.k1 += d[4];
  camera.distortion.k2 += d[5];
  camera.distortion.k3 += d[6];
  camera.distortion.p1 += d[7];
  camera.distortion.p2 += d[8];
  return camera;
}

// Derivative of exp([phi]x) by phi from the left: exp([phi + d]x) = exp([J d]x) exp([phi]x).
Mat3 left_jacobian(const Vec3& phi) {
  const double a2 = phi.squaredNorm();
  const double a = std::sqrt(a2);
  const Mat3 cross = cross_matrix(phi);
  const double first = a > 1e-4 ? (1.0 - std::cos(a)) / a2 : 0.5;
  const double second = a > 1e-4 ? (a - std::sin(a)) / (a2 * a) : 1.0 / 6.0;
  return Mat3::Identity() + first * cross + second * cross * cross;
}

// Whitened residual of one star: parameters theta (3) of its picture and the lens (docs/theory/camera.md eq. 10).
class StarCost final : public ceres::CostFunction {
 public:
  StarCost(const StarObservation& star, const Mat3& R_CN, const Intrinsics& first, const ByLens& map,
           const Scatter& scatter)
      : direction_C_(R_CN * star.direction_N), pixel_(star.pixel.vec()), first_(first), map_(map) {
    whitening_ = scatter.covariance(star.covariance_px2).inverse().llt().matrixU();
    set_num_residuals(2);
    mutable_parameter_block_sizes()->push_back(3);
    mutable_parameter_block_sizes()->push_back(static_cast<int>(map.cols()));
  }

  bool Evaluate(double const* const* parameters, double* residuals, double** jacobians) const override {
    const Vec3 theta = Eigen::Map<const Vec3>(parameters[0]);
    const Lens lens = Eigen::Map<const Lens>(parameters[1], map_.cols());
    const Vec3 direction_C = rotation_exp(-theta) * direction_C_;
    Mat23 by_direction;
    IntrinsicsJacobian by_intrinsics;
    const Result<Pixel> predicted = project(changed(first_, map_, lens), direction_C, &by_direction, &by_intrinsics);
    if (!predicted) return false;
    Eigen::Map<Vec2> r(residuals);
    r = whitening_ * (pixel_ - predicted->vec());
    if (jacobians == nullptr) return true;
    using RowMajor = Eigen::Matrix<double, 2, Eigen::Dynamic, Eigen::RowMajor>;
    if (jacobians[0] != nullptr) {
      Eigen::Map<RowMajor>(jacobians[0], 2, 3) =
          -whitening_ * by_direction * cross_matrix(direction_C) * left_jacobian(-theta);
    }
    if (jacobians[1] != nullptr)
      Eigen::Map<RowMajor>(jacobians[1], 2, map_.cols()) = -whitening_ * by_intrinsics * map_;
    return true;
  }

 private:
  Vec3 direction_C_;
  Vec2 pixel_;
  Intrinsics first_;
  ByLens map_;
  Mat2 whitening_;
};

void silence_the_library() {
  static const bool once = [] {
    FLAGS_minloglevel = google::GLOG_FATAL;
    return true;
  }();
  (void)once;
}

class Bundle {
 public:
  Bundle(std::span<const StarObservation> stars, std::span<const Mat3> R_CN, const Intrinsics& first,
         const LensFreedom& freedom)
      : stars_(stars), freedom_(freedom) {
    out_.camera = first;
    silence_the_library();
    out_.R_CN.assign(R_CN.begin(), R_CN.end());
    out_.residuals_px.resize(stars.size());
    out_.used.assign(stars.size(), true);
    look();
    for (std::size_t i = 0; i < stars.size(); ++i) out_.used[i] = out_.residuals_px[i].x() < kFarOffPx;
  }

  // One least squares from where the last one ended. `robust`: Cauchy's loss.
  bool solve(const Scatter& scatter, bool robust, bool with_covariance) {
    if (out_.R_CN.size() == 1) return solve_one(scatter, robust, with_covariance);
    const ByLens map = intrinsics_by_lens(out_.camera, freedom_);
    Lens lens = Lens::Zero(map.cols());
    std::vector<Vec3> theta(out_.R_CN.size(), Vec3::Zero());
    ceres::Problem problem;
    problem.AddParameterBlock(lens.data(), static_cast<int>(lens.size()));
    std::vector<int> stars_of(theta.size(), 0);
    for (std::size_t i = 0; i < stars_.size(); ++i) {
      if (!out_.used[i]) continue;
      const auto frame = static_cast<std::size_t>(stars_[i].frame);
      ++stars_of[frame];
      problem.AddResidualBlock(new StarCost(stars_[i], out_.R_CN[frame], out_.camera, map, scatter),
                               robust ? new ceres::CauchyLoss(kLossSigma) : nullptr, theta[frame].data(), lens.data());
    }
    for (const int count : stars_of) {
      if (count < 2) return false;
    }
    if (2 * problem.NumResidualBlocks() < 2 * parameters()) return false;
    ceres::Solver::Options options;
    options.linear_solver_type = ceres::DENSE_SCHUR;
    options.linear_solver_ordering.reset(new ceres::ParameterBlockOrdering);
    for (Vec3& t : theta) options.linear_solver_ordering->AddElementToGroup(t.data(), 0);
    options.linear_solver_ordering->AddElementToGroup(lens.data(), 1);
    options.logging_type = ceres::SILENT;
    options.max_num_iterations = 50;
    options.function_tolerance = 1e-9;  // of chi-square: a thousandth of a sigma is 1e-6 of one star
    options.parameter_tolerance = 1e-10;
    ceres::Solver::Summary summary;
    ceres::Solve(options, &problem, &summary);
    if (!summary.IsSolutionUsable()) return false;
    if (with_covariance && !find_covariance(problem, theta, lens, map)) return false;
    out_.camera = changed(out_.camera, map, lens);
    for (std::size_t k = 0; k < theta.size(); ++k) {
      out_.R_CN[k] = to_matrix(to_quaternion(rotation_exp(-theta[k]) * out_.R_CN[k]));
    }
    look();
    return true;
  }

  // Of all pairs (scale, extra) that make chi-square what the degrees of freedom say, the likeliest: that with the
  // least sum of log determinants (docs/theory/camera.md eq. 11).
  Scatter scatter() const {
    Scatter best = with_right_chi_square(1.0);
    if (used() < kStarsForScale) return best;
    double least = log_determinants(best);
    for (double scale = 0.5; scale < 4.1; scale *= 1.15) {
      const Scatter other = with_right_chi_square(scale);
      const double sum = log_determinants(other);
      if (sum < least && std::abs(chi_square(other) / wanted_chi_square() - 1.0) < 1e-3) {
        least = sum;
        best = other;
      }
    }
    return best;
  }
  // A first idea of it that a few wrong stars do not pull.
  Scatter robust_scatter() const {
    std::vector<double> squares;
    for (std::size_t i = 0; i < stars_.size(); ++i) {
      if (out_.residuals_px[i].x() < kFarOffPx) squares.push_back(out_.residuals_px[i].squaredNorm());
    }
    if (squares.empty()) return {};
    return {.scale = 1.0,
            .extra_sigma_px = std::max(std::sqrt(median(squares) / (2.0 * std::log(2.0))), kLeastSigmaPx)};
  }

  // Uses what lies within the gate; true where that is another set than before.
  bool gate(double gate_sigma, const Scatter& scatter) {
    bool other = false;
    for (std::size_t i = 0; i < stars_.size(); ++i) {
      const bool inside = surprise(i, scatter) < gate_sigma * gate_sigma;
      other |= inside != out_.used[i];
      out_.used[i] = inside;
    }
    return other;
  }

  double surprise(std::size_t i, const Scatter& scatter) const {
    if (!(out_.residuals_px[i].x() < kFarOffPx)) return 1e12;
    return out_.residuals_px[i].dot(scatter.covariance(stars_[i].covariance_px2).inverse() * out_.residuals_px[i]);
  }

  int used() const { return static_cast<int>(std::count(out_.used.begin(), out_.used.end(), true)); }
  int parameters() const { return freedom_.count() + 3 * static_cast<int>(out_.R_CN.size()); }

  Adjustment result(const Scatter& scatter) {
    out_.scatter = scatter;
    double sum = 0.0;
    for (std::size_t i = 0; i < stars_.size(); ++i) {
      if (out_.used[i]) sum += out_.residuals_px[i].squaredNorm();
    }
    out_.rms_px = std::sqrt(sum / std::max(1, used()));
    return out_;
  }

 private:
  // Of one picture: Levenberg and Marquardt's steps without the library, which spends more time on setting so small a
  // problem up than on solving it.
  bool solve_one(const Scatter& scatter, bool robust, bool with_covariance) {
    constexpr int kMaxSteps = 50;
    constexpr double kEnough = 1e-9;  // of chi-square, as above
    if (used() < std::max(2, parameters())) return false;
    const ByLens map = intrinsics_by_lens(out_.camera, freedom_);
    Normals normals;
    normals.by_lens.leftCols(map.cols()) = map;
    for (const StarObservation& star : stars_)
      normals.weights.push_back(scatter.covariance(star.covariance_px2).inverse());
    double chi2 = normals.look_at(*this, out_.R_CN[0], out_.camera, robust, false);
    double damping = 1e-4;
    for (int step = 0; step < kMaxSteps && chi2 < HUGE_VAL && damping < 1e8; ++step) {
      Normals::Matrix damped = normals.information;
      damped.diagonal() *= 1.0 + damping;
      const Normals::Change change = damped.ldlt().solve(normals.slope);
      if (!change.allFinite()) return false;
      const Mat3 R_CN = rotation_exp(-change.head<3>()) * out_.R_CN[0];
      const Intrinsics camera = changed(out_.camera, map, change.segment(3, map.cols()));
      const double tried = normals.look_at(*this, R_CN, camera, robust, true);
      if (!(tried <= chi2)) {
        damping *= 10.0;
        continue;
      }
      const bool done = chi2 - tried <= kEnough * chi2;
      out_.R_CN[0] = to_matrix(to_quaternion(R_CN));
      out_.camera = camera;
      damping *= 0.1;
      if (done && !with_covariance) break;
      chi2 = normals.look_at(*this, R_CN, camera, robust, false);
      if (done) break;
    }
    look();
    return chi2 < HUGE_VAL && (!with_covariance || take_covariance(normals));
  }

  // The attitude and all nine parameters; what is held has columns of nothing, and does not change.
  struct Normals {
    static constexpr int kAll = 12;
    using Matrix = Eigen::Matrix<double, kAll, kAll>;
    using Change = Eigen::Matrix<double, kAll, 1>;
    Matrix information = Matrix::Zero();
    Change slope = Change::Zero();
    Eigen::Matrix<double, 9, 9> by_lens = Eigen::Matrix<double, 9, 9>::Zero();  // columns of freedom first
    std::vector<Mat2> weights;

    // Chi-square; infinite where a star falls nowhere.
    double look_at(const Bundle& bundle, const Mat3& R_CN, const Intrinsics& camera, bool robust,
                   bool only_chi_square) {
      if (!only_chi_square) {
        information.setZero();
        information.diagonal().tail(9 - bundle.freedom_.count()).setOnes();
        slope.setZero();
      }
      Eigen::Matrix<double, 2, kAll> jacobian = Eigen::Matrix<double, 2, kAll>::Zero();
      double chi2 = 0.0;
      for (std::size_t i = 0; i < bundle.stars_.size(); ++i) {
        if (!bundle.out_.used[i]) continue;
        const Vec3 direction_C = R_CN * bundle.stars_[i].direction_N;
        Mat23 by_direction;
        IntrinsicsJacobian by_intrinsics;
        const auto predicted = project(camera, direction_C, &by_direction, &by_intrinsics);
        if (!predicted) return HUGE_VAL;
        const Vec2 off = bundle.stars_[i].pixel.vec() - predicted->vec();
        const double d2 = off.dot(weights[i] * off), of_loss2 = kLossSigma * kLossSigma;
        const double pull = robust ? 1.0 / (1.0 + d2 / of_loss2) : 1.0;
        chi2 += robust ? of_loss2 * std::log1p(d2 / of_loss2) : d2;
        if (only_chi_square) continue;
        jacobian.leftCols<3>() = by_direction * cross_matrix(direction_C);
        jacobian.rightCols<9>() = by_intrinsics * by_lens;
        const Eigen::Matrix<double, kAll, 2> weighted = pull * jacobian.transpose() * weights[i];
        information.noalias() += weighted * jacobian;
        slope.noalias() += weighted * off;
      }
      return chi2;
    }
  };

  bool take_covariance(const Normals& normals) {
    const Eigen::LDLT<Normals::Matrix> factors(normals.information);
    if (factors.info() != Eigen::Success || !factors.isPositive()) return false;
    PlateCovariance to_all = PlateCovariance::Zero();
    to_all.topLeftCorner<3, 3>().setIdentity();
    to_all.bottomRightCorner<9, 9>() = normals.by_lens;
    out_.plate_covariance = to_all * factors.solve(Normals::Matrix::Identity()) * to_all.transpose();
    out_.covariance = out_.plate_covariance.bottomRightCorner<9, 9>();
    out_.attitude_covariance_rad2 = {out_.plate_covariance.topLeftCorner<3, 3>()};
    return out_.plate_covariance.allFinite();
  }

  double wanted_chi_square() const { return std::max(1.0, 2.0 * used() - parameters()); }
  double chi_square(const Scatter& scatter) const {
    double sum = 0.0;
    for (std::size_t i = 0; i < stars_.size(); ++i) {
      if (out_.used[i]) sum += surprise(i, scatter);
    }
    return sum;
  }
  double log_determinants(const Scatter& scatter) const {
    double sum = 0.0;
    for (std::size_t i = 0; i < stars_.size(); ++i) {
      if (out_.used[i]) sum += std::log(scatter.covariance(stars_[i].covariance_px2).determinant());
    }
    return sum;
  }
  Scatter with_right_chi_square(double scale) const {
    double lo = kLeastSigmaPx, hi = 30.0;
    for (int i = 0; i < 24; ++i) {
      const double middle = std::sqrt(lo * hi);
      (chi_square({scale, middle}) > wanted_chi_square() ? lo : hi) = middle;
    }
    return {scale, hi};
  }

  void look() {
    for (std::size_t i = 0; i < stars_.size(); ++i) {
      const auto predicted =
          project(out_.camera, out_.R_CN[static_cast<std::size_t>(stars_[i].frame)] * stars_[i].direction_N);
      out_.residuals_px[i] = predicted ? Vec2(stars_[i].pixel.vec() - predicted->vec()) : Vec2::Constant(kFarOffPx);
    }
  }

  bool find_covariance(ceres::Problem& problem, std::vector<Vec3>& theta, Lens& lens, const ByLens& map) {
    ceres::Covariance::Options options;
    options.algorithm_type = ceres::SPARSE_QR;
    ceres::Covariance covariance(options);
    std::vector<std::pair<const double*, const double*>> blocks{{lens.data(), lens.data()}};
    for (Vec3& t : theta) blocks.emplace_back(t.data(), t.data());
    if (!covariance.Compute(blocks, &problem)) return false;
    using RowMajor = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
    RowMajor of_lens(lens.size(), lens.size());
    covariance.GetCovarianceBlock(lens.data(), lens.data(), of_lens.data());
    out_.covariance = map * of_lens * map.transpose();
    out_.attitude_covariance_rad2.clear();
    for (Vec3& t : theta) {
      Eigen::Matrix<double, 3, 3, Eigen::RowMajor> block;
      covariance.GetCovarianceBlock(t.data(), t.data(), block.data());
      out_.attitude_covariance_rad2.push_back(block);
    }
    return out_.covariance.allFinite();
  }

  std::span<const StarObservation> stars_;
  LensFreedom freedom_;
  Adjustment out_;
};

tl::unexpected<Error> undetermined(const LensFreedom& freedom, int stars) {
  return fail(ErrorCode::not_converged, "{0} stars do not determine {1} parameters of the camera",
              {static_cast<double>(stars), static_cast<double>(freedom.count())});
}

}  // namespace

std::array<bool, 9> LensFreedom::free() const {
  return {focal, focal || aspect, centre, centre, radial >= 1, radial >= 2, radial >= 3, tangential, tangential};
}

std::array<double, 9> intrinsics_values(const Intrinsics& c) {
  const Distortion& d = c.distortion;
  return {c.fx_px, c.fy_px, c.cx_px, c.cy_px, d.k1, d.k2, d.k3, d.p1, d.p2};
}

Result<Adjustment> adjust(std::span<const StarObservation> observations, std::span<const Mat3> first_R_CN,
                          const Intrinsics& first, const LensFreedom& freedom, const AdjustOptions& options) {
  Bundle bundle(observations, first_R_CN, first, freedom);
  Scatter scatter = options.scatter.value_or(bundle.robust_scatter());
  for (int robust = 0; robust < 2; ++robust) {
    if (!bundle.solve(scatter, true, false)) return undetermined(freedom, bundle.used());
    if (!options.scatter) scatter = bundle.robust_scatter();
  }
  for (int pass = 0; pass < options.passes; ++pass) {
    const bool other = bundle.gate(options.gate_sigma, scatter);
    if (!options.scatter) scatter = bundle.scatter();
    if (!bundle.solve(scatter, false, false)) return undetermined(freedom, bundle.used());
    if (!options.scatter) scatter = bundle.scatter();
    if (!other && pass > 0) break;
  }
  if (!bundle.solve(scatter, false, true)) return undetermined(freedom, bundle.used());
  return bundle.result(scatter);
}

Result<CrossValidation> cross_validate(std::span<const StarObservation> observations, std::span<const Mat3> first_R_CN,
                                       const Intrinsics& first, const LensFreedom& freedom, const Scatter& scatter,
                                       int folds) {
  std::vector<std::size_t> order(observations.size());
  std::iota(order.begin(), order.end(), std::size_t{0});
  RandomStream random({.seed = 1, .purpose = "parts of a cross-validation"});
  std::shuffle(order.begin(), order.end(), random);
  CrossValidation out{.freedom = freedom, .surprise = std::vector<double>(observations.size(), 0.0)};
  double squares = 0.0, surprises = 0.0;
  std::size_t foretold = 0;
  for (int fold = 0; fold < folds; ++fold) {
    std::vector<StarObservation> kept;
    for (std::size_t i = 0; i < order.size(); ++i) {
      if (static_cast<int>(i % static_cast<std::size_t>(folds)) != fold) kept.push_back(observations[order[i]]);
    }
    // The stars have been gated before: all of them count here.
    Bundle bundle(kept, first_R_CN, first, freedom);
    if (!bundle.solve(scatter, false, false)) return undetermined(freedom, bundle.used());
    const Adjustment fitted = bundle.result(scatter);
    for (std::size_t i = 0; i < order.size(); ++i) {
      if (static_cast<int>(i % static_cast<std::size_t>(folds)) != fold) continue;
      const StarObservation& star = observations[order[i]];
      const auto predicted =
          project(fitted.camera, fitted.R_CN[static_cast<std::size_t>(star.frame)] * star.direction_N);
      const Vec2 miss = predicted ? Vec2(star.pixel.vec() - predicted->vec()) : Vec2::Constant(kFarOffPx);
      out.surprise[order[i]] =
          std::min(kMostSurprise, miss.dot(scatter.covariance(star.covariance_px2).inverse() * miss));
      if (predicted) {
        squares += miss.squaredNorm();
        ++foretold;
      }
      surprises += out.surprise[order[i]];
    }
  }
  out.held_out_rms_px = std::sqrt(squares / static_cast<double>(std::max<std::size_t>(1, foretold)));
  out.mean_surprise = surprises / static_cast<double>(std::max<std::size_t>(1, observations.size()));
  return out;
}

}  // namespace astronav::opensky
