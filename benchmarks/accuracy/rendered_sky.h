// SPDX-License-Identifier: Apache-2.0
// Frames of the simulator for figures of accuracy: the camera of the reference mission, whose truth has a halo beside
// the core, coma and a width that depends on the field, of which the onboard software is not told; a sky deeper than
// the onboard list, in which a fifth of the stars have a companion that no catalogue knows.
#pragma once

#include <cmath>
#include <memory>
#include <optional>
#include <vector>

#include "benchmarks/accuracy/spot_sky.h"
#include "foundation/files/mapped_file.h"
#include "foundation/math/random.h"
#include "foundation/math/rotation.h"
#include "models/camera_file/camera_file.h"
#include "models/ephemeris/ephemeris.h"
#include "onboard/vision/vision.h"
#include "simulator/render/renderer.h"
#include "simulator/sky/sky.h"

namespace astronav::accuracy {

inline Camera true_lens(Camera believed) {
  PointSpread& psf = believed.psf;
  psf.sigma_px *= 1.01;
  psf.sigma_growth_px = 0.02;
  psf.halo_fraction = 0.015;
  psf.halo_sigma_px = 2.5;
  psf.halo_offset_u_px = 0.05;
  psf.halo_offset_v_px = -0.04;
  psf.coma_px = 0.1;
  believed.intrinsics.fx_px *= 1.0 + 1e-5;
  believed.intrinsics.fy_px *= 1.0 + 1e-5;
  return believed;
}

class RenderedSky {
 public:
  explicit RenderedSky(const std::string& camera = "extrema-20deg") : RenderedSky(read_camera(camera).value()) {}
  explicit RenderedSky(const Camera& camera)
      : believed(camera),
        truth(true_lens(believed)),
        catalogue_file(MappedFile::open(home_directory() / "data/hipparcos.stars").value()),
        catalogue(StarCatalogue::open(catalogue_file.bytes()).value()),
        ephemeris_file(MappedFile::open(home_directory() / "data/de405_2000_2050.bsp").value()),
        ephemeris(Ephemeris::open(ephemeris_file.bytes()).value()),
        sky(ephemeris, catalogue),
        band(truth),
        renderer(truth, 1),
        frame(truth.intrinsics.width_px, truth.intrinsics.height_px) {}

  // Takes a picture; `frame` and `sources` are what it shows.
  void shoot(Epoch epoch, const State& observer_O, const Mat3& R_CN, double exposure_s, RandomStream& random) {
    sky::SkySettings settings;
    settings.max_v_mag = max_v_mag;
    settings.companion_share = 0.2;
    settings.companion_seed = random.next();
    std::vector<sky::SkySource> seen = sky.look(epoch, observer_O, R_CN.row(2).transpose(),
                                                truth.intrinsics.half_diagonal_rad() + 0.5 * kDegree, band, settings)
                                           .value();
    seen.insert(seen.end(), extra.begin(), extra.end());
    add_false_spots(R_CN, random, seen);
    sources = render::place_sources(seen, truth, R_CN, exposure_s);
    renderer.frame(sources, {.duration_s = exposure_s}, {.image = ++images, .purpose = "frame"}, frame);
  }

  Camera believed, truth;
  MappedFile catalogue_file;
  StarCatalogue catalogue;
  MappedFile ephemeris_file;
  Ephemeris ephemeris;
  sky::Sky sky;
  BandPhotometry band;
  render::Renderer renderer;
  ImageU16 frame;
  std::vector<render::RenderedSource> sources;
  std::vector<sky::SkySource> extra;  // seen as well
  double max_v_mag = 10.0;
  // So many lights that are no stars, anywhere in the picture, as bright as stars of this magnitude or brighter in it.
  int false_spots = 0;
  double false_v_mag = 7.0;
  std::uint64_t images = 0;

 private:
  void add_false_spots(const Mat3& R_CN, RandomStream& random, std::vector<sky::SkySource>& seen) const {
    std::vector<sky::SkySource> bright;
    for (const sky::SkySource& s : seen) {
      const auto pixel = project(truth.intrinsics, R_CN * s.direction_N);
      if (s.kind == sky::SourceKind::star && s.v_mag < false_v_mag && pixel && truth.intrinsics.contains(*pixel))
        bright.push_back(s);
    }
    for (int k = 0; k < false_spots && !bright.empty(); ++k) {
      sky::SkySource spot = bright[static_cast<std::size_t>(random.uniform() * static_cast<double>(bright.size()))];
      const Pixel place{random.uniform(0.0, truth.intrinsics.width_px - 1.0),
                        random.uniform(0.0, truth.intrinsics.height_px - 1.0)};
      spot.id = 0;
      spot.direction_N = R_CN.transpose() * *unproject(truth.intrinsics, place);
      seen.push_back(spot);
    }
  }
};

inline Mat3 random_attitude(RandomStream& random) {
  return R_CN_from_pointing(
      {random.uniform(0.0, 2.0 * kPi), std::asin(random.uniform(-1.0, 1.0)), random.uniform(0.0, 2.0 * kPi)});
}

}  // namespace astronav::accuracy
