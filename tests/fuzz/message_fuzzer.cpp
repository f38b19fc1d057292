// SPDX-License-Identifier: Apache-2.0
// For libFuzzer: tests/fuzz/run.sh builds it with clang and runs it.
#include "fuzz/messages.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  astronav::fuzz::read_messages({data, size});
  return 0;
}
