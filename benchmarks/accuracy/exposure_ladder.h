// SPDX-License-Identifier: Apache-2.0
// Windows of rendered frames of one planet, exposure by exposure: what the exposure control expects, and what comes.
#pragma once

#include "benchmarks/accuracy/rendered_sky.h"
#include "onboard/vision/exposure.h"

namespace astronav::accuracy {

struct ExposureRow {
  vision::ExposureForecast expected;
  int images = 0;            // in which attitude and planet were measured
  double attitude_px = 0.0;  // rms across the boresight, an axis
  double scatter_px = 0.0;   // of the planet among the stars about the window's mean, an axis
  double mean_px = 0.0;      // the window's mean error, rms of the two axes
};

class ExposureLadder {
 public:
  explicit ExposureLadder(double onboard_v_mag = 7.0)
      : onboard_(world_.catalogue, world_.believed.intrinsics, onboard_v_mag, cruising().epoch),
        eyes_({}, world_.believed.intrinsics, vision::SensorModel::from(world_.believed), onboard_.field,
              onboard_.index),
        control_(settings(), vision::SensorModel::from(world_.believed), world_.believed.intrinsics, onboard_.field) {
    // The optics are learned before anything is judged.
    RandomStream random(StreamId{.seed = 3, .purpose = "learning"});
    for (int k = 0; k < 20; ++k) {
      point(random_attitude(random), -2.0, random);
      shoot(0.4, random);
      eyes_.process(world_.frame, cruising());
    }
  }

  vision::ExposureSettings settings() const {
    return vision::ExposureSettings::of(world_.believed, world_.band.flux(0.0, kColour).electrons_per_s);
  }

  // Somewhere in the sky, by the number of the window.
  ExposureRow window(int number, double v_mag, double exposure_s, int images) {
    RandomStream where(StreamId{.seed = 17, .sample = static_cast<std::uint64_t>(number), .purpose = "window"});
    const Mat3 R_CN = random_attitude(where);
    point(R_CN, v_mag, where);
    ExposureRow row;
    row.expected = control_.forecast({planet_.direction_N, planet_dn_s()}, eyes_.psf_in_the_middle(), exposure_s);
    Vec2 sum = Vec2::Zero();
    double squares = 0.0, attitude2 = 0.0;
    for (int k = 0; k < images; ++k) {
      const Vec3 dither(where.normal(0.0, 50.0), where.normal(0.0, 50.0), 0.0);
      point(rotation_exp(dither * world_.believed.intrinsics.plate_scale_rad_px()) * R_CN, v_mag, where, true);
      shoot(exposure_s, where);
      const vision::PlanetPrediction told{.body = body::mars_barycenter,
                                          .direction_N = planet_.direction_N,
                                          .direction_covariance = Mat3::Identity() * 1e-10,
                                          .v_mag = v_mag,
                                          .expected_flux_dn = planet_dn_s() * exposure_s};
      const auto& seen = eyes_.process(world_.frame, cruising(), {}, std::span(&told, 1));
      if (seen.source == vision::AttitudeSource::none || !seen.planets[0].found) continue;
      const auto expected = project(seen.attitude.intrinsics, seen.attitude.R_CN * planet_.direction_N);
      if (!expected) continue;
      const Vec2 error = seen.centroids[seen.planets[0].centroid].pixel.vec() - expected->vec();
      sum += error;
      squares += error.squaredNorm();
      attitude2 += rotation_log(R_CN_ * seen.attitude.R_CN.transpose()).head<2>().squaredNorm();
      ++row.images;
    }
    if (row.images < 2) return row;
    const double n = row.images;
    const Vec2 mean = sum / n;
    row.attitude_px = std::sqrt(0.5 * attitude2 / n) * world_.believed.intrinsics.fx_px;
    row.scatter_px = std::sqrt(0.5 * (squares / n - mean.squaredNorm()) * n / (n - 1.0));
    row.mean_px = std::sqrt(0.5) * mean.norm();
    return row;
  }

  vision::ExposureForecast choose(int number, double v_mag) {
    RandomStream where(StreamId{.seed = 17, .sample = static_cast<std::uint64_t>(number), .purpose = "window"});
    point(random_attitude(where), v_mag, where);
    return control_.choose({planet_.direction_N, planet_dn_s()}, eyes_.psf_in_the_middle());
  }

 private:
  static constexpr double kColour = vision::ExposureSettings::kStarColour;

  double planet_dn_s() const { return planet_.flux.electrons_per_s / world_.believed.detector.gain_e_dn; }

  void point(const Mat3& R_CN, double v_mag, RandomStream&, bool same_place = false) {
    R_CN_ = R_CN;
    if (!same_place) {
      planet_.kind = sky::SourceKind::small_body;
      planet_.direction_N = R_CN.row(2).transpose();
      planet_.id = body::mars_barycenter.value;
    }
    planet_.v_mag = v_mag;
    planet_.flux = world_.band.flux(v_mag, kColour);
    world_.extra = {planet_};
  }
  void shoot(double exposure_s, RandomStream& random) {
    const vision::Observer here = cruising();
    world_.shoot(here.epoch, {here.p_O_N, here.v_O_N}, R_CN_, exposure_s, random);
  }

  RenderedSky world_;
  Onboard onboard_;
  vision::Vision eyes_;
  vision::ExposureControl control_;
  sky::SkySource planet_;
  Mat3 R_CN_ = Mat3::Identity();
};

}  // namespace astronav::accuracy
