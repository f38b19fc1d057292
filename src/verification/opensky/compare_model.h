// SPDX-License-Identifier: Apache-2.0
// The camera that is fitted, and the sky through it. Internal.
#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <span>
#include <vector>

#include "simulator/render/renderer.h"
#include "verification/opensky/compare.h"
#include "verification/opensky/compare_sky.h"

namespace astronav::opensky {

// The picture as a camera that is not mirrored would have taken it.
struct Frame {
  ImageF dn;
  SmoothSky sky;
  NoiseLaw noise;
  double saturation_dn = 0.0;
  double levels = 65535.0;
};

struct Measured {
  std::int64_t id = 0;
  Pixel pixel;
  double electrons = 0.0;  // of the exposure, as they arrived
  double sigma_px = 0.0;
  double sigma_e = 0.0;
  double snr = 0.0;  // expected
  bool saturated = false;
  bool found = false;
};

// Numbers of named stars begin here.
inline constexpr std::int64_t kNamedStars = 4'000'000'000;

class Model {
 public:
  Model(const CompareRequest& request, const Frame& frame);

  // Looks at the sky with the camera as it is now.
  Result<void> look();
  const std::vector<render::RenderedSource>& sources() const { return sources_; }  // bright first
  // Expected DN, the smooth sky included; and the light of the stars alone, in electrons.
  ImageF rendering_dn() const;
  ImageF light_e() const;
  // S/N of a star, the best that its point-spread function allows.
  double expected_snr(const render::RenderedSource& source) const;

  // Place and flux of each source of at least this S/N, its neighbours' light taken away.
  std::vector<Measured> measure(double least_snr) const;

  // One round of fits to what was measured, stars of which `use` says no left out. False: too few.
  bool fit(std::span<const Measured> stars, const std::function<bool(std::int64_t)>& use);

  Camera camera;
  Mat3 R_CN;
  double tint = 0.0;  // of the transmission: e-folds per 100 nm

 private:
  void fit_plate(std::span<const Measured> stars);
  void fit_photometry(std::span<const Measured> stars);
  void fit_point_spread(std::span<const Measured> stars);
  const render::RenderedSource* find(std::int64_t id) const;

  const CompareRequest& request_;
  const Frame& frame_;
  Optics clear_;  // optics before they are tinted
  std::vector<render::RenderedSource> sources_;
  std::vector<std::pair<std::int64_t, std::size_t>> index_;  // id to place in sources_, sorted
};

}  // namespace astronav::opensky
