// SPDX-License-Identifier: Apache-2.0
#include "validation/webgeocalc.h"

#include <fstream>
#include <map>

#include <gtest/gtest.h>

namespace astronav::testing {
namespace {

std::vector<std::string> fields(const std::string& line) {
  std::vector<std::string> out(1);
  bool quoted = false;
  for (const char c : line) {
    if (c == '"')
      quoted = !quoted;
    else if (c == ',' && !quoted)
      out.emplace_back();
    else if (c != '\r')
      out.back() += c;
  }
  return out;
}

WebgeocalcCorrection stated_correction(std::map<std::string, std::string>& inputs) {
  if (inputs["Light propagation"] == "No correction") return kNone;
  EXPECT_EQ(inputs["Light propagation"], "To observer");
  EXPECT_EQ(inputs["Light-time algorithm"], "Newtonian");
  return inputs["Stellar aberration"].empty() ? kLt : kLtS;
}

}  // namespace

std::vector<WebgeocalcRow> read_webgeocalc(const std::filesystem::path& path, const WebgeocalcTable& table) {
  std::ifstream file(path);
  std::map<std::string, std::string> inputs;
  std::vector<WebgeocalcRow> rows;
  for (std::string line; std::getline(file, line);) {
    const auto f = fields(line);
    if (f.size() == 2) inputs[f[0]] = f[1];
    if (f.size() != 11 || f[0] == "TDB calendar date") continue;
    WebgeocalcRow row;
    const auto epoch = Epoch::parse(f[0]);
    EXPECT_TRUE(epoch) << f[0];
    row.epoch = epoch.value_or(Epoch());
    row.state.p_m = 1e3 * Vec3(std::stod(f[3]), std::stod(f[4]), std::stod(f[5]));
    row.state.v_m_s = 1e3 * Vec3(std::stod(f[6]), std::stod(f[7]), std::stod(f[8]));
    row.light_time_s = std::stod(f[10]);
    rows.push_back(row);
  }
  EXPECT_EQ(parse_body(inputs["Target"]).value_or(BodyId{-1}), table.target) << path;
  EXPECT_EQ(parse_body(inputs["Observer"]).value_or(BodyId{-1}), table.observer) << path;
  EXPECT_EQ(inputs["Reference frame"], "J2000") << path;
  EXPECT_EQ(inputs["Time system"], "TDB") << path;
  EXPECT_EQ(stated_correction(inputs), table.correction) << path;
  EXPECT_GE(rows.size(), 36U) << path;
  return rows;
}

}  // namespace astronav::testing
