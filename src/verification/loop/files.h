// SPDX-License-Identifier: Apache-2.0
// The files that a run leaves behind (docs/interfaces.md, "Files of run"), all but the report.
#pragma once

#include <filesystem>
#include <string>

#include "foundation/base/error.h"
#include "models/oem/oem.h"
#include "verification/loop/records.h"
#include "verification/loop/summary.h"

namespace astronav::loop {

// Makes the folder where it is not there, and writes summary.json, estimate.oem, truth.oem, records.csv and
// scenario.resolved.toml into it; smoothed.oem where there is something of it.
Result<void> write_files(const std::filesystem::path& folder, const Records& records, const Summary& summary);

// One row per event; errors in km and m/s, one column per number, the first row names them with their units.
std::string records_csv(const Records& records);
// One state per epoch (the last event of each), barycentric, TDB. The estimate carries covariance where a window or a
// coast ends and along the coasts, not for each image.
Oem estimate_oem(const Records& records);
Oem truth_oem(const Records& records);

std::string_view name(EventKind kind);  // "image", "cycle_end", ...

}  // namespace astronav::loop
