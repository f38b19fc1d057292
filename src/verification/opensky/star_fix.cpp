// SPDX-License-Identifier: Apache-2.0
#include "verification/opensky/star_fix.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <span>
#include <utility>

#include "foundation/math/rotation.h"
#include "foundation/math/statistics.h"
#include "models/aberration/aberration.h"
#include "models/ephemeris/bodies.h"
#include "onboard/navigation/triangulation.h"

namespace astronav::opensky {
namespace {

using vision::Centroid;

constexpr double kClip = 4.0;  // robust sigma

// A spot among the far stars, in N.
std::optional<Vec3> direction_of(const FixFrame& frame, const Centroid& spot) {
  const double u = frame.mirrored ? frame.plate.width_px - 1 - spot.pixel.u : spot.pixel.u;
  const auto direction_C = unproject(frame.plate, {u, spot.pixel.v});
  if (!direction_C) return std::nullopt;
  return Vec3(frame.R_CN.transpose() * *direction_C);
}

Vec2 across(const EastNorth& axes, const Vec3& v) {
  return {axes.east.dot(v), axes.north.dot(v)};
}

bool same_light(const FixFrame& a, const Centroid& in_a, const FixFrame& b, const Centroid& in_b, double share) {
  const double first = in_a.flux_dn / a.exposure_s, second = in_b.flux_dn / b.exposure_s;
  return std::abs(first - second) < share * std::max(first, second);
}

class Fixer {
 public:
  Fixer(const std::vector<FixFrame>& frames, const std::vector<NearStar>& stars, const StarFixSettings& settings)
      : frames_(frames), stars_(stars), settings_(settings) {
    directions_.resize(frames.size());
    for (std::size_t f = 0; f < frames.size(); ++f)
      for (const Centroid& spot : frames[f].spots) directions_[f].push_back(direction_of(frames[f], spot));
  }

  Result<StarFix> fix();

 private:
  // One star of a field: its spot in each of the field's frames.
  using Track = std::vector<std::size_t>;

  void find_fields();
  std::vector<std::size_t> candidates(std::size_t frame, std::size_t star) const;
  std::optional<std::size_t> counterpart(std::size_t from, std::size_t spot, std::size_t in) const;
  std::optional<Track> track(const std::vector<std::size_t>& frames, std::size_t spot) const;
  void measure_scatter(FixField& field, const std::vector<std::size_t>& frames, const Track& near_star) const;
  Vec3 aberrated_among_stars(const FixFrame& frame, const Vec3& direction) const;

  const std::vector<FixFrame>& frames_;
  const std::vector<NearStar>& stars_;
  const StarFixSettings& settings_;
  std::vector<std::vector<std::optional<Vec3>>> directions_;  // of spots, by frame
  StarFix out_;
};

// Spots that may be the near star: as far off as parallax can carry it; brightest first.
std::vector<std::size_t> Fixer::candidates(std::size_t f, std::size_t s) const {
  const Star& star = stars_[s].star;
  const Vec3 home = star_direction(star, frames_[f].epoch, Vec3::Zero());
  const double reach =
      star.parallax_rad * settings_.most_distance_au + settings_.same_place_px * frames_[f].plate.plate_scale_rad_px();
  std::vector<std::size_t> found;
  for (std::size_t i = 0; i < directions_[f].size(); ++i)
    if (directions_[f][i] && angle_between(*directions_[f][i], home) < reach) found.push_back(i);
  std::sort(found.begin(), found.end(),
            [&](std::size_t a, std::size_t b) { return frames_[f].spots[a].flux_dn > frames_[f].spots[b].flux_dn; });
  return found;
}

// The spot of another frame that is at the same place and about as bright.
std::optional<std::size_t> Fixer::counterpart(std::size_t from, std::size_t spot, std::size_t in) const {
  if (!directions_[from][spot]) return std::nullopt;
  std::optional<std::size_t> best;
  double least = settings_.same_place_px * frames_[in].plate.plate_scale_rad_px();
  for (std::size_t i = 0; i < directions_[in].size(); ++i) {
    if (!directions_[in][i]) continue;
    const double off = angle_between(*directions_[from][spot], *directions_[in][i]);
    if (off >= least) continue;
    if (!same_light(frames_[from], frames_[from].spots[spot], frames_[in], frames_[in].spots[i], settings_.same_light))
      continue;
    best = i;
    least = off;
  }
  return best;
}

// What is at one place in all frames of a field is a star; what the detector alone saw is not.
std::optional<Fixer::Track> Fixer::track(const std::vector<std::size_t>& frames, std::size_t spot) const {
  Track out{spot};
  for (std::size_t k = 1; k < frames.size(); ++k) {
    const auto other = counterpart(frames[0], spot, frames[k]);
    if (!other) return std::nullopt;
    out.push_back(*other);
  }
  return out;
}

void Fixer::find_fields() {
  for (std::size_t s = 0; s < stars_.size(); ++s) {
    std::vector<std::size_t> frames;
    for (std::size_t f = 0; f < frames_.size(); ++f) {
      const Vec3 home_C = frames_[f].R_CN * star_direction(stars_[s].star, frames_[f].epoch, Vec3::Zero());
      const auto pixel = home_C.z() > 0.0 ? project(frames_[f].plate, home_C) : Result<Pixel>(Pixel{-1e9, -1e9});
      if (pixel && frames_[f].plate.contains(*pixel) && !candidates(f, s).empty()) frames.push_back(f);
    }
    if (frames.empty()) continue;
    std::optional<Track> near_star;
    for (const std::size_t spot : candidates(frames[0], s))
      if ((near_star = track(frames, spot))) break;
    if (!near_star) continue;
    FixField field;
    field.star = s;
    field.frames = frames.size();
    measure_scatter(field, frames, *near_star);
    out_.fields.push_back(field);
    for (std::size_t k = 0; k < frames.size(); ++k) {
      StarSight sight;
      sight.frame = frames[k];
      sight.star = s;
      sight.pixel = frames_[frames[k]].spots[(*near_star)[k]].pixel;
      sight.direction_N = *directions_[frames[k]][(*near_star)[k]];
      const Vec3 home = star_direction(stars_[s].star, frames_[frames[k]].epoch, Vec3::Zero());
      sight.parallax_shift_rad = across(east_north(home), sight.direction_N - home);
      out_.sights.push_back(sight);
    }
  }
}

// docs/theory/fix.md eq. 6 and 7: about their means over the frames, the stars of a field tell what one star scatters,
// and their common shifts what one plate does. Both means take degrees of freedom.
void Fixer::measure_scatter(FixField& field, const std::vector<std::size_t>& frames, const Track& near_star) const {
  const FixFrame& first = frames_[frames[0]];
  const double least = settings_.least_light_share * first.spots[near_star[0]].flux_dn;
  std::vector<Track> tracks;
  for (std::size_t i = 0; i < first.spots.size(); ++i) {
    if (i == near_star[0] || first.spots[i].flux_dn < least) continue;
    if (auto found = track(frames, i)) tracks.push_back(std::move(*found));
  }
  field.field_stars = tracks.size();
  if (frames.size() < 2 || tracks.size() < settings_.least_field_stars) return;
  const double n_frames = static_cast<double>(frames.size());
  std::vector<std::vector<Vec2>> off(frames.size());  // by frame and star
  for (const Track& star : tracks) {
    Vec3 mean = Vec3::Zero();
    for (std::size_t k = 0; k < frames.size(); ++k) mean += *directions_[frames[k]][star[k]] / n_frames;
    const EastNorth axes = east_north(mean.normalized());
    for (std::size_t k = 0; k < frames.size(); ++k)
      off[k].push_back(across(axes, *directions_[frames[k]][star[k]] - mean));
  }
  double plate = 0.0;
  std::vector<double> sizes;
  for (const std::vector<Vec2>& frame : off) {
    std::vector<double> east, north;
    for (const Vec2& o : frame) {
      east.push_back(o.x());
      north.push_back(o.y());
    }
    const Vec2 shift(median(east), median(north));
    plate += shift.squaredNorm();
    for (const Vec2& o : frame) sizes.push_back((o - shift).norm());
  }
  const double limit = kClip * median(sizes) / 1.1774;  // the median of Rayleigh's law
  std::erase_if(sizes, [&](double size) { return size > limit; });
  const double n_stars = static_cast<double>(tracks.size());
  const double star2 = 0.5 * std::pow(rms(sizes), 2) * n_frames * n_stars / ((n_frames - 1.0) * (n_stars - 1.0));
  field.star_scatter_rad = std::sqrt(star2);
  // The medians themselves scatter by the stars' share: pi/2 of a mean's variance.
  field.plate_scatter_rad = std::sqrt(std::max(plate / (2.0 * (n_frames - 1.0)) - 0.5 * kPi * star2 / n_stars, 0.0));
  field.measured = true;
}

// What aberration does to a star beyond what it does to the frame's middle, which is the plate's.
Vec3 Fixer::aberrated_among_stars(const FixFrame& frame, const Vec3& direction) const {
  if (!settings_.velocity_m_s) return direction;
  const Vec3 middle = frame.R_CN.row(2).transpose();
  const Vec3 moved = aberrate(direction, *settings_.velocity_m_s) - direction;
  const Vec3 with_plate = aberrate(middle, *settings_.velocity_m_s) - middle;
  return (direction + moved - with_plate).normalized();
}

Result<StarFix> Fixer::fix() {
  find_fields();
  if (out_.fields.size() < 2)
    return fail(ErrorCode::no_match, "{0} of the near stars are seen; a place needs two",
                {static_cast<double>(out_.fields.size())});
  // Few frames of a field tell little of their plates: all fields together.
  double plate = 0.0, degrees = 0.0;
  for (const FixField& field : out_.fields) {
    if (!field.measured) continue;
    const double n = 2.0 * (static_cast<double>(field.frames) - 1.0);
    plate += n * field.plate_scatter_rad * field.plate_scatter_rad;
    degrees += n;
  }
  for (FixField& field : out_.fields) {
    if (field.measured) {
      field.sigma_rad = std::hypot(field.star_scatter_rad, std::sqrt(plate / degrees));
    } else if (settings_.sight_sigma_rad) {
      field.sigma_rad = *settings_.sight_sigma_rad;
    } else {
      return fail(ErrorCode::invalid_argument,
                  "{0} frames with {1} stars in common are too few to tell what a sight of '{s}' is worth; say so",
                  {static_cast<double>(field.frames), static_cast<double>(field.field_stars)}, {},
                  stars_[field.star].name);
    }
    for (StarSight& sight : out_.sights)
      if (sight.star == field.star) sight.sigma_rad = field.sigma_rad;
  }

  const double seconds = std::accumulate(out_.sights.begin(), out_.sights.end(), 0.0, [&](double sum, const auto& s) {
    return sum + (frames_[s.frame].epoch - frames_[0].epoch).seconds() / static_cast<double>(out_.sights.size());
  });
  out_.epoch = frames_[0].epoch + Duration::seconds(seconds);
  const auto moved = [&](const StarSight& sight) {
    return settings_.velocity_m_s ? Vec3(*settings_.velocity_m_s * (frames_[sight.frame].epoch - out_.epoch).seconds())
                                  : Vec3(Vec3::Zero());
  };

  // Where the light seems to come from needs the observer's place for its travel time (3 mas at 47 au): twice.
  for (int round = 0; round < 2; ++round) {
    std::vector<navigation::LineOfSight> lines;
    for (StarSight& sight : out_.sights) {
      const FixFrame& frame = frames_[sight.frame];
      const Star& star = stars_[sight.star].star;
      const Vec3 here = out_.p_O_N + moved(sight);
      const Vec3 true_direction = star_direction(star, frame.epoch, here);
      const double distance = kAstronomicalUnit / star.parallax_rad;
      navigation::LineOfSight line;
      line.p_beacon_O_N = here + true_direction * distance - moved(sight);
      line.direction_N =
          (sight.direction_N - (aberrated_among_stars(frame, true_direction) - true_direction)).normalized();
      line.covariance_rad2 = Mat3::Identity() * sight.sigma_rad * sight.sigma_rad;
      lines.push_back(line);
    }
    // The barycentre's distance stands for the observer's: 47 au of 268,000.
    const auto found = navigation::triangulate(lines);
    if (!found) return forward(found);
    out_.p_O_N = found->p_O_N;
    out_.covariance_m2 = found->covariance_m2;
    out_.chi2 = found->chi2;
    out_.degrees_of_freedom = found->degrees_of_freedom;
  }
  for (StarSight& sight : out_.sights) {
    const FixFrame& frame = frames_[sight.frame];
    const Vec3 foretold =
        aberrated_among_stars(frame, star_direction(stars_[sight.star].star, frame.epoch, out_.p_O_N + moved(sight)));
    sight.residual_rad = across(east_north(foretold), sight.direction_N - foretold);
  }
  return std::move(out_);
}

}  // namespace

Result<StarFix> fix_by_near_stars(const std::vector<FixFrame>& frames, const std::vector<NearStar>& stars,
                                  const StarFixSettings& settings) {
  for (const NearStar& star : stars)
    if (!(star.star.parallax_rad > 0.0))
      return fail(ErrorCode::invalid_argument, "the star '{s}' has no parallax", {}, {}, star.name);
  for (const FixFrame& frame : frames)
    if (!(frame.exposure_s > 0.0)) return fail(ErrorCode::invalid_argument, "an exposure of {0} s", {frame.exposure_s});
  return Fixer(frames, stars, settings).fix();
}

}  // namespace astronav::opensky
