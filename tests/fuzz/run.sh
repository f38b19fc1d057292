#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Fuzzes the parser of everything that comes over the wire, under AddressSanitizer and UndefinedBehaviorSanitizer:
#   tests/fuzz/run.sh [SECONDS]        600 where none is given
# What is new and worth keeping is added to tests/fuzz/corpus; what fails is left in build/fuzz. Needs clang-14 and
# libclang-rt-14-dev.
set -euo pipefail
cd "$(dirname "$(readlink -f "$0")")/../.."
seconds=${1:-600}
cmake -S . -B build/fuzz -G Ninja -DCMAKE_BUILD_TYPE=RelWithDebInfo -DCMAKE_C_COMPILER=clang-14 -DCMAKE_CXX_COMPILER=clang++-14 \
  -DASTRONAV_FUZZ=ON -DASTRONAV_SANITIZE=address,undefined > build/fuzz.log 2>&1 || { cat build/fuzz.log; exit 1; }
ninja -C build/fuzz message_fuzzer
mkdir -p build/fuzz/found
build/fuzz/message_fuzzer -max_total_time="$seconds" -timeout=10 -rss_limit_mb=2048 -max_len=8192 -print_final_stats=1 \
  -dict=tests/fuzz/words.dict -artifact_prefix=build/fuzz/ build/fuzz/found tests/fuzz/corpus
build/fuzz/message_fuzzer -set_cover_merge=1 -use_counters=0 -max_len=4096 tests/fuzz/corpus build/fuzz/found
