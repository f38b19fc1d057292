// SPDX-License-Identifier: Apache-2.0
#include "foundation/base/nearest_word.h"

#include <array>
#include <string>
#include <vector>

#include <gtest/gtest.h>

namespace astronav {
namespace {

TEST(NearestWord, DistancesFromTextbooks) {
  EXPECT_EQ(edit_distance("kitten", "sitting"), 3u);
  EXPECT_EQ(edit_distance("saturday", "sunday"), 3u);
  EXPECT_EQ(edit_distance("flaw", "lawn"), 2u);
  EXPECT_EQ(edit_distance("", "mars"), 4u);
  EXPECT_EQ(edit_distance("mars", ""), 4u);
  EXPECT_EQ(edit_distance("mars", "mars"), 0u);
}

TEST(NearestWord, LongWordsCountByTheirBeginning) {
  EXPECT_EQ(edit_distance(std::string(1'000'000, 'x'), "x"), kLongestWord - 1);
  EXPECT_EQ(edit_distance(std::string(1'000'000, 'x'), std::string(1'000'000, 'y')), kLongestWord);
}

TEST(NearestWord, TheFirstOfTheNearestIsTaken) {
  const std::vector<std::string> words{"venus", "mars", "marz", "earth"};
  EXPECT_EQ(*nearest_word("marx", words), "mars");
  EXPECT_EQ(*nearest_word("eart", words), "earth");
  const std::vector<std::string> none;
  EXPECT_EQ(nearest_word("x", none), none.end());
}

TEST(NearestWord, WordsAreTakenOutOfItems) {
  struct Item {
    int number;
    std::string_view word;
  };
  const std::array<Item, 2> items{{{1, "width"}, {2, "height"}}};
  EXPECT_EQ(nearest_word("heigth", items, [](const Item& item) { return item.word; })->number, 2);
}

}  // namespace
}  // namespace astronav
