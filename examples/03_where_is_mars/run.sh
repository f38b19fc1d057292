#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Results go to the current folder. ASTRONAV names another binary.
set -euo pipefail
here=$(dirname "$(readlink -f "$0")")
astronav=${ASTRONAV:-$here/../../build/release/astronav}

"$astronav" ephemeris mars --from earth --epoch "2027-01-01T00:00:00 TDB/2027-04-01T00:00:00 TDB/15d"
"$astronav" beacons earth-mars-ballistic
