// SPDX-License-Identifier: Apache-2.0
// Scenario: everything that one mission is flown with, as plain structs, read from TOML through one table of keys.
//
// The fields carry the units of their keys ("conops.tracking_min"); a field's initialiser below is the key's default.
// The table (keys.h) gives every key its unit, range and meaning: parser, schema, documentation and the resolved
// scenario all come out of it. Truth and onboard belief are kept apart. In a file, any number may be a distribution;
// Draft keeps it as written, and resolve() draws it for one sample of one seed, so that the structs hold plain values.
#pragma once

#include <cstdint>
#include <filesystem>
#include <map>
#include <string>
#include <string_view>
#include <vector>

#include "foundation/base/error.h"
#include "foundation/time/epoch.h"
#include "models/camera/camera.h"

namespace astronav::scenario {

struct Mission {
  std::string name = "earth-mars-ballistic";
  std::string from = "earth";
  std::string to = "mars";
  Epoch departure = Epoch::tdb_seconds(847454400.0);  // 2026-11-09T00:00:00 TDB
  double days = 300.0;
  std::string trajectory_file;  // SPK or OEM instead of a designed transfer
  std::string trajectory_body;  // whose states to take from an SPK
  std::string thrust_plan;      // flown, with errors, from the trajectory file's first state
};

struct Data {
  std::string ephemeris_file;        // empty: the one that ships with astronav
  std::string truth_ephemeris_file;  // empty: the same
  std::string catalogue_file;
};

struct Conops {
  double tracking_min = 60.0;
  double image_period_s = 100.0;
  double slew_min = 25.0;
  double cycle_days = 10.0;  // from start to start
  double first_window_day = 1.0;
  double dither_px = 50.0;
  double sun_exclusion_deg = 35.0;
  double limiting_magnitude = 6.0;
  double max_beacon_size_px = 3.0;
  double slew_rate_deg_s = 0.5;
  double slew_acceleration_deg_s2 = 0.02;
  double settling_s = 60.0;
};

struct TruthCamera {
  std::string file = "extrema-20deg";
  double focal_error_relative = 0.0;
  double center_offset_u_px = 0.0;
  double center_offset_v_px = 0.0;
  double k1_error = 0.0;
  double psf_sigma_scale = 1.0;
  double psf_sigma_growth_px = 0.02;
  double psf_halo_fraction = 0.015;
  double psf_halo_sigma_px = 2.5;
  double psf_halo_offset_u_px = 0.0;
  double psf_halo_offset_v_px = 0.0;
};

struct TruthDynamics {
  double area_to_mass_cr_m2_kg = 0.026;
  double srp_scale_error = 0.0;
  double unmodelled_acceleration_m_s2 = 1e-8;
  double unmodelled_tau_days = 5.0;
  bool relativity = true;
  std::vector<std::string> bodies = {"mercury", "venus",  "earth",  "moon",   "mars",
                                     "jupiter", "saturn", "uranus", "neptune"};
};

struct TruthThrust {
  double magnitude_sigma = 0.0;
  double pointing_sigma_deg = 0.0;
  double tau_days = 1.0;
};

// Of momentum, by kicks.
struct TruthUnloading {
  bool on = false;
  double smallest_mm_s = 2.0;
  double largest_mm_s = 13.0;
  double shortest_pause_days = 1.0;
  double longest_pause_days = 5.0;
};

struct TruthEphemeris {
  double error_scale = 0.0;
};

struct TruthClock {
  double offset_ms = 0.0;
};

// What goes wrong once. Days count from where the trajectory begins; a length or a size of 0: it does not happen.
struct TruthUpsets {
  double safe_mode_day = 0.0, safe_mode_days = 0.0;
  double storm_day = 0.0, storm_days = 0.0, storm_protons_cm2_s = 200.0;
  double clock_step_day = 0.0, clock_step_ms = 0.0;
  double maneuver_day = 0.0, maneuver_m_s = 0.0, maneuver_error_relative = 0.02;
  bool maneuver_errs = true;  // no key: a covariance analysis flies as commanded, and knows the error's sigma
};

struct TruthPointing {
  double jitter_arcsec = 10.0;
  double sun_sensor_deg = 1.0;
};

struct TruthGyro {
  bool on = false;
  double sample_period_s = 1.0;
  double angle_random_walk_deg_sqrt_h = 0.15;  // of a good MEMS gyro
  double bias_random_walk_deg_h_sqrt_h = 0.3;
  double bias_deg_h = 10.0;
  double jump_deg_h = 0.0;
};

struct TruthPhotocentre {
  bool on = true;
  double scale = 1.0;
  double minnaert = 1.0;
  // On top of the scale, a planet's own.
  double mercury = 1.0, venus = 1.0, earth = 1.0, mars = 1.0, jupiter = 1.0, saturn = 1.0;
};

struct Sky {
  double max_v_mag = 9.5;
  double companion_share = 0.2;
};

struct OnboardStart {
  std::string from = "prior";  // or "survey"
};

struct OnboardBeacons {
  std::string merit = "static";  // or "filter"
};

struct OnboardCamera {
  std::string file = "extrema-20deg";
};

struct OnboardFilter {
  double initial_position_sigma_km = 10000.0;
  double initial_velocity_sigma_km_s = 0.1;
  double acceleration_sigma_m_s2 = 1e-8;
  double acceleration_tau_days = 5.0;
  double area_to_mass_cr_m2_kg = 0.026;
  double srp_scale_sigma = 0.05;
  double thrust_magnitude_sigma = 0.005;
  double thrust_pointing_sigma_deg = 0.3;
  double thrust_tau_days = 1.0;
  bool knows_unloading = true;
  double unloading_error_relative = 0.05;
  bool knows_maneuver = true;
  double clock_sigma_ms = 0.0;
  double clock_tau_days = 1000.0;
  double camera_focal_relative_sigma = 1e-5;
  double camera_k1_sigma = 1e-4;
  double camera_tau_days = 30.0;
  double window_bias_sigma_px = 0.0;
  double window_memory_days = 3.0;
  double window_bias_tau_hours = 12.0;
  double ephemeris_sigma_km = 1.0;
  double gate_probability = 0.9999;
  bool adaptive_r = true;
  bool photocentre = true;
  double photocentre_sigma = 0.0;
  double photocentre_tau_days = 1000.0;
  std::vector<std::string> bodies = {"mercury", "venus",  "earth",  "moon",   "mars",
                                     "jupiter", "saturn", "uranus", "neptune"};
};

// By how much planets may stand elsewhere than the onboard ephemeris says, along the orbit and across its plane, each.
// Root mean square of DE405 less DE430 (2020 to 2029) and less DE440 (2023 to 2025), along and across together:
// docs/theory/navigation.md section 2.
struct OnboardEphemeris {
  double mercury_km = 1.2;
  double venus_km = 0.54;
  double earth_km = 0.76;
  double mars_km = 0.85;
  double jupiter_km = 130.0;
  double saturn_km = 150.0;
  double uranus_km = 1900.0;
  double tau_days = 1000.0;
};

struct OnboardGyro {
  double angle_random_walk_deg_sqrt_h = 0.15;
  double bias_random_walk_deg_h_sqrt_h = 0.3;
  double bias_sigma_deg_h = 10.0;
};

struct OnboardVision {
  std::string exposure = "fixed";           // "fixed" or "chosen"
  std::string centroid_method = "psf_fit";  // "moment" or "psf_fit"
  bool prior_attitude = true;
  double threshold_sigma = 6.0;
  double star_max_v_mag = 7.0;
  int max_spots = 200;
  double match_radius_px = 2.0;
  double camera_focal_sigma = 0.0;
  double camera_center_sigma_px = 0.0;
  double camera_k1_sigma = 0.0;
  double planet_gate_probability = 0.999999;  // wider than the filter's, which does the editing
};

struct Mil {
  double line_of_sight_noise_arcsec = 0.07;
  double outlier_share = 0.0;
  double outlier_scale = 10.0;
  double systematic_arcsec = 0.0;
};

struct Scenario {
  Mission mission;
  Data data;
  Conops conops;
  struct Truth {
    TruthCamera camera;
    TruthDynamics dynamics;
    TruthThrust thrust;
    TruthUnloading unloading;
    TruthEphemeris ephemeris;
    TruthClock clock;
    TruthUpsets upsets;
    TruthPointing pointing;
    TruthGyro gyro;
    TruthPhotocentre photocentre;
  } truth;
  struct Onboard {
    OnboardStart start;
    OnboardBeacons beacons;
    OnboardCamera camera;
    OnboardFilter filter;
    OnboardEphemeris ephemeris;
    OnboardGyro gyro;
    OnboardVision vision;
  } onboard;
  Mil mil;
  Sky sky;
};

// The truth's camera: its file with the errors of [truth.camera] applied. The onboard camera: its file as it is.
Result<Camera> truth_camera(const Scenario& scenario);
Result<Camera> onboard_camera(const Scenario& scenario);

// A scenario as written, before the dice are thrown.
class Draft {
 public:
  // All defaults.
  Draft() = default;
  // invalid_argument with file:line:column; an unknown key names the nearest known one. A relative path in the file is
  // taken from the folder of the file, where it exists there.
  static Result<Draft> parse(std::string_view toml, std::string_view name_for_errors);
  // A path, or the name of a file in scenarios/ without ".toml".
  static Result<Draft> read(const std::filesystem::path& path_or_name);

  // "conops.cycle_days=5", "truth.camera.psf_halo_fraction={ uniform = { min = 0.0, max = 0.02 } }"; strings may do
  // without quotes.
  Result<void> set(std::string_view key_equals_value);
  // Every distribution drawn from RandomStream(seed, sample, 0, key). The same (seed, sample) gives the same scenario.
  Result<Scenario> resolve(std::uint64_t seed, std::uint64_t sample = 0) const;

  // What [run] of a resolved scenario says, so that flying such a file again repeats the run; 1, 0 and "" by default.
  std::uint64_t seed() const { return seed_; }
  std::uint64_t sample() const { return sample_; }
  const std::string& level() const { return level_; }
  // The keys that are distributions, for a campaign's report.
  std::vector<std::string> distributions() const;
  // All values as written or by default, in one fixed order: two drafts with the same text fly the same missions.
  std::string to_toml() const;

  // A value as written; Kind::text holds texts and epochs.
  struct Value {
    enum class Kind : unsigned char { number, gaussian, uniform, text, flag, names } kind = Kind::number;
    double a = 0.0;  // number, mean or minimum
    double b = 0.0;  // sigma or maximum
    bool flag = false;
    std::string text;
    std::vector<std::string> names;
    std::string where;  // file:line:column
  };

 private:
  std::map<std::string, Value, std::less<>> values_;  // only what was written
  std::uint64_t seed_ = 1;
  std::uint64_t sample_ = 0;
  std::string level_;
};

struct RunHeader {
  std::string version;
  std::string level;
  std::uint64_t seed = 1;
  std::uint64_t sample = 0;
};
// scenario.resolved.toml: every value used, and [run]; Draft::parse reads it back to the same values.
std::string to_toml(const Scenario& scenario, const RunHeader& run);

// Every key with unit, default, range and meaning: for a terminal, and as docs/scenario.md.
std::string schema_text();
std::string schema_markdown();

}  // namespace astronav::scenario
