// SPDX-License-Identifier: Apache-2.0
#include "verification/opensky/compare_model.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <utility>

#include "foundation/math/rotation.h"
#include "foundation/math/statistics.h"
#include "models/aberration/aberration.h"
#include "simulator/sky/sky.h"
#include "verification/opensky/compare_least_squares.h"
#include "verification/opensky/compare_star_shape.h"

namespace astronav::opensky {
namespace {

constexpr double kMarginPx = 20.0;
constexpr int kStamp = StarShape::kReach;
constexpr int kFit = 4;  // half the side of the window in which it is fitted
constexpr double kSearchPx = 2.0;
constexpr double kGate = 4.0;  // robust sigma, in fits
constexpr double kSamePlace = 5.0 * kArcsecond;

// Nothing but the light of stars: no sky, no dark current, nothing lost in a full well.
render::Effects starlight() {
  render::Effects effects = render::Effects::expected();
  effects.background = effects.dark = effects.stray_light = effects.full_well = effects.blooming = false;
  effects.frame_transfer = effects.motion = false;
  return effects;
}

}  // namespace

Model::Model(const CompareRequest& request, const Frame& frame) : request_(request), frame_(frame) {
  camera = request.camera;
  camera.intrinsics = request.plate;
  camera.exposure_s = request.exposure_s;
  R_CN = request.R_CN;
  clear_ = camera.optics;
}

Result<void> Model::look() {
  camera.optics.transmission = clear_.transmission;
  double highest = 0.0;
  for (BandPoint& point : camera.optics.transmission) {
    point.value *= std::exp(tint * (point.wavelength_m - 600e-9) / 100e-9);
    highest = std::max(highest, point.value);
  }
  if (tint != 0.0)
    for (BandPoint& point : camera.optics.transmission) point.value /= highest;
  const BandPhotometry band(camera);
  sky::SkySettings settings;
  settings.max_v_mag = request_.max_v_mag;
  settings.aberration = request_.observer_known && request_.aberration;
  const double radius =
      camera.intrinsics.half_diagonal_rad() + 2.0 * kMarginPx * camera.intrinsics.plate_scale_rad_px();
  auto seen = sky::Sky(*request_.ephemeris, *request_.catalogue)
                  .look(request_.epoch, request_.observer, R_CN.row(2).transpose(), radius, band, settings);
  if (!seen) return forward(seen);
  if (!request_.observer_known) std::erase_if(*seen, [](const auto& s) { return s.kind != sky::SourceKind::star; });
  for (std::size_t i = 0; i < request_.named.size(); ++i) {
    const NamedStar& named = request_.named[i];
    sky::SkySource source;
    source.id = kNamedStars + static_cast<std::int64_t>(i);
    source.direction_N = star_direction(named.star, request_.epoch, request_.observer.p_m);
    if (settings.aberration) source.direction_N = aberrate(source.direction_N, request_.observer.v_m_s);
    source.v_mag = static_cast<double>(named.star.v_mag);
    source.b_v = static_cast<double>(named.star.b_v);
    source.flux = band.flux(source.v_mag, source.b_v, named.v_i);
    std::erase_if(*seen, [&](const sky::SkySource& other) {
      return other.kind == sky::SourceKind::star && other.id < kNamedStars &&
             angle_between(other.direction_N, source.direction_N) < kSamePlace;
    });
    seen->push_back(source);
  }
  sources_ = render::place_sources(*seen, camera, R_CN, request_.exposure_s, kMarginPx);
  std::stable_sort(sources_.begin(), sources_.end(),
                   [](const auto& a, const auto& b) { return a.electrons > b.electrons; });
  index_.clear();
  for (std::size_t i = 0; i < sources_.size(); ++i) index_.emplace_back(sources_[i].source.id, i);
  std::sort(index_.begin(), index_.end());
  return {};
}

const render::RenderedSource* Model::find(std::int64_t id) const {
  const auto at = std::lower_bound(index_.begin(), index_.end(), std::pair(id, std::size_t{0}));
  return at != index_.end() && at->first == id ? &sources_[at->second] : nullptr;
}

ImageF Model::light_e() const {
  ImageF light;
  render::Renderer(camera, 1).electrons(sources_, {.duration_s = request_.exposure_s}, light, starlight());
  return light;
}

ImageF Model::rendering_dn() const {
  ImageF out = light_e();
  const auto gain = static_cast<float>(camera.detector.gain_e_dn);
  for (std::size_t i = 0; i < out.pixels().size(); ++i)
    out.pixels()[i] = out.pixels()[i] / gain + frame_.sky.level_dn.pixels()[i];
  return out;
}

double Model::expected_snr(const render::RenderedSource& source) const {
  const Intrinsics& c = camera.intrinsics;
  const int u = std::clamp(static_cast<int>(std::lround(source.pixel.u)), 0, c.width_px - 1);
  const int v = std::clamp(static_cast<int>(std::lround(source.pixel.v)), 0, c.height_px - 1);
  const double level = static_cast<double>(frame_.sky.level_dn(u, v));
  StarShape alone(camera, source.pixel);
  double information = 0.0;
  for (const float share : alone.draw(source.pixel).pixels()) {
    const double dn = static_cast<double>(share) * source.electrons / camera.detector.gain_e_dn;
    information += dn * dn / frame_.noise.variance(level + dn);
  }
  return std::sqrt(information);
}

std::vector<Measured> Model::measure(double least_snr) const {
  const Intrinsics& c = camera.intrinsics;
  const double gain = camera.detector.gain_e_dn;
  const ImageF light = light_e();
  std::vector<Measured> out;
  for (const render::RenderedSource& source : sources_) {
    const Pixel first = source.pixel;
    if (!c.contains(first)) continue;
    Measured star;
    star.id = source.source.id;
    star.pixel = first;
    star.snr = expected_snr(source);
    if (star.snr < least_snr) continue;
    StarShape alone(camera, first);
    const ImageF own = alone.draw(first);
    // What is left of the picture when sky and neighbours are taken away, with the expected noise.
    struct Sample {
      int x, y;  // on the stamp
      double e, sigma_e;
    };
    std::vector<Sample> samples;
    for (int y = kStamp - kFit; y <= kStamp + kFit; ++y) {
      for (int x = kStamp - kFit; x <= kStamp + kFit; ++x) {
        const int u = alone.u0() + x, v = alone.v0() + y;
        if (u < 0 || v < 0 || u >= c.width_px || v >= c.height_px) continue;
        const double dn = static_cast<double>(frame_.dn(u, v)), sky = static_cast<double>(frame_.sky.level_dn(u, v));
        if (!std::isfinite(dn)) continue;
        star.saturated |= dn >= frame_.saturation_dn;
        const double neighbours = static_cast<double>(light(u, v)) - static_cast<double>(own(x, y)) * source.electrons;
        const double expected = sky + static_cast<double>(light(u, v)) / gain;
        samples.push_back({x, y, (dn - sky) * gain - neighbours, gain * std::sqrt(frame_.noise.variance(expected))});
      }
    }
    if (samples.size() < 20) continue;
    const auto residuals = [&](const Eigen::VectorXd& p) {
      const ImageF& shape = alone.draw({first.u + p[0], first.v + p[1]});
      Eigen::VectorXd r(static_cast<Eigen::Index>(samples.size()) + 2);
      for (std::size_t i = 0; i < samples.size(); ++i) {
        const Sample& s = samples[i];
        r[static_cast<Eigen::Index>(i)] =
            (p[2] * source.electrons * static_cast<double>(shape(s.x, s.y)) - s.e) / s.sigma_e;
      }
      // Without light there is no place: it stays near the prediction.
      r[r.size() - 2] = p[0] / (2.0 * kSearchPx);
      r[r.size() - 1] = p[1] / (2.0 * kSearchPx);
      return r;
    };
    Eigen::VectorXd p(3);
    p << 0.0, 0.0, 1.0;
    Eigen::VectorXd steps(3);
    steps << 0.05, 0.05, 0.05;
    least_squares(residuals, p, steps, 12);
    star.pixel = {first.u + p[0], first.v + p[1]};
    star.electrons = p[2] * source.electrons;
    star.found = std::hypot(p[0], p[1]) < kSearchPx && star.electrons > 0.0;
    Eigen::MatrixXd J(samples.size() + 2, 3);
    for (int k = 0; k < 3; ++k) {
      Eigen::VectorXd up = p, down = p;
      up[k] += steps[k];
      down[k] -= steps[k];
      J.col(k) = (residuals(up) - residuals(down)) / (2.0 * steps[k]);
    }
    const Eigen::MatrixXd covariance =
        (J.transpose() * J + Eigen::MatrixXd::Identity(3, 3) * 1e-12).ldlt().solve(Eigen::MatrixXd::Identity(3, 3));
    star.sigma_px = std::sqrt(0.5 * (covariance(0, 0) + covariance(1, 1)));
    star.sigma_e = source.electrons * std::sqrt(covariance(2, 2));
    out.push_back(star);
  }
  return out;
}

bool Model::fit(std::span<const Measured> stars, const std::function<bool(std::int64_t)>& use) {
  std::vector<Measured> taken;
  for (const Measured& star : stars)
    if (star.found && !star.saturated && use(star.id)) taken.push_back(star);
  if (request_.fit_plate) {
    if (taken.size() < 6) return false;
    fit_plate(taken);
    fit_photometry(taken);
  }
  fit_point_spread(taken);
  return true;
}

void Model::fit_plate(std::span<const Measured> stars) {
  const Intrinsics start = camera.intrinsics;
  const Mat3 R_start = R_CN;
  // Half the diagonal on the normalised plane: parameters are told by what they move there, in pixels.
  const double edge = start.half_diagonal_px() / start.fx_px;
  const double e2 = edge * edge;
  const double px = start.fx_px * edge;  // half the diagonal
  // Three turns, fx, fy, k1, k2, p1, p2; and how far each may go without good reason.
  const std::array<double, 9> unit{1.0 / start.fx_px,    1.0 / start.fx_px, 1.0 / px,
                                   start.fx_px / px,     start.fy_px / px,  1.0 / (px * e2),
                                   1.0 / (px * e2 * e2), 1.0 / (px * edge), 1.0 / (px * edge)};
  const std::array<double, 9> loose{100.0, 100.0, 100.0, 100.0, 100.0, 30.0, 3.0, 3.0, 3.0};
  const auto apply = [&](const Eigen::VectorXd& x, Intrinsics& c, Mat3& R) {
    c = start;
    R = rotation_exp(Vec3(x[0] * unit[0], x[1] * unit[1], x[2] * unit[2])) * R_start;
    c.fx_px += x[3] * unit[3];
    c.fy_px += x[4] * unit[4];
    c.distortion.k1 += x[5] * unit[5];
    c.distortion.k2 += x[6] * unit[6];
    c.distortion.p1 += x[7] * unit[7];
    c.distortion.p2 += x[8] * unit[8];
  };
  // fx and fy differ only by what the air does to the height of the sky.
  constexpr double kUnequalPx = 0.5;
  constexpr double kFloorPx = 0.02;
  std::vector<const render::RenderedSource*> sources;
  std::vector<char> used(stars.size(), 1);
  for (const Measured& star : stars) sources.push_back(find(star.id));
  Eigen::VectorXd x = Eigen::VectorXd::Zero(9);
  const auto off = [&](const Intrinsics& c, const Mat3& R, std::size_t i) {
    const auto pixel = sources[i] != nullptr ? project(c, R * sources[i]->source.direction_N) : Result<Pixel>(Pixel{});
    return pixel ? Vec2(stars[i].pixel.vec() - pixel->vec()) : Vec2(Vec2::Zero());
  };
  for (int round = 0; round < 5; ++round) {
    const auto residuals = [&](const Eigen::VectorXd& p) {
      Intrinsics c;
      Mat3 R;
      apply(p, c, R);
      Eigen::VectorXd r = Eigen::VectorXd::Zero(static_cast<Eigen::Index>(2 * stars.size()) + 10);
      for (std::size_t i = 0; i < stars.size(); ++i) {
        if (!used[i]) continue;
        r.segment<2>(static_cast<Eigen::Index>(2 * i)) = off(c, R, i) / std::hypot(stars[i].sigma_px, kFloorPx);
      }
      const auto priors = static_cast<Eigen::Index>(2 * stars.size());
      for (Eigen::Index k = 0; k < 9; ++k) r[priors + k] = p[k] / loose[static_cast<std::size_t>(k)];
      r[priors + 9] = (p[3] - p[4]) / kUnequalPx;
      return r;
    };
    least_squares(residuals, x, Eigen::VectorXd::Constant(9, 0.01), 10);
    Intrinsics c;
    Mat3 R;
    apply(x, c, R);
    std::vector<double> sizes;
    for (std::size_t i = 0; i < stars.size(); ++i)
      sizes.push_back(off(c, R, i).norm() / std::hypot(stars[i].sigma_px, kFloorPx));
    const double gate = std::max(kGate * median(sizes) / 1.1774, 1e-6);  // median of Rayleigh's law
    for (std::size_t i = 0; i < stars.size(); ++i) used[i] = sizes[i] < gate;
  }
  apply(x, camera.intrinsics, R_CN);
}

void Model::fit_photometry(std::span<const Measured> stars) {
  const Intrinsics& c = camera.intrinsics;
  const double corner = c.half_diagonal_px();
  const double loss_now = camera.optics.vignetting_corner_loss;
  constexpr double kFloorMag = 0.1;  // catalogue, variability, undersampling
  struct Row {
    double v_mag, b_v, v_i, mag, sigma, r2;
  };
  std::vector<Row> rows;
  for (const Measured& star : stars) {
    const render::RenderedSource* source = find(star.id);
    if (source == nullptr || source->source.kind != sky::SourceKind::star || !(star.electrons > 0.0)) continue;
    const double r2 = std::pow((star.pixel.u - c.cx_px) / corner, 2) + std::pow((star.pixel.v - c.cy_px) / corner, 2);
    rows.push_back(
        {source->source.v_mag, source->source.b_v,
         star.id >= kNamedStars ? request_.named[static_cast<std::size_t>(star.id - kNamedStars)].v_i : kUnknownColour,
         -2.5 * std::log10(star.electrons / request_.exposure_s),
         std::hypot(1.0857 * star.sigma_e / star.electrons, kFloorMag), r2});
  }
  if (rows.size() < 6) return;
  std::vector<char> used(rows.size(), 1);
  // Zero point (mag), tint (e-folds per 100 nm), what is lost at the corner.
  Eigen::VectorXd x(3);
  x << 0.0, tint, loss_now;
  const auto off = [&](const Eigen::VectorXd& p) {
    Camera tinted = camera;
    tinted.optics.transmission = clear_.transmission;
    for (BandPoint& point : tinted.optics.transmission)
      point.value *= std::exp(p[1] * (point.wavelength_m - 600e-9) / 100e-9);
    const BandPhotometry band(tinted);
    Eigen::VectorXd r(static_cast<Eigen::Index>(rows.size()));
    for (std::size_t i = 0; i < rows.size(); ++i) {
      const Row& row = rows[i];
      const double expected =
          band.flux(row.v_mag, row.b_v, row.v_i).electrons_per_s * std::max(1.0 - p[2] * row.r2, 1e-3);
      r[static_cast<Eigen::Index>(i)] = row.mag + p[0] + 2.5 * std::log10(expected);
    }
    return r;
  };
  // First without colour and edge, so that the gate starts from sense.
  {
    const Eigen::VectorXd r = off(x);
    x[0] = -median(std::span(r.data(), static_cast<std::size_t>(r.size())));
  }
  const bool free_tint = !request_.camera_known && rows.size() >= 12;
  const bool free_loss = rows.size() >= 20;
  for (int round = 0; round < 5; ++round) {
    const auto residuals = [&](const Eigen::VectorXd& p) {
      Eigen::VectorXd full = x;
      full[0] = p[0];
      if (free_tint) full[1] = p[1];
      if (free_loss) full[2] = p[2];
      Eigen::VectorXd r = off(full);
      for (std::size_t i = 0; i < rows.size(); ++i) {
        const auto k = static_cast<Eigen::Index>(i);
        r[k] = used[i] ? r[k] / rows[i].sigma : 0.0;
      }
      r.conservativeResize(r.size() + 2);
      r[r.size() - 2] = p[1] / 0.5;
      r[r.size() - 1] = p[2] / 0.5;
      return r;
    };
    Eigen::VectorXd steps(3);
    steps << 0.01, 0.01, 0.01;
    Eigen::VectorXd p = x;
    least_squares(residuals, p, steps, 8);
    x[0] = p[0];
    if (free_tint) x[1] = std::clamp(p[1], -1.0, 1.0);
    if (free_loss) x[2] = std::clamp(p[2], 0.0, 0.9);
    const Eigen::VectorXd r = off(x);
    std::vector<double> sizes;
    for (std::size_t i = 0; i < rows.size(); ++i)
      sizes.push_back(std::abs(r[static_cast<Eigen::Index>(i)]) / rows[i].sigma);
    const double gate = std::max(kGate * 1.4826 * median(sizes), 1e-6);
    for (std::size_t i = 0; i < rows.size(); ++i) used[i] = sizes[i] < gate;
  }
  tint = x[1];
  camera.optics.vignetting_corner_loss = x[2];
  // The zero point is the pupil's. Here the tinted curve was used as it is; look() scales it to a highest value of 1.
  double highest = tint != 0.0 ? 0.0 : 1.0;
  if (tint != 0.0)
    for (const BandPoint& point : clear_.transmission)
      highest = std::max(highest, point.value * std::exp(tint * (point.wavelength_m - 600e-9) / 100e-9));
  camera.optics.pupil_diameter_m *= std::pow(10.0, 0.2 * x[0]) * std::sqrt(highest);
}

void Model::fit_point_spread(std::span<const Measured> stars) {
  // The brightest tell the shape.
  std::vector<Measured> bright(stars.begin(), stars.end());
  std::sort(bright.begin(), bright.end(), [](const auto& a, const auto& b) { return a.snr > b.snr; });
  std::erase_if(bright, [](const Measured& star) { return star.snr < 25.0; });
  if (bright.size() > 60) bright.resize(60);
  if (bright.size() < 4) return;
  const Intrinsics& c = camera.intrinsics;
  const double gain = camera.detector.gain_e_dn;
  const ImageF light = light_e();
  struct Window {
    Pixel at;
    double electrons;
    std::vector<float> e, sigma_e;  // of the whole stamp; sigma 0 beyond the picture
  };
  std::vector<Window> windows;
  for (const Measured& star : bright) {
    const render::RenderedSource* source = find(star.id);
    if (source == nullptr) continue;
    StarShape model(camera, source->pixel);
    const ImageF own = model.draw(source->pixel);
    StarShape there(camera, star.pixel);  // where the stamp will lie
    Window window{star.pixel, star.electrons, {}, {}};
    for (int y = 0; y <= 2 * kStamp; ++y) {
      for (int x = 0; x <= 2 * kStamp; ++x) {
        const int u = there.u0() + x, v = there.v0() + y;
        const int ou = u - model.u0(), ov = v - model.v0();
        const bool inside = u >= 0 && v >= 0 && u < c.width_px && v < c.height_px && own.view().contains(ou, ov);
        if (!inside || !std::isfinite(frame_.dn(u, v))) {
          window.e.push_back(0.0f);
          window.sigma_e.push_back(0.0f);
          continue;
        }
        const double sky = static_cast<double>(frame_.sky.level_dn(u, v));
        const double neighbours =
            static_cast<double>(light(u, v)) - static_cast<double>(own(ou, ov)) * source->electrons;
        window.e.push_back(static_cast<float>((static_cast<double>(frame_.dn(u, v)) - sky) * gain - neighbours));
        // A share of the light itself stands for what no model of few parameters explains.
        const double expected = sky + static_cast<double>(light(u, v)) / gain;
        window.sigma_e.push_back(static_cast<float>(
            std::hypot(gain * std::sqrt(frame_.noise.variance(expected)), 0.05 * static_cast<double>(light(u, v)))));
      }
    }
    windows.push_back(std::move(window));
  }
  // ln sigma, growth, logarithms of what the halo holds and of its width.
  PointSpread start = camera.psf;
  const auto shaped = [&](const Eigen::VectorXd& p) {
    Camera shape = camera;
    shape.psf.sigma_px = std::clamp(start.sigma_px * std::exp(p[0]), 0.2, 10.0);
    shape.psf.sigma_growth_px = std::clamp(start.sigma_growth_px + p[1], -0.5 * shape.psf.sigma_px, shape.psf.sigma_px);
    shape.psf.halo_fraction = std::clamp(start.halo_fraction * std::exp(p[2]), 1e-4, 0.95);
    shape.psf.halo_sigma_px = std::clamp(start.halo_sigma_px * std::exp(p[3]), 1.2 * shape.psf.sigma_px, 8.0);
    return shape;
  };
  const auto residuals = [&](const Eigen::VectorXd& p) {
    const Camera shape = shaped(p);
    std::vector<double> r;
    for (const Window& window : windows) {
      StarShape alone(shape, window.at);
      const ImageF& drawn = alone.draw(window.at);
      // The flux that fits best.
      double top = 0.0, bottom = 0.0;
      for (std::size_t i = 0; i < window.e.size(); ++i) {
        if (window.sigma_e[i] == 0.0f) continue;
        const double w = 1.0 / std::pow(static_cast<double>(window.sigma_e[i]), 2);
        const double share = static_cast<double>(drawn.pixels()[i]);
        top += w * share * static_cast<double>(window.e[i]);
        bottom += w * share * share;
      }
      const double electrons = bottom > 0.0 ? top / bottom : 0.0;
      for (std::size_t i = 0; i < window.e.size(); ++i) {
        if (window.sigma_e[i] == 0.0f) {
          r.push_back(0.0);
          continue;
        }
        const double z = (electrons * static_cast<double>(drawn.pixels()[i]) - static_cast<double>(window.e[i])) /
                         static_cast<double>(window.sigma_e[i]);
        r.push_back(std::abs(z) <= 3.0 ? z : std::copysign(std::sqrt(6.0 * std::abs(z) - 9.0), z));  // Huber's law
      }
    }
    for (Eigen::Index k = 0; k < p.size(); ++k) r.push_back(p[k] / 2.0);
    return Eigen::VectorXd(Eigen::Map<const Eigen::VectorXd>(r.data(), static_cast<Eigen::Index>(r.size())));
  };
  // A sharp core in a wide halo and a wide core with faint wings are two valleys: each round goes down both.
  PointSpread sharp = camera.psf, wide = camera.psf;
  sharp.sigma_px = 0.5 * camera.psf.sigma_px;
  sharp.halo_fraction = 0.5;
  sharp.halo_sigma_px = camera.psf.sigma_px;
  std::optional<double> least;
  PointSpread best = camera.psf;
  for (const PointSpread& first : {wide, sharp}) {
    start = first;
    Eigen::VectorXd p = Eigen::VectorXd::Zero(4);
    const double cost = least_squares(residuals, p, Eigen::VectorXd::Constant(4, 0.02), 12);
    if (least && cost >= *least) continue;
    least = cost;
    best = shaped(p).psf;
  }
  camera.psf = best;
}

}  // namespace astronav::opensky
