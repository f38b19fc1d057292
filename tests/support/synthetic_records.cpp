// SPDX-License-Identifier: Apache-2.0
#include "support/synthetic_records.h"

#include <algorithm>
#include <array>
#include <cmath>

#include <Eigen/Cholesky>
#include <Eigen/LU>

#include "foundation/math/random.h"
#include "foundation/math/rotation.h"

namespace astronav::testing {
namespace {

using Vec9 = Eigen::Matrix<double, 9, 1>;
using Mat9 = Eigen::Matrix<double, 9, 9>;

constexpr double kSunGm = 1.32712440018e20;
constexpr double kDay = 86400.0;
constexpr double kPlateScale = 70.0 * kArcsecond;  // rad per pixel
constexpr double kAccelerationSigma = 1e-8;
constexpr double kAccelerationTau = 5.0 * kDay;
constexpr double kPixelSigma = 0.05;

struct Orbit {
  double a_au, eccentricity, longitude_deg, inclination_deg;
};
constexpr std::array<Orbit, 9> kPlanets{{{0, 0, 0, 0},
                                         {0.387, 0.2, 120, 7},
                                         {0.723, 0, 200, 3.4},
                                         {1.0, 0.017, 46, 0},
                                         {1.524, 0.093, 90, 1.8},
                                         {5.203, 0.048, 130, 1.3},
                                         {9.54, 0.054, 10, 2.5},
                                         {19.2, 0.046, 60, 0.8},
                                         {30.1, 0.009, 2, 1.8}}};

// Place and velocity on a Kepler orbit whose perihelion is at the starting longitude; ICRF axes.
State on_orbit(const Orbit& orbit, double t) {
  const double a = orbit.a_au * kAstronomicalUnit;
  const double n = std::sqrt(kSunGm / (a * a * a));
  const double e = orbit.eccentricity;
  double anomaly = n * t;
  for (int i = 0; i < 30; ++i) anomaly -= (anomaly - e * std::sin(anomaly) - n * t) / (1.0 - e * std::cos(anomaly));
  const double b = a * std::sqrt(1.0 - e * e);
  const double rate = n / (1.0 - e * std::cos(anomaly));
  const Vec3 p(a * (std::cos(anomaly) - e), b * std::sin(anomaly), 0.0);
  const Vec3 v(-a * std::sin(anomaly) * rate, b * std::cos(anomaly) * rate, 0.0);
  const Mat3 R = rotation_exp(Vec3(23.44 * kDegree, 0, 0)) * rotation_exp(Vec3(0, 0, orbit.longitude_deg * kDegree)) *
                 rotation_exp(Vec3(orbit.inclination_deg * kDegree, 0, 0));
  return {R * p, R * v};
}

struct Filter {
  Vec9 error;  // estimate minus truth
  Mat9 P;
};

Vec9 draw(RandomStream& random, const Mat9& covariance) {
  const Vec9 scale = covariance.diagonal().cwiseSqrt().cwiseMax(1e-300);
  const Mat9 correlation = scale.cwiseInverse().asDiagonal() * covariance * scale.cwiseInverse().asDiagonal();
  const Eigen::LDLT<Mat9> ldlt(correlation);
  Vec9 n;
  for (int i = 0; i < 9; ++i) n[i] = random.normal() * std::sqrt(std::max(0.0, ldlt.vectorD()[i]));
  return scale.asDiagonal() * Vec9(ldlt.transpositionsP().transpose() * Vec9(ldlt.matrixL() * n));
}

void propagate(Filter& filter, const Vec3& p_sun, double dt, double factor, RandomStream& random) {
  const double r2 = p_sun.squaredNorm();
  const Mat3 gradient = kSunGm / (r2 * std::sqrt(r2)) * (3.0 / r2 * p_sun * p_sun.transpose() - Mat3::Identity());
  Mat9 F = Mat9::Zero();
  F.block<3, 3>(0, 3) = Mat3::Identity();
  F.block<3, 3>(3, 0) = gradient;
  F.block<3, 3>(3, 6) = Mat3::Identity();
  F.block<3, 3>(6, 6) = -Mat3::Identity() / kAccelerationTau;
  const Mat9 Phi = Mat9::Identity() + dt * F + dt * dt / 2.0 * F * F + dt * dt * dt / 6.0 * F * F * F;
  const double q = 2.0 * kAccelerationSigma * kAccelerationSigma / kAccelerationTau;
  Mat9 Q = Mat9::Zero();
  for (int i = 0; i < 3; ++i) {
    const int index[3] = {i, 3 + i, 6 + i};
    const double g[3] = {dt * dt / 2.0, dt, 1.0};
    // Integral of the white noise through position, velocity and acceleration.
    const double order[3] = {2, 1, 0};
    for (int j = 0; j < 3; ++j) {
      for (int k = 0; k < 3; ++k) Q(index[j], index[k]) = q * g[j] * g[k] * dt / (order[j] + order[k] + 1.0);
    }
  }
  filter.error = Phi * filter.error + factor * draw(random, Q);
  filter.P = Phi * filter.P * Phi.transpose() + Q;
}

void draw_frame(loop::KeptFrame& frame, RandomStream& random, const char* planet) {
  frame.pixels = ImageU16(1024, 1024);
  for (auto& pixel : frame.pixels.pixels())
    pixel = static_cast<std::uint16_t>(std::clamp(64.0 + random.normal() * 1.2, 0.0, 4095.0));
  const auto spot = [&](double u, double v, double flux) {
    for (int y = std::max(0, static_cast<int>(v) - 6); y < std::min(1024, static_cast<int>(v) + 7); ++y) {
      for (int x = std::max(0, static_cast<int>(u) - 6); x < std::min(1024, static_cast<int>(u) + 7); ++x) {
        const double r2 = (x - u) * (x - u) + (y - v) * (y - v);
        frame.pixels(x, y) =
            static_cast<std::uint16_t>(std::min(4095.0, frame.pixels(x, y) + flux * std::exp(-r2 / 1.3)));
      }
    }
  };
  for (int i = 0; i < 70; ++i) {
    const Pixel p{random.uniform(10, 1013), random.uniform(10, 1013)};
    spot(p.u, p.v, 8.0 * std::pow(10.0, random.uniform(0.0, 2.2)));
    if (i < 50) frame.marks.push_back({p, "HIP " + std::to_string(10000 + 37 * i), "star", 6.0});
    if (i >= 66) frame.marks.push_back({p, "", "spot", 6.0});
  }
  const Pixel p{random.uniform(400, 620), random.uniform(400, 620)};
  spot(p.u, p.v, 40000.0);
  frame.marks.push_back({{p.u + 1.5, p.v - 2.0}, planet, "predicted", 14.0});
  frame.marks.push_back({p, planet, "planet", 9.0});
}

}  // namespace

loop::Records synthetic_records(const SyntheticOptions& options) {
  loop::Records records;
  records.level = "sil";
  records.version = "0.0.0";
  records.seed = options.seed;
  records.scenario_toml = "[mission]\nname = \"synthetic\"\n";
  RandomStream random(StreamId{.seed = options.seed, .purpose = "synthetic records"});

  const double factor = options.truth_over_filter;
  const Orbit spacecraft{1.262, 0.2076, 46.0, 0.5};
  const Epoch start = Epoch::tdb_seconds(847454400.0);
  Filter filter;
  filter.P.setZero();
  filter.P.diagonal() << Vec3::Constant(1e14), Vec3::Constant(1e4),
      Vec3::Constant(kAccelerationSigma * kAccelerationSigma);
  filter.error = factor * draw(random, filter.P);

  double t = 0.0;
  const auto advance = [&](double until) {
    while (t < until) {
      const double dt = std::min(until - t, 0.5 * kDay);
      propagate(filter, on_orbit(spacecraft, t + 0.5 * dt).p_m, dt, factor, random);
      t += dt;
    }
  };
  const auto add_event = [&](loop::EventKind kind, int cycle, int window) -> loop::Event& {
    loop::Event e;
    e.kind = kind;
    e.epoch = start + Duration::seconds(t);
    e.cycle = cycle;
    e.window = window;
    e.truth = on_orbit(spacecraft, t);
    e.estimate = {e.truth.p_m + filter.error.segment<3>(0), e.truth.v_m_s + filter.error.segment<3>(3)};
    e.covariance = filter.P.topLeftCorner<6, 6>();
    const Vec6 error = filter.error.head<6>();
    e.nees = error.dot(e.covariance.ldlt().solve(error));
    records.events.push_back(e);
    return records.events.back();
  };

  static constexpr BodyId kBeacons[] = {body::earth, body::mars, body::venus, body::jupiter};
  static constexpr int kBeaconOrbit[] = {3, 4, 2, 5};
  static constexpr const char* kBeaconNames[] = {"earth", "mars", "venus", "jupiter"};
  for (int cycle = 0; cycle < options.cycles; ++cycle) {
    const double cycle_start = (1.0 + 10.0 * cycle) * kDay;
    advance(cycle_start);
    if (cycle > 0) add_event(loop::EventKind::coast_end, cycle - 1, 1);
    const int pair[2] = {cycle < 8 ? 0 : 2, cycle < 16 ? 1 : 3};
    loop::BeaconChoice choice;
    choice.cycle = cycle;
    choice.epoch = start + Duration::seconds(t);
    choice.first = kBeacons[pair[0]];
    choice.second = kBeacons[pair[1]];
    choice.figure_of_merit_km = 500.0;
    for (int i = 0; i < 4; ++i) {
      const bool near_sun = (cycle + 3 * i) % 11 < 3;
      choice.candidates.push_back({kBeacons[i], -2.0 + i, near_sun ? 20.0 : 40.0 + 3.0 * cycle, 1e8 + 3e7 * i,
                                   !near_sun, near_sun ? "Sun exclusion" : ""});
    }
    records.beacons.push_back(choice);
    for (int window = 0; window < 2; ++window) {
      const int beacon = pair[window];
      const double window_start = cycle_start + window * 85.0 * 60.0;
      for (int k = 0; k < options.images_per_window; ++k) {
        advance(window_start + 100.0 * k);
        const Vec3 line =
            on_orbit(kPlanets[static_cast<std::size_t>(kBeaconOrbit[beacon])], t).p_m - on_orbit(spacecraft, t).p_m;
        const Vec3 s = line.normalized();
        const EastNorth en = east_north(s);
        Eigen::Matrix<double, 2, 9> H = Eigen::Matrix<double, 2, 9>::Zero();
        H.block<1, 3>(0, 0) = -en.east.transpose() / (line.norm() * kPlateScale);
        H.block<1, 3>(1, 0) = -en.north.transpose() / (line.norm() * kPlateScale);
        const Mat2 R = Mat2::Identity() * kPixelSigma * kPixelSigma;
        const Vec2 noise = factor * kPixelSigma * Vec2(random.normal(), random.normal());
        const Vec2 innovation = noise - H * filter.error;
        const Mat2 S = H * filter.P * H.transpose() + R;
        const Eigen::Matrix<double, 9, 2> K = filter.P * H.transpose() * S.inverse();
        filter.error += K * innovation;
        const Mat9 keep = Mat9::Identity() - K * H;
        filter.P = keep * filter.P * keep.transpose() + K * R * K.transpose();
        loop::Event& e = add_event(loop::EventKind::image, cycle, window);
        e.image = records.images++;
        e.body = kBeacons[beacon];
        e.attitude_found = e.planet_found = e.accepted = true;
        e.innovation_px = innovation;
        e.innovation_covariance_px2 = S;
        e.nis = innovation.dot(S.inverse() * innovation);
        e.planet_error_px = noise;
        e.planet_sigma_px = Vec2::Constant(kPixelSigma);
        e.attitude_sigma_rad = Vec3(0.5, 0.5, 4.0) * kArcsecond;
        e.attitude_error_rad =
            e.attitude_sigma_rad.cwiseProduct(Vec3(random.normal(), random.normal(), random.normal()));
        e.stars_matched = 60 + static_cast<int>(random.uniform(0, 30));
        e.spots = 2;
        e.centroid_error_count = 2 * e.stars_matched;
        e.centroid_error_sum2_px2 = e.centroid_error_count * 0.0025;
        records.image_ms.push_back(6.0 + 1.5 * std::abs(random.normal()));
      }
      add_event(loop::EventKind::window_end, cycle, window);
    }
    add_event(loop::EventKind::cycle_end, cycle, 1);
    for (int k = 1; k < 5; ++k) {
      advance(cycle_start + 2.0 * k * kDay);
      add_event(loop::EventKind::coast_sample, cycle, 1);
    }
  }
  for (int f = 0; f < options.frames; ++f) {
    loop::KeptFrame frame;
    frame.epoch = start + Duration::days(1.0 + 70.0 * f);
    frame.beacon = kBeacons[f % 4];
    draw_frame(frame, random, kBeaconNames[f % 4]);
    records.frames.push_back(std::move(frame));
  }
  records.begin = start;
  records.end = start + Duration::days(10.0 * options.cycles);
  for (std::size_t planet = 1; planet < kPlanets.size(); ++planet) {
    for (int k = 0; k <= 150; ++k) {
      records.planet_tracks_m[planet].push_back(
          on_orbit(kPlanets[planet], 10.0 * options.cycles * kDay * k / 150.0).p_m);
    }
  }
  records.cycles = options.cycles;
  records.duration_days = 10.0 * options.cycles;
  const double images = records.images;
  records.stage_ms_sum = {12.0 * images, 2.5 * images, 1.4 * images, 0.2 * images, 1.1 * images, 0.3 * images};
  records.wall_s = 41.0;
  records.peak_memory_mb = 212.0;
  return records;
}

}  // namespace astronav::testing
