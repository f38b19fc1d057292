// SPDX-License-Identifier: Apache-2.0
// Cameras, sources and sums that the tests of this folder share.
#pragma once

#include "foundation/math/rotation.h"
#include "simulator/render/renderer.h"

namespace astronav::render {

// A camera of 20 degrees without light, dark current or patterns of its own.
inline Camera quiet_camera(int size = 64) {
  Camera camera;
  camera.intrinsics = Intrinsics::from_field_of_view(size, size, 20.0 * kDegree);
  camera.psf.sigma_px = 0.8;
  camera.detector = {.pixel_pitch_m = 13e-6,
                     .quantum_efficiency = {},
                     .read_noise_e = 10.0,
                     .dark_current_e_s = 0.0,
                     .full_well_e = 1e5,
                     .gain_e_dn = 25.0,
                     .bias_dn = 64.0,
                     .bits = 12};
  return camera;
}

inline RenderedSource star_at(double u, double v, double electrons) {
  RenderedSource source;
  source.pixel = {u, v};
  source.electrons = electrons;
  return source;
}

inline StreamId frame_name(std::uint64_t seed, std::uint64_t image) {
  StreamId id;
  id.seed = seed;
  id.image = image;
  return id;
}

// Sum, centre and central second moments of a picture.
struct Moments {
  double sum = 0.0;
  Vec2 centre = Vec2::Zero();
  Mat2 second = Mat2::Zero();
};
template <typename T>
Moments moments_of(const Image<T>& image, double zero = 0.0) {
  Moments m;
  for (int v = 0; v < image.height(); ++v) {
    for (int u = 0; u < image.width(); ++u) {
      const double light = static_cast<double>(image(u, v)) - zero;
      m.sum += light;
      m.centre += light * Vec2(u, v);
      m.second += light * Vec2(u, v) * Vec2(u, v).transpose();
    }
  }
  m.centre /= m.sum;
  m.second = m.second / m.sum - m.centre * m.centre.transpose();
  return m;
}

inline Moments drawn(const Camera& camera, const RenderedSource& source, const Effects& effects = {}) {
  ImageF image;
  Renderer(camera, 1).electrons({&source, 1}, {.duration_s = 0.4}, image, effects);
  return moments_of(image);
}

}  // namespace astronav::render
