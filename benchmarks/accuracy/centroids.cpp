// SPDX-License-Identifier: Apache-2.0
// How well the flight software places stars and planets, on frames of the simulator with all noise and with optics that
// it is not told of (centroid_scene.h). One JSON object a line.
//
//   centroids_accuracy [stars] [s-curve] [planets] [frames N] [windows N] [only WORD-OF-CAMERA]
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <map>
#include <string>
#include <string_view>

#include <fmt/format.h>
#include <unistd.h>

#include "benchmarks/accuracy/arguments.h"
#include "benchmarks/accuracy/centroid_scene.h"
#include "foundation/math/random.h"
#include "foundation/math/statistics.h"
#include "foundation/raster/raster.h"

namespace astronav::accuracy {
namespace {

constexpr int kSpacing = 40;  // px between stars, so that no halo counts in another's window
constexpr int kSpots = 2000;

const char* name_of(vision::CentroidMethod method) {
  return method == vision::CentroidMethod::psf_fit ? "psf-fit" : "squares";
}

// Errors of stars by class of S/N, against the bound and against what was told of them.
class Judge {
 public:
  // `spot`: nullptr where the star was not found. `told`: the covariance is known.
  void judge(const Bound& bound, const Pixel& truth, const Pixel* spot, const Mat2* told) {
    for (Class& c : classes_) {
      if (bound.snr < c.least || bound.snr >= c.most) continue;
      ++c.asked;
      if (spot == nullptr) continue;
      ++c.found;
      const Vec2 error = spot->vec() - truth.vec();
      c.error2 += error.squaredNorm() / 2.0;
      c.over_bound2 += error.dot(bound.covariance_px2.inverse() * error) / 2.0;
      if (told != nullptr) c.chi2 += error.dot(told->inverse() * error) / 2.0;
      c.bias += error;
    }
  }
  void tell(std::string_view camera, std::string_view method) const {
    for (const Class& c : classes_) {
      if (c.found == 0) continue;
      const std::string most = c.most < 1e9 ? fmt::format("..{}", c.most) : "";
      const double n = c.found;
      fmt::print(
          "{{\"bench\":\"centroids.stars\",\"camera\":\"{}\",\"method\":\"{}\",\"snr\":\"{}{}\",\"stars\":{},"
          "\"found_share\":{:.4f},\"rms_px\":{:.5f},\"over_bound\":{:.3f},\"chi2_per_dof\":{:.3f},\"mean_u_px\":{:.5f},"
          "\"mean_v_px\":{:.5f}}}\n",
          camera, method, c.least, most, c.asked, n / c.asked, std::sqrt(c.error2 / n), std::sqrt(c.over_bound2 / n),
          c.chi2 / n, c.bias.x() / n, c.bias.y() / n);
    }
    std::fflush(stdout);
  }

 private:
  struct Class {
    double least = 0.0, most = 1e9;
    int asked = 0, found = 0;
    double error2 = 0.0, over_bound2 = 0.0, chi2 = 0.0;  // sums, per axis
    Vec2 bias = Vec2::Zero();
  };
  std::vector<Class> classes_{{10.0, 20.0}, {20.0, 50.0}, {50.0, 100.0}, {100.0, 200.0}, {200.0}, {100.0}, {10.0}};
};

std::vector<render::RenderedSource> star_grid(const TestCamera& camera, RandomStream& random, double faintest,
                                              double brightest) {
  std::vector<render::RenderedSource> stars;
  const Intrinsics& c = camera.truth.intrinsics;
  for (int v = kSpacing; v < c.height_px - kSpacing; v += kSpacing) {
    for (int u = kSpacing; u < c.width_px - kSpacing; u += kSpacing)
      stars.push_back(star_at(u + random.uniform(-6.0, 6.0), v + random.uniform(-6.0, 6.0),
                              faintest * std::pow(brightest / faintest, random.uniform())));
  }
  return stars;
}

// `with_sep`: SEP's windowed centroids on the same frames.
void measure_stars(const TestCamera& camera, int frames, bool with_sep = false) {
  namespace fs = std::filesystem;
  const double faintest = electrons_for_snr(camera.truth, 10.0);
  const double brightest = electrons_for_peak(camera.truth, 0.85);
  const render::Renderer renderer(camera.truth, 1);
  const fs::path folder = fs::temp_directory_path() / ("astronav_centroids_" + std::to_string(::getpid()));
  std::ofstream list;
  if (with_sep) {
    fs::create_directories(folder);
    list.open(folder / "stars.csv");
    list.precision(12);
  }
  std::map<std::string, Bound> bounds;  // of what is in the list, by its line
  for (const auto method : {vision::CentroidMethod::psf_fit, vision::CentroidMethod::squared_intensity}) {
    vision::CentroidFinder finder({.method = method, .max_centroids = kSpots},
                                  vision::SensorModel::from(camera.believed), camera.truth.intrinsics.width_px,
                                  camera.truth.intrinsics.height_px);
    std::vector<vision::Centroid> spots(kSpots);
    Judge judge;
    RandomStream random({.seed = 11, .purpose = "stars"});
    ImageU16 frame;
    for (int i = 0; i < frames; ++i) {
      const auto stars = star_grid(camera, random, faintest, brightest);
      renderer.frame(stars, exposure_of(camera), {.image = static_cast<std::uint64_t>(i), .purpose = ""}, frame);
      const std::string name = fmt::format("frame{}.fits", i);
      const bool listed = with_sep && method == vision::CentroidMethod::psf_fit;
      if (listed && !write_fits(folder / name, frame, {})) return;
      const std::size_t count = finder.find(std::as_const(frame).view(), spots);
      for (const auto& star : stars) {
        const Bound bound = cramer_rao(camera.truth, star.pixel, star.electrons, stray_electrons(camera, star.pixel));
        const auto* spot = nearest({spots.data(), count}, star.pixel);
        judge.judge(bound, star.pixel, spot != nullptr ? &spot->pixel : nullptr,
                    spot != nullptr ? &spot->covariance_px2 : nullptr);
        if (!listed) continue;
        const std::string line = fmt::format("{},{:.6f},{:.6f}", name, star.pixel.u, star.pixel.v);
        list << line << '\n';
        bounds.emplace(line, bound);
      }
    }
    judge.tell(camera.name, name_of(method));
  }
  if (!with_sep) return;
  list.close();
  const std::string command = fmt::format("/usr/bin/python3 '{}/centroids_with_sep.py' '{}' {}", ASTRONAV_ACCURACY_DIR,
                                          folder.string(), camera.truth.detector.gain_e_dn);
  if (std::system(command.c_str()) == 0) {
    Judge judge;
    std::ifstream measured(folder / "measured.csv");
    for (std::string name, u, v, x, y; std::getline(measured, name, ',') && std::getline(measured, u, ',') &&
                                       std::getline(measured, v, ',') && std::getline(measured, x, ',') &&
                                       std::getline(measured, y);) {
      const auto bound = bounds.find(fmt::format("{},{},{}", name, u, v));
      if (bound == bounds.end()) continue;
      const Pixel truth{std::stod(u), std::stod(v)};
      const bool seen = !x.empty();
      const Pixel spot{seen ? std::stod(x) : 0.0, seen ? std::stod(y) : 0.0};
      judge.judge(bound->second, truth, seen ? &spot : nullptr, nullptr);
    }
    judge.tell(camera.name, "sep-winpos");
  }
  fs::remove_all(folder);
}

// Without noise: what depends on the place within the pixel, about its mean; and that mean.
void measure_s_curve(double sigma_px, Optics optics) {
  constexpr int kPhases = 20;
  TestCamera camera = test_camera("extrema-20deg", sigma_px, optics, optics == Optics::hard ? "hard" : "mission");
  const render::Renderer renderer(camera.truth, 1);
  const Detector& d = camera.truth.detector;
  vision::FrameLevel level;
  level.background_dn = d.bias_dn + (d.dark_current_e_s + d.background_e_s_px) * camera.truth.exposure_s / d.gain_e_dn;
  level.noise_dn = std::sqrt(dark_variance_e2(camera.truth)) / d.gain_e_dn;
  level.threshold_dn = level.background_dn + 5.0 * level.noise_dn;
  // Stars at the same phase all over the field, at S/N 100: a curve that depends on the place is none of the pixel's.
  std::vector<vision::Centroid> spots(kSpots);
  for (const auto method : {vision::CentroidMethod::psf_fit, vision::CentroidMethod::squared_intensity}) {
    vision::CentroidFinder finder({.method = method, .max_centroids = kSpots},
                                  vision::SensorModel::from(camera.believed), 1024, 1024);
    std::vector<double> along_u;
    for (int phase = 0; phase < kPhases; ++phase) {
      const double at = 512.0 + (phase + 0.5) / kPhases - 0.5;
      const render::RenderedSource star = star_at(at, 512.2, electrons_for_peak(camera.truth, 0.3));
      ImageF electrons;
      renderer.electrons({&star, 1}, exposure_of(camera), electrons, render::Effects::expected());
      for (float& e : electrons.pixels()) e = static_cast<float>(d.bias_dn + e / d.gain_e_dn);
      const std::size_t count = finder.find_above(std::as_const(electrons).view(), level, spots);
      const auto* spot = nearest({spots.data(), count}, star.pixel);
      if (spot != nullptr) along_u.push_back(spot->pixel.u - star.pixel.u);
    }
    const double middle = mean(along_u);
    double worst = 0.0;
    for (const double e : along_u) worst = std::max(worst, std::abs(e - middle));
    fmt::print(
        "{{\"bench\":\"centroids.s_curve\",\"optics\":\"{}\",\"psf_sigma_px\":{},\"method\":\"{}\",\"worst_px\":{:.5f},"
        "\"mean_px\":{:.5f}}}\n",
        camera.name, sigma_px, name_of(method), worst, middle);
  }
}

struct Planet {
  const char* name;
  double electrons;  // with the reference camera
  double radius_px;
  double phase_rad;
};
// As seen on the way from Earth to Mars: a point first, then discs.
constexpr Planet kPlanets[] = {{"V 1.5", 6e5, 0.0, 0.0},
                               {"V 0", 2.3e6, 0.0, 0.0},
                               {"Jupiter", 2.3e7, 0.0, 0.0},
                               {"Venus", 1.4e8, 0.0, 0.0},
                               {"Jupiter, disc", 2.3e7, 0.28, 10.0 * kDegree},
                               {"Venus, disc", 1.4e8, 0.4, 80.0 * kDegree},
                               {"Mars, nearer", 1.0e8, 0.7, 48.0 * kDegree},
                               {"Mars, near", 2.5e8, 1.25, 66.0 * kDegree}};

// Windows of 36 images of one planet among 150 stars, dithered by 50 px (1 sigma), each in another part of the field.
// The first two frames of a camera are not counted: what is learned in flight is learned there and after.
void measure_planets(const TestCamera& camera, int windows) {
  constexpr int kImages = 36;
  const render::Renderer renderer(camera.truth, 1);
  for (const auto method : {vision::CentroidMethod::psf_fit, vision::CentroidMethod::squared_intensity}) {
    for (const Planet& planet : kPlanets) {
      vision::CentroidFinder finder({.method = method}, vision::SensorModel::from(camera.believed), 1024, 1024);
      std::vector<vision::Centroid> spots(200);
      RandomStream random({.seed = 5, .purpose = "planets"});
      double image2 = 0.0, window2 = 0.0, worst_window = 0.0, chi2 = 0.0, formal2 = 0.0, repeating2 = 0.0;
      int seen = 0;
      ImageU16 frame;
      for (int w = 0; w < windows; ++w) {
        const Vec2 about(random.uniform(200.0, 824.0), random.uniform(200.0, 824.0));
        const double sunward = random.uniform(0.0, 2.0 * kPi);
        Vec2 sum = Vec2::Zero();
        int found = 0;
        for (int i = 0; i < kImages; ++i) {
          std::vector<render::RenderedSource> sources;
          const Vec2 at = about + 50.0 * Vec2(random.normal(), random.normal()).cwiseMin(2.5).cwiseMax(-2.5);
          render::RenderedSource body = star_at(at.x(), at.y(), planet.electrons);
          body.source.kind = sky::SourceKind::planet;
          body.radius_px = planet.radius_px;
          body.source.phase_angle_rad = planet.phase_rad;
          body.sunward_px = Vec2(std::cos(sunward), std::sin(sunward));
          for (int s = 0; s < 150; ++s) {
            // Counts grow threefold with each magnitude; 3600 electrons at V 7.
            const double u = random.uniform(0.0, 1023.0), v = random.uniform(0.0, 1023.0);
            const double flux = 3600.0 * std::pow(random.uniform() + 1e-3, -0.84);
            if (std::hypot(u - at.x(), v - at.y()) > 25.0) sources.push_back(star_at(u, v, flux));
          }
          sources.push_back(body);
          renderer.frame(sources, exposure_of(camera),
                         {.seed = 5, .image = static_cast<std::uint64_t>(w * kImages + i), .purpose = ""}, frame);
          vision::FrameLevel level;
          const std::size_t count = finder.find(std::as_const(frame).view(), spots, &level);
          const auto* seen_spot = nearest({spots.data(), count}, body.pixel);
          if (seen_spot == nullptr || (w == 0 && i < 2)) continue;
          vision::Centroid spot = *seen_spot;
          if (planet.radius_px > 0.0 && spot.saturated && method == vision::CentroidMethod::psf_fit)
            finder.measure_disc(std::as_const(frame).view(), level,
                                {planet.radius_px, body.sunward_px, planet.phase_rad}, spot);
          const Vec2 error = spot.pixel.vec() - body.pixel.vec();
          sum += error;
          ++found;
          image2 += error.squaredNorm() / 2.0;
          formal2 += spot.covariance_px2.trace() / 2.0;
          repeating2 += spot.repeating_sigma_px * spot.repeating_sigma_px;
          chi2 += error.dot(spot.whole_covariance_px2().inverse() * error) / 2.0;
        }
        seen += found;
        const Vec2 mean_error = sum / std::max(1, found);
        window2 += mean_error.squaredNorm() / 2.0;
        worst_window = std::max(worst_window, mean_error.cwiseAbs().maxCoeff());
      }
      const double n = std::max(1, seen);
      fmt::print(
          "{{\"bench\":\"centroids.planets\",\"camera\":\"{}\",\"method\":\"{}\",\"planet\":\"{}\",\"electrons\":{:.2g}"
          ","
          "\"images\":{},\"rms_px\":{:.5f},\"window_mean_rms_px\":{:.5f},\"window_mean_worst_px\":{:.5f},"
          "\"told_sigma_px\":{:.5f},\"told_repeating_px\":{:.5f},\"chi2_per_dof\":{:.3f}}}\n",
          camera.name, name_of(method), planet.name, planet.electrons, seen, std::sqrt(image2 / n),
          std::sqrt(window2 / windows), worst_window, std::sqrt(formal2 / n), std::sqrt(repeating2 / n), chi2 / n);
      std::fflush(stdout);
    }
  }
}

}  // namespace
}  // namespace astronav::accuracy

int main(int argc, char** argv) {
  using namespace astronav::accuracy;
  bool stars = argc == 1, s_curve = argc == 1, planets = argc == 1;
  int frames = 10, windows = 6;
  std::string_view only;  // a word in the camera's name
  for (int i = 1; i < argc; ++i) {
    const std::string_view word = argv[i];
    if (word == "stars") {
      stars = true;
    } else if (word == "s-curve") {
      s_curve = true;
    } else if (word == "planets") {
      planets = true;
    } else if (word == "only" && i + 1 < argc) {
      only = argv[++i];
    } else if (word == "frames" && i + 1 < argc) {
      frames = count_of(argc, argv, ++i, "frames", frames);
    } else if (word == "windows" && i + 1 < argc) {
      windows = count_of(argc, argv, ++i, "windows", windows);
    } else {
      fmt::print(stderr, "{}: '{}' is none of stars, s-curve, planets, only WORD, frames N, windows N\n", argv[0],
                 word);
      return 2;
    }
  }
  const auto chosen = [&](const TestCamera& camera) { return camera.name.find(only) != std::string::npos; };
  std::vector<TestCamera> cameras{
      test_camera("extrema-20deg", 0.0, Optics::mission, "extrema-20deg, mission's optics"),
      test_camera("extrema-20deg", 0.0, Optics::hard, "extrema-20deg, hard optics"),
      test_camera("extrema-20deg", 0.0, Optics::moffat, "extrema-20deg, Moffat's profile"),
      in_stray_light(test_camera("extrema-20deg", 0.0, Optics::hard, "extrema-20deg, stray light")),
      test_camera("star-tracker-10deg", 0.0, Optics::hard, "star-tracker-10deg, hard optics")};
  for (const double sigma : {0.5, 1.0, 1.5})
    cameras.push_back(
        test_camera("extrema-20deg", sigma, Optics::hard, fmt::format("sigma {} px, hard optics", sigma)));
  if (stars) {
    for (const TestCamera& camera : cameras) {
      const bool with_sep = camera.name == "extrema-20deg, hard optics" || camera.truth.psf.sigma_px < 0.6;
      if (chosen(camera)) measure_stars(camera, frames, with_sep);
    }
  }
  if (s_curve) {
    for (const double sigma : {0.5, 0.6, 0.7, 0.8, 1.0, 1.5}) {
      for (const Optics optics : {Optics::mission, Optics::hard}) measure_s_curve(sigma, optics);
    }
  }
  if (planets) {
    cameras.resize(4);
    TestCamera blooming = test_camera("extrema-20deg", 0.0, Optics::hard, "extrema-20deg, blooming");
    blooming.truth.detector.blooming = blooming.believed.detector.blooming = true;
    cameras.push_back(blooming);
    for (const TestCamera& camera : cameras) {
      if (chosen(camera)) measure_planets(camera, windows);
    }
  }
}
