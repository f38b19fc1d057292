// SPDX-License-Identifier: Apache-2.0
#include <cmath>

#include <fmt/format.h>

#include "verification/scenario/keys.h"

namespace astronav::scenario {

namespace {

std::string range_text(const Key& key) {
  if (!key.choices.empty()) return std::string(key.choices);
  if (!key.is_number()) return "";
  const auto end = [](double v) { return fmt::format("{}", v); };
  if (std::isinf(key.min) && std::isinf(key.max)) return "any";
  if (std::isinf(key.max)) return "from " + end(key.min);
  return end(key.min) + " to " + end(key.max);
}

const char* section_title(std::string_view section) {
  struct Title {
    std::string_view section;
    const char* text;
  };
  static constexpr Title kTitles[] = {
      {"mission", "what is flown"},
      {"data", "ephemeris and star catalogue"},
      {"conops", "when the camera looks where"},
      {"truth.camera", "the camera as it really is"},
      {"truth.dynamics", "the forces that really act"},
      {"truth.thrust", "how the engine really works"},
      {"truth.unloading", "kicks by thrusters"},
      {"truth.clock", "the onboard clock"},
      {"truth.pointing", "how well the spacecraft points and knows the Sun"},
      {"truth.gyro", "the gyro, and what is wrong with it"},
      {"truth.photocentre", "where the light of a planet really comes from"},
      {"onboard.start", "what is known at the beginning"},
      {"onboard.beacons", "which planets are tracked"},
      {"onboard.camera", "the camera as the onboard software believes it to be"},
      {"onboard.filter", "the navigation filter"},
      {"onboard.ephemeris", "how wrong the planets' places may be"},
      {"onboard.gyro", "the gyro as the attitude filter believes it to be"},
      {"onboard.vision", "the image processing"},
      {"mil", "sights without images (`--level mil`)"},
      {"sky", "what is drawn"},
  };
  for (const Title& title : kTitles) {
    if (title.section == section) return title.text;
  }
  return "";
}

}  // namespace

std::string schema_text() {
  const Scenario defaults;
  std::string out =
      "Keys of a scenario. Any number may be a distribution:\n"
      "  { gaussian = { mean = 0.0, sigma = 1.0 } }  or  { uniform = { min = 0.0, max = 1.0 } }\n";
  std::string_view section;
  for (const Key& key : keys()) {
    if (section_of(key.name) != section) {
      section = section_of(key.name);
      out += fmt::format("\n[{}]  {}\n", section, section_title(section));
    }
    const std::string range = range_text(key);
    out += fmt::format("  {} = {}{}{}\n", leaf_of(key.name), value_text(key, defaults), key.unit.empty() ? "" : "  # ",
                       key.unit);
    out += fmt::format("      {}{}\n", key.meaning, range.empty() ? "" : fmt::format(" ({})", range));
  }
  return out;
}

std::string schema_markdown() {
  const Scenario defaults;
  std::string out =
      "# Scenario\n\n"
      "A scenario is a TOML file with everything that one mission is flown with. This page is written by\n"
      "`astronav run --schema=markdown` from the table that also holds the parser and the defaults; a test keeps it "
      "true.\n\n"
      "- Every key has a default: an empty section, or none, is fine. An unknown key is an error that names its line "
      "and the\n"
      "  nearest known key.\n"
      "- Any number may be a distribution, drawn once for each sample from the run's seed:\n"
      "  `{ gaussian = { mean = 0.0, sigma = 1.0 } }` or `{ uniform = { min = 0.0, max = 1.0 } }`.\n"
      "- `--set key=value` on the command line overrides any key: `--set conops.cycle_days=5`.\n"
      "- Truth and onboard belief are separate sections, and may differ on purpose.\n"
      "- `scenario.resolved.toml`, beside each run's results, holds every value used, and `[run]` with `version`, "
      "`level`, `seed`\n"
      "  and `sample`: flying that file repeats the run.\n";
  std::string_view section;
  for (const Key& key : keys()) {
    if (section_of(key.name) != section) {
      section = section_of(key.name);
      out +=
          fmt::format("\n## [{}]: {}\n\n| key | unit | default | range | meaning |\n| --- | --- | --- | --- | --- |\n",
                      section, section_title(section));
    }
    out += fmt::format("| `{}` | {} | `{}` | {} | {} |\n", leaf_of(key.name), key.unit, value_text(key, defaults),
                       range_text(key), key.meaning);
  }
  return out;
}

}  // namespace astronav::scenario
