// SPDX-License-Identifier: Apache-2.0
// Cone search over the shipped catalogue: the circle around a square field of 20 degrees, to V 7.
#include <array>
#include <vector>

#include <benchmark/benchmark.h>

#include "foundation/files/mapped_file.h"
#include "foundation/math/random.h"
#include "models/stars/catalogue.h"

namespace {

using namespace astronav;

std::vector<Vec3> random_centers() {
  RandomStream random(StreamId{.seed = 1, .purpose = "cone search benchmark"});
  std::vector<Vec3> centers(1024);
  for (Vec3& center : centers) center = Vec3(random.normal(), random.normal(), random.normal()).normalized();
  return centers;
}

// Arguments: radius in tenths of a degree, faintest V in tenths of a magnitude.
void cone(benchmark::State& state) {
  const auto file = MappedFile::open(home_directory() / "data/hipparcos.stars").value();
  const auto catalogue = StarCatalogue::open(file.bytes()).value();
  const auto centers = random_centers();
  const double radius = static_cast<double>(state.range(0)) * 0.1 * kDegree;
  const double max_v = static_cast<double>(state.range(1)) * 0.1;
  std::array<std::uint32_t, 20000> out;
  std::size_t found = 0;
  std::size_t k = 0;
  for (auto _ : state) found += catalogue.cone(centers[k++ % centers.size()], radius, max_v, out);
  state.counters["stars"] = benchmark::Counter(static_cast<double>(found), benchmark::Counter::kAvgIterations);
}
BENCHMARK(cone)->Args({141, 70})->Args({71, 70})->Args({28, 90})->Args({141, 90});

void open_catalogue(benchmark::State& state) {
  const auto file = MappedFile::open(home_directory() / "data/hipparcos.stars").value();
  for (auto _ : state) benchmark::DoNotOptimize(StarCatalogue::open(file.bytes()));
}
BENCHMARK(open_catalogue)->Unit(benchmark::kMillisecond);

}  // namespace

BENCHMARK_MAIN();
