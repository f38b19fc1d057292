// SPDX-License-Identifier: Apache-2.0
// The ephemeris that ships with the project, opened once.
#pragma once

#include "foundation/files/mapped_file.h"
#include "models/ephemeris/ephemeris.h"

namespace astronav::testing {

inline const Ephemeris& shipped_ephemeris() {
  static const Result<MappedFile> file = MappedFile::open(home_directory() / "data/de405_2000_2050.bsp");
  static const Result<Ephemeris> ephemeris = Ephemeris::open(file.value().bytes());
  return ephemeris.value();
}

}  // namespace astronav::testing
