// SPDX-License-Identifier: Apache-2.0
#include "onboard/navigation/survey.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include <gtest/gtest.h>

#include "foundation/files/mapped_file.h"
#include "foundation/math/random.h"
#include "foundation/math/rotation.h"
#include "foundation/math/statistics.h"
#include "models/aberration/aberration.h"
#include "models/photometry/photometry.h"

namespace astronav::navigation {
namespace {

const Ephemeris& ephemeris() {
  static const MappedFile file = MappedFile::open(home_directory() / "data/de405_2000_2050.bsp").value();
  static const Ephemeris instance = Ephemeris::open(file.bytes()).value();
  return instance;
}

constexpr double kObliquity = 23.44 * kDegree;
constexpr double kSunExclusion = 35.0 * kDegree;
constexpr double kLimit = 6.0;

struct Sky {
  Epoch epoch;
  State spacecraft;  // at the first frame
  std::vector<SurveyFrame> frames;
  std::vector<SurveySpot> spots;
  std::vector<BodyId> truth;  // of each spot; 0: false
};

Vec3 from_ecliptic(const Vec3& v) {
  return {v.x(), std::cos(kObliquity) * v.y() - std::sin(kObliquity) * v.z(),
          std::sin(kObliquity) * v.y() + std::cos(kObliquity) * v.z()};
}

// Frames along the ecliptic, a minute or two apart, as a spacecraft takes them that knows where the Sun is; all of them
// or only `few` with planets in them. What each shows: planets where light time and aberration put them, measured
// among stars that are aberrated too, and spots that are nothing.
Sky look_around(RandomStream& random, std::size_t few, double false_per_frame) {
  Sky sky;
  sky.epoch = Epoch::tdb_seconds(random.uniform(25.0, 45.0) * 365.25 * 86400.0);
  const double r = random.uniform(0.6, 2.0) * kAstronomicalUnit, longitude = random.uniform(0.0, 2.0 * kPi);
  const double circular = 29.78e3 * std::sqrt(kAstronomicalUnit / r);
  sky.spacecraft.p_m = from_ecliptic({r * std::cos(longitude), r * std::sin(longitude), random.normal(0.0, 0.03) * r});
  const double bend = random.normal(0.0, 0.15), speed = circular * random.uniform(0.8, 1.2);
  sky.spacecraft.v_m_s =
      from_ecliptic({-speed * std::sin(longitude + bend), speed * std::cos(longitude + bend), random.normal(0.0, 1e3)});
  for (double off = 40.0; off < 321.0; off += 18.0) {
    SurveyFrame frame;
    frame.epoch = sky.epoch + Duration::seconds(90.0 * static_cast<double>(sky.frames.size()));
    frame.camera = Intrinsics::from_field_of_view(1024, 1024, 20.0 * kDegree);
    const double at = longitude + kPi + off * kDegree;
    const RaDec aim = radec_from_direction(from_ecliptic({std::cos(at), std::sin(at), random.normal(0.0, 0.02)}));
    frame.R_CN = R_CN_from_pointing({aim.ra_rad, aim.dec_rad, random.uniform(0.0, 2.0 * kPi)});
    frame.limit_v_mag = kLimit;
    sky.frames.push_back(frame);
  }
  std::vector<std::pair<SurveySpot, BodyId>> seen;
  for (std::size_t f = 0; f < sky.frames.size(); ++f) {
    const SurveyFrame& frame = sky.frames[f];
    State here = sky.spacecraft;
    here.p_m += here.v_m_s * (frame.epoch - sky.epoch).seconds();
    const Vec3 boresight = frame.R_CN.row(2).transpose();
    // Stars that are taken for unaberrated turn the attitude with them.
    const Mat3 turned =
        Eigen::Quaterniond::FromTwoVectors(aberrate(boresight, here.v_m_s), boresight).toRotationMatrix();
    std::vector<std::pair<SurveySpot, BodyId>> spots;
    for (const BodyId id :
         {body::mercury, body::venus, body::earth, body::moon, body::mars, body::jupiter, body::saturn, body::uranus}) {
      const auto sight = light_time(ephemeris(), *ephemeris().resolve(id), here, frame.epoch).value();
      const Epoch emitted = frame.epoch - Duration::seconds(sight.light_time_s);
      const State sun = ephemeris().state(*ephemeris().resolve(id), body::sun, emitted).value();
      const auto v_mag = planet_v_magnitude(id, {sun.p_m, sight.relative.p_m, emitted});
      const double measured_mag = v_mag.value() + random.normal(0.0, 0.25);
      const Vec3 direction = turned * aberrate(sight.relative.p_m.normalized(), here.v_m_s);
      const Vec3 in_camera = frame.R_CN * direction;
      if (!(in_camera.z() > 0.0) || measured_mag > kLimit) continue;
      const Result<Pixel> pixel = project(frame.camera, in_camera);
      if (!pixel || pixel->u < 4 || pixel->v < 4 || pixel->u > 1019 || pixel->v > 1019) continue;
      SurveySpot spot;
      spot.frame = f;
      spot.sigma_rad = 1.5 * kArcsecond;
      spot.direction_N =
          (direction + spot.sigma_rad * Vec3(random.normal(), random.normal(), random.normal())).normalized();
      spot.v_mag = measured_mag;
      spots.push_back({spot, id});
    }
    // What is within 3 px of a brighter body is part of its spot.
    for (const auto& s : spots) {
      bool hidden = random.uniform() < 0.01;
      for (const auto& other : spots)
        hidden |= other.first.v_mag < s.first.v_mag &&
                  angle_between(other.first.direction_N, s.first.direction_N) < 3.0 * frame.camera.plate_scale_rad_px();
      if (!hidden) seen.push_back(s);
    }
    for (std::uint64_t k = random.poisson(false_per_frame); k > 0; --k) {
      SurveySpot spot;
      spot.frame = f;
      spot.sigma_rad = 1.5 * kArcsecond;
      spot.direction_N =
          frame.R_CN.transpose() * *unproject(frame.camera, {random.uniform(4.0, 1019.0), random.uniform(4.0, 1019.0)});
      spot.v_mag = random.uniform(0.0, kLimit);
      seen.push_back({spot, BodyId{0}});
    }
  }
  if (few > 0) {
    // The frames with the brightest planets.
    std::vector<std::size_t> chosen;
    std::sort(seen.begin(), seen.end(), [](const auto& a, const auto& b) { return a.first.v_mag < b.first.v_mag; });
    for (const auto& [spot, id] : seen)
      if (id != BodyId{0} && chosen.size() < few && std::find(chosen.begin(), chosen.end(), spot.frame) == chosen.end())
        chosen.push_back(spot.frame);
    std::sort(chosen.begin(), chosen.end());
    std::vector<SurveyFrame> frames;
    for (const std::size_t f : chosen) frames.push_back(sky.frames[f]);
    sky.frames = frames;
    std::erase_if(
        seen, [&](const auto& s) { return std::find(chosen.begin(), chosen.end(), s.first.frame) == chosen.end(); });
    for (auto& s : seen)
      s.first.frame = static_cast<std::size_t>(std::find(chosen.begin(), chosen.end(), s.first.frame) - chosen.begin());
    if (!frames.empty()) sky.spacecraft.p_m += sky.spacecraft.v_m_s * (frames[0].epoch - sky.epoch).seconds();
  }
  std::sort(seen.begin(), seen.end(), [](const auto& a, const auto& b) { return a.first.v_mag < b.first.v_mag; });
  if (seen.size() > kMaxSurveySpots) seen.resize(kMaxSurveySpots);
  for (const auto& [spot, id] : seen) {
    sky.spots.push_back(spot);
    sky.truth.push_back(id);
  }
  return sky;
}

struct Tally {
  int skies = 0, right = 0, open = 0, wrong = 0;
  double chi2 = 0.0;
  std::vector<double> error_km;
};

Tally try_skies(int skies, std::size_t few, double false_per_frame, const char* name) {
  RandomStream random(StreamId{.seed = 40, .purpose = name});
  Tally t;
  while (t.skies < skies) {
    const Sky sky = look_around(random, few, false_per_frame);
    int planets = 0;
    for (std::size_t i = 0; i < sky.truth.size(); ++i)
      planets += sky.truth[i] != BodyId{0} && sky.truth[i] != body::moon;
    if (planets < 2) continue;  // one line is no place
    ++t.skies;
    SurveySettings settings;
    settings.false_per_frame = std::max(false_per_frame, 0.1);
    const auto found = survey(ephemeris(), sky.frames, sky.spots, settings);
    if (!found) {
      ++t.open;
      continue;
    }
    const Vec3 error = found->p_O_N - sky.spacecraft.p_m;
    const double d2 = error.dot(found->covariance_m2.inverse() * error);
    bool good = d2 < 40.0;
    for (std::size_t k = 0; k < found->count; ++k) good &= sky.truth[found->named[k].spot] == found->named[k].body;
    if (!good) {
      ++t.wrong;
      continue;
    }
    ++t.right;
    t.chi2 += d2;
    t.error_km.push_back(error.norm() / 1e3);
  }
  std::printf("  %s: %d skies, right %d, left open %d, wrong %d, chi2/3 %.3f, error %.0f km (median)\n", name, t.skies,
              t.right, t.open, t.wrong, t.right > 0 ? t.chi2 / (3.0 * t.right) : 0.0,
              t.right > 0 ? median(t.error_km) : 0.0);
  return t;
}

TEST(Survey, FindsItsPlaceFromNothingAllAround) {
  const Tally t = try_skies(400, 0, 0.3, "all around");
  EXPECT_GE(t.right, 396);
  EXPECT_EQ(t.wrong, 0);
  EXPECT_LT(t.chi2 / (3.0 * t.right), 1.2);
}

TEST(Survey, FromAFewFrames) {
  const Tally t = try_skies(300, 3, 0.3, "three frames");
  EXPECT_GE(t.right, 285);
  EXPECT_EQ(t.wrong, 0);
}

TEST(Survey, SaysSoWhereItCannotTell) {
  // Only false spots, many of them: nothing is named.
  RandomStream random(StreamId{.seed = 41, .purpose = "nothing there"});
  int claimed = 0;
  for (int k = 0; k < 200; ++k) {
    Sky sky = look_around(random, 0, 1.0);
    std::vector<SurveySpot> spots;
    for (std::size_t i = 0; i < sky.spots.size(); ++i)
      if (sky.truth[i] == BodyId{0}) spots.push_back(sky.spots[i]);
    SurveySettings settings;
    settings.false_per_frame = 1.0;
    claimed += survey(ephemeris(), sky.frames, spots, settings).has_value();
  }
  EXPECT_LE(claimed, 2);  // 1 % is what min_probability promises
}

TEST(Survey, RefusesWhatMakesNoSense) {
  EXPECT_EQ(survey(ephemeris(), {}, {}).error().code, ErrorCode::invalid_argument);
  const SurveyFrame frame{Epoch::tdb_seconds(9e8), Mat3::Identity(), Intrinsics::from_field_of_view(64, 64, 0.3), 6.0};
  const SurveySpot elsewhere{.frame = 1};
  EXPECT_EQ(survey(ephemeris(), std::span(&frame, 1), std::span(&elsewhere, 1)).error().code,
            ErrorCode::invalid_argument);
  EXPECT_EQ(survey(ephemeris(), std::span(&frame, 1), {}).error().code, ErrorCode::no_match);
}

}  // namespace
}  // namespace astronav::navigation
