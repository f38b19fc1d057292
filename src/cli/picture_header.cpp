// SPDX-License-Identifier: Apache-2.0
#include "cli/picture_header.h"

#include "cli/inputs.h"

namespace astronav::cli {

std::optional<double> header_number(const Picture& picture, const std::string& key) {
  const auto at = picture.header.find(key);
  if (at == picture.header.end()) return {};
  const auto numbers = parse_numbers(at->second, 1, 1, key);
  return numbers ? std::optional(numbers->front()) : std::nullopt;
}

std::optional<Epoch> header_epoch(const Picture& picture) {
  if (const auto tdb = header_number(picture, "SPCSCET")) return Epoch::tdb_seconds(*tdb);
  for (const char* key : {"DATE-AVG", "DATE-OBS"}) {
    const auto at = picture.header.find(key);
    if (at == picture.header.end()) continue;
    const auto epoch = Epoch::parse(at->second);
    if (epoch) return *epoch;
  }
  return {};
}

Result<std::optional<State>> header_observer(const Picture& picture, const Ephemeris& ephemeris, Epoch epoch) {
  Vec3 p, v;
  for (int axis = 0; axis < 3; ++axis) {
    const std::string letter(1, static_cast<char>('X' + axis));
    const auto to_sun = header_number(picture, "SPCSSC" + letter), rate = header_number(picture, "SPCSSCV" + letter);
    if (!to_sun || !rate) return std::optional<State>{};
    p[axis] = -1e3 * *to_sun;
    v[axis] = -1e3 * *rate;
  }
  auto sun = ephemeris.state(body::sun, body::solar_system_barycenter, epoch);
  if (!sun) return forward(sun);
  sun->p_m += p;
  sun->v_m_s += v;
  return std::optional<State>(*sun);
}

}  // namespace astronav::cli
