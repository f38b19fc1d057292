// SPDX-License-Identifier: Apache-2.0
// Pictures of the sky as the simulator's camera takes them, for tests of what reads pictures.
#pragma once

#include <cmath>
#include <span>
#include <vector>

#include <gtest/gtest.h>

#include "foundation/files/mapped_file.h"
#include "models/camera_file/camera_file.h"
#include "simulator/render/renderer.h"
#include "simulator/sky/sky.h"
#include "support/shipped_ephemeris.h"
#include "verification/opensky/calibrate.h"

namespace astronav::opensky {

using astronav::testing::shipped_ephemeris;

inline const StarCatalogue& catalogue() {
  static const Result<MappedFile> file = MappedFile::open(home_directory() / "data/hipparcos.stars");
  static const Result<StarCatalogue> stars = StarCatalogue::open(file.value().bytes());
  return stars.value();
}

// Frames as the simulator's camera takes them.
struct Night {
  std::vector<Picture> pictures;
  std::vector<CalibrationFrame> frames;
};
inline Night take_pictures(const Camera& camera, std::span<const Pointing> pointings, bool mirrored, double max_v_mag) {
  const Epoch epoch = *Epoch::parse("2026-11-22T03:00:00");
  const State earth = *shipped_ephemeris().state(body::earth, body::solar_system_barycenter, epoch);
  // Away from the Earth, which would fill half of an all-sky picture.
  const State observer{earth.p_m + Vec3(0.0, 0.0, 5e9), earth.v_m_s};
  const sky::Sky sky(shipped_ephemeris(), catalogue());
  const render::Renderer renderer(camera, 1);
  Night night;
  for (std::size_t k = 0; k < pointings.size(); ++k) {
    const Mat3 R_CN = R_CN_from_pointing(pointings[k]);
    sky::SkySettings settings;
    settings.max_v_mag = max_v_mag;
    const auto seen = sky.look(epoch, observer, R_CN.row(2).transpose(),
                               camera.intrinsics.half_diagonal_rad() + 0.5 * kDegree, BandPhotometry(camera), settings);
    EXPECT_TRUE(seen);
    ImageU16 frame;
    renderer.frame(render::place_sources(*seen, camera, R_CN, camera.exposure_s), {.duration_s = camera.exposure_s},
                   {.seed = 3, .sample = 0, .image = static_cast<std::uint64_t>(k), .purpose = ""}, frame);
    Picture picture;
    picture.pixels = ImageF(frame.width(), frame.height());
    for (int v = 0; v < frame.height(); ++v) {
      for (int u = 0; u < frame.width(); ++u)
        picture.pixels(mirrored ? frame.width() - 1 - u : u, v) = static_cast<float>(frame(u, v));
    }
    picture.bits = camera.detector.bits;
    picture.white_level = std::exp2(camera.detector.bits) - 1.0;
    night.pictures.push_back(std::move(picture));
    night.frames.push_back({.picture = nullptr, .epoch = epoch, .observer = observer});
  }
  for (std::size_t k = 0; k < pointings.size(); ++k) night.frames[k].picture = &night.pictures[k];
  return night;
}

}  // namespace astronav::opensky
