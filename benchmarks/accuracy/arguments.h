// SPDX-License-Identifier: Apache-2.0
// How often, as the first argument of a program in this folder.
#pragma once

#include <cstdio>
#include <cstdlib>

namespace astronav::accuracy {

// argv[at] as a number above 0, or what is usual where there is none. What is no such number ends the program with a
// line that says what would be right.
inline int count_of(int argc, char** argv, int at, const char* what, int usual) {
  if (argc <= at) return usual;
  char* end = nullptr;
  const long n = std::strtol(argv[at], &end, 10);
  if (end != argv[at] && *end == '\0' && n > 0 && n <= 10'000'000) return static_cast<int>(n);
  std::fprintf(stderr, "%s: '%s' is no number of %s, from 1 on (usually %d)\n", argv[0], argv[at], what, usual);
  std::exit(2);
}

}  // namespace astronav::accuracy
