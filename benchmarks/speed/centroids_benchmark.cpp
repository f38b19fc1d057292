// SPDX-License-Identifier: Apache-2.0
// Centroids of one frame, on one core: 1024 x 1024, 100 stars, all noise; frames in turn, so that none is in the cache.
#include <cmath>

#include <benchmark/benchmark.h>

#include "models/camera_file/camera_file.h"
#include "onboard/vision/centroids.h"
#include "simulator/render/renderer.h"

namespace astronav::vision {
namespace {

void centroids(benchmark::State& state) {
  constexpr std::size_t kFrames = 8;
  const Camera camera = *read_camera("extrema-20deg");
  const render::Renderer renderer(camera, 1);
  RandomStream random({.seed = 1, .purpose = "star field"});
  std::vector<render::RenderedSource> stars(100);
  for (render::RenderedSource& star : stars) {
    star.pixel = {random.uniform(10.0, 1013.0), random.uniform(10.0, 1013.0)};
    // Counts grow threefold with each magnitude; 3600 electrons at V 7.
    star.electrons = 3600.0 * std::pow(random.uniform() + 1e-3, -0.84);
  }
  if (state.range(1) != 0) stars.front().electrons = 1.4e8;  // Venus
  std::vector<ImageU16> frames(kFrames);
  for (std::size_t i = 0; i < kFrames; ++i)
    renderer.frame(stars, {.duration_s = camera.exposure_s}, {.image = i, .purpose = ""}, frames[i]);
  const CentroidSettings settings{.method = static_cast<CentroidMethod>(state.range(0))};
  CentroidFinder finder(settings, SensorModel::from(camera), 1024, 1024);
  std::vector<Centroid> spots(200);
  std::size_t image = 0, count = 0;
  for (auto _ : state) count = finder.find(std::as_const(frames[image++ % kFrames]).view(), spots);
  state.counters["spots"] = static_cast<double>(count);
}
BENCHMARK(centroids)
    ->ArgNames({"psf_fit", "venus"})
    ->ArgsProduct({{static_cast<int>(CentroidMethod::squared_intensity), static_cast<int>(CentroidMethod::psf_fit)},
                   {0, 1}})
    ->Unit(benchmark::kMillisecond);

}  // namespace
}  // namespace astronav::vision

BENCHMARK_MAIN();
