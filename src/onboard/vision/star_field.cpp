// SPDX-License-Identifier: Apache-2.0
#include "onboard/vision/star_field.h"

#include <algorithm>
#include <cmath>

#include "foundation/math/rotation.h"

namespace astronav::vision {
namespace {

int cell_of(double x, int cells) {
  return std::clamp(static_cast<int>((x + 1.0) * 0.5 * cells), 0, cells - 1);
}

}  // namespace

StarField StarField::build(const StarCatalogue& catalogue, double max_v_mag, Epoch epoch) {
  StarField field;
  field.epoch_ = epoch;
  std::size_t bright = 0;
  for (std::size_t i = 0; i < catalogue.size(); ++i) bright += catalogue.star(i).v_mag <= max_v_mag;
  field.stars_.reserve(bright);
  for (std::size_t i = 0; i < catalogue.size(); ++i) {
    const Star star = catalogue.star(i);
    if (!(star.v_mag <= max_v_mag)) continue;
    const EastNorth axes = east_north(star.direction_N);
    const Vec3 motion = axes.east * star.pm_ra_cosdec_rad_yr + axes.north * star.pm_dec_rad_yr;
    FieldStar entry;
    entry.direction_N = (star.direction_N + motion * epoch.julian_years_since_j2000()).normalized();
    entry.motion_rad_yr = motion.cast<float>();
    entry.parallax_rad = static_cast<float>(star.parallax_rad);
    entry.v_mag = star.v_mag;
    entry.catalogue_index = static_cast<std::uint32_t>(i);
    entry.id = star.id;
    field.stars_.push_back(entry);
  }
  field.arrange();
  return field;
}

StarField StarField::subset(std::span<const std::uint32_t> stars) const {
  StarField field;
  field.epoch_ = epoch_;
  for (const std::uint32_t i : stars) field.stars_.push_back(stars_[i]);
  field.arrange();
  return field;
}

void StarField::arrange() {
  cells_ = std::clamp(static_cast<int>(std::sqrt(static_cast<double>(stars_.size())) / 4.0), 8, 80);
  const int n = cells_;
  const auto cell = [n](const FieldStar& s) {
    return (cell_of(s.direction_N.x(), n) * n + cell_of(s.direction_N.y(), n)) * n + cell_of(s.direction_N.z(), n);
  };
  std::stable_sort(stars_.begin(), stars_.end(),
                   [&](const FieldStar& a, const FieldStar& b) { return cell(a) < cell(b); });
  first_.assign(static_cast<std::size_t>(n) * n * n + 1, 0);
  for (const FieldStar& s : stars_) ++first_[cell(s) + 1];
  for (std::size_t i = 1; i < first_.size(); ++i) first_[i] += first_[i - 1];
}

template <typename Use>
void StarField::visit(const Vec3& center, double radius, Use&& use) const {
  const double reach = std::min(2.0, 2.0 * std::sin(0.5 * std::min(radius, kPi)));  // chord
  const int n = cells_;
  const int x0 = cell_of(center.x() - reach, n), x1 = cell_of(center.x() + reach, n);
  const int y0 = cell_of(center.y() - reach, n), y1 = cell_of(center.y() + reach, n);
  const int z0 = cell_of(center.z() - reach, n), z1 = cell_of(center.z() + reach, n);
  for (int x = x0; x <= x1; ++x) {
    for (int y = y0; y <= y1; ++y) {
      const std::size_t row = (static_cast<std::size_t>(x) * n + y) * n;
      for (std::uint32_t i = first_[row + z0]; i < first_[row + z1 + 1]; ++i) use(i);
    }
  }
}

std::size_t StarField::cone(const Vec3& center_N, double radius_rad, std::span<std::uint32_t> out) const {
  std::size_t count = 0;
  const double least = std::cos(std::min(radius_rad, kPi));
  visit(center_N, radius_rad, [&](std::uint32_t i) {
    if (stars_[i].direction_N.dot(center_N) >= least && count < out.size()) out[count++] = i;
  });
  return count;
}

std::int32_t StarField::nearest(const Vec3& direction_N, double radius_rad, double max_v_mag) const {
  const double chord = 2.0 * std::sin(0.5 * radius_rad);
  double best = chord * chord;
  std::int32_t found = -1;
  visit(direction_N, radius_rad, [&](std::uint32_t i) {
    const double d2 = (stars_[i].direction_N - direction_N).squaredNorm();
    if (d2 < best && stars_[i].v_mag <= max_v_mag) {
      best = d2;
      found = static_cast<std::int32_t>(i);
    }
  });
  return found;
}

Vec3 StarField::apparent(const FieldStar& star, const Observer& observer) const {
  return ApparentPlaces(*this, observer).of(star);
}

}  // namespace astronav::vision
