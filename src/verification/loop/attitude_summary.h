// SPDX-License-Identifier: Apache-2.0
// The attitude filter's part of a summary. Internal to this folder.
#pragma once

#include <span>
#include <string>

#include <nlohmann/json_fwd.hpp>

#include "verification/loop/summary.h"

namespace astronav::loop {

AttitudeFilterSummary summarize_attitude_filter(const Records& records);
AttitudeFilterSummary pool_attitude_filter(std::span<const Summary> runs);
nlohmann::ordered_json attitude_filter_json(const AttitudeFilterSummary& summary);
AttitudeFilterSummary attitude_filter_from(const nlohmann::ordered_json& json);
// One line for a person; empty without a gyro.
std::string attitude_filter_in_words(const AttitudeFilterSummary& summary);

}  // namespace astronav::loop
