// SPDX-License-Identifier: Apache-2.0
// The project's own catalogue as the tests of this folder use it: opened once, with a star field and a pair index.
#pragma once

#include <gtest/gtest.h>

#include <vector>

#include "foundation/files/mapped_file.h"
#include "onboard/vision/pair_index.h"
#include "onboard/vision/star_field.h"

namespace astronav::vision::testing {

struct Sky {
  MappedFile file;
  StarField field;
  std::vector<std::byte> bytes;
  PairIndex index;
};

// For a 20-degree camera.
inline const Sky& sky() {
  static const Sky instance = [] {
    Sky s;
    auto file = MappedFile::open(home_directory() / "data/hipparcos.stars");
    if (!file) ADD_FAILURE() << describe(file.error());
    s.file = std::move(*file);
    const auto catalogue = StarCatalogue::open(s.file.bytes());
    if (!catalogue) ADD_FAILURE() << describe(catalogue.error());
    s.field = StarField::build(*catalogue, 9.0, Epoch::tdb_seconds(26.9 * 365.25 * 86400.0));
    s.bytes = build_pair_index(s.field, AsterismSettings::for_field(20.0 * kDegree, 20.0 * kDegree));
    s.index = *PairIndex::open(s.bytes);
    return s;
  }();
  return instance;
}

}  // namespace astronav::vision::testing
