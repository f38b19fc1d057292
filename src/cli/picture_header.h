// SPDX-License-Identifier: Apache-2.0
// What the header of a FITS picture says of when and from where it was taken.
#pragma once

#include <optional>
#include <string>

#include "foundation/base/error.h"
#include "foundation/raster/raster.h"
#include "foundation/time/epoch.h"
#include "models/ephemeris/ephemeris.h"

namespace astronav::cli {

std::optional<double> header_number(const Picture& picture, const std::string& key);
// The middle of the exposure: SPCSCET (New Horizons: seconds past J2000 TDB), DATE-AVG or DATE-OBS.
std::optional<Epoch> header_epoch(const Picture& picture);
// Barycentric, from New Horizons' way to the Sun. Nothing where the header does not say.
Result<std::optional<State>> header_observer(const Picture& picture, const Ephemeris& ephemeris, Epoch epoch);

}  // namespace astronav::cli
