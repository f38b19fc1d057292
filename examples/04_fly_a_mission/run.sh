#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Results go to the current folder. ASTRONAV names another binary.
set -euo pipefail
here=$(dirname "$(readlink -f "$0")")
astronav=${ASTRONAV:-$here/../../build/release/astronav}

"$astronav" run --set mission.days=100 --out first
"$astronav" run --set mission.days=100 --level mil --out sights
"$astronav" run sights/scenario.resolved.toml --out again
cmp sights/estimate.oem again/estimate.oem
echo "flown again from its own scenario: the same estimate, byte for byte"
