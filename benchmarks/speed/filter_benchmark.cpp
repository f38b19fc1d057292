// SPDX-License-Identifier: Apache-2.0
// The filter on one core: ten days of coast, a hundred seconds within a window, one update, one beacon selection.
#include <benchmark/benchmark.h>

#include "foundation/files/mapped_file.h"
#include "foundation/math/rotation.h"
#include "onboard/navigation/beacons.h"
#include "onboard/navigation/filter.h"

namespace astronav::navigation {
namespace {

struct Flight {
  MappedFile file = MappedFile::open(home_directory() / "data/de405_2000_2050.bsp").value();
  Ephemeris ephemeris = Ephemeris::open(file.bytes()).value();
  Epoch epoch = Epoch::parse("2027-03-01T00:00:00 TDB").value();
  State state = [this] {
    // Between Earth and Mars, at about the speed of a transfer.
    const State earth = ephemeris.state(body::earth, body::solar_system_barycenter, epoch).value();
    return State{1.2 * earth.p_m, 0.95 * earth.v_m_s};
  }();

  Filter filter() const {
    FilterSettings settings;  // every state in use
    settings.process.solar_pressure.sigma = 0.05;
    const BodyId bodies[] = {body::mercury, body::venus,  body::earth,  body::mars,
                             body::jupiter, body::saturn, body::uranus, body::moon};
    for (std::size_t i = 0; i < settings.beacon_errors.size(); ++i) {
      settings.beacon_errors[i] = {
          .body = bodies[i], .ephemeris_m = 1e3, .photocentre_fraction = 0.07, .lasting_ephemeris_m = 1e5};
    }
    settings.camera = Intrinsics::from_field_of_view(1024, 1024, 20.0 * kDegree);
    Filter out(settings, ephemeris);
    Mat6 P = Mat6::Zero();
    P.diagonal() << Vec3::Constant(1e12), Vec3::Constant(1.0);
    if (!out.initialise({epoch, state, P})) std::abort();
    return out;
  }
  BeaconMeasurement look(const Filter& from, BodyId body) const {
    BeaconMeasurement m;
    m.body = body;
    m.mid_exposure = from.epoch();
    m.pixel = {511.5, 511.5};
    m.pixel_covariance_px2 = 0.0025 * Mat2::Identity();
    const RaDec at = radec_from_direction(from.predict_direction(body)->direction_N);
    m.R_CN = R_CN_from_pointing({at.ra_rad, at.dec_rad, 0.0});
    m.attitude_covariance_rad2 = 1e-11 * Mat3::Identity();
    return m;
  }
};

void propagate_10_days(benchmark::State& state) {
  const Flight flight;
  const Filter start = flight.filter();
  for (auto _ : state) {
    Filter filter = start;
    benchmark::DoNotOptimize(filter.propagate_to(flight.epoch + Duration::days(10.0)));
  }
}
BENCHMARK(propagate_10_days)->Unit(benchmark::kMillisecond);

void propagate_100_seconds(benchmark::State& state) {
  const Flight flight;
  Filter filter = flight.filter();
  for (auto _ : state) benchmark::DoNotOptimize(filter.propagate_to(filter.epoch() + Duration::seconds(100.0)));
}
BENCHMARK(propagate_100_seconds)->Unit(benchmark::kMicrosecond)->Iterations(20000);

void update(benchmark::State& state) {
  const Flight flight;
  Filter filter = flight.filter();
  const BeaconMeasurement m = flight.look(filter, body::mars);
  for (auto _ : state) benchmark::DoNotOptimize(filter.update(m));
}
BENCHMARK(update)->Unit(benchmark::kMicrosecond);

void beacon_selection(benchmark::State& state) {
  const Flight flight;
  for (auto _ : state) benchmark::DoNotOptimize(select_beacons(flight.ephemeris, flight.state, flight.epoch, {}));
}
BENCHMARK(beacon_selection)->Unit(benchmark::kMicrosecond);

}  // namespace
}  // namespace astronav::navigation

BENCHMARK_MAIN();
