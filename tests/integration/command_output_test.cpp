// SPDX-License-Identifier: Apache-2.0
// What the commands promise in docs/interfaces.md: the fields of their JSON, the files of a run, help that fits a
// screen.
#include <cmath>
#include <memory>
#include <regex>
#include <set>
#include <string>
#include <vector>

#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include "support/program.h"

namespace astronav {
namespace {

namespace fs = std::filesystem;
using nlohmann::json;
using testing::lines_of;
using testing::Outcome;
using testing::read_text;
using testing::words;

using Fields = std::set<std::string>;

Fields fields_of(const json& object) {
  Fields out;
  for (const auto& [key, value] : object.items()) out.insert(key);
  return out;
}

// The page's part from a heading that begins so to the next one.
std::string chapter(const std::string& heading) {
  const std::string page = read_text(fs::path(ASTRONAV_TEST_HOME) / "docs/interfaces.md");
  const std::size_t begin = page.find("## " + heading);
  if (begin == std::string::npos) return {};
  return page.substr(begin, page.find("\n## ", begin) - begin);
}

// The object has exactly these fields, and the page tells of each.
void expect_fields(const json& object, const Fields& fields, const std::string& heading) {
  EXPECT_EQ(fields_of(object), fields) << heading;
  const std::string page = chapter(heading);
  for (const std::string& field : fields) {
    const bool told = std::regex_search(page, std::regex("\\b" + field + "\\b"));
    EXPECT_TRUE(told) << "docs/interfaces.md, \"" << heading << "\", does not tell of " << field;
  }
}

// Standard output holds JSON objects, one a line, and nothing else.
std::vector<json> objects(const Outcome& got) {
  EXPECT_EQ(got.status, 0) << got.err;
  std::vector<json> out;
  for (const std::string& line : lines_of(got.out)) {
    out.push_back(json::parse(line, nullptr, false));
    EXPECT_TRUE(out.back().is_object()) << line;
  }
  EXPECT_FALSE(out.empty());
  return out;
}

class CommandOutput : public ::testing::Test {
 protected:
  Outcome astronav(const std::string& line) const {
    return testing::run_program(ASTRONAV_PROGRAM, words(line), folder());
  }
  const fs::path& folder() const { return scratch_.path(); }

 private:
  testing::ScratchFolder scratch_;
};

TEST_F(CommandOutput, HelpFitsAScreenAndEndsWithAnExample) {
  std::vector<std::string> commands = testing::commands_of(ASTRONAV_PROGRAM, folder());
  EXPECT_GE(commands.size(), 15u);
  commands.insert(commands.begin(), "");
  for (const std::string& command : commands) {
    const Outcome got = astronav(command + " --help");
    EXPECT_EQ(got.status, 0) << command;
    EXPECT_EQ(got.err, "") << command;
    const std::vector<std::string> lines = lines_of(got.out);
    EXPECT_LE(lines.size(), 40u) << command;
    for (const std::string& line : lines) EXPECT_LE(line.size(), 120u) << command << ": " << line;
    ASSERT_GE(lines.size(), 2u);
    EXPECT_EQ(lines[lines.size() - 2], "Example:") << command;
    const std::string example = "  astronav" + (command.empty() ? "" : " " + command) + " ";
    EXPECT_TRUE((lines.back() + " ").starts_with(example) || command == "catalog" || command == "trajectory")
        << lines.back();
  }
}

TEST_F(CommandOutput, Ephemeris) {
  Fields fields{"body",          "from",        "epoch_tdb", "epoch_utc", "correction",  "position_km",
                "velocity_km_s", "distance_km", "ra_deg",    "dec_deg",   "light_time_s"};
  for (const json& moon : objects(astronav(
           "ephemeris 'mars barycenter' --from ssb --epoch 2026-11-22/2026-11-25/1d --correction none --json"))) {
    expect_fields(moon["position_km"], {"x", "y", "z"}, "JSON of `ephemeris`");
    expect_fields(moon["velocity_km_s"], {"x", "y", "z"}, "JSON of `ephemeris`");
  }
  const auto sun = objects(astronav("ephemeris sun --epoch 2026-11-22 --json"));
  ASSERT_EQ(sun.size(), 1u);
  expect_fields(sun[0], fields, "JSON of `ephemeris`");
  EXPECT_NEAR(sun[0].at("distance_km").get<double>(), 147.8e6, 0.5e6);
  fields.insert({"magnitude_v", "phase_angle_deg", "sun_elongation_deg"});
  const auto mars = objects(astronav("ephemeris mars --epoch 2026-11-22/2026-11-25/1d --json"));
  ASSERT_EQ(mars.size(), 4u);
  for (const json& each : mars) expect_fields(each, fields, "JSON of `ephemeris`");
}

TEST_F(CommandOutput, TruthOfRender) {
  const auto told =
      objects(astronav("render --epoch '2026-11-22T00:00:00 TDB' --pointing 83.8,-1.2,10 --max-v 8 --out frame.fits "
                       "--truth truth.json --json"));
  ASSERT_EQ(told.size(), 1u);
  expect_fields(told[0], {"image", "truth", "camera", "epoch_tdb", "stars", "planets"}, "Truth of `render`");
  const json truth = json::parse(read_text(folder() / "truth.json"), nullptr, false);
  ASSERT_TRUE(truth.is_object());
  expect_fields(truth,
                {"image", "camera", "exposure_ms", "seed", "epoch_tdb", "ra_deg", "dec_deg", "roll_deg", "q_NC",
                 "observer", "sources"},
                "Truth of `render`");
  expect_fields(truth["q_NC"], {"w", "x", "y", "z"}, "Truth of `render`");
  expect_fields(truth["observer"], {"position_km", "velocity_km_s"}, "Truth of `render`");
  EXPECT_NEAR(truth["roll_deg"].get<double>(), 10.0, 1e-9);
  ASSERT_GT(truth["sources"].size(), 50u);
  EXPECT_EQ(truth["sources"].size(), told[0]["stars"].get<std::size_t>() + told[0]["planets"].size());
  for (const json& source : truth["sources"]) {
    Fields fields{"id", "kind", "u_px", "v_px", "ra_deg", "dec_deg", "electrons", "mag", "irradiance_w_m2"};
    if (source["kind"] == "planet") fields.insert("name");
    ASSERT_EQ(fields_of(source), fields);
  }
  expect_fields(truth["sources"][0], fields_of(truth["sources"][0]), "Truth of `render`");
}

TEST_F(CommandOutput, CentroidsAndSolve) {
  ASSERT_EQ(astronav("render --epoch 2026-11-22 --pointing 83.8,-1.2,10 --max-v 9 --out frame.fits").status, 0);
  const auto seen = objects(astronav("centroids frame.fits --json"));
  ASSERT_EQ(seen.size(), 1u);
  expect_fields(seen[0], {"image", "count", "threshold_dn", "background_dn", "noise_dn", "time_ms", "centroids"},
                "JSON of `centroids`");
  ASSERT_GT(seen[0]["centroids"].size(), 20u);
  EXPECT_EQ(seen[0]["count"], seen[0]["centroids"].size());
  expect_fields(seen[0]["centroids"][0],
                {"u_px", "v_px", "sigma_u_px", "sigma_v_px", "flux_dn", "snr", "pixels", "saturated"},
                "JSON of `centroids`");

  const std::string chapter_name = "JSON of `solve`";
  const auto solved =
      objects(astronav("solve frame.fits --camera extrema-20deg --epoch 2026-11-22 --observer earth --json"));
  ASSERT_EQ(solved.size(), 1u);
  const json& s = solved[0];
  expect_fields(s,
                {"image",
                 "status",
                 "message",
                 "ra_deg",
                 "dec_deg",
                 "roll_deg",
                 "fov_h_deg",
                 "fov_v_deg",
                 "plate_scale_arcsec",
                 "q_NC",
                 "attitude_sigma_arcsec",
                 "center_sigma_arcsec",
                 "parity",
                 "chance_probability",
                 "focal_px",
                 "aspect",
                 "principal_point_px",
                 "distortion",
                 "epoch_tdb",
                 "epoch_assumed",
                 "aberration_corrected",
                 "refraction_corrected",
                 "stars_detected",
                 "stars_matched",
                 "residual_rms_px",
                 "stars",
                 "planets",
                 "spots",
                 "time_ms"},
                chapter_name);
  expect_fields(s["q_NC"], {"w", "x", "y", "z"}, chapter_name);
  expect_fields(s["attitude_sigma_arcsec"], {"x", "y", "z"}, chapter_name);
  expect_fields(s["center_sigma_arcsec"], {"right", "down", "roll"}, chapter_name);
  expect_fields(s["distortion"], {"k1", "k2", "k3", "p1", "p2"}, chapter_name);
  expect_fields(s["time_ms"], {"read", "centroid", "lists", "identify", "attitude", "planets", "total"}, chapter_name);
  ASSERT_GT(s["stars"].size(), 10u);
  expect_fields(s["stars"][0], {"id", "u_px", "v_px", "residual_px", "flux_dn", "mag"}, chapter_name);
  EXPECT_NEAR(s["ra_deg"].get<double>(), 83.8, 0.01);
  EXPECT_NEAR(s["dec_deg"].get<double>(), -1.2, 0.01);
  EXPECT_NEAR(s["roll_deg"].get<double>(), 10.0, 0.05);
  EXPECT_TRUE(s["aberration_corrected"].get<bool>());
}

TEST_F(CommandOutput, Catalog) {
  const auto stars = objects(astronav("catalog cone 83.8,-5.4,3 --max-v 6 --json"));
  ASSERT_GT(stars.size(), 3u);
  double last = -30.0;
  for (const json& star : stars) {
    expect_fields(star,
                  {"id", "ra_deg", "dec_deg", "pm_ra_cosdec_mas_yr", "pm_dec_mas_yr", "parallax_mas", "v_mag",
                   "b_v_mag", "separation_deg"},
                  "JSON of `catalog`");
    EXPECT_GE(star["v_mag"].get<double>(), last);
    last = star["v_mag"].get<double>();
    EXPECT_LE(star["separation_deg"].get<double>(), 3.0);
  }
  const auto info = objects(astronav("catalog info --json"));
  ASSERT_EQ(info.size(), 1u);
  expect_fields(info[0],
                {"file", "source", "size_bytes", "epoch", "stars", "stars_without_colour", "v_mag_min", "v_mag_max",
                 "stars_to_v_mag"},
                "JSON of `catalog`");
}

TEST_F(CommandOutput, TrajectoryIsDesignedToldOfAndConverted) {
  const std::string chapter_name = "JSON of `trajectory`";
  const auto design = objects(astronav("trajectory design --departure 2026-11-09 --days 300 --out cruise.oem --json"));
  ASSERT_EQ(design.size(), 1u);
  expect_fields(design[0],
                {"from", "to", "departure_tdb", "arrival_tdb", "duration_days", "c3_km2_s2",
                 "v_infinity_departure_km_s", "v_infinity_arrival_km_s", "closest_approach_km", "miss_distance_km",
                 "aim_error_km", "iterations", "begin_tdb", "end_tdb", "position_km", "velocity_km_s", "out"},
                chapter_name);
  const auto info = objects(astronav("trajectory info cruise.oem --json"));
  ASSERT_EQ(info.size(), 1u);
  expect_fields(info[0],
                {"file", "format", "object", "object_id", "center", "center_id", "time_system", "begin_tdb", "end_tdb",
                 "duration_days", "states", "covariances"},
                chapter_name);
  EXPECT_NEAR(info[0]["duration_days"].get<double>(), 294.0, 1e-6);
  const auto converted = objects(astronav("trajectory convert cruise.oem hourly.oem --step 1h --json"));
  ASSERT_EQ(converted.size(), 1u);
  expect_fields(converted[0], {"out", "states", "begin_tdb", "end_tdb"}, chapter_name);
  EXPECT_EQ(converted[0]["states"].get<int>(), 294 * 24 + 1);
}

TEST_F(CommandOutput, Beacons) {
  const auto cycles = objects(astronav("beacons --set conops.cycle_days=50 --json"));
  ASSERT_GT(cycles.size(), 3u);
  expect_fields(cycles[0],
                {"cycle", "epoch_tdb", "day", "first", "second", "separation_deg", "figure_of_merit_km",
                 "filter_merit_km", "slew_s", "candidates"},
                "JSON of `beacons`");
  // After a first pair the filter knows more than two sights tell.
  EXPECT_LT(cycles[2]["filter_merit_km"].get<double>(), cycles[2]["figure_of_merit_km"].get<double>());
  expect_fields(cycles[0]["candidates"][0],
                {"body", "usable", "reason", "magnitude_v", "sun_elongation_deg", "distance_km", "phase_angle_deg",
                 "angular_diameter_arcsec", "nearest_arcsec"},
                "JSON of `beacons`");
}

TEST_F(CommandOutput, FixByPlanets) {
  // From (-1.2e8, 1.0e8, 4.5e7) km, light time counted, rounded to 1e-4 degrees (0.2 arcsec).
  const auto found = objects(
      astronav("fix --json --epoch '2027-03-01 TDB' --sight earth,250.3791,-23.6087,1 --sight mars,182.8468,2.4912,1"));
  ASSERT_EQ(found.size(), 1u);
  expect_fields(
      found[0],
      {"status", "epoch_tdb", "position_km", "sigma_km", "covariance_km2", "chi2", "degrees_of_freedom", "sights"},
      "JSON of `fix`");
  expect_fields(found[0]["sights"][0],
                {"name", "distance_km", "light_time_s", "residual_east_arcsec", "residual_north_arcsec"},
                "JSON of `fix`");
  const json& p = found[0]["position_km"];
  EXPECT_LT(std::hypot(p["x"].get<double>() + 1.2e8, p["y"].get<double>() - 1.0e8, p["z"].get<double>() - 4.5e7), 1e3);
  EXPECT_EQ(
      astronav("fix --epoch '2027-03-01 TDB' --sight earth,70.3791,23.6087,1 --sight mars,2.8468,-2.4912,1").status, 3);
}

TEST_F(CommandOutput, RunLeavesItsFilesAndTellsItsSummary) {
  const Outcome got =
      astronav("run --level mil --seed 3 --set conops.cycle_days=40 --set conops.tracking_min=10 --out results --json");
  const auto told = objects(got);
  ASSERT_EQ(told.size(), 1u);
  for (const char* name :
       {"summary.json", "estimate.oem", "truth.oem", "records.csv", "scenario.resolved.toml", "report.html"})
    EXPECT_GT(fs::is_regular_file(folder() / "results" / name) ? fs::file_size(folder() / "results" / name) : 0, 100u)
        << name;
  const json summary = json::parse(read_text(folder() / "results/summary.json"), nullptr, false);
  const std::string chapter_name = "Files of `run`";
  const Fields fields{"level",
                      "seed",
                      "sample",
                      "version",
                      "runs",
                      "cycles",
                      "images",
                      "duration_days",
                      "start",
                      "position_error_km",
                      "velocity_error_m_s",
                      "nees_mean",
                      "nees_band_95",
                      "nis_mean",
                      "nis_band_95",
                      "vision",
                      "attitude_filter",
                      "time_ms_per_image",
                      "time_ms",
                      "peak_memory_mb",
                      "wall_s",
                      "counts"};
  expect_fields(summary, fields, chapter_name);
  for (const char* which : {"position_error_km", "velocity_error_m_s"}) {
    expect_fields(summary[which],
                  {"final_rss", "steady_rms_rss", "steady_3sigma_axis", "formal_3sigma_axis", "end_of_coast"},
                  chapter_name);
    expect_fields(summary[which]["end_of_coast"],
                  {"final_rss", "steady_rms_rss", "steady_3sigma_axis", "formal_3sigma_axis"}, chapter_name);
    EXPECT_EQ(summary[which]["steady_3sigma_axis"].size(), 3u);
  }
  expect_fields(summary["vision"],
                {"attitude_success_rate", "planet_success_rate", "false_planets", "centroid_error_px_1sigma",
                 "planet_error_px_1sigma", "attitude_error_arcsec_1sigma"},
                chapter_name);
  expect_fields(summary["vision"]["attitude_error_arcsec_1sigma"], {"cross", "roll"}, chapter_name);
  expect_fields(summary["attitude_filter"],
                {"by_prior_rate", "between_images_arcsec_1sigma", "after_slew_arcsec_1sigma", "nees_mean",
                 "nees_band_95", "nis_mean", "nis_band_95", "gyro_bias_error_deg_h_1sigma", "restarts", "counts"},
                chapter_name);
  expect_fields(summary["attitude_filter"]["counts"], {"foretold", "slews", "accepted", "biases"}, chapter_name);
  expect_fields(summary["time_ms_per_image"], {"median", "p99"}, chapter_name);
  expect_fields(summary["time_ms"], {"render", "centroid", "identify", "planets", "propagate", "update"}, chapter_name);
  expect_fields(summary["start"],
                {"from", "cycle", "surveys", "pictures", "planets", "survey_error_km", "survey_sigma_km",
                 "position_error_km", "position_sigma_km", "velocity_error_m_s", "velocity_sigma_m_s"},
                chapter_name);
  EXPECT_EQ(summary["level"], "mil");
  EXPECT_EQ(summary["seed"], 3);
  Fields with_places = fields;
  with_places.insert({"out", "report"});
  expect_fields(told[0], with_places, chapter_name);

  // The resolved scenario flies the same mission again.
  const auto again = objects(astronav("run results/scenario.resolved.toml --out again --json"));
  EXPECT_EQ(again.at(0)["position_error_km"], told[0]["position_error_km"]);

  for (const char* name : {"truth.oem", "estimate.oem"}) {
    const auto info = objects(astronav(std::string("trajectory info --json results/") + name));
    EXPECT_EQ(info.at(0)["center"], "solar system barycenter");
    EXPECT_EQ(info.at(0)["time_system"], "TDB");
    EXPECT_EQ(info.at(0)["covariances"].get<int>() > 0, std::string(name) == "estimate.oem");
  }
}

TEST_F(CommandOutput, CampaignTellsItsSummaryAndGoesOn) {
  const std::string line =
      "campaign earth-mars-ballistic --level mil --jobs 2 --set conops.cycle_days=40 --set conops.tracking_min=10 "
      "--out many --json";
  const auto two = objects(astronav(line + " --samples 2"));
  ASSERT_EQ(two.size(), 1u);
  for (const char* name : {"summary.json", "samples.csv", "report.html"})
    EXPECT_TRUE(fs::is_regular_file(folder() / "many" / name)) << name;
  const auto three = objects(astronav(line + " --samples 3"));
  EXPECT_EQ(lines_of(read_text(folder() / "many/samples.csv")).size(), 4u);  // a header and three samples
  const auto merged = objects(astronav("campaign merge many --json"));
  EXPECT_EQ(merged.at(0).dump(), three.at(0).dump());
}

// Where the observer is shows in the truth of a rendered frame.
TEST_F(CommandOutput, ObserversOfEveryKind) {
  ASSERT_EQ(astronav("trajectory convert '" ASTRONAV_TEST_HOME
                     "/data/de405_2000_2050.bsp' mars.oem --body 4 --begin 2026-11-20 --end 2026-11-25 --step 6h")
                .status,
            0);
  const auto place = [&](const std::string& observer) {
    const Outcome got = astronav(
        "render --camera star-tracker-10deg --epoch '2026-11-22T00:00:00 TDB' --pointing 10,20,30 --max-v 4 --out "
        "x.fits --truth x.json --observer " +
        observer);
    EXPECT_EQ(got.status, 0) << observer << ": " << got.err;
    const json truth = json::parse(read_text(folder() / "x.json"), nullptr, false);
    std::vector<double> out;
    for (const char* part : {"position_km", "velocity_km_s"})
      for (const char* axis : {"x", "y", "z"}) out.push_back(truth.at("observer").at(part).at(axis).get<double>());
    return out;
  };
  const auto state = [&](const std::string& body) {
    const auto one = objects(
        astronav("ephemeris " + body + " --from ssb --correction none --epoch '2026-11-22T00:00:00 TDB' --json"));
    std::vector<double> out;
    for (const char* part : {"position_km", "velocity_km_s"})
      for (const char* axis : {"x", "y", "z"}) out.push_back(one.at(0).at(part).at(axis).get<double>());
    return out;
  };
  EXPECT_EQ(place("ssb:1.5e8,-2e7,3,1,2,3"), (std::vector<double>{1.5e8, -2e7, 3, 1, 2, 3}));
  EXPECT_EQ(place("ssb:1.5e8,-2e7,3"), (std::vector<double>{1.5e8, -2e7, 3, 0, 0, 0}));
  EXPECT_EQ(place("mars"), state("mars"));
  EXPECT_EQ(place("399"), state("earth"));
  EXPECT_EQ(place("spk:mars@" ASTRONAV_TEST_HOME "/data/de405_2000_2050.bsp"), state("mars"));
  const auto from_oem = place("oem:mars.oem"), mars = state("mars");
  for (std::size_t i = 0; i < 6; ++i) EXPECT_NEAR(from_oem[i], mars[i], i < 3 ? 1e-2 : 1e-6) << i;
  // On the equator, at sea level: an equatorial radius from the Earth's centre, turning with it.
  const auto ground = place("ground:0,0,0"), earth = state("earth");
  double radius = 0.0, speed = 0.0;
  for (std::size_t i = 0; i < 3; ++i) {
    radius += std::pow(ground[i] - earth[i], 2);
    speed += std::pow(ground[i + 3] - earth[i + 3], 2);
  }
  EXPECT_NEAR(std::sqrt(radius), 6378.137, 0.001);
  EXPECT_NEAR(std::sqrt(speed), 0.4651, 0.0002);
}

}  // namespace
}  // namespace astronav
