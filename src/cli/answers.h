// SPDX-License-Identifier: Apache-2.0
// How several commands say the same things.
#pragma once

#include <cmath>
#include <string>

#include <nlohmann/json.hpp>

#include "foundation/math/linear.h"
#include "foundation/time/epoch.h"
#include "models/ephemeris/bodies.h"

namespace astronav::cli {

// The body's name, or its NAIF number where it has none.
inline std::string title(BodyId id) {
  const std::string_view known = body_name(id);
  return known.empty() ? std::to_string(id.value) : std::string(known);
}

// To a whole number of steps of 1/steps_per_unit.
inline double rounded(double x, double steps_per_unit) {
  return std::round(x * steps_per_unit) / steps_per_unit;
}

inline std::string tdb(Epoch epoch) {
  return epoch.iso(TimeScale::tdb, 3, false);
}

// A file that was written, or null where none was asked for.
inline nlohmann::ordered_json path_or_null(const std::string& path) {
  return path.empty() ? nlohmann::ordered_json(nullptr) : nlohmann::ordered_json(path);
}

// {x, y, z}, in the unit that is `unit` in SI: xyz(p_m, 1e3) gives km.
inline nlohmann::ordered_json xyz(const Vec3& v, double unit) {
  return {{"x", v.x() / unit}, {"y", v.y() / unit}, {"z", v.z() / unit}};
}

}  // namespace astronav::cli
