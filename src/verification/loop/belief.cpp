// SPDX-License-Identifier: Apache-2.0
#include "verification/loop/belief.h"

#include <algorithm>
#include <cstddef>
#include <string>

#include "foundation/math/statistics.h"
#include "models/photometry/photometry.h"

namespace astronav::loop {
namespace {

// A survey's spot must be so much brighter than the faintest stars that are known, or it may be one that is not.
constexpr double kStarMargin = 1.0;

navigation::Agility agility(const scenario::Scenario& s) {
  return {.max_rate_rad_s = s.conops.slew_rate_deg_s * kDegree,
          .max_acceleration_rad_s2 = s.conops.slew_acceleration_deg_s2 * kDegree,
          .settle_s = s.conops.settling_s};
}

}  // namespace

Result<navigation::FilterSettings> filter_settings(const scenario::Scenario& s, const Camera& camera, Level level,
                                                   double mass_kg) {
  const scenario::OnboardFilter& belief = s.onboard.filter;
  navigation::FilterSettings settings;
  settings.process.attractors = {};
  std::size_t count = 0;
  settings.process.attractors[count++] = body::sun;
  for (const std::string& text : belief.bodies) {
    Result<BodyId> id = parse_body(text);
    if (!id) return forward(id, "onboard.filter.bodies");
    if (*id != body::earth && *id != body::moon && barycenter_of(*id)) id = *barycenter_of(*id);
    if (*id == body::sun) continue;
    if (count == settings.process.attractors.size()) {
      return fail(ErrorCode::limit_exceeded, "the filter takes at most {0} attracting bodies beside the Sun",
                  {static_cast<double>(settings.process.attractors.size() - 1)}, "onboard.filter.bodies");
    }
    settings.process.attractors[count++] = *id;
  }
  settings.process.reflectivity_area_m2 = belief.area_to_mass_cr_m2_kg * mass_kg;
  settings.process.solar_pressure.sigma = belief.srp_scale_sigma;
  settings.process.acceleration = {.sigma = belief.acceleration_sigma_m_s2,
                                   .tau_s = belief.acceleration_tau_days * 86400.0};
  const double thrust_tau_s = belief.thrust_tau_days * 86400.0;
  settings.process.thrust_magnitude = {.sigma = belief.thrust_magnitude_sigma, .tau_s = thrust_tau_s};
  settings.process.thrust_pointing = {.sigma = belief.thrust_pointing_sigma_deg * kDegree, .tau_s = thrust_tau_s};
  settings.camera = camera.intrinsics;
  settings.sight.centre_of_light = belief.photocentre;
  settings.photocentre_tau_s = belief.photocentre_tau_days * 86400.0;
  settings.gate_probability = belief.gate_probability;
  const scenario::OnboardEphemeris& places = s.onboard.ephemeris;
  const double lasting_km[] = {places.mercury_km, places.venus_km,  places.earth_km,  places.mars_km,
                               places.jupiter_km, places.saturn_km, places.uranus_km, 0.0};  // the Moon: the Earth's
  settings.ephemeris_tau_s = places.tau_days * 86400.0;
  for (std::size_t i = 0; i < settings.beacon_errors.size(); ++i) {
    static constexpr BodyId planets[] = {body::mercury, body::venus,  body::earth,  body::mars,
                                         body::jupiter, body::saturn, body::uranus, body::moon};
    settings.beacon_errors[i] = {planets[i], belief.ephemeris_sigma_km * 1e3, belief.photocentre_sigma,
                                 lasting_km[i] * 1e3};
  }
  settings.clock = {.sigma = belief.clock_sigma_ms * 1e-3, .tau_s = belief.clock_tau_days * 86400.0};
  if (level == Level::mil) {
    settings.focal.sigma = settings.k1.sigma = 0.0;
    settings.bias = {.sigma = s.mil.systematic_arcsec * kArcsecond / camera.intrinsics.plate_scale_rad_px(),
                     .tau_s = belief.window_bias_tau_hours * 3600.0};
    settings.adaptive_noise = false;
    for (auto& e : settings.beacon_errors) e.ephemeris_m = 0.0;
  } else {
    settings.focal.sigma = belief.camera_focal_relative_sigma;
    settings.k1.sigma = belief.camera_k1_sigma;
    settings.focal.tau_s = settings.k1.tau_s = belief.camera_tau_days * 86400.0;
    settings.window_memory = Duration::days(belief.window_memory_days);
    settings.bias = {.sigma = belief.window_bias_sigma_px, .tau_s = belief.window_bias_tau_hours * 3600.0};
    settings.adaptive_noise = belief.adaptive_r;
  }
  return settings;
}

double neighbours_max_v_mag(const scenario::Scenario& s) {
  constexpr double kDeeperMag = 2.0;
  return s.onboard.vision.star_max_v_mag + kDeeperMag;
}

vision::VisionSettings vision_settings(const scenario::Scenario& s) {
  const scenario::OnboardVision& belief = s.onboard.vision;
  vision::VisionSettings settings;
  settings.centroids.method =
      belief.centroid_method == "psf_fit" ? vision::CentroidMethod::psf_fit : vision::CentroidMethod::squared_intensity;
  settings.centroids.threshold_sigma = belief.threshold_sigma;
  settings.centroids.max_centroids = belief.max_spots;
  settings.identify.match_px = belief.match_radius_px;
  settings.camera = {.focal_relative = belief.camera_focal_sigma,
                     .centre_px = belief.camera_center_sigma_px,
                     .k1 = belief.camera_k1_sigma};
  // The first frames are to be recognised with the camera as told: focal lengths up to four of its sigmas off.
  settings.identify.focal_uncertainty = 4.0 * belief.camera_focal_sigma;
  settings.planets.gate_d2 = chi_square_quantile(belief.planet_gate_probability, 2.0);
  return settings;
}

Result<vision::ExposureSettings> exposure_settings(const scenario::Scenario& s, const Camera& camera) {
  const auto cycle = cycle_settings(s);
  if (!cycle) return forward(cycle);
  auto settings = vision::ExposureSettings::of(
      camera, BandPhotometry(camera).flux(0.0, vision::ExposureSettings::kStarColour).electrons_per_s);
  settings.images = cycle->images_per_window();
  settings.threshold_sigma = s.onboard.vision.threshold_sigma;
  if (s.onboard.vision.prior_attitude) settings.most_stars = static_cast<int>(vision_settings(s).guide_stars);
  return settings;
}

executive::StanceSettings stance_settings(const scenario::Scenario& s) {
  executive::StanceSettings settings{.expects = s.onboard.vision.prior_attitude, .gyro = {}};
  if (!s.truth.gyro.on) return settings;
  constexpr double kDegreePerHour = kDegree / 3600.0, kRootHour = 60.0;
  const scenario::OnboardGyro& belief = s.onboard.gyro;
  settings.gyro.emplace().gyro = {
      .angle_random_walk_rad_sqrt_s = belief.angle_random_walk_deg_sqrt_h * kDegree / kRootHour,
      .bias_random_walk_rad_s_sqrt_s = belief.bias_random_walk_deg_h_sqrt_h * kDegreePerHour / kRootHour,
      .bias_sigma_rad_s = belief.bias_sigma_deg_h * kDegreePerHour};
  return settings;
}

navigation::BeaconSettings beacon_settings(const scenario::Scenario& s, const Camera& camera) {
  navigation::BeaconSettings settings;
  settings.sun_exclusion_rad = s.conops.sun_exclusion_deg * kDegree;
  settings.v_magnitude_limit = s.conops.limiting_magnitude;
  // The image processing takes the Moon's light out of the Earth's spot, so the two may be as near as a pixel.
  settings.min_separation_rad = camera.intrinsics.plate_scale_rad_px();
  settings.max_angular_diameter_rad = s.conops.max_beacon_size_px * camera.intrinsics.plate_scale_rad_px();
  settings.mode =
      s.onboard.beacons.merit == "filter" ? navigation::BeaconMode::filter_merit : navigation::BeaconMode::static_merit;
  settings.agility = agility(s);
  settings.slew_s = s.conops.slew_min * 60.0;
  settings.window_s = s.conops.tracking_min * 60.0;
  return settings;
}

executive::ColdStartSettings cold_start_settings(const scenario::Scenario& s, const navigation::FilterSettings& filter,
                                                 double mass_kg, int images_per_window) {
  executive::ColdStartSettings settings;
  settings.filter = filter;
  settings.mass_kg = mass_kg;
  settings.agility = agility(s);
  settings.sun_exclusion_rad = s.conops.sun_exclusion_deg * kDegree;
  settings.limit_v_mag = std::min(s.conops.limiting_magnitude, s.onboard.vision.star_max_v_mag - kStarMargin);
  settings.images_per_window = images_per_window;
  return settings;
}

Result<executive::CycleSettings> cycle_settings(const scenario::Scenario& s) {
  const executive::CycleSettings settings{.tracking = Duration::seconds(s.conops.tracking_min * 60.0),
                                          .image_period = Duration::seconds(s.conops.image_period_s),
                                          .slew = Duration::seconds(s.conops.slew_min * 60.0),
                                          .cycle = Duration::days(s.conops.cycle_days)};
  if (settings.image_period > settings.tracking) {
    return fail(ErrorCode::invalid_argument, "a window of {0} s has no room for an image every {1} s",
                {settings.tracking.seconds(), settings.image_period.seconds()}, "conops.image_period_s");
  }
  if (settings.cycle < settings.tracking * 2 + settings.slew) {
    return fail(ErrorCode::invalid_argument,
                "a cycle of {0} days is shorter than its two windows and the slew between them",
                {settings.cycle.days()}, "conops.cycle_days");
  }
  return settings;
}

}  // namespace astronav::loop
