// SPDX-License-Identifier: Apache-2.0
// Frames for the tests of this folder: pixel-integrated Gaussians (with a halo where asked for) and all noise.
#pragma once

#include <algorithm>
#include <cmath>

#include "foundation/image/image.h"
#include "foundation/math/random.h"
#include "onboard/vision/psf_fit.h"

namespace astronav::vision::testing {

struct Truth {
  double gain_e_dn = 25.0, read_noise_e = 10.0, prnu = 0.01, background_e = 5.0, bias_dn = 64.0, full_well_e = 1e5;
  int max_dn = 4095;
  double sigma_px = 0.8, halo_fraction = 0.0, halo_sigma_px = 3.0, halo_offset_u = 0.0, halo_offset_v = 0.0;
};

inline SensorModel believed(const Truth& t) {
  SensorModel s;
  s.gain_e_dn = t.gain_e_dn;
  s.read_noise_e = t.read_noise_e;
  s.photo_nonuniformity = t.prnu;
  s.saturation_dn = t.bias_dn + 0.95 * std::min(t.full_well_e / t.gain_e_dn, t.max_dn - t.bias_dn);
  return s;
}

inline double gaussian_share(double x0, double sigma) {
  return 0.5 * (std::erf((x0 + 0.5) / (std::sqrt(2.0) * sigma)) - std::erf((x0 - 0.5) / (std::sqrt(2.0) * sigma)));
}

// Adds the expected electrons of a point source.
inline void add_source(ImageF& electrons, const Truth& t, double u, double v, double flux_e) {
  const auto add = [&](double cu, double cv, double sigma, double energy, int reach) {
    const int iu = static_cast<int>(std::lround(cu)), iv = static_cast<int>(std::lround(cv));
    for (int y = std::max(0, iv - reach); y <= std::min(electrons.height() - 1, iv + reach); ++y) {
      const double sy = gaussian_share(y - cv, sigma);
      for (int x = std::max(0, iu - reach); x <= std::min(electrons.width() - 1, iu + reach); ++x)
        electrons(x, y) += static_cast<float>(energy * sy * gaussian_share(x - cu, sigma));
    }
  };
  add(u, v, t.sigma_px, flux_e * (1.0 - t.halo_fraction), 8);
  if (t.halo_fraction > 0.0)
    add(u + t.halo_offset_u, v + t.halo_offset_v, t.halo_sigma_px, flux_e * t.halo_fraction, 15);
}

inline void expose(const ImageF& electrons, const Truth& t, RandomStream& random, ImageU16& out) {
  for (int v = 0; v < out.height(); ++v) {
    for (int u = 0; u < out.width(); ++u) {
      const double mean = (electrons(u, v) + t.background_e) * (1.0 + t.prnu * random.normal());
      double e = static_cast<double>(random.poisson(std::max(mean, 0.0)));
      e = std::min(e, t.full_well_e) + t.read_noise_e * random.normal();
      out(u, v) = static_cast<std::uint16_t>(
          std::clamp(std::lround(e / t.gain_e_dn + t.bias_dn), 0L, static_cast<long>(t.max_dn)));
    }
  }
}

}  // namespace astronav::vision::testing
