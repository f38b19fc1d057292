// SPDX-License-Identifier: Apache-2.0
#include "cli/wcs.h"

#include <algorithm>
#include <cmath>
#include <string>
#include <utility>

#include <Eigen/Cholesky>
#include <fmt/format.h>

#include "foundation/math/rotation.h"

namespace astronav::cli {
namespace {

// FITS names for the linear map from pixels to the tangent plane, and SIP polynomials where the camera distorts
// (Shupe et al. 2005). The world is the apparent one: what this observer sees.
class Wcs {
 public:
  Wcs(const Intrinsics& camera, const Mat3& R_CN, bool mirrored) : camera_(camera), right_(mirrored ? -1.0 : 1.0) {
    const Vec3 boresight_N = R_CN.row(2).transpose();
    const RaDec place = radec_from_direction(boresight_N);
    const EastNorth axes = east_north(boresight_N);
    const double u = mirrored ? camera.width_px - 1 - camera.cx_px : camera.cx_px;
    const Vec2 reference = fits_from_pixel({u, camera.cy_px}, camera.height_px);
    const Vec3 right = right_ * R_CN.row(0).transpose();
    const Vec3 down = R_CN.row(1).transpose();
    const bool distorted = has_distortion();
    text("CTYPE1", distorted ? "RA---TAN-SIP" : "RA---TAN", "apparent places of this observer");
    text("CTYPE2", distorted ? "DEC--TAN-SIP" : "DEC--TAN", "");
    text("CUNIT1", "deg", "");
    text("CUNIT2", "deg", "");
    text("RADESYS", "ICRS", "axes; aberration and light time are in the places");
    number("CRVAL1", place.ra_rad / kDegree, "boresight");
    number("CRVAL2", place.dec_rad / kDegree, "boresight");
    number("CRPIX1", reference.x(), "boresight");
    number("CRPIX2", reference.y(), "boresight");
    number("CD1_1", right.dot(axes.east) / camera.fx_px / kDegree, "");
    number("CD1_2", -down.dot(axes.east) / camera.fy_px / kDegree, "FITS rows count upwards");
    number("CD2_1", right.dot(axes.north) / camera.fx_px / kDegree, "");
    number("CD2_2", -down.dot(axes.north) / camera.fy_px / kDegree, "");
    if (distorted) add_sip();
  }
  const std::vector<FitsCard>& cards() const { return cards_; }

 private:
  static constexpr int kOrder = 5;

  bool has_distortion() const {
    const Distortion& d = camera_.distortion;
    return d.k1 != 0.0 || d.k2 != 0.0 || d.k3 != 0.0 || d.p1 != 0.0 || d.p2 != 0.0;
  }
  void text(const char* key, const char* value, const char* comment) {
    cards_.push_back({.key = key, .text = value, .number = {}, .comment = comment});
  }
  void number(const std::string& key, double value, const char* comment) {
    cards_.push_back({.key = key, .text = {}, .number = value, .comment = comment});
  }

  // Least squares over a grid of pixels, in units of half the image so that the normal equations are well conditioned.
  void add_sip() {
    std::vector<std::pair<int, int>> powers;
    for (int p = 0; p <= kOrder; ++p) {
      for (int q = 0; p + q <= kOrder; ++q) {
        if (p + q >= 2) powers.emplace_back(p, q);
      }
    }
    const double unit = 0.5 * std::max(camera_.width_px, camera_.height_px);
    std::vector<Vec2> seen;   // FITS offsets from the reference pixel, with distortion
    std::vector<Vec2> plane;  // and without
    const int steps = 24;
    for (int i = 0; i <= steps; ++i) {
      for (int j = 0; j <= steps; ++j) {
        const Pixel pixel{-0.5 + camera_.width_px * (static_cast<double>(i) / steps),
                          -0.5 + camera_.height_px * (static_cast<double>(j) / steps)};
        const auto direction = unproject(camera_, pixel);
        if (!direction) continue;
        seen.emplace_back(right_ * (pixel.u - camera_.cx_px), camera_.cy_px - pixel.v);
        plane.emplace_back(right_ * camera_.fx_px * direction->x() / direction->z(),
                           -camera_.fy_px * direction->y() / direction->z());
      }
    }
    const auto fit = [&](const std::vector<Vec2>& from, const std::vector<Vec2>& to, const char* prefix_x,
                         const char* prefix_y) {
      Eigen::MatrixXd design(from.size(), powers.size());
      Eigen::MatrixX2d wanted(from.size(), 2);
      for (Eigen::Index r = 0; r < design.rows(); ++r) {
        const Vec2& at = from[static_cast<std::size_t>(r)];
        wanted.row(r) = (to[static_cast<std::size_t>(r)] - at).transpose();
        for (Eigen::Index c = 0; c < design.cols(); ++c) {
          const auto [p, q] = powers[static_cast<std::size_t>(c)];
          design(r, c) = std::pow(at.x() / unit, p) * std::pow(at.y() / unit, q);
        }
      }
      const Eigen::MatrixX2d terms = (design.transpose() * design).ldlt().solve(design.transpose() * wanted);
      for (const auto& [prefix, column] : {std::pair{prefix_x, 0}, std::pair{prefix_y, 1}}) {
        number(fmt::format("{}_ORDER", prefix), kOrder, "");
        for (std::size_t c = 0; c < powers.size(); ++c) {
          const auto [p, q] = powers[c];
          number(fmt::format("{}_{}_{}", prefix, p, q),
                 terms(static_cast<Eigen::Index>(c), column) / std::pow(unit, p + q), "");
        }
      }
    };
    fit(seen, plane, "A", "B");
    fit(plane, seen, "AP", "BP");
  }

  Intrinsics camera_;
  double right_;  // -1 where columns run the other way than the camera's x
  std::vector<FitsCard> cards_;
};

}  // namespace

std::vector<FitsCard> wcs_cards(const Intrinsics& camera, const Mat3& R_CN, bool mirrored) {
  return Wcs(camera, R_CN, mirrored).cards();
}

}  // namespace astronav::cli
