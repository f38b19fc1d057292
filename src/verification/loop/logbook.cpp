// SPDX-License-Identifier: Apache-2.0
#include "verification/loop/logbook.h"

#include <utility>

#include <sys/resource.h>

namespace astronav::loop {
namespace {

double peak_memory_mb() {
  struct rusage usage {};
  getrusage(RUSAGE_SELF, &usage);
  return static_cast<double>(usage.ru_maxrss) / 1024.0;
}

const char* name(Level level) {
  switch (level) {
    case Level::cov:
      return "cov";
    case Level::mil:
      return "mil";
    case Level::sil:
      return "sil";
  }
  return "";
}

}  // namespace

BeaconChoice beacon_choice(int cycle, Epoch epoch, const navigation::BeaconSelection& selection, BodyId first,
                           BodyId second) {
  BeaconChoice choice;
  choice.cycle = cycle;
  choice.epoch = epoch;
  choice.first = first;
  choice.second = second;
  if (selection.pair_count > 0) choice.figure_of_merit_km = selection.pairs()[0].figure_of_merit_m * 1e-3;
  for (const navigation::BeaconCandidate& c : selection.candidates()) {
    choice.candidates.push_back({.body = c.body,
                                 .v_mag = c.v_magnitude,
                                 .sun_elongation_deg = c.sun_elongation_rad / kDegree,
                                 .distance_km = c.distance_m * 1e-3,
                                 .visible = c.usable(),
                                 .why_not = c.usable() ? "" : navigation::name(c.verdict)});
  }
  return choice;
}

void record_orbits(const Ephemeris& ephemeris, Records& records) {
  for (int planet = 1; planet <= 8; ++planet) {
    for (int i = 0; i <= 150; ++i) {
      const Epoch t = records.begin + Duration::seconds((records.end - records.begin).seconds() * i / 150.0);
      const auto place = ephemeris.state(BodyId{planet}, body::sun, t);
      if (place) records.planet_tracks_m[planet].push_back(place->p_m);
    }
  }
}

void sign(const scenario::Scenario& scenario, const FlyOptions& options, Records& records) {
  records.level = name(options.level);
  records.seed = options.seed;
  records.sample = options.sample;
  records.version = ASTRONAV_VERSION;
  records.scenario_toml = scenario::to_toml(
      scenario, {.version = records.version, .level = records.level, .seed = options.seed, .sample = options.sample});
  records.peak_memory_mb = peak_memory_mb();
}

}  // namespace astronav::loop
