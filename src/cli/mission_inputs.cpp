// SPDX-License-Identifier: Apache-2.0
#include "cli/mission_inputs.h"

namespace astronav::cli {

Result<loop::Level> parse_level(std::string_view text) {
  if (text == "cov") return loop::Level::cov;
  if (text == "mil") return loop::Level::mil;
  if (text == "sil") return loop::Level::sil;
  if (text == "pil" || text == "hil") {
    return fail(ErrorCode::unsupported, "level {s} is not there yet: cov, mil and sil are", {}, "--level", text);
  }
  return fail(ErrorCode::invalid_argument, "\"{s}\" is not a level: cov, mil or sil", {}, "--level", text);
}

Result<scenario::Draft> read_draft(const std::string& scenario, const std::vector<std::string>& assignments) {
  auto draft = scenario::Draft::read(scenario);
  if (!draft) return draft;
  for (const std::string& assignment : assignments) {
    if (auto ok = draft->set(assignment); !ok) return forward(ok);
  }
  return draft;
}

std::string folder_name(std::string_view mission) {
  std::string out;
  for (const char c : mission) {
    const bool plain =
        (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') || c == '-' || c == '_' || c == '.';
    out += plain ? c : '-';
  }
  return out.empty() || out.front() == '.' ? "mission" : out;
}

}  // namespace astronav::cli
