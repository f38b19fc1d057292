#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Results go to the current folder. ASTRONAV names another binary.
set -euo pipefail
here=$(dirname "$(readlink -f "$0")")
astronav=${ASTRONAV:-$here/../../build/release/astronav}

"$astronav" campaign earth-mars-ballistic --level mil --samples 10 --jobs 2 --out ten
"$astronav" campaign earth-mars-ballistic --level mil --samples 12 --jobs 2 --out ten   # flies only the two that are missing
