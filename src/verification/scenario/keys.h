// SPDX-License-Identifier: Apache-2.0
// The one table of a scenario's keys. A key's name is the path of its field in Scenario, its default that field's
// initialiser, so that a new key is a field in scenario.h and a row in keys.cpp.
#pragma once

#include <limits>
#include <span>
#include <string>
#include <string_view>
#include <variant>
#include <vector>

#include "verification/scenario/scenario.h"

namespace astronav::scenario {

using Member =
    std::variant<double* (*)(Scenario&), int* (*)(Scenario&), bool* (*)(Scenario&), std::string* (*)(Scenario&),
                 std::vector<std::string>* (*)(Scenario&), Epoch* (*)(Scenario&)>;

struct Key {
  std::string_view name;     // "conops.tracking_min"
  std::string_view unit;     // "min"; empty for what has none
  std::string_view meaning;  // one sentence
  Member member;
  double min = -std::numeric_limits<double>::infinity();  // of a number, both ends allowed
  double max = std::numeric_limits<double>::infinity();
  std::string_view choices = {};  // of a text: "moment psf_fit"
  bool is_path = false;           // of a text: a file, looked for beside the scenario first

  bool is_number() const { return member.index() <= 1; }
};

std::span<const Key> keys();
const Key* find_key(std::string_view name);
// The known name with the smallest edit distance.
std::string_view nearest_key(std::string_view name);

// "conops" of "conops.tracking_min", "truth.camera" of "truth.camera.file", and the rest.
std::string_view section_of(std::string_view key);
std::string_view leaf_of(std::string_view key);

// The value of a key as TOML text ("60.0", "true", "\"mars\"").
std::string value_text(const Key& key, const Scenario& scenario);

}  // namespace astronav::scenario
