// SPDX-License-Identifier: Apache-2.0
#include "cli/wcs.h"

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <optional>
#include <string>
#include <utility>

#include <Eigen/Cholesky>
#include <fmt/format.h>

#include "foundation/math/rotation.h"
#include "verification/opensky/compare_least_squares.h"

namespace astronav::cli {
namespace {

// FITS names for the linear map from pixels to the plane of the projection (TAN for a pinhole, ARC for a fisheye), and
// SIP polynomials where the camera distorts (Shupe et al. 2005). The world is the apparent one: what this observer
// sees.
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
    const std::string projection = std::string(is_fisheye() ? "ARC" : "TAN") + (distorted ? "-SIP" : "");
    text("CTYPE1", "RA---" + projection, "apparent places of this observer");
    text("CTYPE2", "DEC--" + projection, "");
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

  bool is_fisheye() const { return camera_.model == ProjectionModel::fisheye; }
  bool has_distortion() const {
    const Distortion& d = camera_.distortion;
    return d.k1 != 0.0 || d.k2 != 0.0 || d.k3 != 0.0 || d.p1 != 0.0 || d.p2 != 0.0;
  }
  void text(const char* key, const std::string& value, const char* comment) {
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
        const double across = std::hypot(direction->x(), direction->y());
        const double scale = !is_fisheye()    ? 1.0 / direction->z()
                             : across > 1e-12 ? std::atan2(across, direction->z()) / across
                                              : 1.0;
        plane.emplace_back(right_ * camera_.fx_px * direction->x() * scale, -camera_.fy_px * direction->y() * scale);
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

using Header = std::map<std::string, std::string>;

std::optional<double> number_in(const Header& header, const std::string& key) {
  const auto at = header.find(key);
  if (at == header.end()) return {};
  std::string_view text = at->second;
  while (!text.empty() && (text.front() == ' ' || text.front() == '+')) text.remove_prefix(1);
  double value = 0.0;
  const auto [end, problem] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (problem != std::errc() || !std::isfinite(value)) return {};
  return value;
}

// Pixel to direction after a header.
class HeaderMap {
 public:
  static Result<HeaderMap> read(const Header& header) {
    const auto type = header.find("CTYPE1");
    if (type == header.end()) return fail(ErrorCode::not_found, "the header holds no world coordinates");
    if (type->second.rfind("RA---TAN", 0) != 0)
      return fail(ErrorCode::unsupported, "world coordinates of type '{s}'; TAN and TAN-SIP are read", {}, "CTYPE1",
                  type->second);
    HeaderMap map;
    const std::pair<const char*, double*> needed[] = {{"CRVAL1", &map.ra_deg_},        {"CRVAL2", &map.dec_deg_},
                                                      {"CRPIX1", &map.reference_.x()}, {"CRPIX2", &map.reference_.y()},
                                                      {"CD1_1", &map.cd_(0, 0)},       {"CD1_2", &map.cd_(0, 1)},
                                                      {"CD2_1", &map.cd_(1, 0)},       {"CD2_2", &map.cd_(1, 1)}};
    for (const auto& [key, place] : needed) {
      const auto value = number_in(header, key);
      if (!value) return fail(ErrorCode::corrupt_data, "the header's world coordinates lack '{s}'", {}, {}, key);
      *place = *value;
    }
    if (std::abs(map.cd_.determinant()) < 1e-12)
      return fail(ErrorCode::corrupt_data, "the header's CD matrix has no inverse");
    for (int axis = 0; axis < 2; ++axis) {
      const char* prefix = axis == 0 ? "A" : "B";
      const int order = static_cast<int>(number_in(header, fmt::format("{}_ORDER", prefix)).value_or(0.0));
      for (int p = 0; p <= std::clamp(order, 0, 9); ++p)
        for (int q = 0; p + q <= order; ++q)
          if (const auto term = number_in(header, fmt::format("{}_{}_{}", prefix, p, q)))
            map.sip_[static_cast<std::size_t>(axis)].push_back({p, q, *term});
    }
    return map;
  }

  Vec3 direction(Pixel pixel, int height) const {
    const Vec2 d = fits_from_pixel(pixel, height) - reference_;
    Vec2 bent = d;
    for (int axis = 0; axis < 2; ++axis)
      for (const Term& t : sip_[static_cast<std::size_t>(axis)])
        bent[axis] += t.value * std::pow(d.x(), t.p) * std::pow(d.y(), t.q);
    const Vec2 plane = cd_ * bent * kDegree;
    const Vec3 centre = direction_from_radec(ra_deg_ * kDegree, dec_deg_ * kDegree);
    const EastNorth axes = east_north(centre);
    return (centre + plane.x() * axes.east + plane.y() * axes.north).normalized();
  }
  // FITS counts rows upwards and RA grows to the left: a picture as it is seen has a negative determinant.
  bool mirrored() const { return cd_.determinant() > 0.0; }
  double rad_px() const { return std::sqrt(std::abs(cd_.determinant())) * kDegree; }

 private:
  struct Term {
    int p, q;
    double value;
  };
  double ra_deg_ = 0.0, dec_deg_ = 0.0;
  Vec2 reference_ = Vec2::Zero();
  Mat2 cd_ = Mat2::Zero();
  std::array<std::vector<Term>, 2> sip_;
};

}  // namespace

Result<HeaderPlate> plate_from_header(const Header& header, int width, int height) {
  const auto map = HeaderMap::read(header);
  if (!map) return forward(map);
  HeaderPlate plate;
  plate.mirrored = map->mirrored();
  Intrinsics& camera = plate.camera;
  camera.width_px = width;
  camera.height_px = height;
  camera.cx_px = 0.5 * (width - 1);
  camera.cy_px = 0.5 * (height - 1);
  camera.fx_px = camera.fy_px = 1.0 / map->rad_px();
  const auto in_picture = [&](double u) { return plate.mirrored ? width - 1 - u : u; };
  const Vec3 z = map->direction({camera.cx_px, camera.cy_px}, height);
  const Vec3 below = map->direction({camera.cx_px, camera.cy_px + 1.0}, height);
  const Vec3 y = (below - z * z.dot(below)).normalized();
  plate.R_CN << y.cross(z).transpose(), y.transpose(), z.transpose();
  std::vector<std::pair<Pixel, Vec3>> grid;
  constexpr int kSteps = 16;
  for (int j = 0; j <= kSteps; ++j) {
    for (int i = 0; i <= kSteps; ++i) {
      const Pixel pixel{static_cast<double>(width - 1) * i / kSteps, static_cast<double>(height - 1) * j / kSteps};
      grid.emplace_back(pixel, map->direction({in_picture(pixel.u), pixel.v}, height));
    }
  }
  // Turns, fx, fy, k1, k2, p1, p2, each by what it moves at half the diagonal, in pixels.
  const Intrinsics start = camera;
  const Mat3 R_start = plate.R_CN;
  const double edge_px = 0.5 * std::hypot(width, height), edge = edge_px / start.fx_px;
  const auto apply = [&](const Eigen::VectorXd& x) {
    camera = start;
    plate.R_CN = rotation_exp(Vec3(x[0] / start.fx_px, x[1] / start.fx_px, x[2] / edge_px)) * R_start;
    camera.fx_px += x[3] / edge;
    camera.fy_px += x[4] / edge;
    camera.distortion.k1 = x[5] / (edge_px * edge * edge);
    camera.distortion.k2 = x[6] / (edge_px * std::pow(edge, 4));
    camera.distortion.p1 = x[7] / (edge_px * edge);
    camera.distortion.p2 = x[8] / (edge_px * edge);
  };
  const auto residuals = [&](const Eigen::VectorXd& x) {
    apply(x);
    Eigen::VectorXd r(static_cast<Eigen::Index>(2 * grid.size()) + 9);
    for (std::size_t i = 0; i < grid.size(); ++i) {
      const auto seen = project(camera, plate.R_CN * grid[i].second);
      r.segment<2>(static_cast<Eigen::Index>(2 * i)) =
          seen ? Vec2(seen->vec() - grid[i].first.vec()) : Vec2(edge_px, edge_px);
    }
    r.tail(9) = 1e-6 * x;
    return r;
  };
  Eigen::VectorXd x = Eigen::VectorXd::Zero(9);
  opensky::least_squares(residuals, x, Eigen::VectorXd::Constant(9, 0.01), 30);
  const Eigen::VectorXd off = residuals(x);
  for (std::size_t i = 0; i < grid.size(); ++i)
    plate.largest_error_px = std::max(plate.largest_error_px, off.segment<2>(static_cast<Eigen::Index>(2 * i)).norm());
  if (!(plate.largest_error_px < 0.1))
    return fail(ErrorCode::unsupported, "no camera with k1, k2, p1, p2 sees the sky as the header says: {0} px off",
                {plate.largest_error_px});
  return plate;
}

std::vector<FitsCard> wcs_cards(const Intrinsics& camera, const Mat3& R_CN, bool mirrored) {
  return Wcs(camera, R_CN, mirrored).cards();
}

}  // namespace astronav::cli
