// SPDX-License-Identifier: Apache-2.0
// Checks of single options, said in words.
#pragma once

#include <CLI/CLI.hpp>

namespace astronav::cli {

// A number between two limits, both included; "nan" is none (CLI::Range lets it pass).
CLI::Validator number_within(double min, double max);

// A seed: a whole number from 0 to 2^63 - 1, what TOML can hold, so that a scenario can name it.
CLI::Validator seed_number();

}  // namespace astronav::cli
