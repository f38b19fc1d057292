// SPDX-License-Identifier: Apache-2.0
#include "verification/scenario/keys.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include <fmt/format.h>

#include "foundation/base/nearest_word.h"

namespace astronav::scenario {
namespace {

constexpr double kAny = std::numeric_limits<double>::infinity();

#define FIELD(path) #path
#define MEMBER(path) [](Scenario& s) { return &s.path; }

// clang-format off
#define NUMBER(path, unit, lo, hi, meaning) Key{FIELD(path), unit, meaning, Member(MEMBER(path)), lo, hi}
#define SWITCH(path, meaning) Key{FIELD(path), "", meaning, Member(MEMBER(path))}
#define TEXT(path, meaning) Key{FIELD(path), "", meaning, Member(MEMBER(path))}
#define CHOICE(path, list, meaning) Key{FIELD(path), "", meaning, Member(MEMBER(path)), -kAny, kAny, list}
#define PATH(path, meaning) Key{FIELD(path), "", meaning, Member(MEMBER(path)), -kAny, kAny, {}, true}

const std::array kKeys{
    TEXT(mission.name, "what the mission is called in reports"),
    TEXT(mission.from, "body left at departure (name or NAIF number)"),
    TEXT(mission.to, "body reached after `days` (name or NAIF number)"),
    Key{FIELD(mission.departure), "", "epoch of departure, ISO 8601 with its scale; UTC where none is given", Member(MEMBER(mission.departure))},
    NUMBER(mission.days, "d", 1.0, 3000.0, "time of flight from departure to arrival; the cruise is flown from 3 days after the one to 3 days before the other"),
    PATH(mission.trajectory_file, "SPK kernel or CCSDS OEM flown instead of a designed ballistic transfer, as it is: without a thrust plan departure, days and the forces of truth.dynamics play no part; empty for none"),
    TEXT(mission.trajectory_body, "whose states to take from an SPK (name or NAIF number); empty where the file holds one body only"),

    PATH(mission.thrust_plan, "thrust plan (docs/formats.md) that is flown from the first state of `trajectory_file`; empty for none"),

    PATH(data.ephemeris_file, "SPK kernel with Sun and planets; empty for the one that ships with astronav"),
    PATH(data.truth_ephemeris_file, "SPK kernel by which the truth flies and the planets stand; empty for the same as the onboard software's"),
    PATH(data.catalogue_file, "star catalogue made by `astronav catalog import`; empty for the one that ships with astronav"),

    NUMBER(conops.tracking_min, "min", 1.0, 1440.0, "time spent on each of the two beacons"),
    NUMBER(conops.image_period_s, "s", 1.0, 3600.0, "time between images inside a tracking window"),
    NUMBER(conops.slew_min, "min", 0.0, 1440.0, "time from the end of the first window to the start of the second"),
    NUMBER(conops.cycle_days, "d", 0.1, 100.0, "from the start of one navigation cycle to the start of the next"),
    NUMBER(conops.first_window_day, "d", 0.0, 1000.0, "start of the first navigation cycle after the trajectory's begin (of a designed transfer: some days after departure, outside the planet's surroundings)"),
    NUMBER(conops.dither_px, "px", 0.0, 400.0, "offset of the pointing drawn for each image, 1 sigma per axis"),
    NUMBER(conops.sun_exclusion_deg, "deg", 0.0, 90.0, "smallest angle between the Sun and a beacon that is looked at"),
    NUMBER(conops.limiting_magnitude, "mag", -5.0, 15.0, "faintest beacon (V) that is looked at"),
    NUMBER(conops.max_beacon_size_px, "px", 0.1, 1000.0, "largest apparent diameter of a beacon that is looked at"),
    NUMBER(conops.slew_rate_deg_s, "deg/s", 1e-4, 100.0, "how fast the platform turns at most; two beacons that it cannot turn between in `slew_min` are no pair"),
    NUMBER(conops.slew_acceleration_deg_s2, "deg/s2", 1e-6, 100.0, "how fast it gathers and loses that rate"),
    NUMBER(conops.settling_s, "s", 0.0, 3600.0, "after a turn, until the pointing is quiet enough for images"),

    PATH(truth.camera.file, "the camera that takes the pictures: a file, or the name of one in scenarios/cameras"),
    NUMBER(truth.camera.focal_error_relative, "", -0.1, 0.1, "true focal length over that of the file, less one"),
    NUMBER(truth.camera.center_offset_u_px, "px", -100.0, 100.0, "true principal point less that of the file, along columns"),
    NUMBER(truth.camera.center_offset_v_px, "px", -100.0, 100.0, "true principal point less that of the file, along rows"),
    NUMBER(truth.camera.k1_error, "", -1.0, 1.0, "true radial distortion k1 less that of the file"),
    NUMBER(truth.camera.psf_sigma_scale, "", 0.2, 5.0, "true width of the point-spread function over that of the file"),
    NUMBER(truth.camera.psf_sigma_growth_px, "px", 0.0, 10.0, "how much wider (sigma) the true point-spread function is at the corner of the image"),
    NUMBER(truth.camera.psf_halo_fraction, "", 0.0, 0.9, "share of the light in a wider halo that the onboard software does not know"),
    NUMBER(truth.camera.psf_halo_sigma_px, "px", 0.5, 50.0, "width (sigma) of the halo"),
    NUMBER(truth.camera.psf_halo_offset_u_px, "px", -10.0, 10.0, "displacement of the halo from the core, along columns"),
    NUMBER(truth.camera.psf_halo_offset_v_px, "px", -10.0, 10.0, "displacement of the halo from the core, along rows"),

    NUMBER(truth.dynamics.area_to_mass_cr_m2_kg, "m2/kg", 0.0, 10.0, "area over mass times reflectivity coefficient, for solar radiation pressure"),
    NUMBER(truth.dynamics.srp_scale_error, "", -1.0, 10.0, "true solar radiation pressure over that of area_to_mass_cr, less one"),
    NUMBER(truth.dynamics.unmodelled_acceleration_m_s2, "m/s2", 0.0, 1e-3, "size (1 sigma per axis) of a random acceleration that nobody models (first-order Gauss-Markov)"),
    NUMBER(truth.dynamics.unmodelled_tau_days, "d", 0.01, 1000.0, "correlation time of that acceleration"),
    SWITCH(truth.dynamics.relativity, "the Sun's first post-Newtonian term"),
    TEXT(truth.dynamics.bodies, "whose gravity acts beside the Sun's"),

    NUMBER(truth.thrust.magnitude_sigma, "", 0.0, 0.5, "error of the engine's thrust (first-order Gauss-Markov), relative, 1 sigma"),
    NUMBER(truth.thrust.pointing_sigma_deg, "deg", 0.0, 30.0, "error of its direction, 1 sigma per axis"),
    NUMBER(truth.thrust.tau_days, "d", 0.01, 1000.0, "correlation time of both"),

    SWITCH(truth.unloading.on, "thrusters that unload the wheels kick the spacecraft now and then"),
    NUMBER(truth.unloading.smallest_mm_s, "mm/s", 0.0, 1e4, "smallest kick; uniform between both, in any direction"),
    NUMBER(truth.unloading.largest_mm_s, "mm/s", 0.0, 1e4, "largest kick"),
    NUMBER(truth.unloading.shortest_pause_days, "d", 0.01, 1000.0, "shortest time from kick to kick; uniform between both"),
    NUMBER(truth.unloading.longest_pause_days, "d", 0.01, 1000.0, "longest time from kick to kick"),

    NUMBER(truth.ephemeris.error_scale, "", 0.0, 100.0, "planets stand elsewhere than the onboard ephemeris says, along and across their orbits, drawn once a mission: this times the sigmas of [onboard.ephemeris]; of no effect where data.truth_ephemeris_file says where they stand"),

    NUMBER(truth.clock.offset_ms, "ms", -10000.0, 10000.0, "onboard clock less the true time"),

    NUMBER(truth.upsets.safe_mode_day, "d", 0.0, 10000.0, "when the spacecraft falls into a safe mode: no images, and nothing is tracked; days of all upsets count from the trajectory's begin, as first_window_day does"),
    NUMBER(truth.upsets.safe_mode_days, "d", 0.0, 10000.0, "how long it stays there; 0: never, a fraction of an hour: a lost window"),
    NUMBER(truth.upsets.storm_day, "d", 0.0, 10000.0, "when a proton storm begins (of effect on images, so with `--level sil`)"),
    NUMBER(truth.upsets.storm_days, "d", 0.0, 10000.0, "how long it lasts; 0: none"),
    NUMBER(truth.upsets.storm_protons_cm2_s, "1/cm2/s", 0.0, 1e5, "its protons on the detector, in place of the camera's own cosmic rays"),
    NUMBER(truth.upsets.clock_step_day, "d", 0.0, 10000.0, "when the onboard clock jumps"),
    NUMBER(truth.upsets.clock_step_ms, "ms", -10000.0, 10000.0, "by how much; 0: it does not"),
    NUMBER(truth.upsets.maneuver_day, "d", 0.0, 10000.0, "when the spacecraft corrects its course, in any direction"),
    NUMBER(truth.upsets.maneuver_m_s, "m/s", 0.0, 1000.0, "by how much it is told to; 0: it does not"),
    NUMBER(truth.upsets.maneuver_error_relative, "", 0.0, 1.0, "error of what is flown over the size of what was told, 1 sigma per axis"),

    NUMBER(truth.pointing.jitter_arcsec, "arcsec", 0.0, 3600.0, "pointing error of each image beside the dither, 1 sigma per axis"),

    NUMBER(truth.pointing.sun_sensor_deg, "deg", 0.0, 10.0, "error of the sun sensor, 1 sigma per axis; asked only by a start from a survey"),

    SWITCH(truth.gyro.on, "the spacecraft has a gyro, switched on for each navigation cycle (`--level sil`); by it and the frames the onboard software knows its attitude between frames and through slews"),
    NUMBER(truth.gyro.sample_period_s, "s", 0.1, 100.0, "from one of its samples to the next; each is the mean rate since the one before"),
    NUMBER(truth.gyro.angle_random_walk_deg_sqrt_h, "deg/sqrt(h)", 0.0, 100.0, "white noise of the rate, an axis"),
    NUMBER(truth.gyro.bias_random_walk_deg_h_sqrt_h, "deg/h/sqrt(h)", 0.0, 1000.0, "how its bias walks, an axis"),
    NUMBER(truth.gyro.bias_deg_h, "deg/h", 0.0, 1e5, "its bias when it is switched on: drawn anew for each cycle, 1 sigma an axis"),
    NUMBER(truth.gyro.jump_deg_h, "deg/h", 0.0, 1e6, "a fault: by how much the bias jumps, in any direction, when the slew between the two windows of a cycle begins; 0: none"),

    SWITCH(truth.photocentre.on, "planets are lit discs, which shine from their centre of light; false: points in their centre of figure"),
    NUMBER(truth.photocentre.scale, "", 0.0, 3.0, "true displacement of the centre of light over that of a Lambert sphere, of all planets"),
    NUMBER(truth.photocentre.minnaert, "", 0.5, 1.5, "exponent of Minnaert's law by which discs are drawn about that centre; 1: Lambert's law, which the onboard software believes"),
    NUMBER(truth.photocentre.mercury, "", 0.0, 3.0, "times this for Mercury"),
    NUMBER(truth.photocentre.venus, "", 0.0, 3.0, "times this for Venus"),
    NUMBER(truth.photocentre.earth, "", 0.0, 3.0, "times this for the Earth"),
    NUMBER(truth.photocentre.mars, "", 0.0, 3.0, "times this for Mars"),
    NUMBER(truth.photocentre.jupiter, "", 0.0, 3.0, "times this for Jupiter"),
    NUMBER(truth.photocentre.saturn, "", 0.0, 3.0, "times this for Saturn"),

    CHOICE(onboard.start.from, "prior survey", "prior: a state is told, with the errors of [onboard.filter]; survey: nothing but the clock and the Sun's direction, so that pictures along the ecliptic have to show planets before the first window; where they do not, again before the next cycle. A prior that has spread beyond 3.5 million km (3 sigma) by the first window is not used: survey"),

    CHOICE(onboard.beacons.merit, "static filter", "the pair of beacons is chosen by the place that its two sights would give alone, or by what they would leave of the filter's covariance"),

    PATH(onboard.camera.file, "the camera that the onboard software believes in"),

    NUMBER(onboard.filter.initial_position_sigma_km, "km", 1e-3, 1e8, "initial position error, 1 sigma per axis: drawn for the truth and told to the filter"),
    NUMBER(onboard.filter.initial_velocity_sigma_km_s, "km/s", 1e-9, 100.0, "initial velocity error, 1 sigma per axis: drawn for the truth and told to the filter"),
    NUMBER(onboard.filter.acceleration_sigma_m_s2, "m/s2", 0.0, 1e-3, "unmodelled acceleration as the filter assumes it (first-order Gauss-Markov), 1 sigma per axis"),
    NUMBER(onboard.filter.acceleration_tau_days, "d", 0.01, 1000.0, "its correlation time"),
    NUMBER(onboard.filter.area_to_mass_cr_m2_kg, "m2/kg", 0.0, 10.0, "area over mass times reflectivity coefficient that the filter believes in"),
    NUMBER(onboard.filter.srp_scale_sigma, "", 0.0, 1.0, "error of CR A/m that the filter allows for and estimates, relative, 1 sigma"),
    NUMBER(onboard.filter.thrust_magnitude_sigma, "", 0.0, 0.5, "error of the thrust that the filter allows for and estimates, relative, 1 sigma"),
    NUMBER(onboard.filter.thrust_pointing_sigma_deg, "deg", 0.0, 30.0, "error of its direction, likewise, 1 sigma per axis"),
    NUMBER(onboard.filter.thrust_tau_days, "d", 0.01, 1000.0, "correlation time of both"),
    SWITCH(onboard.filter.knows_unloading, "kicks are reported to the filter, with the error that follows; false: unmodelled acceleration has to cover them"),
    NUMBER(onboard.filter.unloading_error_relative, "", 0.0, 1.0, "error of a reported kick over its size, 1 sigma per axis"),
    SWITCH(onboard.filter.knows_maneuver, "a correction of truth.upsets is told to the filter as it was commanded, with its true error's sigma; false: nobody tells it"),
    NUMBER(onboard.filter.clock_sigma_ms, "ms", 0.0, 10000.0, "error of the onboard clock that the filter allows for and estimates from the planets' own motion, 1 sigma; 0: it is right"),
    NUMBER(onboard.filter.clock_tau_days, "d", 1.0, 1e6, "how long that error stays the same: correlation time; some weeks where it may jump"),
    NUMBER(onboard.filter.camera_focal_relative_sigma, "", 0.0, 0.1, "focal length error that the filter allows for (first-order Gauss-Markov), relative, 1 sigma"),
    NUMBER(onboard.filter.camera_k1_sigma, "", 0.0, 1.0, "error of the radial distortion k1 that the filter allows for (first-order Gauss-Markov), 1 sigma"),
    NUMBER(onboard.filter.camera_tau_days, "d", 0.01, 10000.0, "correlation time of both"),
    NUMBER(onboard.filter.window_bias_sigma_px, "px", 0.0, 10.0, "what is constant while one beacon is tracked, per axis, 1 sigma; starts anew with each window"),
    NUMBER(onboard.filter.window_memory_days, "d", 0.0, 10000.0, "for how long a window resembles the last one of the same beacon, before the same stars; 0: not at all"),
    NUMBER(onboard.filter.window_bias_tau_hours, "h", 0.01, 10000.0, "its correlation time within a window"),
    NUMBER(onboard.filter.ephemeris_sigma_km, "km", 0.0, 1e6, "error of a beacon's place that the filter allows for, 1 sigma per axis"),
    NUMBER(onboard.filter.gate_probability, "", 0.5, 1.0, "measurement editing: share of good measurements that pass; 1 for no editing"),
    SWITCH(onboard.filter.adaptive_r, "a scale of the measurement noise is learnt for each beacon from past residuals; false: as the image processing says"),
    SWITCH(onboard.filter.photocentre, "centre of light of a Lambert sphere in the measurement model; false: centre of figure"),
    NUMBER(onboard.filter.photocentre_sigma, "", 0.0, 1.0, "error of that law which the filter allows for and estimates, one scale a planet, relative, 1 sigma; 0: the law is known"),
    NUMBER(onboard.filter.photocentre_tau_days, "d", 1.0, 1e6, "how long that error stays the same: correlation time"),
    TEXT(onboard.filter.bodies, "whose gravity the filter models beside the Sun's"),

    NUMBER(onboard.ephemeris.mercury_km, "km", 0.0, 1e6, "lasting error of its place that the filter allows for and estimates, along the orbit and across its plane, 1 sigma each; 0: known"),
    NUMBER(onboard.ephemeris.venus_km, "km", 0.0, 1e6, "likewise"),
    NUMBER(onboard.ephemeris.earth_km, "km", 0.0, 1e6, "likewise; also the Moon"),
    NUMBER(onboard.ephemeris.mars_km, "km", 0.0, 1e6, "likewise"),
    NUMBER(onboard.ephemeris.jupiter_km, "km", 0.0, 1e6, "likewise"),
    NUMBER(onboard.ephemeris.saturn_km, "km", 0.0, 1e6, "likewise"),
    NUMBER(onboard.ephemeris.uranus_km, "km", 0.0, 1e6, "likewise"),
    NUMBER(onboard.ephemeris.tau_days, "d", 1.0, 1e6, "correlation time of these errors"),

    NUMBER(onboard.gyro.angle_random_walk_deg_sqrt_h, "deg/sqrt(h)", 0.0, 100.0, "white noise of the gyro's rate as the attitude filter assumes it, an axis"),
    NUMBER(onboard.gyro.bias_random_walk_deg_h_sqrt_h, "deg/h/sqrt(h)", 0.0, 1000.0, "how it assumes the bias to walk, an axis"),
    NUMBER(onboard.gyro.bias_sigma_deg_h, "deg/h", 1e-6, 1e5, "bias that it assumes of a gyro just switched on, 1 sigma an axis"),

    CHOICE(onboard.vision.exposure, "fixed chosen", "fixed: the camera's own exposure; chosen: by the onboard software for each window, up to the camera's own"),
    CHOICE(onboard.vision.centroid_method, "moment psf_fit", "how the centre of a spot is found"),
    SWITCH(onboard.vision.prior_attitude, "stars are looked for where the gyro, or without one the last image of the window, turned as commanded since, puts them; false: each image is lost in space"),
    NUMBER(onboard.vision.threshold_sigma, "", 1.0, 1000.0, "detection threshold above the background, in sigmas of the background"),
    NUMBER(onboard.vision.star_max_v_mag, "mag", 2.0, 12.0, "faintest star (V) in the onboard catalogue"),
    NUMBER(onboard.vision.max_spots, "", 4.0, 10000.0, "most spots that are measured in a frame, brightest first"),
    NUMBER(onboard.vision.match_radius_px, "px", 0.05, 50.0, "how far a spot may lie from the star that it is taken for"),
    NUMBER(onboard.vision.camera_focal_sigma, "", 0.0, 0.1, "relative error of the camera file's focal length that the eyes may learn from the stars, 1 sigma; 0: taken as told"),
    NUMBER(onboard.vision.camera_center_sigma_px, "px", 0.0, 100.0, "... of the principal point, per axis"),
    NUMBER(onboard.vision.camera_k1_sigma, "", 0.0, 1.0, "... of the radial distortion k1"),
    NUMBER(onboard.vision.planet_gate_probability, "", 0.5, 1.0, "share of true planets that the search ellipse must hold"),

    NUMBER(mil.line_of_sight_noise_arcsec, "arcsec", 0.0, 36000.0, "noise of the sights flown without images, 1 sigma per axis; 0: perfect"),
    NUMBER(mil.systematic_arcsec, "arcsec", 0.0, 3600.0, "error that all sights of a window share, per axis, 1 sigma; drawn anew for each window, and told to the filter"),
    NUMBER(mil.outlier_share, "", 0.0, 0.5, "share of sights whose noise is larger than the filter is told"),
    NUMBER(mil.outlier_scale, "", 1.0, 1e4, "how much larger"),

    NUMBER(sky.max_v_mag, "mag", 0.0, 15.0, "faintest star (V) that is drawn"),
    NUMBER(sky.companion_share, "", 0.0, 1.0, "share of the stars that have a companion which no catalogue knows, 0.1 to 10 arcsec away and up to 4 mag fainter"),
};
// clang-format on

std::string toml_string(std::string_view text) {
  std::string out = "\"";
  for (const char c : text) {
    if (c == '"' || c == '\\') {
      out += '\\';
      out += c;
    } else if (static_cast<unsigned char>(c) < 0x20) {
      out += fmt::format("\\u{:04x}", static_cast<unsigned>(c));
    } else {
      out += c;
    }
  }
  return out + '"';
}

std::string text_of(double v) {
  std::string s = fmt::format("{}", v);  // shortest that reads back to the same bits
  if (s.find_first_of(".einf") == std::string::npos) s += ".0";
  return s;
}
std::string text_of(int v) {
  return fmt::format("{}", v);
}
std::string text_of(bool v) {
  return v ? "true" : "false";
}
std::string text_of(const std::string& v) {
  return toml_string(v);
}
std::string text_of(const Epoch& v) {
  return toml_string(v.iso(TimeScale::tdb, 9));
}
std::string text_of(const std::vector<std::string>& v) {
  std::string out = "[";
  for (const std::string& item : v) out += (out.size() > 1 ? ", " : "") + toml_string(item);
  return out + "]";
}

}  // namespace

std::span<const Key> keys() {
  return kKeys;
}

const Key* find_key(std::string_view name) {
  const auto it = std::find_if(kKeys.begin(), kKeys.end(), [&](const Key& key) { return key.name == name; });
  return it == kKeys.end() ? nullptr : &*it;
}

std::string_view nearest_key(std::string_view name) {
  return nearest_word(name, kKeys, [](const Key& key) { return key.name; })->name;
}

std::string_view section_of(std::string_view key) {
  return key.substr(0, key.rfind('.'));
}
std::string_view leaf_of(std::string_view key) {
  return key.substr(key.rfind('.') + 1);
}

std::string value_text(const Key& key, const Scenario& scenario) {
  // The accessors hand out the address of a field; nothing is written through it here.
  return std::visit([&](auto member) { return text_of(*member(const_cast<Scenario&>(scenario))); }, key.member);
}

}  // namespace astronav::scenario
