// SPDX-License-Identifier: Apache-2.0
// For the tests: flights of the filter along the arc of arc_for_tests.h, with pictures taken of planets, errors drawn
// as the filter believes them, and what may go wrong.
#pragma once

#include <functional>
#include <vector>

#include <Eigen/Cholesky>

#include "foundation/math/statistics.h"
#include "onboard/navigation/arc_for_tests.h"

namespace astronav::navigation::testing {

inline FilterSettings plain_settings() {
  FilterSettings settings;
  settings.camera = twenty_degree_camera();
  settings.process.reflectivity_area_m2 = 0.0;
  settings.sight.centre_of_light = false;
  settings.focal.sigma = settings.k1.sigma = settings.bias.sigma = 0.0;
  return settings;
}

inline Mat6 diagonal_covariance(double position_m, double velocity_m_s) {
  Mat6 P = Mat6::Zero();
  P.diagonal() << Vec3::Constant(position_m * position_m), Vec3::Constant(velocity_m_s * velocity_m_s);
  return P;
}

// What one image says, with the noise that it says it has. xi_c are the truth's camera errors.
struct ImageNoise {
  double pixel = 0.05;
  double cross = 1.3 * kArcsecond;  // attitude, about x and y
  double roll = 9.0 * kArcsecond;
  double dither_px = 50.0;
};
inline BeaconMeasurement photograph(const State& truth, BodyId body, Epoch epoch, const Intrinsics& camera,
                                    const ImageNoise& noise, RandomStream* random,
                                    const Eigen::Vector4d& xi_c = Eigen::Vector4d::Zero(),
                                    const Vec2& middle_px = Vec2::Zero()) {
  const auto normal = [random] { return random ? random->normal() : 0.0; };
  BeaconMeasurement m;
  m.body = body;
  m.mid_exposure = epoch;
  const Vec3 direction = exact_direction(truth, body, epoch);
  const Vec2 dither = middle_px + noise.dither_px * Vec2(normal(), normal());
  const Mat3 R = pointed_at(direction, camera, dither, 0.3);
  Intrinsics real = camera;
  real.fx_px *= 1.0 + xi_c[0];
  real.fy_px *= 1.0 + xi_c[0];
  real.distortion.k1 += xi_c[1];
  const Vec2 pixel =
      project(real, R * direction).value().vec() + xi_c.tail<2>() + noise.pixel * Vec2(normal(), normal());
  m.pixel = {pixel.x(), pixel.y()};
  m.pixel_covariance_px2 = noise.pixel * noise.pixel * Mat2::Identity();
  const Vec3 theta(noise.cross * normal(), noise.cross * normal(), noise.roll * normal());
  m.R_CN = rotation_exp(theta) * R;  // R_true = exp(-[theta]x) R_measured
  m.attitude_covariance_rad2 =
      Vec3(noise.cross * noise.cross, noise.cross * noise.cross, noise.roll * noise.roll).asDiagonal();
  return m;
}

// The usable pair with the least trace, 35 degrees from the Sun.
inline std::array<BodyId, 2> best_pair(const State& observer, Epoch epoch) {
  struct Seen {
    BodyId body;
    Vec3 direction;
    double weight;
  };
  std::vector<Seen> seen;
  const Vec3 sun = barycentric(body::sun, epoch).p_m - observer.p_m;
  for (const BodyId body : {body::mercury, body::venus, body::earth, body::mars, body::jupiter, body::saturn}) {
    const Vec3 d = barycentric(body, epoch).p_m - observer.p_m;
    if (angle_between(d, sun) < 35.0 * kDegree) continue;
    seen.push_back({body, d.normalized(), 1.0 / d.squaredNorm()});
  }
  std::array<BodyId, 2> best{};
  double least = 1e300;
  for (std::size_t i = 0; i < seen.size(); ++i) {
    for (std::size_t j = i + 1; j < seen.size(); ++j) {
      const double w1 = seen[i].weight, w2 = seen[j].weight;
      const double trace =
          1.0 / (w1 + w2) + (w1 + w2) / (w1 * w2 * seen[i].direction.cross(seen[j].direction).squaredNorm());
      if (trace < least) best = {seen[i].body, seen[j].body}, least = trace;
    }
  }
  return best;
}

inline constexpr int kImages = 36;
inline const Duration kImagePeriod = Duration::seconds(100.0);
inline const Duration kSecondWindow = Duration::seconds(3600.0 + 25.0 * 60.0);
inline const Duration kCycle = Duration::days(10.0);

// The truth of one run: its own integrator, the acceleration a Gauss-Markov process drawn every two hours or less, the
// camera's errors likewise.
class Truth {
 public:
  Truth(const FilterSettings& s, const State& state, Epoch epoch, std::uint64_t run)
      : settings_(s), state_(state), epoch_(epoch), random_({.seed = 7, .sample = run, .purpose = "truth"}) {
    for (double& a : xi_a_) a = s.process.acceleration.sigma * random_.normal();
    xi_c_ << s.focal.sigma * random_.normal(), s.k1.sigma * random_.normal(), 0.0, 0.0;
  }
  void move_to(Epoch epoch) {
    while (epoch_ < epoch) {
      const Duration h = std::min(epoch - epoch_, Duration::seconds(7200.0));
      const Vec3 before = xi_a_;
      for (double& a : xi_a_) a = evolve(a, settings_.process.acceleration, h);
      const Vec3 after = xi_a_;
      state_ =
          fly(state_, epoch_, h, 0.0, [&](double t) -> Vec3 { return before + (after - before) * (t / h.seconds()); });
      xi_c_[0] = evolve(xi_c_[0], settings_.focal, h);
      xi_c_[1] = evolve(xi_c_[1], settings_.k1, h);
      xi_c_[2] = evolve(xi_c_[2], settings_.bias, h);
      xi_c_[3] = evolve(xi_c_[3], settings_.bias, h);
      epoch_ = epoch_ + h;
    }
  }
  void start_window() { xi_c_.tail<2>() = settings_.bias.sigma * Vec2(random_.normal(), random_.normal()); }
  void push(const Vec3& delta_v) { state_.v_m_s += delta_v; }
  const State& state() const { return state_; }
  const Eigen::Vector4d& xi_c() const { return xi_c_; }
  RandomStream& random() { return random_; }

 private:
  double evolve(double x, const GaussMarkov& law, Duration h) {
    const double phi = std::exp(-h.seconds() / law.tau_s);
    return phi * x + law.sigma * std::sqrt(1.0 - phi * phi) * random_.normal();
  }
  FilterSettings settings_;
  State state_;
  Epoch epoch_;
  RandomStream random_;
  Vec3 xi_a_;
  Eigen::Vector4d xi_c_;
};

struct Consistency {
  std::vector<double> nees_of_run;                 // mean over the cycles
  std::vector<std::vector<double>> nees_of_cycle;  // [cycle][run], when its second window ends
  double nis_sum = 0.0;
  long nis_count = 0;
  long rejected = 0;
};

// What goes wrong in a campaign.
struct Upsets {
  // What becomes of an image; false: it is not there.
  std::function<bool(int cycle, int window, BeaconMeasurement&, RandomStream&)> image = {};
  std::function<void(int cycle, Truth&, Filter&)> after_cycle = {};
};

inline Consistency fly_campaign(const FilterSettings& truth_settings, const FilterSettings& settings, int runs,
                                int cycles, const Upsets& upsets = {}) {
  Consistency out;
  out.nees_of_cycle.resize(static_cast<std::size_t>(cycles));
  const Start& start = cruise_start();
  std::vector<std::array<BodyId, 2>> pairs;
  State nominal = start.state;
  for (int cycle = 0; cycle < cycles; ++cycle) {
    pairs.push_back(best_pair(nominal, start.epoch + kCycle * cycle));
    nominal = fly(nominal, start.epoch + kCycle * cycle, kCycle);
  }
  for (int run = 0; run < runs; ++run) {
    Truth truth(truth_settings, start.state, start.epoch, run);
    State guess = start.state;
    for (double& p : guess.p_m) p += 1e7 * truth.random().normal();
    for (double& v : guess.v_m_s) v += 100.0 * truth.random().normal();
    Filter filter(settings, kernel());
    EXPECT_TRUE(filter.initialise({start.epoch, guess, diagonal_covariance(1e7, 100.0)}));
    double nees = 0.0;
    for (int cycle = 0; cycle < cycles; ++cycle) {
      for (int window = 0; window < 2; ++window) {
        for (int image = 0; image < kImages; ++image) {
          const Epoch epoch =
              start.epoch + kCycle * cycle + (window ? kSecondWindow : Duration()) + kImagePeriod * image;
          truth.move_to(epoch);
          if (image == 0) truth.start_window();
          BeaconMeasurement m = photograph(truth.state(), pairs[cycle][window], epoch, settings.camera, {},
                                           &truth.random(), truth.xi_c(), {150.0, -100.0});
          if (upsets.image && !upsets.image(cycle, window, m, truth.random())) continue;
          const UpdateResult result = filter.update(m);
          if (!upsets.image) {
            EXPECT_EQ(result.window_started, image == 0);
          }
          out.rejected += !result.accepted;
          out.nis_sum += result.nis;
          ++out.nis_count;
        }
      }
      const double squared = squared_error(filter, truth.state());
      out.nees_of_cycle[static_cast<std::size_t>(cycle)].push_back(squared);
      nees += squared / cycles;
      if (upsets.after_cycle) upsets.after_cycle(cycle, truth, filter);
    }
    out.nees_of_run.push_back(nees);
  }
  return out;
}

inline FilterSettings campaign_settings() {
  FilterSettings settings = plain_settings();
  settings.focal = {.sigma = 1e-4, .tau_s = 30.0 * 86400.0};
  settings.k1 = {.sigma = 1e-2, .tau_s = 30.0 * 86400.0};
  settings.bias = {.sigma = 0.02, .tau_s = 12.0 * 3600.0};
  return settings;
}

}  // namespace astronav::navigation::testing
