// SPDX-License-Identifier: Apache-2.0
// One frame with all noise, on one core: 150 stars and a saturated planet in 20 degrees.
#include <cmath>

#include <benchmark/benchmark.h>

#include "models/camera_file/camera_file.h"
#include "simulator/render/renderer.h"

namespace astronav::render {
namespace {

std::vector<RenderedSource> star_field(int size, int stars) {
  std::vector<RenderedSource> sources;
  RandomStream random({.seed = 1, .purpose = "star field"});
  for (int i = 0; i < stars; ++i) {
    RenderedSource source;
    source.pixel = {random.uniform(0.0, size - 1.0), random.uniform(0.0, size - 1.0)};
    // Counts grow threefold with each magnitude; 3600 electrons at V 7.
    source.electrons = 3600.0 * std::pow(random.uniform() + 1e-3, -0.84);
    sources.push_back(source);
  }
  sources.front().electrons = 2e7;
  return sources;
}

void frame(benchmark::State& state) {
  Camera camera = *read_camera("extrema-20deg");
  const int size = static_cast<int>(state.range(0));
  camera.intrinsics = Intrinsics::from_field_of_view(size, size, 20.0 * kDegree);
  const Renderer renderer(camera, 1);
  const auto sources = star_field(size, 150);
  ImageU16 image;
  StreamId noise;
  for (auto _ : state) {
    ++noise.image;
    renderer.frame(sources, {.duration_s = camera.exposure_s}, noise, image);
    benchmark::DoNotOptimize(image.pixels().data());
  }
  state.counters["fps"] = benchmark::Counter(static_cast<double>(state.iterations()), benchmark::Counter::kIsRate);
}
BENCHMARK(frame)->Arg(1024)->Arg(2048)->Unit(benchmark::kMillisecond);

void frame_without_sources(benchmark::State& state) {
  const Camera camera = *read_camera("extrema-20deg");
  const Renderer renderer(camera, 1);
  ImageU16 image;
  StreamId noise;
  for (auto _ : state) {
    ++noise.image;
    renderer.frame({}, {.duration_s = camera.exposure_s}, noise, image);
    benchmark::DoNotOptimize(image.pixels().data());
  }
}
BENCHMARK(frame_without_sources)->Unit(benchmark::kMillisecond);

void expected_electrons(benchmark::State& state) {
  const Camera camera = *read_camera("extrema-20deg");
  const Renderer renderer(camera, 1);
  const auto sources = star_field(1024, 150);
  ImageF image;
  for (auto _ : state) {
    renderer.electrons(sources, {.duration_s = camera.exposure_s}, image);
    benchmark::DoNotOptimize(image.pixels().data());
  }
}
BENCHMARK(expected_electrons)->Unit(benchmark::kMillisecond);

void new_detector(benchmark::State& state) {
  const Camera camera = *read_camera("extrema-20deg");
  ImageU16 image;
  for (auto _ : state) {
    const Renderer renderer(camera, 1);
    renderer.frame({}, {.duration_s = camera.exposure_s}, {}, image);
    benchmark::DoNotOptimize(image.pixels().data());
  }
}
BENCHMARK(new_detector)->Unit(benchmark::kMillisecond);

}  // namespace
}  // namespace astronav::render

BENCHMARK_MAIN();
