// SPDX-License-Identifier: Apache-2.0
// How long to expose: planets and stars span eleven magnitudes, and one exposure must serve both, because the attitude
// that a planet's pixel needs is that of the same instant: a platform that moves by arcseconds between two frames
// cannot lend it from a second, longer exposure.
//
// Each exposure of a ladder is judged by what the navigation would get from a window of images: the planet's spot and
// the stars' as they are expected are measured with the flight software's own fit, saturated cores and all
// (docs/theory/vision.md, Exposure). No heap.
#pragma once

#include <array>

#include "onboard/vision/psf_model.h"
#include "onboard/vision/star_field.h"

namespace astronav::vision {

struct ExposureSettings {
  static constexpr double kStarColour = 0.6;  // B - V of the star that `star_dn_s` is meant for
  // Of a camera's own exposure and down to a 64th of it; `v0_e_s`: flux of V = 0 in its band, electrons/s.
  static ExposureSettings of(const Camera& camera, double v0_e_s);

  double shortest_s = 0.0125;
  double longest_s = 0.4;  // what drift and jitter of the platform allow
  int images = 36;         // of a window: what does not repeat averages over them
  int least_stars = 6;     // fewer may not be recognised
  int most_stars = 1000;  // of the brightest: no more are measured (with a prior attitude, VisionSettings::guide_stars)
  double threshold_sigma = 5;  // a star counts whose brightest pixel is so far above the noise
  double star_dn_s = 0.0;      // flux of V = 0, DN/s
  double sky_dn_s = 0.0;       // background of a pixel, DN/s
};

// What the fit would make of a point of light, 1 sigma an axis.
struct SpotForecast {
  double sigma_px = 0.0;      // of one image
  double repeating_px = 0.0;  // the same in all images
  double peak_dn = 0.0;
  bool saturated = false;
  bool measured = false;  // false: no fit, the core is too wide or the light too faint
};
SpotForecast forecast_spot(const SensorModel& sensor, const LocalPsf& psf, double flux_dn, double noise_dn);

struct ExposureForecast {
  double exposure_s = 0.0;
  SpotForecast planet;
  double attitude_px = 0.0;            // across the boresight, 1 sigma an axis, one image
  double attitude_repeating_px = 0.0;  // its share that the next image of the same stars has again
  int stars = 0;
  double window_px = 0.0;  // of the planet among the stars, the mean of all images
};

// The planet that a window is for, as it is expected.
struct ExpectedPlanet {
  Vec3 direction_N = Vec3::Zero();
  double dn_s = 0.0;
  double radius_px = 0.0;  // of its disc
};

class ExposureControl {
 public:
  ExposureControl(const ExposureSettings& settings, const SensorModel& sensor, const Intrinsics& camera,
                  const StarField& field);

  // Looking at a planet, the optics as believed there.
  ExposureForecast forecast(const ExpectedPlanet& planet, const LocalPsf& psf, double exposure_s) const;
  // The best of the ladder: the longest exposure, and each shorter one by half a stop. Where none shows enough stars:
  // the longest.
  ExposureForecast choose(const ExpectedPlanet& planet, const LocalPsf& psf) const;

 private:
  static constexpr int kMagClasses = 24;  // of half a magnitude, from V -2
  using Census = std::array<int, kMagClasses>;
  Census stars_around(const Vec3& direction_N) const;
  ExposureForecast forecast(const Census& stars, const ExpectedPlanet& planet, const LocalPsf& psf,
                            double exposure_s) const;

  ExposureSettings settings_;
  SensorModel sensor_;
  const StarField* field_;
  double radius_rad_;  // of a circle as large as the field
};

}  // namespace astronav::vision
