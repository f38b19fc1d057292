// SPDX-License-Identifier: Apache-2.0
// Starts from nothing, spread over the dates of an Earth-Mars transfer (cold_start_flight.h): how many, how right, and
// from which cycle on as good as with a prior.
//
//   cold_start_accuracy [STARTS]     default 240, for each of two levels of noise
#include <cstdlib>

#include <fmt/format.h>

#include "benchmarks/accuracy/arguments.h"
#include "benchmarks/accuracy/cold_start_flight.h"
#include "foundation/files/mapped_file.h"
#include "simulator/transfer/ballistic.h"

namespace {

using namespace astronav;

void report(const char* name, const cold_start::Pool& pool) {
  const auto line = [&](const char* what, double value, const char* unit) {
    fmt::print("{{\"name\":\"{}.{}\",\"value\":{:.4g},\"unit\":\"{}\"}}\n", name, what, value, unit);
  };
  line("starts", pool.starts, "");
  line("started", pool.started, "");
  line("confidently_wrong", pool.wrong, "");
  line("survey_error_mean", pool.survey_error_km, "km");
  line("survey_nees_of_3", pool.survey_nees, "");
  for (int cycle = 0; cycle < cold_start::kCycles; ++cycle) {
    for (const bool cold : {true, false}) {
      const auto& a = (cold ? pool.cold : pool.primed)[static_cast<std::size_t>(cycle)];
      const auto key = [&](const char* what) {
        return fmt::format("cycle_{}.{}.{}", cycle + 1, cold ? "from_nothing" : "with_prior", what);
      };
      line(key("position_3sigma").c_str(), a.position_km, "km");
      line(key("position_3sigma_formal").c_str(), a.formal_position_km, "km");
      line(key("velocity_3sigma").c_str(), a.velocity_m_s, "m/s");
      line(key("velocity_3sigma_formal").c_str(), a.formal_velocity, "m/s");
      line(key("nees_of_6").c_str(), a.nees, "");
    }
  }
}

}  // namespace

int main(int argc, char** argv) {
  const int starts = astronav::accuracy::count_of(argc, argv, 1, "starts", 240);
  const auto file = MappedFile::open(home_directory() / "data/de405_2000_2050.bsp");
  if (!file) return 2;
  const auto ephemeris = Ephemeris::open(file->bytes());
  if (!ephemeris) return 2;
  const auto design =
      transfer::design_ballistic(*ephemeris, body::earth, body::mars_barycenter,
                                 Epoch::parse("2026-11-09T00:00:00 TDB").value(), Duration::days(300.0));
  if (!design) return 1;
  const struct {
    const char* name;
    cold_start::Level level;
  } levels[] = {{"white_0.07_arcsec", {0.07 * kArcsecond, 0.0}},
                {"white_0.4_bias_0.3_arcsec", {0.4 * kArcsecond, 0.3 * kArcsecond}}};
  for (const auto& [name, level] : levels) {
    cold_start::Pool pool;
    // From day 10 on until a flight still ends before the arrival.
    const double last_day = (design->end - design->begin).days() - cold_start::kFlightDays - 1.0;
    for (int i = 0; i < starts; ++i) {
      const Epoch epoch = design->begin + Duration::days(7.0 + (last_day - 7.0) * i / std::max(1, starts - 1));
      pool.add(
          cold_start::Flight(*ephemeris, epoch, design->arc.at(epoch).value(), level, static_cast<std::uint64_t>(i))
              .run());
    }
    pool.finish();
    report(name, pool);
  }
}
