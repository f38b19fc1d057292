// SPDX-License-Identifier: Apache-2.0
// Lost in space, from lists of spots: how often the attitude is found, how often it is wrong, how long it takes.
// One JSON object a line. Options: [pointings] [only cases whose name contains this].
#include <chrono>
#include <cstring>

#include <fmt/format.h>

#include "benchmarks/accuracy/arguments.h"
#include "benchmarks/accuracy/spot_sky.h"
#include "foundation/math/statistics.h"

namespace astronav::accuracy {
namespace {

using vision::IdentifySettings;

struct Case {
  std::string name;
  int camera;  // of the list in main()
  SpotDefects defects;
  double least_success;  // the target
  IdentifySettings settings{};
  double focal_error = 0.0;  // relative, of the believed focal length: uniform within +- this
  double k1 = 0.0;           // of the true lens; the believed one has none
};

struct Tally {
  int frames = 0, right = 0, wrong = 0, none = 0, false_stars = 0, mirrored = 0;
  double nees = 0.0, worst_chance = 0.0;
  std::vector<double> ms, cross_px;
};

double now_ms() {
  return std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now().time_since_epoch()).count();
}

void judge(const SpotField& field, const Intrinsics& truth, const vision::Identification& found,
           std::span<const vision::MatchedStar> matches, Tally& tally) {
  const Vec3 theta = -rotation_log(field.R_CN * found.attitude.R_CN.transpose());
  const double d2 = theta.dot(found.attitude.covariance_rad2.inverse() * theta);
  // Wrong: off by more than three pixels somewhere in the frame, and by more than the covariance allows.
  const double corner = 0.5 * std::hypot(truth.width_px, truth.height_px);
  const double worst_px = truth.fx_px * theta.head<2>().norm() + corner * std::abs(theta.z());
  if (worst_px > 3.0 && d2 > 100.0) {
    ++tally.wrong;
    return;
  }
  ++tally.right;
  tally.mirrored += found.attitude.mirrored;
  tally.nees += d2;
  tally.cross_px.push_back(truth.fx_px * theta.head<2>().norm());
  tally.worst_chance = std::max(tally.worst_chance, found.attitude.chance_probability);
  for (std::size_t i = 0; i < found.matched; ++i) tally.false_stars += field.star[matches[i].centroid] != matches[i].id;
}

Tally run(const Case& c, const SpotCamera& camera, const Onboard& onboard, const SpotSky& sky,
          const vision::Observer& observer, int pointings) {
  RandomStream random(StreamId{.seed = 4, .purpose = c.name});
  Intrinsics believed = camera.intrinsics;
  SpotCamera truth = camera;
  truth.intrinsics.distortion.k1 = c.k1;
  vision::Identifier identifier(onboard.field, onboard.index, believed, c.settings, SpotSky::kMaxSpots + 64);
  std::vector<vision::MatchedStar> matches(SpotSky::kMaxSpots + 64);
  Tally tally;
  for (int k = 0; k < pointings; ++k) {
    const double scale = 1.0 + c.focal_error * random.uniform(-1.0, 1.0);
    truth.intrinsics.fx_px = camera.intrinsics.fx_px * scale;
    truth.intrinsics.fy_px = camera.intrinsics.fy_px * scale;
    const SpotField field = sky.draw(truth, c.defects, random);
    const double begin = now_ms();
    const auto found = identifier.lost_in_space(field.spots, observer, matches);
    tally.ms.push_back(now_ms() - begin);
    ++tally.frames;
    if (!found) {
      ++tally.none;
      continue;
    }
    judge(field, truth.intrinsics, *found, matches, tally);
  }
  return tally;
}

void print(const Case& c, const Tally& t) {
  const double success = static_cast<double>(t.right) / t.frames;
  fmt::print(
      "{{\"benchmark\": \"identification\", \"case\": \"{}\", \"frames\": {}, \"success\": {:.5f}, \"target\": {}, "
      "\"met\": {}, \"wrong\": {}, \"not_found\": {}, \"false_stars\": {}, \"nees_over_3\": {:.3f}, "
      "\"mirrored\": {}, \"cross_px_median\": {:.4f}, \"worst_chance\": {:.1e}, \"ms_median\": {:.3f}, \"ms_99\": "
      "{:.3f}, \"ms_max\": "
      "{:.3f}}}\n",
      c.name, t.frames, success, c.least_success, success >= c.least_success && t.wrong == 0, t.wrong, t.none,
      t.false_stars, t.right > 0 ? t.nees / (3.0 * t.right) : 0.0, t.mirrored, t.right > 0 ? median(t.cross_px) : 0.0,
      t.worst_chance, median(t.ms), quantile(t.ms, 0.99), quantile(t.ms, 1.0));
  std::fflush(stdout);
}

int main_of(int argc, char** argv) {
  const int pointings = count_of(argc, argv, 1, "pointings", 2000);
  const char* only = argc > 2 ? argv[2] : "";
  const MappedFile file = MappedFile::open(home_directory() / "data/hipparcos.stars").value();
  const StarCatalogue catalogue = StarCatalogue::open(file.bytes()).value();
  const vision::Observer observer = cruising();
  const SpotSky sky(catalogue, observer);

  struct Named {
    const char* name;
    SpotCamera camera;
    double onboard_v_mag;
  };
  const auto lens = [](double fov_deg) { return Intrinsics::from_field_of_view(1024, 1024, fov_deg * kDegree); };
  const Named cameras[] = {{"20deg", {lens(20.0), 8.5}, 8.0},
                           {"10deg", {lens(10.0), 8.5}, 8.5},
                           {"4deg", {lens(4.0), 9.0}, 9.0},
                           {"60deg", {lens(60.0), 6.0}, 6.5}};
  std::vector<Case> cases;
  const double few_target[] = {0.95, 0.99, 0.99};
  for (int i = 0; i < 4; ++i) {
    const std::string n = cameras[i].name;
    const double target[] = {0.999, 0.995, 0.99, 0.999};
    cases.push_back({n + " 5 false", i, {.false_spots = 5}, target[i]});
    cases.push_back({n + " half false", i, {.false_share = 0.5}, 0.99});
    cases.push_back({n + " half false, bright", i, {.false_share = 0.5, .false_bright = true}, 0.99});
    cases.push_back({n + " third missing", i, {.false_spots = 5, .missing_share = 1.0 / 3.0}, 0.99});
    cases.push_back({n + " 0.5 px", i, {.false_spots = 5, .noise_px = 0.5}, 0.99});
    cases.push_back({n + " 0.5 px not told", i, {.false_spots = 5, .noise_px = 0.5, .noise_told = false}, 0.99});
    for (int few = 4; few <= 6; ++few) {
      cases.push_back({fmt::format("{} {} stars", n, few), i, {.brightest = few}, few_target[few - 4]});
      cases.push_back({fmt::format("{} {} stars, 1 false", n, few), i, {.false_spots = 1, .brightest = few}, 0.9});
    }
    IdentifySettings either;
    either.parity = vision::Parity::unknown;
    cases.push_back({n + " mirrored", i, {.false_spots = 5, .mirrored = true}, 0.99, either});
    cases.push_back({n + " parity unknown", i, {.false_spots = 5}, 0.99, either});
    IdentifySettings any_focal;
    any_focal.focal_uncertainty = 0.05;
    cases.push_back({n + " focal length to 5 %", i, {.false_spots = 5}, 0.99, any_focal, 0.05});
    // Barrel distortion that moves a corner by 8 px, and a focal length known to 0.5 %.
    IdentifySettings bent;
    bent.focal_uncertainty = 0.005;
    bent.distortion_from_stars = 20;
    const double corner = std::tan(0.5 * cameras[i].camera.intrinsics.field_of_view_horizontal_rad()) * std::sqrt(2.0);
    cases.push_back({n + " distorted",
                     i,
                     {.false_spots = 5},
                     0.99,
                     bent,
                     0.005,
                     -8.0 / (cameras[i].camera.intrinsics.fx_px * corner * corner * corner)});
    cases.push_back({n + " low light", i, {.false_spots = 5, .noise_px = 0.25, .brightest = 12}, 0.99});
  }
  for (const Case& c : cases) {
    if (c.name.find(only) == std::string::npos) continue;
    const Named& named = cameras[c.camera];
    const Onboard onboard(catalogue, named.camera.intrinsics, named.onboard_v_mag, observer.epoch);
    if (c.name == std::string(named.name) + " 5 false")
      fmt::print(
          "{{\"benchmark\": \"identification\", \"index\": \"{}\", \"stars\": {}, \"asterism_stars\": {}, "
          "\"pairs\": {}, \"megabytes\": {:.2f}}}\n",
          named.name, onboard.field.stars().size(), onboard.index.star_count(), onboard.index.pair_count(),
          onboard.megabytes());
    print(c, run(c, named.camera, onboard, sky, observer, pointings));
  }
  return 0;
}

}  // namespace
}  // namespace astronav::accuracy

int main(int argc, char** argv) {
  return astronav::accuracy::main_of(argc, argv);
}
