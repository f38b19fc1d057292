// SPDX-License-Identifier: Apache-2.0
#include "onboard/navigation/survey.h"

#include <algorithm>
#include <cmath>

#include <Eigen/Cholesky>

#include "foundation/math/rotation.h"
#include "models/ephemeris/ecliptic.h"
#include "models/photometry/photometry.h"

namespace astronav::navigation {
namespace {

constexpr std::array kBodies{body::mercury, body::venus,   body::earth,  body::moon,
                             body::mars,    body::jupiter, body::saturn, body::uranus};
constexpr std::int8_t kNothing = -1;
constexpr double kGate1 = 23.9;      // chi-square, one degree of freedom: one in a million
constexpr double kGate2 = 27.6;      // two degrees
constexpr double kMagnitudes = 6.0;  // over which false spots are spread
constexpr double kEdgePx = 20.0;     // a planet nearer to the edge may be lost
constexpr double kBlendPx = 6.0;     // two bodies nearer to each other may be one spot

using Naming = std::array<std::int8_t, kMaxSurveySpots>;  // index into kBodies

struct Fix {
  Vec3 p = Vec3::Zero();
  Mat3 covariance = Mat3::Zero();
  double chi2 = 0.0;
};

struct Hypothesis {
  Naming naming;
  Fix fix;
  double evidence = 0.0;  // natural logarithm
};

class Surveyor {
 public:
  Surveyor(std::span<const SurveyFrame> frames, std::span<const SurveySpot> spots, const SurveySettings& settings)
      : frames_(frames), spots_(spots), settings_(settings) {}

  Result<void> load(const Ephemeris& ephemeris);
  void try_all();
  Result<SurveySolution> answer() const;

 private:
  // Of a body, light time counted: where the light came from that reaches p at the frame's epoch.
  Vec3 source(std::size_t frame, int body, const Vec3& p) const {
    const State& s = states_[frame][static_cast<std::size_t>(body)];
    Vec3 at = s.p_m;
    for (int i = 0; i < 2; ++i) at = s.p_m - s.v_m_s * ((at - p).norm() / kSpeedOfLight);
    return at;
  }
  double seconds(std::size_t frame) const { return (frames_[frame].epoch - frames_[0].epoch).seconds(); }
  Vec3 guessed_velocity(const Vec3& p) const { return circular_velocity(p, gm_sun_); }
  double sight_sigma(const SurveySpot& spot, double distance) const;
  // How far a body, seen from p, stands off the sight of a spot; nothing where it is behind the spacecraft.
  struct Miss {
    Vec3 across_m;
    double sigma_m;
  };
  std::optional<Miss> miss(const SurveySpot& spot, int body, const Vec3& p) const;
  std::optional<Fix> fix(const Naming& naming) const;
  bool possible(const Vec3& p) const;
  void extend(Hypothesis& h) const;
  double evidence(const Hypothesis& h) const;
  double v_mag(std::size_t frame, int body, const Vec3& p) const;
  std::optional<Pixel> in_frame(std::size_t frame, int body, const Vec3& p) const;
  double log_clutter(const SurveySpot& spot) const;
  void keep(const Hypothesis& h);

  std::span<const SurveyFrame> frames_;
  std::span<const SurveySpot> spots_;
  SurveySettings settings_;
  std::array<std::array<State, kBodies.size()>, kMaxSurveyFrames> states_{};
  std::array<Vec3, kMaxSurveyFrames> sun_{};
  double gm_sun_ = 0.0;  // m3/s2
  std::array<Hypothesis, 32> kept_{};
  std::size_t kept_count_ = 0;
};

Result<void> Surveyor::load(const Ephemeris& ephemeris) {
  const Result<BodyConstants> sun_constants = body_constants(body::sun);
  if (!sun_constants) return forward(sun_constants);
  gm_sun_ = sun_constants->gm_m3_s2;
  for (std::size_t f = 0; f < frames_.size(); ++f) {
    const auto sun = ephemeris.state(body::sun, body::solar_system_barycenter, frames_[f].epoch);
    if (!sun) return forward(sun);
    sun_[f] = sun->p_m;
    for (std::size_t b = 0; b < kBodies.size(); ++b) {
      const auto id = ephemeris.resolve(kBodies[b]);
      if (!id) return forward(id);
      const auto state = ephemeris.state(*id, body::solar_system_barycenter, frames_[f].epoch);
      if (!state) return forward(state);
      states_[f][b] = *state;
    }
  }
  return {};
}

// Centroid and attitude; what the speed aberrates differently where the spot is and where the stars are on average; and
// how far the spacecraft may have come since the first frame.
double Surveyor::sight_sigma(const SurveySpot& spot, double distance) const {
  const SurveyFrame& frame = frames_[spot.frame];
  const double off_axis = angle_between(frame.R_CN.row(2).transpose(), spot.direction_N);
  const double aberration = settings_.speed_m_s / std::sqrt(3.0) / kSpeedOfLight * off_axis;
  const double way = settings_.velocity_sigma_m_s * std::abs(seconds(spot.frame)) / distance;
  return std::sqrt(spot.sigma_rad * spot.sigma_rad + aberration * aberration + way * way);
}

std::optional<Surveyor::Miss> Surveyor::miss(const SurveySpot& spot, int body, const Vec3& p) const {
  const Vec3 to = source(spot.frame, body, p) - p;
  const double along = to.dot(spot.direction_N), distance = to.norm();
  if (along <= 0.0) return std::nullopt;
  return Miss{to - along * spot.direction_N, distance * sight_sigma(spot, distance)};
}

bool Surveyor::possible(const Vec3& p) const {
  const Vec3 from_sun = (p - sun_[0]) / kAstronomicalUnit;
  const double height = from_sun.dot(ecliptic_north_N());
  return from_sun.norm() > settings_.least_distance_au && from_sun.norm() < settings_.most_distance_au &&
         std::abs(height) < settings_.most_height_au;
}

// Least squares on all named sights (eq. 15): what is across a sight is measured, what is along it is not. Weights and
// light time need the place, so three rounds.
std::optional<Fix> Surveyor::fix(const Naming& naming) const {
  Fix out;
  out.p = sun_[0] + Vec3(kAstronomicalUnit, 0.0, 0.0);
  constexpr int kRounds = 4;
  for (int round = 0; round < kRounds; ++round) {
    Mat3 information = Mat3::Zero();
    Vec3 sum = Vec3::Zero();
    const Vec3 velocity = round == 0 ? Vec3::Zero() : guessed_velocity(out.p);
    for (std::size_t i = 0; i < spots_.size(); ++i) {
      if (naming[i] == kNothing) continue;
      const SurveySpot& spot = spots_[i];
      const Vec3 moved = velocity * seconds(spot.frame);
      const Vec3 from = source(spot.frame, naming[i], out.p + moved);
      const double distance = (from - out.p).norm();
      const double sigma = distance * (round == 0 ? 1e-4 : sight_sigma(spot, distance));
      const Mat3 weight = (Mat3::Identity() - spot.direction_N * spot.direction_N.transpose()) / (sigma * sigma);
      information += weight;
      sum += weight * (from - moved);
    }
    const Eigen::LDLT<Mat3> ldlt(information);
    // Sights that are parallel to a few arcseconds cross nowhere.
    if (ldlt.info() != Eigen::Success || !(ldlt.vectorD().minCoeff() > 1e-10 * ldlt.vectorD().maxCoeff()))
      return std::nullopt;
    out.p = ldlt.solve(sum);
    if (!out.p.allFinite() || (out.p - sun_[0]).norm() > 10.0 * kAstronomicalUnit) return std::nullopt;
    if (round + 1 == kRounds) out.covariance = ldlt.solve(Mat3::Identity());
  }
  const Vec3 velocity = guessed_velocity(out.p);
  for (std::size_t i = 0; i < spots_.size(); ++i) {
    if (naming[i] == kNothing) continue;
    const SurveySpot& spot = spots_[i];
    const auto off = miss(spot, naming[i], out.p + velocity * seconds(spot.frame));
    if (!off) return std::nullopt;
    out.chi2 += off->across_m.squaredNorm() / (off->sigma_m * off->sigma_m);
  }
  return out;
}

double Surveyor::v_mag(std::size_t frame, int body, const Vec3& p) const {
  const Vec3 at = source(frame, body, p);
  const auto magnitude = planet_v_magnitude(
      kBodies[static_cast<std::size_t>(body)],
      {.p_body_from_sun_N = at - sun_[frame], .p_body_from_observer_N = at - p, .epoch = frames_[frame].epoch});
  return magnitude ? *magnitude : 99.0;
}

std::optional<Pixel> Surveyor::in_frame(std::size_t frame, int body, const Vec3& p) const {
  const SurveyFrame& f = frames_[frame];
  const Vec3 direction_C = f.R_CN * (source(frame, body, p) - p);
  if (!(direction_C.z() > 0.0)) return std::nullopt;
  const Result<Pixel> pixel = project(f.camera, direction_C);
  if (!pixel || pixel->u < 0.0 || pixel->v < 0.0 || pixel->u > f.camera.width_px - 1 ||
      pixel->v > f.camera.height_px - 1)
    return std::nullopt;
  return *pixel;
}

// How many false spots there are by steradian and magnitude.
double Surveyor::log_clutter(const SurveySpot& spot) const {
  const Intrinsics& camera = frames_[spot.frame].camera;
  const double solid_angle = camera.width_px / camera.fx_px * camera.height_px / camera.fy_px;
  return std::log(settings_.false_per_frame / (solid_angle * kMagnitudes));
}

// From the place that some sights gave, which of the other spots are planets?
void Surveyor::extend(Hypothesis& h) const {
  for (std::size_t i = 0; i < spots_.size(); ++i) {
    if (h.naming[i] != kNothing) continue;
    const SurveySpot& spot = spots_[i];
    const Vec3 p = h.fix.p + guessed_velocity(h.fix.p) * seconds(spot.frame);
    int best = kNothing;
    double least = kGate2;
    for (int b = 0; b < static_cast<int>(kBodies.size()); ++b) {
      bool taken = false;
      for (std::size_t k = 0; k < spots_.size(); ++k) taken |= h.naming[k] == b && spots_[k].frame == spot.frame;
      if (taken) continue;
      const auto off = miss(spot, b, p);
      if (!off) continue;
      const Mat3 covariance = h.fix.covariance + Mat3::Identity() * off->sigma_m * off->sigma_m;
      const double d2 = off->across_m.dot(covariance.ldlt().solve(off->across_m));
      if (d2 > least || std::abs(v_mag(spot.frame, b, p) - spot.v_mag) > 4.0 * settings_.v_mag_sigma) continue;
      best = b;
      least = d2;
    }
    if (best == kNothing) continue;
    Naming longer = h.naming;
    longer[i] = static_cast<std::int8_t>(best);
    const auto fixed = fix(longer);
    if (!fixed || fixed->chi2 - h.fix.chi2 > kGate2 || !possible(fixed->p)) continue;
    h.naming = longer;
    h.fix = *fixed;
  }
}

// Eq. 16. Natural logarithm; the place is integrated over.
double Surveyor::evidence(const Hypothesis& h) const {
  const double au3 = std::pow(kAstronomicalUnit, 3);
  const double volume = kPi * settings_.most_distance_au * settings_.most_distance_au * 2.0 * settings_.most_height_au;
  double sum = 1.5 * std::log(2.0 * kPi) + 0.5 * std::log(h.fix.covariance.determinant() / (au3 * au3)) -
               std::log(volume) - 0.5 * h.fix.chi2;
  const Vec3 velocity = guessed_velocity(h.fix.p);
  for (std::size_t i = 0; i < spots_.size(); ++i) {
    const SurveySpot& spot = spots_[i];
    if (h.naming[i] == kNothing) {
      sum += log_clutter(spot);
      continue;
    }
    const Vec3 p = h.fix.p + velocity * seconds(spot.frame);
    const double distance = (source(spot.frame, h.naming[i], p) - p).norm();
    const double sigma = sight_sigma(spot, distance);
    const double off = (v_mag(spot.frame, h.naming[i], p) - spot.v_mag) / settings_.v_mag_sigma;
    sum += std::log(settings_.detection / (2.0 * kPi * sigma * sigma)) - 0.5 * off * off -
           std::log(std::sqrt(2.0 * kPi) * settings_.v_mag_sigma);
  }
  // Planets that should be seen, and are not.
  for (std::size_t f = 0; f < frames_.size(); ++f) {
    const Vec3 p = h.fix.p + velocity * seconds(f);
    for (int b = 0; b < static_cast<int>(kBodies.size()); ++b) {
      bool named = false;
      for (std::size_t i = 0; i < spots_.size(); ++i) named |= h.naming[i] == b && spots_[i].frame == f;
      if (named) continue;
      const std::optional<Pixel> pixel = in_frame(f, b, p);
      const Intrinsics& camera = frames_[f].camera;
      if (!pixel || pixel->u < kEdgePx || pixel->v < kEdgePx || pixel->u > camera.width_px - kEdgePx ||
          pixel->v > camera.height_px - kEdgePx || v_mag(f, b, p) > frames_[f].limit_v_mag - 0.5)
        continue;
      const Vec3 to = source(f, b, p) - p;
      if (angle_between(to, sun_[f] - p) < settings_.sun_exclusion_rad) continue;
      bool hidden = false;
      for (std::size_t i = 0; i < spots_.size(); ++i)
        hidden |= spots_[i].frame == f && angle_between(to, spots_[i].direction_N) < kBlendPx / camera.fx_px;
      if (!hidden) sum += std::log(1.0 - settings_.detection);
    }
  }
  return sum;
}

void Surveyor::keep(const Hypothesis& h) {
  for (std::size_t i = 0; i < kept_count_; ++i)
    if (kept_[i].naming == h.naming) return;
  if (kept_count_ < kept_.size()) {
    kept_[kept_count_++] = h;
    return;
  }
  Hypothesis* worst = &kept_[0];
  for (Hypothesis& k : kept_)
    if (k.evidence < worst->evidence) worst = &k;
  if (h.evidence > worst->evidence) *worst = h;
}

void Surveyor::try_all() {
  const int bodies = static_cast<int>(kBodies.size());
  for (std::size_t i = 0; i < spots_.size(); ++i) {
    for (std::size_t j = i + 1; j < spots_.size(); ++j) {
      for (int a = 0; a < bodies; ++a) {
        for (int b = 0; b < bodies; ++b) {
          if (a == b) continue;
          Hypothesis h;
          h.naming.fill(kNothing);
          h.naming[i] = static_cast<std::int8_t>(a);
          h.naming[j] = static_cast<std::int8_t>(b);
          const auto fixed = fix(h.naming);
          if (!fixed || fixed->chi2 > kGate1 || !possible(fixed->p)) continue;
          h.fix = *fixed;
          const Vec3 velocity = guessed_velocity(h.fix.p);
          const auto off = [&](std::size_t spot, int body) {
            const std::size_t f = spots_[spot].frame;
            return std::abs(v_mag(f, body, h.fix.p + velocity * seconds(f)) - spots_[spot].v_mag);
          };
          if (off(i, a) > 5.0 * settings_.v_mag_sigma || off(j, b) > 5.0 * settings_.v_mag_sigma) continue;
          extend(h);
          h.evidence = evidence(h);
          keep(h);
        }
      }
    }
  }
}

// Eq. 17.
Result<SurveySolution> Surveyor::answer() const {
  const Hypothesis* best = nullptr;
  double none = 0.0;  // all spots are false, or at most one is a planet
  for (const SurveySpot& spot : spots_) none += log_clutter(spot);
  for (std::size_t i = 0; i < kept_count_; ++i)
    if (best == nullptr || kept_[i].evidence > best->evidence) best = &kept_[i];
  if (best == nullptr)
    return fail(ErrorCode::no_match, "no two of {0} spots are planets seen from one place",
                {static_cast<double>(spots_.size())});
  double sum = std::exp(none - best->evidence), next = 0.0;
  for (std::size_t i = 0; i < kept_count_; ++i) {
    const double share = std::exp(kept_[i].evidence - best->evidence);
    sum += share;
    if (&kept_[i] != best) next = std::max(next, share);
  }
  SurveySolution out;
  out.epoch = frames_[0].epoch;
  out.p_O_N = best->fix.p;
  out.covariance_m2 = best->fix.covariance;
  out.chi2 = best->fix.chi2;
  out.probability = 1.0 / sum;
  out.runner_up = next / sum;
  for (std::size_t i = 0; i < spots_.size(); ++i)
    if (best->naming[i] != kNothing) out.named[out.count++] = {i, kBodies[static_cast<std::size_t>(best->naming[i])]};
  if (out.probability < settings_.min_probability)
    return fail(ErrorCode::no_match, "the likeliest naming of the spots has a probability of {0}, the next of {1}",
                {out.probability, out.runner_up});
  return out;
}

}  // namespace

Vec3 circular_velocity(const Vec3& p_from_sun_N, double gm_sun_m3_s2) {
  return ecliptic_north_N().cross(p_from_sun_N).normalized() * std::sqrt(gm_sun_m3_s2 / p_from_sun_N.norm());
}

Result<SurveySolution> survey(const Ephemeris& ephemeris, std::span<const SurveyFrame> frames,
                              std::span<const SurveySpot> spots, const SurveySettings& settings) {
  if (frames.empty() || frames.size() > kMaxSurveyFrames)
    return fail(ErrorCode::invalid_argument, "{0} frames; 1 to {1} can be surveyed",
                {static_cast<double>(frames.size()), static_cast<double>(kMaxSurveyFrames)});
  if (spots.size() > kMaxSurveySpots)
    return fail(ErrorCode::invalid_argument, "{0} spots; {1} at most, the brightest",
                {static_cast<double>(spots.size()), static_cast<double>(kMaxSurveySpots)});
  for (const SurveySpot& spot : spots)
    if (spot.frame >= frames.size())
      return fail(ErrorCode::invalid_argument, "a spot of frame {0} of {1}",
                  {static_cast<double>(spot.frame), static_cast<double>(frames.size())});
  Surveyor surveyor(frames, spots, settings);
  if (const auto loaded = surveyor.load(ephemeris); !loaded) return forward(loaded);
  surveyor.try_all();
  return surveyor.answer();
}

}  // namespace astronav::navigation
