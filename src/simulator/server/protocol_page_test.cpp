// SPDX-License-Identifier: Apache-2.0
// The examples of docs/protocol.md, from the first to the last, in one session with a real server: what the page says a
// client sends is sent, and what comes back has the fields, the kinds of values and the words that the page shows.
#include <string>
#include <vector>

#include <gtest/gtest.h>
#include <nlohmann/json.hpp>

#include "simulator/server/server_for_tests.h"
#include "support/program.h"

namespace astronav::server {
namespace {

using nlohmann::json;

struct Example {
  bool from_client = false;
  std::string type;
  json said;
  int line = 0;
};

std::vector<Example> examples() {
  std::vector<Example> out;
  std::string body;
  bool inside = false;
  int number = 0;
  for (const std::string& line : testing::lines_of(testing::read_text(home_directory() / "docs/protocol.md"))) {
    ++number;
    if (line.starts_with("```json ")) {
      const auto words = testing::words(line);
      out.push_back({words.at(1) == "client", words.at(2), {}, number});
      body.clear();
      inside = true;
    } else if (inside && line == "```") {
      out.back().said = json::parse(body, nullptr, false);
      EXPECT_FALSE(out.back().said.is_discarded()) << "line " << out.back().line << " is no JSON";
      inside = false;
    } else if (inside) {
      body += line + "\n";
    }
  }
  return out;
}

std::uint16_t number_of(const std::string& type) {
  for (int i = 0; i < 200; ++i) {
    if (name(static_cast<MessageType>(i)) == type) return static_cast<std::uint16_t>(i);
  }
  ADD_FAILURE() << "no message is called " << type;
  return 0;
}

// Fields are the same, values of the same kind; texts that are words of the protocol are the same.
void compare(const json& page, const json& real, const std::string& where) {
  const bool both_numbers = page.is_number() && real.is_number();
  EXPECT_TRUE(both_numbers || page.type() == real.type()) << where << ": " << page << " and " << real;
  if (page.type() != real.type()) return;
  if (page.is_object()) {
    for (const auto& [key, value] : page.items()) {
      EXPECT_TRUE(real.contains(key)) << where << "." << key << " is on the page alone";
      if (real.contains(key)) compare(value, real[key], where + "." + key);
    }
    for (const auto& [key, value] : real.items()) {
      EXPECT_TRUE(page.contains(key)) << where << "." << key << " is not on the page";
    }
  } else if (page.is_array()) {
    ASSERT_FALSE(real.empty()) << where;
    compare(page[0], real[0], where + "[0]");
  } else if (page.is_string() && !where.ends_with(".server") && !where.ends_with("[0]")) {
    EXPECT_EQ(page, real) << where;
  } else if (where.ends_with(".id") || where.ends_with(".index") || where.ends_with(".frames") ||
             where.find(".limits") != std::string::npos || where.find(".effects") != std::string::npos) {
    EXPECT_EQ(page, real) << where;
  }
}

TEST(ProtocolPage, ExamplesArePlayed) {
  const auto all = examples();
  ASSERT_GT(all.size(), 15u);
  const RunningServer server;
  auto wire = Client::open("127.0.0.1", server.port(), {});
  ASSERT_TRUE(wire);
  std::vector<bool> seen(200);
  for (const Example& example : all) {
    SCOPED_TRACE("docs/protocol.md:" + std::to_string(example.line));
    const std::uint16_t type = number_of(example.type);
    seen.at(type) = true;
    if (example.from_client) {
      ASSERT_TRUE(wire->send_raw(type, example.said.dump()));
      continue;
    }
    const auto answer = wire->receive_raw();
    ASSERT_TRUE(answer) << describe(answer.error());
    EXPECT_EQ(answer->type, type) << answer->json;
    const json said = json::parse(answer->json);
    compare(example.said, said, example.type);
    if (example.type == "frame") {
      const bool picture = said["format"] == "dn";
      EXPECT_EQ(answer->binary.size(), picture ? 2u * 1024 * 1024 : 0u);
    }
  }
  for (const MessageType type : {MessageType::hello, MessageType::set, MessageType::render, MessageType::trajectory,
                                 MessageType::cancel, MessageType::ping, MessageType::stimulation}) {
    EXPECT_TRUE(seen[static_cast<std::size_t>(type)]) << "no example of " << name(type);
  }
}

}  // namespace
}  // namespace astronav::server
