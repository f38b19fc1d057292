// SPDX-License-Identifier: Apache-2.0
// The short form of the fuzzing: everything that the fuzzer has found worth keeping is read again, and changed at
// random for a few seconds. A crash, a failed check or a hang is the failure.
#include <algorithm>
#include <chrono>
#include <filesystem>
#include <vector>

#include <gtest/gtest.h>

#include "foundation/math/random.h"
#include "fuzz/messages.h"
#include "support/program.h"

namespace astronav {
namespace {

using Input = std::vector<std::uint8_t>;

std::vector<Input> corpus() {
  std::vector<std::filesystem::path> files;
  for (const auto& entry : std::filesystem::directory_iterator(ASTRONAV_FUZZ_CORPUS)) files.push_back(entry.path());
  std::sort(files.begin(), files.end());
  std::vector<Input> out;
  for (const auto& file : files) {
    const std::string bytes = testing::read_text(file);
    out.emplace_back(bytes.begin(), bytes.end());
  }
  return out;
}

Input changed(const Input& from, const Input& other, RandomStream& random) {
  Input out = from;
  const auto below = [&](std::size_t n) { return n == 0 ? 0 : static_cast<std::size_t>(random.next() % n); };
  for (std::size_t changes = 1 + below(4); changes > 0; --changes) {
    const std::size_t at = below(out.size());
    switch (below(6)) {
      case 0:
        if (!out.empty()) out[at] = static_cast<std::uint8_t>(random.next());
        break;
      case 1:
        if (!out.empty()) out[at] ^= static_cast<std::uint8_t>(1u << below(8));
        break;
      case 2:
        out.insert(out.begin() + static_cast<std::ptrdiff_t>(at), static_cast<std::uint8_t>(random.next()));
        break;
      case 3:
        if (!out.empty())
          out.erase(out.begin() + static_cast<std::ptrdiff_t>(at),
                    out.begin() + static_cast<std::ptrdiff_t>(at + 1 + below(out.size() - at)));
        break;
      case 4: {  // a piece of another one
        const std::size_t begin = below(other.size()), length = below(other.size() - begin);
        out.insert(out.begin() + static_cast<std::ptrdiff_t>(at), other.begin() + static_cast<std::ptrdiff_t>(begin),
                   other.begin() + static_cast<std::ptrdiff_t>(begin + length));
        break;
      }
      default:  // a piece twice
        if (!out.empty()) {
          const Input piece(out.begin() + static_cast<std::ptrdiff_t>(at),
                            out.begin() + static_cast<std::ptrdiff_t>(at + below(out.size() - at)));
          out.insert(out.end(), piece.begin(), piece.end());
        }
    }
  }
  if (out.size() > 20000) out.resize(20000);
  return out;
}

TEST(MessageFuzz, CorpusIsReadAgain) {
  const auto all = corpus();
  ASSERT_GT(all.size(), 20u);
  for (const Input& input : all) fuzz::read_messages(input);
}

TEST(MessageFuzz, CorpusChangedAtRandomIsRead) {
  const auto all = corpus();
  ASSERT_FALSE(all.empty());
  RandomStream random({.seed = 1, .purpose = "message fuzz"});
  std::size_t inputs = 0;
  for (const auto begin = std::chrono::steady_clock::now();
       std::chrono::steady_clock::now() - begin < std::chrono::seconds(3); ++inputs) {
    fuzz::read_messages(changed(all[random.next() % all.size()], all[random.next() % all.size()], random));
  }
  RecordProperty("inputs", static_cast<int>(inputs));
  EXPECT_GT(inputs, 100u);
}

}  // namespace
}  // namespace astronav
