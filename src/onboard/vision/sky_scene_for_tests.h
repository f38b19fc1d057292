// SPDX-License-Identifier: Apache-2.0
// The real sky as the 20-degree camera of these tests sees it, with bodies where a test wants them.
#pragma once

#include <atomic>
#include <cmath>
#include <span>
#include <vector>

#include <gtest/gtest.h>

#include "foundation/files/mapped_file.h"
#include "foundation/math/rotation.h"
#include "onboard/vision/synthetic_frame_for_tests.h"
#include "onboard/vision/vision.h"

namespace astronav::vision::testing {

// What is allocated while it counts (vision_test.cpp).
extern std::atomic<bool> g_counting;
extern std::atomic<long> g_allocations;

// The project's own catalogue, with an index for a 20-degree camera.
struct Sky {
  MappedFile file;
  StarField field;
  std::vector<std::byte> bytes;
  PairIndex index;
};

inline const Sky& sky() {
  static const Sky instance = [] {
    Sky s;
    auto file = MappedFile::open(home_directory() / "data/hipparcos.stars");
    if (!file) ADD_FAILURE() << describe(file.error());
    s.file = std::move(*file);
    const auto catalogue = StarCatalogue::open(s.file.bytes());
    if (!catalogue) ADD_FAILURE() << describe(catalogue.error());
    s.field = StarField::build(*catalogue, 9.0, Epoch::tdb_seconds(26.9 * 365.25 * 86400.0));
    s.bytes = build_pair_index(s.field, AsterismSettings::for_field(20.0 * kDegree, 20.0 * kDegree));
    s.index = *PairIndex::open(s.bytes);
    return s;
  }();
  return instance;
}

inline constexpr double kElectronsV0 = 2.28e6;  // the 20-degree camera, solar colour

inline Intrinsics camera20() {
  return Intrinsics::from_field_of_view(1024, 1024, 20.0 * kDegree);
}

inline Mat3 random_attitude(RandomStream& random) {
  return R_CN_from_pointing(
      {random.uniform(0.0, 2.0 * kPi), std::asin(random.uniform(-1.0, 1.0)), random.uniform(0.0, 2.0 * kPi)});
}

// A frame of the real sky as a Gaussian camera sees it. `extra`: more sources.
struct Scene {
  Observer observer;
  Mat3 R_CN;
  ImageU16 image{1024, 1024};
};
struct Source {
  Pixel pixel;
  double electrons;
};
inline void paint(Scene& scene, const Truth& truth, const Intrinsics& camera, RandomStream& random,
                  std::span<const Source> extra = {}) {
  ImageF electrons(1024, 1024, 0.0f);
  for (const FieldStar& star : sky().field.stars()) {
    const Vec3 direction = scene.R_CN * sky().field.apparent(star, scene.observer);
    if (direction.z() < 0.9) continue;
    const Result<Pixel> p = project(camera, direction);
    if (!p || p->u < -10 || p->v < -10 || p->u > 1034 || p->v > 1034) continue;
    add_source(electrons, truth, p->u, p->v, kElectronsV0 * std::pow(10.0, -0.4 * star.v_mag));
  }
  for (const Source& s : extra) add_source(electrons, truth, s.pixel.u, s.pixel.v, s.electrons);
  expose(electrons, truth, random, scene.image);
}

inline Observer moving() {
  Observer observer;
  observer.epoch = Epoch::tdb_seconds(27.0 * 365.25 * 86400.0);
  observer.p_O_N = Vec3(1.2, 0.6, 0.2) * 1.5e11;
  observer.v_O_N = Vec3(-14e3, 21e3, 9e3);
  return observer;
}

inline PlanetPrediction prediction_of(BodyId body, const Vec3& direction_N, double sigma_rad, double electrons,
                                      const Truth& truth) {
  PlanetPrediction p;
  p.body = body;
  p.direction_N = direction_N;
  p.direction_covariance = (Mat3::Identity() - direction_N * direction_N.transpose()) * sigma_rad * sigma_rad;
  p.expected_flux_dn = electrons / truth.gain_e_dn;
  return p;
}

}  // namespace astronav::vision::testing
