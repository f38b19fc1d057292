// SPDX-License-Identifier: Apache-2.0
// One frame to attitude and planets, on one core: 1024 x 1024, 16 bits, the mission's camera with all noise, a planet
// in every frame. The frames come one after the other into one buffer, as a camera's driver puts them there. Lost in
// space, and with a prior attitude that is off by 200 arcsec an axis (1 sigma). `ms`: median over the frames of the
// quickest look at each.
#include <algorithm>
#include <limits>
#include <optional>
#include <utility>

#include <benchmark/benchmark.h>

#include "benchmarks/accuracy/rendered_sky.h"
#include "foundation/math/statistics.h"

namespace astronav::accuracy {
namespace {

constexpr std::size_t kFrames = 48;
constexpr double kPriorSigmaRad = 200.0 * kArcsecond;
constexpr double kPlaceSigmaRad = 2e-4;  // of a planet: 30,000 km at 1 au

struct Look {
  ImageU16 frame;
  Mat3 prior_R_CN;
  std::vector<vision::PlanetPrediction> predictions;
};

struct Album {
  vision::Observer observer = cruising();
  RenderedSky world;
  Onboard onboard{world.catalogue, world.believed.intrinsics, 7.0, observer.epoch};
  std::vector<Look> looks;

  Album() {
    RandomStream random({.seed = 1, .purpose = "album"});
    const State here{observer.p_O_N, observer.v_O_N};
    sky::SkySettings bodies;
    bodies.max_v_mag = -30.0;
    auto planets = world.sky.look(observer.epoch, here, here.p_m.normalized(), kPi, world.band, bodies).value();
    std::erase_if(planets, [](const sky::SkySource& s) {
      return s.kind != sky::SourceKind::planet || s.v_mag > 6.5 || s.v_mag < -6.0;
    });
    for (std::size_t k = 0; k < kFrames; ++k) {
      const sky::SkySource& target = planets[k % planets.size()];
      const Vec3 in_camera =
          *unproject(world.truth.intrinsics, {random.uniform(40.0, 983.0), random.uniform(40.0, 983.0)});
      const Mat3 R_CN = rotation_exp(in_camera * random.uniform(0.0, 2.0 * kPi)) *
                        Eigen::Quaterniond::FromTwoVectors(target.direction_N, in_camera).toRotationMatrix();
      world.shoot(observer.epoch, here, R_CN, world.believed.exposure_s, random);
      Look look{world.frame, rotation_exp(kPriorSigmaRad * any(random)) * R_CN, {}};
      for (const sky::SkySource& planet : planets) {
        const auto pixel = project(world.believed.intrinsics, R_CN * planet.direction_N);
        if (!pixel || std::abs(pixel->u - 511.5) > 511.5 || std::abs(pixel->v - 511.5) > 511.5) continue;
        vision::PlanetPrediction p;
        p.body = BodyId{static_cast<std::int32_t>(planet.id)};
        p.direction_N = (planet.direction_N + kPlaceSigmaRad * any(random)).normalized();
        p.direction_covariance = Mat3::Identity() * kPlaceSigmaRad * kPlaceSigmaRad;
        p.expected_flux_dn =
            planet.flux.electrons_per_s * world.believed.exposure_s / world.believed.detector.gain_e_dn;
        look.predictions.push_back(p);
      }
      looks.push_back(std::move(look));
    }
  }
  static Vec3 any(RandomStream& random) { return {random.normal(), random.normal(), random.normal()}; }
};

void frame_to_attitude(benchmark::State& state) {
  static const Album album;
  const bool with_prior = state.range(0) != 0;
  vision::Vision eyes({}, album.world.believed.intrinsics, vision::SensorModel::from(album.world.believed),
                      album.onboard.field, album.onboard.index);
  ImageU16 buffer(album.world.frame.width(), album.world.frame.height());
  const double never = std::numeric_limits<double>::infinity();
  std::vector<double> total(kFrames, never), centroid(kFrames, never);
  std::size_t turn = 0, stars = 0, spots = 0, planets = 0, as_asked = 0, predicted = 0;
  for (auto _ : state) {
    const std::size_t k = turn++ % kFrames;
    const Look& look = album.looks[k];
    std::copy(look.frame.pixels().begin(), look.frame.pixels().end(), buffer.pixels().begin());
    const auto& seen = eyes.process(std::as_const(buffer).view(), album.observer,
                                    with_prior ? std::optional<Mat3>(look.prior_R_CN) : std::nullopt, look.predictions);
    state.SetIterationTime(1e-3 * seen.time_ms.total);
    total[k] = std::min(total[k], seen.time_ms.total);
    centroid[k] = std::min(centroid[k], seen.time_ms.centroid);
    stars += seen.stars.size();
    spots += seen.centroids.size();
    predicted += look.predictions.size();
    for (const vision::PlanetMatch& planet : seen.planets) planets += planet.found;
    as_asked += seen.source == (with_prior ? vision::AttitudeSource::prior : vision::AttitudeSource::lost_in_space);
  }
  const auto share = [](std::size_t a, std::size_t b) { return static_cast<double>(a) / static_cast<double>(b); };
  state.counters["ms"] = median(total);
  state.counters["ms_centroids"] = median(centroid);
  state.counters["spots"] = share(spots, turn);
  state.counters["stars"] = share(stars, turn);
  state.counters["solved"] = share(as_asked, turn);
  state.counters["planets_found"] = share(planets, predicted);
}
BENCHMARK(frame_to_attitude)->ArgName("prior")->Arg(0)->Arg(1)->UseManualTime()->Unit(benchmark::kMillisecond);

}  // namespace
}  // namespace astronav::accuracy

BENCHMARK_MAIN();
